"""How a correlation is written, with its interval and the figures that the interval allows."""

from planish.analyze.light_field import LightField
from planish.core.facts import is_known
from planish.core.numbers import NONE, count, decimals_of_r, fixed, interval_text, number, plain
from planish.results import ComparisonRow, CorrelationRow

Row = CorrelationRow | ComparisonRow


def point_of(row: Row) -> str:
    """Write the point size of a correlation."""
    return plain(round(row.point_um, 4))


def r2_limits(row: Row) -> tuple[float, float] | None:
    """Limits of r²; from 0 on where r may have either sign."""
    if not is_known(row.interval):
        return None
    low, high = sorted(v * v for v in row.interval)
    if not row.direction:
        low = 0.0
    return low, high


def r2_text(row: Row) -> str:
    """Write r² with two decimals, as the page writes it in per cent.

    Three where the interval is narrow.
    """
    return fixed(row.r2, decimals_of_r(r2_limits(row)))


def r2_interval_text(row: Row) -> str:
    """Write the interval of r²."""
    limits = r2_limits(row)
    return interval_text(limits, decimals_of_r(limits))


def r_text(row: Row | LightField) -> str:
    """Write r with two decimals, three where the interval is narrow."""
    return fixed(row.r, decimals_of_r(row.interval))


def r_interval_text(row: Row | LightField) -> str:
    """Write the interval of r."""
    return interval_text(row.interval, decimals_of_r(row.interval))


def rho_text(row: Row) -> str:
    """Write Spearman's rank correlation with as many decimals as r."""
    return fixed(row.rho, decimals_of_r(row.interval))


def r_sentence(row: Row | LightField) -> str:
    """Write ``r = `` with its interval, where it has one."""
    limits_text = f" (95 %: {r_interval_text(row)})" if is_known(row.interval) else ""
    return f"r = {r_text(row)}{limits_text}"


def p_of(row: Row) -> float | None:
    """Return p of a row, after Holm where it stands among others."""
    if isinstance(row, CorrelationRow) and "p_of_table" in row.model_fields_set:
        return row.p_of_table
    return row.p


def p_text(p: float | None) -> str:
    """Write a p with two digits, and small ones as a bound."""
    if p is None or not is_known(p):
        return NONE
    if p < 1e-4:
        return "< 0.0001"
    if p < 0.0995:
        return number(p, 2)
    return fixed(p, 2)


def points_text(row: Row) -> str:
    """Write the points, and how many of them are independent."""
    if not is_known(row.n_eff):
        return count(row.n)
    return f"{count(row.n)}\n{count(round(row.n_eff))}"
