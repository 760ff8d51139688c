"""Errors of the stages that know the volume only: sections, surfaces, centre surface, thickness, flattening."""

from __future__ import annotations

import numpy as np

from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.status import Status
from planish.core.typing import Floats
from planish.register import fit_transform
from planish.sections.network import quick_part
from planish.validate import truth
from planish.validate.figures import Values

_EDGE_UM = 100.0  # length whose error is the strain: well over the scatter of single columns
_WIDE_UM = 20.0  # of a difference that gives a normal where neighbouring sections scatter against each other
_LEAST_SECTIONS = 4


def section_errors(comparison: truth.Comparison) -> Values:
    """Measure the distances of aligned sections from their true places, about the best straight line.

    A shift and a shear of the whole stack are no error of the sheet's structure: they are taken away.
    """
    sections, surfaces = comparison.groups.get("sections"), comparison.groups["surfaces"]
    frame, across = Frame.of(surfaces), np.asarray(surfaces["y"].values, dtype=np.float64)
    # Through z, a section shows the sheet from above, and its pose has other axes.
    if sections is None or frame.through == "z" or across.size < _LEAST_SECTIONS:
        return {}
    middle = {
        frame.cols: float(surfaces["x"].values.mean()),
        frame.through: float(np.nanmean(surfaces["centre"].values)),
        frame.rows: across,
    }
    points = np.stack([np.broadcast_to(middle[axis], across.shape) for axis in ("x", "y", "z")], axis=-1)
    moved = comparison.files.to_physical(points, sections) - points
    line = np.polynomial.polynomial.polyfit(across, moved, 1)
    residual = moved - np.polynomial.polynomial.polyval(across, line).T
    # In the physical frame x runs along the section, y across the sections and z through the sheet.
    # What varies more slowly than the run's cut-off cannot be separated from the sheet's own bend: it is left alone.
    # The rest is jitter that should be gone.
    jitter = [quick_part(across, residual[:, k], cutoff_um=float(sections.attrs["cutoff_um"])) for k in (0, 2)]
    return {
        "sections_x_rms": truth.rms(residual[:, 0]),
        "sections_z_rms": truth.rms(residual[:, 2]),
        "sections_x_jitter": truth.rms(jitter[0]),
        "sections_z_jitter": truth.rms(jitter[1]),
        "sections_place_rms": truth.rms(residual[:, 1]),
    }


def surface_errors(comparison: truth.Comparison) -> Values:
    """Heights of the four faces at the measured columns, along the true normals."""
    surfaces, sheet = comparison.groups["surfaces"], comparison.specimen.sheet
    values: Values = {}
    pool: list[Floats] = []
    for face, field in zip(truth.FACES, sheet.faces, strict=True):
        heights = np.where(comparison.measured, comparison.take(surfaces[face].values), np.nan)
        u, v, s = np.moveaxis(comparison.material_at(comparison.places(heights, *comparison.columns)), -1, 0)
        errors = s - truth.field_at(sheet, field, u, v)
        values |= truth.bias_rmse_p95(face, errors)
        pool.append(errors[np.isfinite(errors)])
    values["surfaces_rmse"] = truth.rms(np.concatenate(pool))
    # Columns that have a sheet: away from the true holes, and from the rims that are left out on purpose.
    u, v, _ = np.moveaxis(comparison.material, -1, 0)
    outside = np.fmin(*(truth.field_at(sheet, field, u, v) for field in sheet.rim_um)) > 0
    status = comparison.take(surfaces["status"].values)
    has_sheet = outside & (status != Status.RIM)
    has_faces = (status == 0) | (status == Status.NORMAL_LEAVES_SHEET)
    values["found_share"] = 100.0 * float(np.mean(has_faces[has_sheet])) if has_sheet.any() else None
    values["measured_share"] = 100.0 * float(np.mean(comparison.measured[has_sheet])) if has_sheet.any() else None
    return values


def centre_errors(comparison: truth.Comparison) -> Values:
    """Height of the found centre surface over the true one, and the angle between their normals."""
    u, v, s = np.moveaxis(np.where(comparison.measured[..., None], comparison.material, np.nan), -1, 0)
    mean, angle = truth.mean_of(s), _angles(comparison, u, v)
    return {
        "centre_mean": mean,
        "centre_rms": None if mean is None else truth.rms(s - mean),
        "angle_rms": truth.rms(angle),
        "angle_p95": truth.percentile(angle, 95),
    }


def _angles(comparison: truth.Comparison, u: Floats, v: Floats) -> Floats:
    """Angles in degrees between found and true normals; NaN where a neighbour is missing."""
    surfaces = comparison.groups["surfaces"]
    centre = surfaces["centre"].values
    reach = [max(1, round(_WIDE_UM / p)) if "sections" in comparison.groups else 1 for p in pitch(surfaces)]
    sides: list[Floats] = []
    for axis, (n, r) in enumerate(zip(centre.shape, reach, strict=True)):
        ends: list[Floats] = []
        for offset in (-r, r):
            index = list(comparison.columns)
            index[axis] = np.clip(index[axis] + offset, 0, n - 1)
            heights = np.asarray(centre[np.ix_(*index)], dtype=np.float64)
            ends.append(comparison.physical_at(comparison.places(heights, index[0], index[1])))
        sides.append(ends[1] - ends[0])
    normals = np.cross(sides[1], sides[0])
    length = np.linalg.norm(normals, axis=-1)
    is_valid = np.isfinite(u) & (length > 0)
    angle = np.full(u.shape, np.nan)
    true = comparison.specimen.warp.normals(u[is_valid], v[is_valid])
    # The arc sine of the cross product keeps small angles, which the arc cosine loses to rounding.
    sine = np.linalg.norm(np.cross(normals[is_valid] / length[is_valid][:, None], true), axis=-1)
    angle[is_valid] = np.rad2deg(np.arcsin(np.clip(sine, 0.0, 1.0)))
    return angle


def thickness_errors(comparison: truth.Comparison) -> Values:
    """Measured thicknesses of the columns against those of the material that they show."""
    u, v = comparison.material[..., 0], comparison.material[..., 1]
    values: Values = {}
    for name in truth.THICKNESSES:
        measured = comparison.take(comparison.groups["surfaces"][name].values)
        values |= truth.bias_rmse_p95(
            f"column_{name}", measured - truth.true_thickness(comparison.specimen.sheet, name, u, v)
        )
        if (stated := comparison.groups["surfaces"].get(f"{name}_se")) is not None:
            values[f"predicted_{name}"] = truth.rms(comparison.take(stated.values)[np.isfinite(measured)])
    return values


def flattening_errors(comparison: truth.Comparison) -> Values:
    """Flat places of the measured columns against their true ones, after the best turn and shift."""
    flat = np.stack([comparison.take(comparison.groups["flat"][name].values) for name in ("u", "v")], axis=-1)
    flat[~comparison.measured] = np.nan
    true = comparison.material[..., :2]
    is_valid = np.isfinite(flat).all(axis=-1) & np.isfinite(true).all(axis=-1)
    if np.count_nonzero(is_valid) < 3:
        return {}
    every = max(1, np.count_nonzero(is_valid) // truth.FITTED)
    rigid, similar = (
        fit_transform(flat[is_valid][::every], true[is_valid][::every], model=model, mirrored=None, robust=False)
        for model in ("rigid", "similarity")
    )
    off = true[is_valid] - rigid.transform(flat[is_valid])
    away = np.hypot(*(off - off.mean(axis=0)).T)
    strains: list[Floats] = []
    for axis, step in enumerate(comparison.pitch_um):
        n = max(1, round(_EDGE_UM / step))
        along = [np.moveaxis(places, axis, 0) for places in (flat, true)]
        edges = [np.linalg.norm(places[n:] - places[:-n], axis=-1) for places in along]
        with np.errstate(invalid="ignore", divide="ignore"):
            strains.append((edges[0] / edges[1] - 1.0).ravel())
    strain = truth.rms(np.concatenate(strains))
    return {
        "node_rms": truth.rms(away),
        "node_p95": truth.percentile(away, 95),
        # The flat map is the source of the fit: it is too large where the fit has to shrink it.
        "flat_scale": 100.0 * (1.0 / similar.transform.scale - 1.0),
        "strain_rms": None if strain is None else 100.0 * strain,
    }
