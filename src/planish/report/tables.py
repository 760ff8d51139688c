"""Tables of the page whose rows depend on the run.

They are column status, correlations, comparison and parameters.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

from planish.checks.light import SIDE_LIGHT
from planish.core.facts import is_known
from planish.core.numbers import NONE, capital, fixed, in_words, interval_text, number, plain, unit
from planish.core.status import Status
from planish.core.tables import grouped
from planish.core.typing import Entries, Fields, Texts
from planish.report.relation import largest, written_difference
from planish.report.statement import Row, r_text
from planish.report.summary import Titles, by_pair, headline_pair, titles_of
from planish.report.text import TwoTexts
from planish.results import ComparisonRow, CorrelationRow, Results, SurfaceFacts


class PairLine(NamedTuple):
    """One line of a table of correlations, one row a point size; ``best`` stands out."""

    name: str
    rows: Sequence[Row | None]
    second: str = ""
    before: Texts = ()
    after: Texts = ()
    best: bool = False


# Status of columns -> class of the style; all others are lost
_COLOURS = {
    "measured": "measured",
    "rim": "rim",
    "no_sheet": "none",
    "leaves_volume": "none",
    "normal_leaves_sheet": "normal",
}


def columns(surfaces: SurfaceFacts) -> list[tuple[str, float, str]]:
    """Return the status of the volume's columns.

    Each entry gives the class of the style, the share of all columns, and what the status means.
    """
    names = {status.label: status.sentence for status in Status}
    shares = dict.fromkeys(_COLOURS, 0.0) | surfaces.shares
    return [
        (_COLOURS.get(name, "lost"), share, names.get(name, name))
        for name, share in shares.items()
        if share
    ]


def comparison(results: Results) -> list[PairLine]:
    """Return the registrations that the paper compares, with both point sizes in one line each.

    Before them stands the residual of the marks in um, and behind them how much larger r is with
    the run's own registration, which stands out.
    """
    rows_by_registration = grouped(results.comparison, lambda row: row.registration)
    lines: list[PairLine] = []
    for name, rows in rows_by_registration.items():
        # How much larger r is with the run's own registration, at the largest points.
        row = largest(rows)
        change_text = NONE
        if is_known(row.difference):
            change_text = f"{fixed(row.difference, 3)}\n{interval_text(row.difference_interval, 3)}"
        before = (number(rows[0].marks_rms_um),)
        is_own = name.startswith("flattened")
        lines.append(
            PairLine(capital(name), rows, before=before, after=(change_text,), best=is_own)
        )
    return lines


def comparison_sentence(results: Results) -> str:
    """State what flattening changed over the largest points and over the pixels.

    It compares the run's own registration with the better of those that project the sheet. Empty
    where they were not compared.
    """
    rows = [row for row in results.comparison if row.n and is_known(row.r)]
    sizes = _sizes(rows)  # from the pixel to the largest points
    if not sizes:
        return ""
    flat, projected = _flat_and_projected(rows, sizes[-1])
    if flat is None or projected is None:
        return ""
    text = (
        f"Over points of {plain(projected.point_um)}, r is {r_text(flat)} flattened and"
        f" {r_text(projected)} by the better projection ({projected.registration})"
    )
    if not is_known(projected.difference_interval):
        return f"{text}; it is not known whether they differ."
    low, high = projected.difference_interval  # of r of the run's own less that of this row
    verdict = "not distinguishable" if low <= 0 <= high else "distinguishable"
    text += f". The two r are {verdict}: r changes by {_change_text(projected)}."
    pixel = _flat_and_projected(rows, sizes[0])[1] if len(sizes) > 1 else None
    if pixel is not None and is_known(pixel.difference_interval):
        text += f" At the pixel, {plain(pixel.point_um)}, it changes by {_change_text(pixel)}."
    return text + _side_light_text(results)


def _side_light_text(results: Results) -> str:
    """Say that slopes brighten one side of a thick place, and that a shift can raise r."""
    registrations = [layer.registration for layer in results.layers if layer.registration]
    if not registrations:
        return ""
    lag = registrations[0].lag
    if lag is None or not lag.light >= SIDE_LIGHT:  # NaN: not known
        return ""
    share_text = f"{100 * lag.light:.0f} % of what it shares with the sheet is slopes alone"
    return (
        " The image also shows the slopes of the face, as light from one side does"
        f" ({share_text}): then a map that is displaced towards the light can have a larger r."
        " Judge the registration by its marks."
    )


def _flat_and_projected(
    rows: list[ComparisonRow], point_um: float
) -> tuple[ComparisonRow | None, ComparisonRow | None]:
    """Return the run's own registration and the better projection, at points of one size.

    None of one that is missing. The run's own is called ``flattened`` with its model.
    """
    flat = None
    projected: list[ComparisonRow] = []
    for row in rows:
        if round(row.point_um, 4) != point_um:
            continue
        if row.registration.startswith("flattened"):
            flat = row
        else:
            projected.append(row)
    return flat, max(projected, key=lambda row: row.r2, default=None)


def _change_text(row: ComparisonRow) -> str:
    """Return how much larger r is with the run's own registration than in a row."""
    return f"{fixed(row.difference, 3)} (95 %: {interval_text(row.difference_interval, 3)})"


def correlations(results: Results, titles: Titles) -> list[PairLine]:
    """Return the correlation of every pair of maps, all point sizes in one line each.

    Of two layers, the pair that leads stands out among others.
    """
    has_two_layers = len(results.layers) == 2
    leading: list[CorrelationRow] = []
    if has_two_layers:
        leading = headline_pair(results, results.moving[0])
    sizes = _sizes(results.correlations)
    has_differences = any(row.same_quantity for row in results.correlations)
    lines: list[PairLine] = []
    for group in by_pair(results):
        row = largest(group)
        a, b = titles_of(row, titles)
        name = f"{row.a}: {in_words(a)}"
        second = f"{row.b}: {in_words(b)}"
        # One quantity of two layers needs its name only once.
        needs_one = a == b if row.same_quantity else results.layer(row.b).kind == "image"
        if has_two_layers and needs_one:
            name = a
            second = ""
        rows_by_size = {round(r.point_um, 4): r for r in group}
        rows = [*map(rows_by_size.get, sizes)]
        after = (_difference_text(row),) if has_differences else ()
        is_best = group == leading and len(results.correlations) > len(group)
        lines.append(PairLine(name, rows, second, after=after, best=is_best))
    return lines


def _difference_text(row: CorrelationRow) -> str:
    if not row.same_quantity:
        return NONE
    units = unit(row.units or "")
    mean, spread, low, high = written_difference(row)
    return f"{mean} ± {spread} {units}\n{low} to {high} {units}"


def point_sizes(rows: Iterable[Row]) -> list[str]:
    """Return the point sizes of a table of correlations."""
    return [plain(size_um) for size_um in _sizes(rows)]


def _sizes(rows: Iterable[Row]) -> list[float]:
    return sorted({round(float(row.point_um), 4) for row in rows})


def parameters(values: Fields) -> list[tuple[str, list[TwoTexts]]]:
    """Return every parameter, by section; sections of a list are named by their ``name``.

    Each is a name and a text; parameters of no section come last, as ``others``.
    """
    sections: list[tuple[str, Fields]] = []
    unsectioned: Entries = {}
    for section, value in values.items():
        if isinstance(value, (list, tuple)) and value and isinstance(value[0], Mapping):
            for k, table in enumerate(cast("Sequence[Mapping[str, Any]]", value), 1):
                sections.append((f"{section}, {table.get('name', k)}", table))
        elif isinstance(value, Mapping):
            sections.append((section, cast("Mapping[str, Any]", value)))
        else:
            unsectioned[section] = value
    sections.append(("others", unsectioned))
    rows = [(name, [*_flat_rows(table)]) for name, table in sections]
    return [section for section in rows if section[1]]


def _flat_rows(section: Fields, prefix: str = "") -> Iterator[TwoTexts]:
    """Write a section of parameters.

    What lies in a section of its own has that one's name before it.
    """
    for key, value in section.items():
        if isinstance(value, Mapping):
            yield from _flat_rows(cast("Mapping[str, Any]", value), f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", _parameter_text(value, key)


def _parameter_text(value: Any, key: str) -> str:
    """Write a parameter with its unit, which its key states; an element of a list has no key."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        value_text = ", ".join(_parameter_text(v, "") for v in cast("list[Any]", value))
    elif isinstance(value, (int, float)):
        value_text = f"{value:.6g}".replace("-", "−")
    else:
        value_text = str(value)
    if key.endswith("_um"):
        value_text += f" {unit('um')}"
    return value_text
