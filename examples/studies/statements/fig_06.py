"""Fig.

6: how much darker the image is where little coating lies, and whether the dark lies in the same
places.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from planish.analyze import Lag, texture_lag
from planish.texture import textures

from .common import draw_map, extent_mm, interval, known, one_run, pitch
from .truth import sentence

THIN_UM, REACH_UM = 5.0, 100.0
# Standard errors within which 95 % of normal points of a plane lie.
WITHIN = math.sqrt(-2 * math.log(0.05))


def state(folder: Path, figure: Figure) -> str:
    """Compare places with less than 5 um of coating with the rest."""
    run = one_run(folder)
    linked = run.groups["linked"]
    coating, image, face = (
        known(linked, name) for name in ("coating_top", "image", "topography_top")
    )
    thin = np.where(np.isfinite(coating), coating < THIN_UM, np.nan)
    # Light from one side makes the slopes of the face bright and dark, which alone would move the
    # outlines.
    shown = textures(
        {"outlines": thin, "image": image, "face": face}, linked.valid.values, pitch(linked)
    )
    lag = texture_lag(
        shown.with_slopes("face"),
        ["outlines", "face_x", "face_y"],
        "image",
        slopes=2,
        reach_um=REACH_UM,
    )
    (found,) = [one for one in run.results.evidence[0].thin if one.thinner_than_um == THIN_UM]
    mean = float(np.nanmean(image))
    darker, *limits = (-100 * v / mean for v in (found.difference, *reversed(found.interval)))

    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    draw_map(left, linked, coating, low=0.0)
    draw_map(right, linked, image)
    x0, x1, y1, y0 = extent_mm(linked)
    rows, cols = coating.shape
    right.contour(
        np.linspace(x0, x1, cols),
        np.linspace(y0, y1, rows),
        np.nan_to_num(coating, nan=99.0),
        levels=[THIN_UM],
        colors="C1",
        linewidths=0.7,
    )
    left.set(title="Coating thickness", xlabel="x / mm", ylabel="y / mm")
    right.set(title=f"Image, coating below {THIN_UM:g} µm outlined", xlabel="x / mm")
    return (
        f"Where the coating is thinner than {THIN_UM:g} um ({100 * found.share:.1f} % of the area),"
        f" the image is {darker:.1f} % darker (95 % interval {interval((limits[0], limits[1]), 1)}"
        f" %). {_place(lag)}{sentence([run])}"
    )


def _place(lag: Lag) -> str:
    """How far the dark places lie beside the outlines."""
    if not lag.distinct:
        return f"How far the dark places lie beside the outlines is inconclusive ({lag.reason})."
    (x, y), (sx, sy) = lag.lag_um, lag.se_um
    largest = math.sqrt(float(np.linalg.eigvalsh(lag.covariance_um2)[-1]))
    return (
        f"The dark places lie {lag.length_um:.1f} um beside the outlines "
        f"(x {x:.1f} um, 95 % interval {interval((x - 1.96 * sx, x + 1.96 * sx), 1)}; "
        f"y {y:.1f} um, {interval((y - 1.96 * sy, y + 1.96 * sy), 1)}), with 95 % at most "
        f"{lag.length_um + WITHIN * largest:.1f} um."
    )
