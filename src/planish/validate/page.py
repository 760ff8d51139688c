"""The certificate as one HTML file that needs nothing else.

It is styled as the report of a run, with its figures.
"""

from collections.abc import Sequence

import numpy as np

from planish import __version__
from planish.core.numbers import number
from planish.report.draw import ACCENT, FAINT, HALF, INK, SOFT, Canvas, Picture
from planish.report.text import template
from planish.synthetic.presets import NUISANCES, PRESETS
from planish.validate import table as tables
from planish.validate.certify import Certificate, Entry, Sensitivity
from planish.validate.scenario import FIGURES, STAGES

_DOT_MARGIN = 6.0


def draw_expected(entries: Sequence[Entry]) -> Picture | None:
    """Draw the true error of registration over the one that each run expects.

    None without a pair of them: a specimen that was refused has neither.
    """
    known_pairs: list[tuple[float, float]] = []
    for entry in entries:
        expected, true = (entry.values.get(name) for name in ("predicted_rms", "tre_rms"))
        if expected is not None and true is not None:
            known_pairs.append((expected, true))
    if not known_pairs:
        return None
    pairs = np.array(known_pairs)
    high = 1.15 * float(pairs.max())
    canvas = Canvas(HALF, 390)
    axes = canvas.axes(62, 10, 320, 320, (0, high, 0, high))
    band = [(0, 0), (high, 0.8 * high), (high, 1.25 * high)]
    axes.area(band, colour=FAINT, opacity=0.45)
    axes.line((0, high), (0, high), width=1.2)
    axes.dots(*np.transpose(pairs), colour=INK, size=7)
    canvas.ticks(axes, "error that the run expects from its marks / µm", "true error / µm")
    expected_square, true_square = np.mean(pairs**2, axis=0)
    ratio = float(np.sqrt(true_square / expected_square))
    return canvas.picture(
        title="True against expected error of registration",
        caption=(
            f"rms over the pixels, one point a specimen (n = {len(pairs)}). On the line a run knows"
            " how good it is; the band is 0.8 to 1.25 times. Above it a run is too sure of itself:"
            " its marks cannot know what is off between them. Over all specimens the true error is"
            f" {number(ratio, 2)} times the expected one."
        ),
    )


def dots(seed_values: Sequence[float], bound: float | None) -> str:
    """Return a row of dots as SVG: one a seed, a tick at 0 and a longer red one at the limit.

    Empty without a value. A limit of values that may be negative bounds both ends.
    """
    if not seed_values:
        return ""
    width, height = 150.0, 16.0  # CSS pixels of a row of dots
    bounds = [] if bound is None else [bound]
    if bound and min(seed_values) < 0:
        bounds.append(-bound)
    low = min(0.0, *seed_values, *bounds)
    high = max(0.0, *seed_values, *bounds)
    span = (high - low) or 1.0

    def tick(value: float, top: float, style: str) -> str:
        return (
            f'<line x1="{x_of(value)}" x2="{x_of(value)}" y1="{top:g}" y2="{height - top:g}"'
            f" {style}/>"
        )

    def x_of(value: float) -> str:
        return f"{_DOT_MARGIN + (value - low) / span * (width - 2 * _DOT_MARGIN):.1f}"

    middle = height / 2
    elements = [
        f'<line x1="{_DOT_MARGIN}" x2="{width - _DOT_MARGIN}" y1="{middle}" y2="{middle}"'
        f' stroke="{FAINT}"/>'
    ]
    elements.append(tick(0.0, 3, f'stroke="{SOFT}"'))
    elements += [tick(limit, 1, f'stroke="{ACCENT}" stroke-width="2"') for limit in bounds]
    dot = f'cy="{middle}" r="3.2" fill="{INK}" fill-opacity="0.55"'
    elements += [f'<circle cx="{x_of(v)}" {dot}/>' for v in seed_values]
    size = f'width="{width:g}" height="{height:g}" viewBox="0 0 {width:g} {height:g}"'
    return (
        f'<svg {size} role="img" aria-label="{len(seed_values)}'
        f' specimens">{"".join(elements)}</svg>'
    )


def render_page(certificate: Certificate, table: Sensitivity | None = None) -> str:
    """Render a certificate as a page; the same certificate gives the same bytes.

    Parameters
    ----------
    certificate : Certificate
    table : Sensitivity, optional; shown below the figures

    Returns
    -------
    str; the text of an HTML file
    """
    heat_rows: list[list[tuple[str, bool]]] = []
    if table is not None:
        for row in table.rows:
            # Three times the baseline is the darkest cell of the heat table.
            heat_row: list[tuple[str, bool]] = []
            for stage in row.added:
                shade = min(1.0, row.growth.get(stage, 0.0) / 3.0)
                heat_row.append((f"{shade:.3f}", row.suffers == stage))
            heat_rows.append(heat_row)
    scenario, entries = certificate.scenario, certificate.entries
    page = template("planish.validate", "certificate.html.j2").render(
        certificate=certificate,
        scenario=scenario,
        params=scenario.params(0),
        lines=certificate.lines(),
        table=table,
        heat=heat_rows,
        tables=tables,
        dots=dots,
        stages=STAGES,
        described=FIGURES,
        presets=PRESETS,
        version=__version__,
        nuisances=[NUISANCES[name].title for name in scenario.active],
        expected=draw_expected(entries),
        pictures=next((entry.pictures for entry in entries if entry.pictures), ()),
    )
    return f"{page}\n"
