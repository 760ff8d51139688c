"""Figures of a certificate: one specimen with its errors, true against expected error, and a row of dots."""

from __future__ import annotations

import numpy as np

from planish.report.colours import ERROR, GREYS, SIGNED, Array, Scale, limits
from planish.report.draw import (
    ACCENT,
    BESIDE,
    FAINT,
    HALF,
    INK,
    SOFT,
    Canvas,
    Picture,
    half_page,
    reduced,
)  # fmt: skip
from planish.report.text import length, number, plain
from planish.validate.certify import Certificate, Example

_NAMES = {"coating_top": "coating thickness", "thickness": "sheet thickness"}
_DOTS = (150.0, 16.0)  # CSS pixels of a row of dots
_DOT_MARGIN = 6.0


def draw_example(example: Example) -> list[Picture]:
    """Draw what the image showed, what was measured, and how far off place and thickness are."""
    name = _NAMES.get(example.name, example.name)
    rows, cols = (np.arange(n) * p for n, p in zip(example.image.shape, example.pixel_um, strict=True))
    valid = example.image[np.isfinite(example.found_um)]

    def draw(values: Array, scale: Scale, label: str, title: str, caption: str) -> Picture:
        canvas, _ = half_page(reduced(values, rows, cols, width=HALF - BESIDE), scale=scale, label=label)
        return canvas.picture(title=title, caption=caption)

    pixel = plain(round(example.pixel_um[1], 4))
    worst = _percentile(example.away_um, 99.9)
    spread = example.error_um[np.isfinite(example.error_um)]
    bias = float(spread.mean()) if spread.size else None
    return [
        draw(
            example.image, limits(valid if valid.size else example.image, GREYS, percent=0.2), "",
            "(a) The image of one specimen", f"Seed {example.seed}; pixels of {pixel}.",
        ),
        draw(
            example.found_um, limits(example.found_um), "µm", f"(b) Measured {name}",
            "On the image's pixels; grey is not valid: holes with their rims, and what lies beside the volume.",
        ),
        draw(
            example.away_um, Scale(0.0, max(worst, 1e-6), ERROR), "µm", "(c) Error of place",
            "Distance in the sheet between the material that a pixel shows and the one whose thickness it was given; "
            f"99.9 % of the pixels are below {length(worst)}.",
        ),
        draw(
            example.error_um, limits(example.error_um, SIGNED, symmetric=True), "µm", f"(d) Error of the {name}",
            f"Measured minus true; {length(bias)} in the mean.",
        ),
    ]  # fmt: skip


def draw_expected(certificate: Certificate) -> Picture | None:
    """Draw the true error of registration over the one that each run expects; None without a pair of them."""
    pairs = [
        (one, two)
        for entry in certificate.entries
        if (one := entry.values.get("predicted_rms")) is not None and (two := entry.values.get("tre_rms")) is not None
    ]
    if not pairs:
        return None
    expected, true = np.array(pairs).T
    high = 1.15 * float(max(expected.max(), true.max()))
    canvas = Canvas(HALF, 390)
    axes = canvas.axes(62, 10, 320, 320, (0, high, 0, high))
    axes.area([(0, 0), (high, 0.8 * high), (high, 1.25 * high)], colour=FAINT, opacity=0.45)
    axes.line([(0, 0), (high, high)], colour=SOFT, width=1.2)
    axes.dots(np.array(pairs), colour=INK, size=7)
    canvas.ticks(axes, "error that the run expects from its marks / µm", "true error / µm")
    ratio = float(np.sqrt(np.mean(true**2) / np.mean(expected**2)))
    return canvas.picture(
        title="True against expected error of registration",
        caption=f"rms over the pixels, one point a specimen (n = {len(pairs)}). On the line a run knows how good it "
        "is; the band is 0.8 to 1.25 times. Above it a run is too sure of itself: its marks cannot know what is off "
        f"between them. Over all specimens the true error is {number(ratio, 2)} times the expected one.",
    )


def dots(values: tuple[float | None, ...], bound: float | None) -> str:
    """Return a row of dots as SVG: one a seed, a long tick at 0 and a red one at the limit; empty without a value."""
    known = [value for value in values if value is not None]
    if not known:
        return ""
    width, height = _DOTS
    ends = [0.0, *known]
    if bound is not None:
        ends += [bound, -bound] if min(known) < 0 else [bound]
    low, high = min(ends), max(ends)
    span = (high - low) or 1.0

    def at(value: float) -> float:
        return _DOT_MARGIN + (value - low) / span * (width - 2 * _DOT_MARGIN)

    middle = height / 2
    parts = [
        f'<line x1="{_DOT_MARGIN}" x2="{width - _DOT_MARGIN}" y1="{middle}" y2="{middle}" stroke="{FAINT}"/>',
        f'<line x1="{at(0):.1f}" x2="{at(0):.1f}" y1="3" y2="{height - 3}" stroke="{SOFT}"/>',
    ]
    if bound is not None:
        for limit in [bound, -bound] if min(known) < 0 and bound else [bound]:
            x = f"{at(limit):.1f}"
            parts.append(f'<line x1="{x}" x2="{x}" y1="1" y2="{height - 1}" stroke="{ACCENT}" stroke-width="2"/>')
    parts += [f'<circle cx="{at(v):.1f}" cy="{middle}" r="3.2" fill="{INK}" fill-opacity="0.55"/>' for v in known]
    size = f'width="{width:g}" height="{height:g}" viewBox="0 0 {width:g} {height:g}"'
    return f'<svg {size} role="img" aria-label="{len(known)} specimens">{"".join(parts)}</svg>'


def _percentile(values: Array, percent: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if known.size else 1.0
