"""Errors of what brings volume and image, or two volumes, together: holes, registration, resampling, statistic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planish.analyze import correlate, pearson
from planish.core.grid import Grid, pitch, values_at
from planish.marks import find_holes
from planish.pipeline import Run
from planish.register import FittedTransform, fit_transform
from planish.resample import find_places, resample
from planish.synthetic import InstrumentFiles, Specimen
from planish.validate.figures import Values
from planish.validate.scenario import PAIR
from planish.validate.truth import (
    FITTED,
    THICKNESSES,
    Comparison,
    mean_of,
    percentile,
    rms,
    three,
    true_thickness,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SAME_HOLE_UM = 60.0  # a third of a hole: nearer than that it is the same one
_MOST_COLUMNS = 1_500_000  # whose material is found one by one for the resampling
_LEAST_THIN = 0.002  # of the valid pixels: with fewer, the thin region is some specks
_PARTS = 4  # points on the stretch of an outline within one cell: so close that the nearest one is as good as the line
_RING = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=1)


def pixel_errors(both: Comparison) -> Values:
    """Linked thicknesses against those of the material that each pixel shows, and the region of thin coating."""
    values: Values = {}
    for name in THICKNESSES:
        found, true = both.linked_values(name), both.pixel_thickness(name, *both.true_uv)
        values |= three(f"pixel_{name}", found - true)
        if name != "coating_top":
            continue
        thin_um = both.run.study.correlate.thin_um
        known = np.isfinite(found) & np.isfinite(true)
        count = int(np.count_nonzero(known))
        if count and np.count_nonzero(true[known] < thin_um) >= _LEAST_THIN * count:
            values["thin_dice"] = dice(found < thin_um, (true < thin_um) & known)
            values["thin_lag"] = outline_lag(found, np.where(known, true, np.nan), thin_um, pitch(both.linked))
    return values


def dice(one: Mask, two: Mask) -> float | None:
    """Twice the common area over the sum of both; None where both are empty."""
    total = int(one.sum()) + int(two.sum())
    return 2.0 * int((one & two).sum()) / total if total else None


def outline_lag(one: Array, two: Array, level: float, pitch_um: tuple[float, float]) -> float | None:
    """Median distance in um between the contour lines of two maps at ``level``, taken from both sides.

    No line passes where a map is NaN; None where one of them has no contour. ``pitch_um`` is that of rows and columns.
    """
    a, b = (contour_points(m, level) * np.array(pitch_um) for m in (one, two))
    if not len(a) or not len(b):
        return None
    away = np.concatenate([KDTree(b).query(a)[0], KDTree(a).query(b)[0]])
    return float(np.median(away))


def contour_points(values: Array, level: float) -> Array:
    """Points (n, 2) as (row, col), in pixels, close together on the contour lines of a map."""
    from contourpy import LineType, contour_generator

    lines = contour_generator(z=np.ma.masked_invalid(values), line_type=LineType.Separate).lines(level)
    share = (np.arange(_PARTS) + 0.5)[:, None] / _PARTS
    points = [start + share * (end - start) for line in lines for start, end in pairwise(np.asarray(line))]
    return np.concatenate(points)[:, ::-1] if points else np.empty((0, 2))


def hole_errors(both: Comparison) -> Values:
    """What hole finding gives on either side, against the true holes; it is asked again as the run asks it."""
    linked, maps, specimen = both.linked, both.groups["maps"], both.specimen
    hole_um = both.run.study.holes.hole_um
    true = specimen.sheet.holes
    radius = 0.5 * float(np.mean(hole_um))
    y, x = linked["y"].values, linked["x"].values
    pixel = pitch(linked)
    holes = find_holes(np.asarray(linked["image"].values), pixel_um=pixel, diameter_um=hole_um)
    in_image = np.asarray(specimen.pose.inverse(_xy(holes)), dtype=np.float64).reshape(-1, 2)
    places = specimen.pose(true)
    inside = np.all((places > radius) & (places < [x[-1] - radius, y[-1] - radius]), axis=1)
    values = _found(in_image, true, inside, "image")
    holes = find_holes(maps["presence"].values, pixel_um=pitch(maps)[1], diameter_um=hole_um, polarity="dark")
    moving = _xy(holes) + np.array([maps["u"].values[0], maps["v"].values[0]])
    volume = values_at(maps, ("volume_x", "volume_y", "volume_z"), moving)
    in_sheet = both.material_at(volume)[:, :2]
    known = both.material[np.isfinite(both.material[..., 0])][:, :2]
    ring = true[:, None] + np.concatenate([np.zeros((1, 2)), radius * _RING])
    reach = np.asarray(KDTree(known).query(ring.reshape(-1, 2))[0]).reshape(len(true), -1)
    values |= _found(in_sheet, true, np.all(reach < 2.0 * max(both.pitch_um), axis=1), "volume")
    sides = [values.get(f"fle_{side}") for side in ("image", "volume")]
    if sides[0] is not None and sides[1] is not None:
        values["fle_pair"] = float(np.hypot(sides[0], sides[1]))
    return values


def _found(found: Array, true: Array, inside: Mask, side: str) -> Values:
    """Recall, false ones and localisation error of one side; all places are material (u, v) in um."""
    found = found[np.isfinite(found).all(axis=1)]
    if not len(true):
        return {f"false_{side}": float(len(found))}
    away = np.linalg.norm(found[:, None] - true[None], axis=-1)
    right = away.min(axis=1) < _SAME_HOLE_UM
    hit = np.zeros(len(true), dtype=bool)
    hit[away.argmin(axis=1)[right]] = True
    errors = away.min(axis=1)[right]
    return {
        f"recall_{side}": float((hit & inside).sum() / inside.sum()) if inside.any() else None,
        f"false_{side}": float(np.count_nonzero(~right)),
        f"fle_{side}": rms(errors),
    }


def registration_errors(both: Comparison) -> Values:
    """Error of every pixel in the sheet, what the marks say of it, and what it would be without flattening."""
    fit, linked, away = both.fit, both.linked, both.away_um
    expected = rms(linked["expected_error"].values[both.valid].astype(np.float64)) if both.valid.any() else None
    true, scale = rms(away), _true_scale(both)
    return {
        "tre_median": percentile(away, 50),
        "tre_p95": percentile(away, 95),
        "tre_max": percentile(away, 99.9),
        "tre_rms": true,
        "fre_rms": fit.rms_um,
        "loo_rms": rms(fit.leave_one_out_um),
        "predicted_rms": expected,
        "predicted_ratio": true / expected if true is not None and expected else None,
        "scale_deviation": 100.0 * (fit.transform.scale / scale - 1.0) if scale else None,
        "tre_projection_p95": _projection_error(both, fit, scale),
    }


def _true_scale(both: Comparison) -> float | None:
    """Scale of the similarity that is nearest to the true pose over the valid pixels."""
    uv = np.stack([values[both.valid] for values in both.true_uv], axis=1)
    if len(uv) < 3:
        return None
    uv = uv[:: max(1, len(uv) // FITTED)]
    return fit_transform(uv, both.specimen.pose(uv), mirrored=None, robust=False).transform.scale


def _projection_error(both: Comparison, fit: FittedTransform, scale: float | None) -> float | None:
    """95th percentile over the columns that the image shows; the distance in the image, brought to the sheet."""
    names = ("projected_u", "projected_v")
    marks = values_at(both.groups["maps"], names, fit.moving)
    if scale is None or not np.isfinite(marks).all():
        return None
    projected = fit_transform(marks, fit.fixed, mirrored=fit.transform.mirrored, robust=False)
    from_run = np.stack([both.take(both.groups["flat"][name].values) for name in names], axis=-1)
    known = both.measured & np.isfinite(both.material[..., 0]) & np.isfinite(from_run).all(axis=-1)
    there = both.specimen.pose(both.material[known][:, :2])
    x, y = (both.linked[d].values for d in "xy")
    inside = np.all((there >= 0) & (there <= [x[-1], y[-1]]), axis=1)
    return percentile(np.linalg.norm(projected(from_run[known]) - there, axis=1)[inside] / scale, 95)


def resampling_errors(both: Comparison) -> Values:
    """Give the columns their true thickness, resample it as the run does, compare with the truth at each pixel."""
    surfaces, flat, linked = (both.groups[name] for name in ("surfaces", "flat", "linked"))
    name = "coating_top" if np.isfinite(linked["coating_top"].values).any() else "thickness"
    height, width = surfaces["centre"].shape
    most = min(height, max(2, _MOST_COLUMNS // width))
    rows, cols = np.arange(most) + (height - most) // 2, np.arange(width)
    centre = np.asarray(surfaces["centre"].values[rows], dtype=np.float64)
    u, v, _ = np.moveaxis(both.material_at(both.places(centre, rows, cols)), -1, 0)
    fit = both.fit
    uv = np.stack([flat["u"].values[rows], flat["v"].values[rows]], axis=-1)
    places = find_places(fit.transform(uv), Grid.of(linked), least_um=min(pitch(surfaces)) * fit.transform.scale)
    carried = resample(true_thickness(both.specimen.sheet, name, u, v), places)
    there = both.pixel_thickness(name, both.found[..., 0], both.found[..., 1])
    errors = np.where(both.valid, carried - there, np.nan)
    return {"resampling_rmse": rms(errors), "resampling_p95": percentile(errors, 95)}


def statistic_errors(both: Comparison) -> Values:
    """Correlation with the image of the measured and of the true map, over the same pixels and the run's points."""
    image, pixel = np.asarray(both.linked["image"].values, dtype=np.float64), pitch(both.linked)
    found = both.linked_values(both.headline)
    true = np.where(np.isfinite(found), both.pixel_thickness(both.headline, *both.true_uv), np.nan)
    point_um = both.run.study.correlate.point_um
    values: Values = {}
    for key, (one, two) in {
        "pixel": [pearson(m, image) for m in (found, true)],
        "point": [correlate(m, image, pixel_um=pixel, point_um=point_um).r for m in (found, true)],
    }.items():
        known = np.isfinite(one) and np.isfinite(two)
        found_r = (one, two, one - two) if known else (None, None, None)
        values |= dict(zip((f"r_{key}", f"r_true_{key}", f"r_difference_{key}"), found_r, strict=True))
    return values


def pair_errors(made: Sequence[tuple[Specimen, InstrumentFiles]], run: Run) -> Values:
    """Errors of two linked volumes of one sheet; places and thicknesses against the truth of the sheet."""
    maps = [run.groups[f"layers/{name}"] for name in PAIR]
    valid = maps[0]["valid"].values & maps[1]["valid"].values
    values: Values = {}
    shown: list[Array] = []
    for name, (specimen, files), data in zip(PAIR, made, maps, strict=True):
        places = np.stack([data[f"volume_{axis}"].values[valid] for axis in ("x", "y", "z")], axis=-1)
        both = Comparison(specimen, files, replace(run, groups=run.sheets[name].groups))
        shown.append(both.material_at(places.astype(np.float64)))
        true = true_thickness(specimen.sheet, "coating_top", shown[-1][..., 0], shown[-1][..., 1])
        values[f"pair_coating_{name}_bias"] = mean_of(data["coating_top"].values[valid] - true)
    off = np.hypot(*(shown[0] - shown[1])[..., :2].T)
    values["pair_median"], values["pair_p95"], values["pair_rms"] = percentile(off, 50), percentile(off, 95), rms(off)
    values["pair_predicted_rms"] = rms(maps[0]["expected_error"].values[valid].astype(np.float64))
    rows = [row for row in run.results.correlations if row.a_map == "coating_top"]
    if rows:
        values["pair_r"], values["pair_r_point"] = rows[0].r, rows[1].r
        values["pair_difference_sd"] = rows[0].difference_sd
    return values


def _xy(holes: xr.Dataset) -> Array:
    return np.stack([holes["x"].values, holes["y"].values], axis=1).astype(np.float64).reshape(-1, 2)
