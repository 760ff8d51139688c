"""Two layers on one grid against each other: correlation, differences of equal quantities, and their lag."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from planish.analyze import correlate, correlate_at
from planish.core.grid import pitch
from planish.marks import Side
from planish.measure import PROPERTIES
from planish.pipeline.grid import agreement, headline_of
from planish.pipeline.run import Array

_FEW = 12  # points
_LIMITS = 1.96  # standard deviations of differences that hold 95 % of normal ones (Bland and Altman 1986)


def side_seen(a: xr.Dataset, b: xr.Dataset) -> Side:
    """Side of the sheet that a pair is about: the one that an image shows, or the top."""
    faces = [data.attrs.get("faces") for data in (a, b) if "image" in data]
    return "bottom" if "bottom" in faces else "top"


def likeness(a: xr.Dataset, b: xr.Dataset, point_um: float) -> dict[str, float] | None:
    """How much two sheets look like one: r of their thickness, and of their coatings side by side and crosswise.

    Over points of ``point_um``, or pixels where too few of those are known. None for others than two sheets.
    """
    if "thickness" not in a or "thickness" not in b:
        return None
    pixel = pitch(a)
    valid = a["valid"].values & b["valid"].values

    def r(of_a: str, of_b: str) -> float:
        p, q = (np.where(valid, d[n].values.astype(np.float64), np.nan) for d, n in ((a, of_a), (b, of_b)))
        coarse = correlate_at(p, q, pixel_um=pixel, point_um=point_um)[0]
        return coarse.r if coarse.n >= _FEW else correlate(p, q, point_um=point_um).r

    sides = ("coating_top", "coating_bottom")
    return {
        "thickness": r("thickness", "thickness"),
        "same_sides": float(np.mean([r(side, side) for side in sides])),
        "crosswise": float(np.mean([r(sides[k], sides[1 - k]) for k in (0, 1)])),
    }


def compare(a: str, b: str, maps: dict[str, xr.Dataset], point_um: float) -> list[dict[str, Any]]:
    """Correlate two layers: the same properties of two sheets, or what stands for each of the two."""
    first, second = maps[a], maps[b]
    shared = [name for name in PROPERTIES if name in first and name in second]
    side = side_seen(first, second)
    names = [(name, name) for name in shared] or [(headline_of(first, side), headline_of(second, side))]
    valid = first["valid"].values & second["valid"].values
    pixel = pitch(first)
    rows: list[dict[str, Any]] = []
    for of_a, of_b in names:
        p, q = (np.where(valid, d[n].values.astype(np.float64), np.nan) for d, n in ((first, of_a), (second, of_b)))
        if not (np.isfinite(p) & np.isfinite(q)).any():
            continue
        coarse, *means = correlate_at(p, q, pixel_um=pixel, point_um=point_um)
        same = of_a == of_b and of_a in PROPERTIES
        for row, (u, v) in ((correlate(p, q, point_um=float(np.sqrt(pixel[0] * pixel[1]))), (p, q)), (coarse, means)):
            found = {"a": a, "a_map": of_a, "b": b, "b_map": of_b, **row.to_dict(), "same_quantity": same}
            rows.append(found | (_differences(u, v, str(first[of_a].attrs.get("units", "1"))) if same else {}))
    return rows


def _differences(a: Array, b: Array, units: str) -> dict[str, Any]:
    """Mean and spread of b - a, and the limits of agreement."""
    off = (b - a)[np.isfinite(a) & np.isfinite(b)]
    mean = float(off.mean()) if off.size else None
    sd = float(off.std(ddof=1)) if off.size > 1 else None
    limits = None if mean is None or sd is None else [mean - _LIMITS * sd, mean + _LIMITS * sd]
    return {"difference_mean": mean, "difference_sd": sd, "limits": limits, "units": units}


def lag_between(name: str, reference: str, maps: dict[str, xr.Dataset]) -> dict[str, Any]:
    """Whether a layer and the reference themselves agree that they lie right."""
    a, b = maps[name], maps[reference]
    side = side_seen(a, b)
    own, other = headline_of(a, side), headline_of(b, side)
    found = agreement(
        a[own].values, b[other].values, a["valid"].values & b["valid"].values,
        pitch(a), a["expected_error"].values, own,
    )  # fmt: skip
    return {"a": name, "b": reference, **(found or {})}
