"""How a correlation is written: with its interval, and with the figures that the interval allows."""

import math

from planish.core.facts import is_known
from planish.core.numbers import MOST_DECIMALS, NONE, count, decimals_of_r, fixed, interval_text, number
from planish.results import ComparisonRow, CorrelationRow

Row = CorrelationRow | ComparisonRow


def decimals(row: Row) -> int:
    """Decimals of r² that its interval allows: those of one significant digit of half its width."""
    limits = r2_limits(row)
    half_width = (limits[1] - limits[0]) / 2 if limits else 0.0
    return min(max(-math.floor(math.log10(half_width)), 1), MOST_DECIMALS) if half_width > 0 else 2


def r2_limits(row: Row) -> tuple[float, float] | None:
    """Limits of r²; from 0 on where r may have either sign."""
    if not is_known(row.interval):
        return None
    low, high = sorted(v * v for v in row.interval)
    return (low if row.direction else 0.0, high)


def r2_text(row: Row | None) -> str:
    """Write r² as far as it is known."""
    return NONE if row is None else fixed(row.r2, decimals(row))


def r2_interval_text(row: Row | None) -> str:
    """Write the interval of r²."""
    return NONE if row is None else interval_text(r2_limits(row), decimals(row))


def r_text(row: Row | None) -> str:
    """Write r with two decimals, three where the interval is narrow."""
    return NONE if row is None else fixed(row.r, decimals_of_r(row.interval))


def r_interval_text(row: Row | None) -> str:
    """Write the interval of r."""
    return NONE if row is None else interval_text(row.interval, decimals_of_r(row.interval))


def r_sentence(row: Row) -> str:
    """Write ``r = `` with its interval, where it has one."""
    limits_text = f" (95 %: {r_interval_text(row)})" if is_known(row.interval) else ""
    return f"r = {r_text(row)}{limits_text}"


def p_text(p: float | None) -> str:
    """Write a p with two digits, and small ones as a bound."""
    if p is None or not is_known(p):
        return NONE
    return "< 0.0001" if p < 1e-4 else number(p, 2) if p < 0.0995 else fixed(p, 2)


def points_text(row: Row | None) -> str:
    """Write the points, and how many of them are independent."""
    if row is None:
        return NONE
    return count(row.n) if not is_known(row.n_eff) else f"{count(row.n)}\n{count(round(row.n_eff))}"
