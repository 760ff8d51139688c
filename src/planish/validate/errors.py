"""Errors of every stage.

First of those that know the volume only, then of what links it to an image or a volume.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.polynomial import polynomial
from scipy.spatial import KDTree

from planish.analyze import correlate, pearson
from planish.core.frame import Frame
from planish.core.grid import Grid, centres_of, pitch, values_at
from planish.core.status import Status
from planish.core.typing import Bools, Floats, Pair
from planish.marks import find_holes
from planish.register import FittedTransform, fit_transform
from planish.resample import find_places, resample
from planish.run import Run
from planish.sections.network import quick_part
from planish.synthetic import InstrumentFiles, Specimen
from planish.validate.scenario import PAIR, Values
from planish.validate.truth import (
    FACES,
    FITTED,
    THICKNESSES,
    Comparison,
    bias_rmse_p95,
    field_at,
    mean_of,
    percentile,
    points_of,
    rms,
    true_thickness,
    volume_places,
)


def section_errors(comparison: Comparison) -> Values:
    """Distances of aligned sections from their true places.

    A shift and a shear of the whole stack are no errors.
    """
    sections = comparison.groups.get("sections")
    surfaces = comparison.surfaces
    frame = Frame.of(surfaces)
    sections_um = np.asarray(surfaces["y"].values, dtype=np.float64)
    # Through z, a section shows the sheet from above, and its pose has other axes.
    if sections is None or frame.through == "z" or sections_um.size < 4:
        return {}
    centre: dict[str, Floats | float] = {
        frame.cols: float(surfaces["x"].values.mean()),
        frame.through: float(np.nanmean(surfaces["centre"].values)),
        frame.rows: sections_um,
    }
    points = points_of(centre)
    displacement = comparison.files.to_physical(points, sections) - points
    line_fit = polynomial.polyfit(sections_um, displacement, 1)
    residual = displacement - polynomial.polyval(sections_um, line_fit).T
    # In the physical frame x runs along the section, y across the sections and z through the sheet.
    # What varies more slowly than the run's cut-off is like the sheet's own bend: it is left alone.
    # The rest is jitter.
    x_um, place_um, z_um = residual.T
    cutoff_um = float(sections.attrs["cutoff_um"])
    return {
        "sections_x_rms": rms(x_um),
        "sections_z_rms": rms(z_um),
        "sections_x_jitter": rms(quick_part(sections_um, x_um, cutoff_um=cutoff_um)),
        "sections_z_jitter": rms(quick_part(sections_um, z_um, cutoff_um=cutoff_um)),
        "sections_place_rms": rms(place_um),
    }


def surface_errors(comparison: Comparison) -> Values:
    """Heights of the four faces at the measured columns, along the true normals."""
    surfaces, sheet = comparison.surfaces, comparison.specimen.sheet
    values = Values()
    all_errors = list[Floats]()
    for face, field in zip(FACES, sheet.faces, strict=True):
        heights = comparison.at_columns(surfaces[face].values)
        heights[~comparison.measured] = np.nan
        material = comparison.material_over(heights, *comparison.columns)
        u, v, s = np.moveaxis(material, -1, 0)
        errors = s - field_at(sheet, field, u, v)
        values |= bias_rmse_p95(face, errors)
        all_errors.append(errors[np.isfinite(errors)])
    values["surfaces_rmse"] = rms(np.concatenate(all_errors))
    # Columns that have a sheet: away from the true holes, and from the rims that are left out on
    # purpose.
    u, v, _ = np.moveaxis(comparison.material, -1, 0)
    is_off_holes = np.fmin(*(field_at(sheet, field, u, v) for field in sheet.rim_um)) > 0
    status = comparison.at_columns(surfaces["status"].values)
    has_sheet = is_off_holes & (status != Status.RIM)
    has_faces = (status == 0) | (status == Status.NORMAL_LEAVES_SHEET)
    values |= dict.fromkeys(("found_share", "measured_share"))
    if has_sheet.any():
        values["found_share"] = 100.0 * float(np.mean(has_faces[has_sheet]))
        values["measured_share"] = 100.0 * float(np.mean(comparison.measured[has_sheet]))
    return values


def centre_errors(comparison: Comparison) -> Values:
    """Return the found centre surface's height over the true one, and their normals' angle.

    The angle between the normals is in degrees.
    """
    material = np.where(comparison.measured[..., None], comparison.material, np.nan)
    u, v, s = np.moveaxis(material, -1, 0)
    centre = comparison.surfaces["centre"].values
    # Neighbouring sections scatter against each other: their normals are of a wider difference.
    half_width_um = 20.0 if "sections" in comparison.groups else 0.0
    half_steps = [max(1, round(half_width_um / p)) for p in pitch(comparison.surfaces)]
    tangents: list[Floats] = []
    for axis, (n, r) in enumerate(zip(centre.shape, half_steps, strict=True)):
        end_points: list[Floats] = []
        for offset in (-r, r):
            index = list(comparison.columns)
            index[axis] = np.clip(index[axis] + offset, 0, n - 1)
            heights = np.asarray(centre[np.ix_(*index)], dtype=np.float64)
            places = comparison.places(heights, index[0], index[1])
            end_points.append(comparison.physical_at(places))
        tangents.append(end_points[1] - end_points[0])
    normals = np.cross(tangents[1], tangents[0])
    length = np.linalg.norm(normals, axis=-1)
    is_valid = np.isfinite(u) & (length > 0)
    true_normals = comparison.specimen.warp.normals(u[is_valid], v[is_valid])
    # The arc sine of the cross product keeps small angles, which the arc cosine loses to rounding.
    unit_normals = normals[is_valid] / length[is_valid][:, None]
    sine = np.linalg.norm(np.cross(unit_normals, true_normals), axis=-1)
    angle = np.rad2deg(np.arcsin(np.clip(sine, 0.0, 1.0)))
    mean = mean_of(s)
    return {
        "centre_mean": mean,
        "centre_rms": None if mean is None else rms(s - mean),
        "angle_rms": rms(angle),
        "angle_p95": percentile(angle, 95),
    }


def thickness_errors(comparison: Comparison) -> Values:
    """Measured thicknesses of the columns against those of the material that they show."""
    u, v = comparison.material[..., 0], comparison.material[..., 1]
    values = Values()
    for name in THICKNESSES:
        measured = comparison.at_columns(comparison.surfaces[name].values)
        errors = measured - true_thickness(comparison.specimen.sheet, name, u, v)
        values |= bias_rmse_p95(f"column_{name}", errors)
        if (standard_errors := comparison.surfaces.get(f"{name}_se")) is not None:
            expected = comparison.at_columns(standard_errors.values)
            values[f"predicted_{name}"] = rms(expected[np.isfinite(measured)])
    return values


def _flat_places(comparison: Comparison, names: tuple[str, str]) -> Floats:
    """Flat places of the columns, (rows, cols, 2) in um."""
    flat = comparison.groups["flat"]
    return np.stack([comparison.at_columns(flat[name].values) for name in names], axis=-1)


def flattening_errors(comparison: Comparison) -> Values:
    """Compare flat places of measured columns with the true ones, after the best turn and shift."""
    flat_uv = _flat_places(comparison, ("u", "v"))
    flat_uv[~comparison.measured] = np.nan
    true_uv = comparison.material[..., :2]
    is_valid = np.isfinite(flat_uv).all(axis=-1) & np.isfinite(true_uv).all(axis=-1)
    if np.count_nonzero(is_valid) < 3:
        return {}
    valid_flat_uv, valid_true_uv = flat_uv[is_valid], true_uv[is_valid]
    stride = max(1, len(valid_flat_uv) // FITTED)
    fit_points = valid_flat_uv[::stride], valid_true_uv[::stride]
    rigid, similar = (
        fit_transform(*fit_points, model=model, mirrored=None, robust=False)
        for model in ("rigid", "similarity")
    )
    error_uv = valid_true_uv - rigid.transform(valid_flat_uv)
    errors_um = np.hypot(*(error_uv - error_uv.mean(axis=0)).T)
    strains: list[Floats] = []
    for axis, step in enumerate(comparison.pitch_um):
        n = max(1, round(100.0 / step))  # well over the scatter of single columns
        moved_axes = (np.moveaxis(places, axis, 0) for places in (flat_uv, true_uv))
        flat_lengths, true_lengths = (
            np.linalg.norm(places[n:] - places[:-n], axis=-1) for places in moved_axes
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            strains.append((flat_lengths / true_lengths - 1.0).ravel())
    strain = rms(np.concatenate(strains))
    return {
        "node_rms": rms(errors_um),
        "node_p95": percentile(errors_um, 95),
        # The flat map is the source of the fit: it is too large where the fit has to shrink it.
        "flat_scale": 100.0 * (1.0 / similar.transform.scale - 1.0),
        "strain_rms": None if strain is None else 100.0 * strain,
    }


# Points on the stretch of an outline within one cell: so close that the nearest one is as good as
# the line.
_PARTS = 4
_EIGHTHS = np.arange(8) * np.pi / 4
_RING = np.stack([np.cos(_EIGHTHS), np.sin(_EIGHTHS)], axis=1)


def pixel_errors(comparison: Comparison) -> Values:
    """Compare linked thicknesses with those of the material that each pixel shows.

    The region of thin coating is compared too.
    """
    values: Values = {}
    for name in THICKNESSES:
        linked_um = comparison.linked_values(name)
        true_um = comparison.pixel_thickness(name, *comparison.true_uv)
        values |= bias_rmse_p95(f"pixel_{name}", linked_um - true_um)
        if name != "coating_top":
            continue
        thin_um = comparison.run.study.correlate.thin_um
        is_valid = np.isfinite(linked_um) & np.isfinite(true_um)
        n_valid = int(np.count_nonzero(is_valid))
        # With fewer of the valid pixels, the thin region is some specks.
        is_thin = is_valid & (true_um < thin_um)
        if n_valid and np.count_nonzero(is_thin) >= 0.002 * n_valid:
            values["thin_dice"] = dice(linked_um < thin_um, is_thin)
            valid_um = np.where(is_valid, true_um, np.nan)
            lag_um = outline_lag(linked_um, valid_um, thin_um, pitch(comparison.linked))
            values["thin_lag"] = lag_um
    return values


def dice(first_mask: Bools, second_mask: Bools) -> float | None:
    """Twice the common area over the sum of both; None where both are empty."""
    total = int(first_mask.sum()) + int(second_mask.sum())
    return 2.0 * int((first_mask & second_mask).sum()) / total if total else None


def outline_lag(
    first_map: Floats, second_map: Floats, level: float, pitch_um: Pair
) -> float | None:
    """Return the median distance in um between the contour lines of two maps at ``level``.

    It is taken from both sides.

    No line passes where a map is NaN; None where one of them has no contour. ``pitch_um`` is that
    of rows and columns.
    """
    a, b = (contour_points(m, level) * np.array(pitch_um) for m in (first_map, second_map))
    if not len(a) or not len(b):
        return None
    away = np.concatenate([KDTree(b).query(a)[0], KDTree(a).query(b)[0]])
    return float(np.median(away))


def contour_points(values: Floats, level: float) -> Floats:
    """Points (n, 2) as (row, col), in pixels, close together on the contour lines of a map."""
    from contourpy import LineType, contour_generator

    contours = contour_generator(z=np.ma.masked_invalid(values), line_type=LineType.Separate)
    share = (np.arange(_PARTS) + 0.5)[:, None] / _PARTS
    points = [np.empty((0, 2))]
    for line in contours.lines(level):
        points += [start + share * (end - start) for start, end in pairwise(np.asarray(line))]
    return np.concatenate(points)[:, ::-1]


def hole_errors(comparison: Comparison) -> Values:
    """Compare the holes of either side with the true ones.

    They are found again, with the run's options.
    """
    linked, maps, specimen = comparison.linked, comparison.groups["maps"], comparison.specimen
    hole_um = comparison.run.study.holes.hole_um
    true_uv = specimen.sheet.holes
    radius = 0.5 * float(np.mean(hole_um))
    image = np.asarray(linked["image"].values)
    holes = find_holes(image, pixel_um=pitch(linked), diameter_um=hole_um)
    image_uv = specimen.pose.inverse(centres_of(holes))
    true_xy = specimen.pose(true_uv)
    border_xy = [linked[axis].values[-1] - radius for axis in "xy"]
    is_inside = np.all((true_xy > radius) & (true_xy < border_xy), axis=1)
    values = _side_errors(image_uv, true_uv, is_inside, "image")
    presence = maps["presence"].values
    holes = find_holes(presence, pixel_um=pitch(maps)[1], diameter_um=hole_um, polarity="dark")
    moving = centres_of(holes) + np.array([maps["u"].values[0], maps["v"].values[0]])
    volume_xyz = values_at(maps, ("volume_x", "volume_y", "volume_z"), moving)
    volume_uv = comparison.material_at(volume_xyz)[:, :2]
    column_uv = comparison.material[np.isfinite(comparison.material[..., 0])][:, :2]
    rings = true_uv[:, None] + np.concatenate([np.zeros((1, 2)), radius * _RING])
    distances_um, _ = KDTree(column_uv).query(rings)
    is_shown = np.all(distances_um < 2.0 * max(comparison.pitch_um), axis=1)
    values |= _side_errors(volume_uv, true_uv, is_shown, "volume")
    image_um = values.get("fle_image")
    volume_um = values.get("fle_volume")
    if image_um is not None and volume_um is not None:
        values["fle_pair"] = float(np.hypot(image_um, volume_um))
    return values


def _side_errors(holes_uv: Floats, true_uv: Floats, is_inside: Bools, side: str) -> Values:
    """Recall, false ones and localisation error of one side.

    All places are material (u, v) in um.
    """
    holes_uv = holes_uv[np.isfinite(holes_uv).all(axis=1)]
    if not len(true_uv):
        return {f"false_{side}": float(len(holes_uv))}
    distances_um = np.linalg.norm(holes_uv[:, None] - true_uv[None], axis=-1)
    errors_um = distances_um.min(axis=1)
    # a third of a hole: nearer than that it is the same one.
    is_true = errors_um < 60.0
    is_detected = np.zeros(len(true_uv), dtype=bool)
    is_detected[distances_um.argmin(axis=1)[is_true]] = True
    recall = float(is_detected[is_inside].mean()) if is_inside.any() else None
    return {
        f"recall_{side}": recall,
        f"false_{side}": float(np.count_nonzero(~is_true)),
        f"fle_{side}": rms(errors_um[is_true]),
    }


def registration_errors(comparison: Comparison) -> Values:
    """Return the error of every pixel in the sheet.

    Also what the marks say of it, and what it would be without flattening.
    """
    fit, errors_um = comparison.fit, comparison.place_error_um
    expected_um = comparison.linked["expected_error"].values[comparison.valid]
    expected_rms = rms(expected_um.astype(np.float64))
    true_rms = rms(errors_um)
    scale = ratio = None
    if true_rms is not None and expected_rms:
        ratio = true_rms / expected_rms
    uv = np.stack([coordinate[comparison.valid] for coordinate in comparison.true_uv], axis=1)
    if len(uv) >= 3:  # of the similarity that is nearest to the true pose over the valid pixels
        uv = uv[:: max(1, len(uv) // FITTED)]
        posed = fit_transform(uv, comparison.specimen.pose(uv), mirrored=None, robust=False)
        scale = posed.transform.scale
    return {
        "tre_median": percentile(errors_um, 50),
        "tre_p95": percentile(errors_um, 95),
        "tre_max": percentile(errors_um, 99.9),
        "tre_rms": true_rms,
        "fre_rms": fit.rms_um,
        "loo_rms": rms(fit.leave_one_out_um),
        "predicted_rms": expected_rms,
        "predicted_ratio": ratio,
        "scale_deviation": 100.0 * (fit.transform.scale / scale - 1.0) if scale else None,
        "tre_projection_p95": _projection_error(comparison, fit, scale),
    }


def _projection_error(
    comparison: Comparison, fit: FittedTransform, scale: float | None
) -> float | None:
    """95th percentile over the columns that the image shows.

    The distance in the image, brought to the sheet.
    """
    names = ("projected_u", "projected_v")
    marks_uv = values_at(comparison.groups["maps"], names, fit.moving)
    if scale is None or not np.isfinite(marks_uv).all():
        return None
    projected = fit_transform(marks_uv, fit.fixed, mirrored=fit.transform.mirrored, robust=False)
    run_uv = _flat_places(comparison, names)
    is_valid = comparison.measured & np.isfinite(comparison.material[..., 0])
    is_valid &= np.isfinite(run_uv).all(axis=-1)
    true_xy = comparison.specimen.pose(comparison.material[is_valid][:, :2])
    border_xy = [comparison.linked[axis].values[-1] for axis in "xy"]
    is_inside = np.all((true_xy >= 0) & (true_xy <= border_xy), axis=1)
    errors_um = np.linalg.norm(projected(run_uv[is_valid]) - true_xy, axis=1)
    return percentile(errors_um[is_inside] / scale, 95)


def resampling_errors(comparison: Comparison) -> Values:
    """Resample the columns' true thickness as the run does, and compare pixels with the truth."""
    surfaces, flat, linked = (comparison.groups[name] for name in ("surfaces", "flat", "linked"))
    name = "coating_top" if np.isfinite(linked["coating_top"].values).any() else "thickness"
    height, width = surfaces["centre"].shape
    max_rows = min(height, max(2, 1_500_000 // width))
    rows = np.arange(max_rows) + (height - max_rows) // 2
    cols = np.arange(width)
    centre = np.asarray(surfaces["centre"].values[rows], dtype=np.float64)
    u, v, _ = np.moveaxis(comparison.material_over(centre, rows, cols), -1, 0)
    fit = comparison.fit
    uv = np.stack([flat["u"].values[rows], flat["v"].values[rows]], axis=-1)
    least_um = min(pitch(surfaces)) * fit.transform.scale
    places = find_places(fit.transform(uv), Grid.of(linked), least_um=least_um)
    resampled_um = resample(true_thickness(comparison.specimen.sheet, name, u, v), places)
    pixel_u, pixel_v, _ = np.moveaxis(comparison.linked_material, -1, 0)
    true_um = comparison.pixel_thickness(name, pixel_u, pixel_v)
    errors = np.where(comparison.valid, resampled_um - true_um, np.nan)
    return {"resampling_rmse": rms(errors), "resampling_p95": percentile(errors, 95)}


def statistic_errors(comparison: Comparison) -> Values:
    """Correlate the measured and the true map with the image.

    Both are taken over the same pixels and the run's points.
    """
    image = np.asarray(comparison.linked["image"].values, dtype=np.float64)
    pixel = pitch(comparison.linked)
    measured_map = comparison.linked_values(comparison.headline)
    true_map = comparison.pixel_thickness(comparison.headline, *comparison.true_uv)
    true_map[~np.isfinite(measured_map)] = np.nan
    point_um = comparison.run.study.correlate.point_um
    maps = (measured_map, true_map)
    pixel_r = [pearson(m, image) for m in maps]
    point_r = [correlate(m, image, pixel_um=pixel, point_um=point_um).r for m in maps]
    values = Values()
    for key, (r_measured, r_true) in (("pixel", pixel_r), ("point", point_r)):
        names = (f"r_{key}", f"r_true_{key}", f"r_difference_{key}")
        correlations = (r_measured, r_true, r_measured - r_true)
        values |= dict.fromkeys(names)
        if np.isfinite(correlations).all():
            values |= zip(names, correlations, strict=True)
    return values


def pair_errors(specimens: Sequence[tuple[Specimen, InstrumentFiles]], run: Run) -> Values:
    """Errors of two linked volumes of one sheet against its truth.

    Parameters
    ----------
    specimens : pairs of a specimen and its files, in the order of the run's layers
    run : Run; the two volumes, linked

    Returns
    -------
    dict; figure name to error of places and thicknesses, in um, and of statistics
    """
    maps = [run.groups[f"layers/{name}"] for name in PAIR]
    valid = maps[0]["valid"].values & maps[1]["valid"].values
    values: Values = {}
    materials: list[Floats] = []
    for name, (specimen, files), layer_maps in zip(PAIR, specimens, maps, strict=True):
        comparison = Comparison(specimen, files, replace(run, groups=run.sheets[name].groups))
        places = volume_places(layer_maps)[valid].astype(np.float64)
        material = comparison.material_at(places)
        materials.append(material)
        true_um = true_thickness(specimen.sheet, "coating_top", material[..., 0], material[..., 1])
        errors_um = layer_maps["coating_top"].values[valid] - true_um
        values[f"pair_coating_{name}_bias"] = mean_of(errors_um)
    distances_um = np.hypot(*(materials[0] - materials[1])[..., :2].T)
    expected_um = maps[0]["expected_error"].values[valid]
    values["pair_median"] = percentile(distances_um, 50)
    values["pair_p95"] = percentile(distances_um, 95)
    values["pair_rms"] = rms(distances_um)
    values["pair_predicted_rms"] = rms(expected_um.astype(np.float64))
    rows = [row for row in run.results.correlations if row.a_map == "coating_top"]
    if rows:
        values["pair_r"], values["pair_r_point"] = rows[0].r, rows[1].r
        values["pair_difference_sd"] = rows[0].difference_sd
    return values


MAP_STAGES = (section_errors, surface_errors, centre_errors, thickness_errors, flattening_errors)
LINK_STAGES = (pixel_errors, hole_errors, registration_errors, resampling_errors, statistic_errors)
