"""Errors of the stages that bring volume and image together: holes, registration, resampling, statistic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planish.analyze import correlate, correlate_at
from planish.core.grid import Grid, pitch, values_at
from planish.marks import find_holes
from planish.pipeline import Run
from planish.register import FittedTransform, fit_transform
from planish.resample import find_places, resample
from planish.synthetic import InstrumentFiles, Specimen
from planish.validate.figures import THICKNESSES
from planish.validate.outlines import dice, outline_lag
from planish.validate.spread import Values, percentile, rms, three
from planish.validate.truth import (
    Lattice,
    file_points,
    material_at,
    pixel_offsets,
    pixel_thickness,
    true_thickness,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SAME_HOLE_UM = 60.0  # a third of a hole: nearer than that it is the same one
_MOST_COLUMNS = 1_500_000  # whose material is found one by one for the resampling
_LEAST_THIN = 0.002  # of the valid pixels: with fewer, the thin region is some specks
_RING = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pixels:
    """The image's pixels as the run and the truth see them, all (rows, cols).

    Attributes
    ----------
    valid : bool
    u, v : float64
        True material of the pixel in um.
    found : (rows, cols, 3)
        Material (u, v, s) at the place in the volume that the run gives for the pixel; NaN where it is not valid.
    offsets : (k, 2)
        See :func:`planish.validate.truth.pixel_offsets`.
    """

    valid: Mask
    u: Array
    v: Array
    found: Array
    offsets: Array


def make_pixels(specimen: Specimen, files: InstrumentFiles, groups: dict[str, xr.Dataset]) -> Pixels:
    """Find the material at the place in the volume that a run gives for each valid pixel."""
    linked = groups["linked"]
    valid = linked["valid"].values.astype(bool)
    places = np.stack([linked[f"volume_{axis}"].values for axis in ("x", "y", "z")], axis=-1)
    places = np.where(valid[..., None], places, np.nan)
    return Pixels(
        valid=valid,
        u=np.asarray(specimen.truth["u"].values, dtype=np.float64),
        v=np.asarray(specimen.truth["v"].values, dtype=np.float64),
        found=material_at(specimen, files, places, groups.get("sections")),
        offsets=pixel_offsets(specimen),
    )


def refit(run: Run) -> FittedTransform:
    """The transformation of a run, fitted again to its own marks."""
    assert run.marks is not None
    moving, fixed = (np.stack([run.marks[f"{side}_{a}"].values for a in "xy"], axis=1) for side in ("moving", "fixed"))
    return fit_transform(
        moving,
        fixed,
        model=run.study.registration.model,
        mirrored=bool(run.results["marks"]["mirrored"]),
        lowest="similarity",
    )


def pixel_errors(specimen: Specimen, run: Run, pixels: Pixels) -> Values:
    """Linked thicknesses against those of the material that each pixel shows, and the region of thin coating."""
    linked, values = run.groups["linked"], Values()
    for name in THICKNESSES:
        found = np.where(pixels.valid, np.asarray(linked[name].values, dtype=np.float64), np.nan)
        true = pixel_thickness(specimen.sheet, name, pixels.u, pixels.v, pixels.offsets)
        values |= three(f"pixel_{name}", found - true)
        if name != "coating_top":
            continue
        thin_um = run.study.correlate.thin_um
        known = np.isfinite(found) & np.isfinite(true)
        count = int(np.count_nonzero(known))
        if count and np.count_nonzero(true[known] < thin_um) >= _LEAST_THIN * count:
            values["thin_dice"] = dice(found < thin_um, (true < thin_um) & known)
            values["thin_lag"] = outline_lag(found, np.where(known, true, np.nan), thin_um, pitch(linked))
    return values


def hole_errors(specimen: Specimen, files: InstrumentFiles, run: Run, lattice: Lattice) -> Values:
    """What hole finding gives on either side, against the true holes; it is asked again as the run asks it."""
    linked, maps = run.groups["linked"], run.groups["maps"]
    hole_um = run.study.registration.hole_um
    true = specimen.sheet.holes
    radius = 0.5 * float(np.mean(hole_um))
    y, x = linked["y"].values, linked["x"].values
    pixel = pitch(linked)
    seen = find_holes(np.asarray(linked["image"].values), pixel_um=pixel, diameter_um=hole_um)
    in_image = np.asarray(specimen.pose.inverse(_xy(seen)), dtype=np.float64).reshape(-1, 2)
    places = specimen.pose(true)
    inside = np.all((places > radius) & (places < [x[-1] - radius, y[-1] - radius]), axis=1)
    values = _found(in_image, true, inside, "image")
    seen = find_holes(maps["presence"].values, pixel_um=pitch(maps)[1], diameter_um=hole_um, polarity="dark")
    moving = _xy(seen) + np.array([maps["u"].values[0], maps["v"].values[0]])
    volume = values_at(maps, ("volume_x", "volume_y", "volume_z"), moving)
    in_sheet = material_at(specimen, files, volume, run.groups.get("sections"))[:, :2]
    known = lattice.material[np.isfinite(lattice.material[..., 0])][:, :2]
    ring = true[:, None] + np.concatenate([np.zeros((1, 2)), radius * _RING])
    reach = np.asarray(KDTree(known).query(ring.reshape(-1, 2))[0]).reshape(len(true), -1)
    values |= _found(in_sheet, true, np.all(reach < 2.0 * max(lattice.pitch_um), axis=1), "volume")
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


def registration_errors(specimen: Specimen, run: Run, pixels: Pixels, lattice: Lattice) -> Values:
    """Error of every pixel in the sheet, what the marks say of it, and what it would be without flattening."""
    assert run.marks is not None
    away = np.hypot(pixels.found[..., 0] - pixels.u, pixels.found[..., 1] - pixels.v)
    fit = refit(run)
    linked = run.groups["linked"]
    rows, cols = np.nonzero(pixels.valid)
    places = np.stack([linked["x"].values[cols], linked["y"].values[rows]], axis=1)
    expected = rms(fit.expected_error_um(fit.inverse(places))) if len(rows) else None
    true = rms(away)
    similar = _true_similarity(specimen, pixels)
    return {
        "tre_median": percentile(away, 50),
        "tre_p95": percentile(away, 95),
        "tre_max": percentile(away, 99.9),
        "tre_rms": true,
        "fre_rms": fit.rms_um,
        "loo_rms": rms(fit.leave_one_out_um),
        "predicted_rms": expected,
        "predicted_ratio": true / expected if true is not None and expected else None,
        "scale_deviation": 100.0 * (fit.transform.scale / similar - 1.0) if similar else None,
        "tre_projection_p95": _projection_error(specimen, run, lattice, fit, similar),
    }


def _true_similarity(specimen: Specimen, pixels: Pixels) -> float | None:
    """Scale of the similarity that is nearest to the true pose over the valid pixels."""
    rows, cols = np.nonzero(pixels.valid)
    if len(rows) < 3:
        return None
    some = slice(None, None, max(1, len(rows) // 20_000))
    uv = np.stack([pixels.u[rows, cols], pixels.v[rows, cols]], axis=1)[some]
    at = specimen.pose(uv)
    turned = float(np.linalg.det((uv - uv.mean(axis=0)).T @ (at - at.mean(axis=0)))) < 0
    return fit_transform(uv, at, mirrored=turned, robust=False).transform.scale


def _projection_error(
    specimen: Specimen, run: Run, lattice: Lattice, fit: FittedTransform, scale: float | None
) -> float | None:
    """95th percentile over the columns that the image shows; the distance in the image, brought to the sheet."""
    names = ("projected_u", "projected_v")
    marks = values_at(run.groups["maps"], names, fit.moving)
    if scale is None or not np.isfinite(marks).all():
        return None
    projected = fit_transform(marks, fit.fixed, mirrored=fit.transform.mirrored, robust=False)
    from_run = np.stack([lattice.take(run.groups["flat"][name].values) for name in names], axis=-1)
    known = lattice.measured & np.isfinite(lattice.material[..., 0]) & np.isfinite(from_run).all(axis=-1)
    there = specimen.pose(lattice.material[known][:, :2])
    x, y = (run.groups["linked"][d].values for d in "xy")
    inside = np.all((there >= 0) & (there <= [x[-1], y[-1]]), axis=1)
    return percentile(np.linalg.norm(projected(from_run[known]) - there, axis=1)[inside] / scale, 95)


def resampling_errors(specimen: Specimen, files: InstrumentFiles, run: Run, pixels: Pixels) -> Values:
    """Give the columns their true thickness, resample it as the run does, compare with the truth at each pixel."""
    surfaces, flat, linked = (run.groups[name] for name in ("surfaces", "flat", "linked"))
    name = "coating_top" if np.isfinite(linked["coating_top"].values).any() else "thickness"
    height, width = surfaces["centre"].shape
    most = min(height, max(2, _MOST_COLUMNS // width))
    rows, cols = np.arange(most) + (height - most) // 2, np.arange(width)
    centre = np.asarray(surfaces["centre"].values[rows], dtype=np.float64)
    points = file_points(surfaces, centre, rows, cols)
    u, v, _ = np.moveaxis(material_at(specimen, files, points, run.groups.get("sections")), -1, 0)
    fit = refit(run)
    uv = np.stack([flat["u"].values[rows], flat["v"].values[rows]], axis=-1)
    shape = pixels.u.shape
    places = find_places(
        fit.transform(uv), Grid.regular((shape[0], shape[1]), pitch(linked)),
        least_um=min(pitch(surfaces)) * fit.transform.scale,
    )  # fmt: skip
    carried = resample(true_thickness(specimen.sheet, name, u, v), places)
    there = pixel_thickness(specimen.sheet, name, pixels.found[..., 0], pixels.found[..., 1], pixels.offsets)
    errors = np.where(pixels.valid, carried - there, np.nan)
    return {"resampling_rmse": rms(errors), "resampling_p95": percentile(errors, 95)}


def statistic_errors(specimen: Specimen, run: Run, pixels: Pixels, *, point_um: float) -> Values:
    """Correlation with the image of the measured and of the true map, over the same pixels."""
    linked, name = run.groups["linked"], str(run.results["headline"])
    image = np.asarray(linked["image"].values, dtype=np.float64)
    pixel = pitch(linked)
    found = np.where(pixels.valid, np.asarray(linked[name].values, dtype=np.float64), np.nan)
    true = pixel_thickness(specimen.sheet, name, pixels.u, pixels.v, pixels.offsets)
    true = np.where(np.isfinite(found), true, np.nan)
    values: Values = {}
    for key in ("pixel", "point"):
        one, two = (
            correlate(m, image, point_um=pixel[0])
            if key == "pixel"
            else correlate_at(m, image, pixel_um=pixel, point_um=point_um)[0]
            for m in (found, true)
        )
        both = np.isfinite(one.r) and np.isfinite(two.r)
        values[f"r_{key}"] = one.r if both else None
        values[f"r_true_{key}"] = two.r if both else None
        values[f"r_difference_{key}"] = one.r - two.r if both else None
    return values


def _xy(holes: xr.Dataset) -> Array:
    return np.stack([holes["x"].values, holes["y"].values], axis=1).astype(np.float64).reshape(-1, 2)
