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

    A shift and a shear of the whole stack are no errors: a straight line is taken off along it. A
    point of each section stands for it, in the middle of its row of columns.
    """
    sections = comparison.groups.get("sections")
    surfaces = comparison.surfaces
    frame = Frame.of(surfaces)
    sections_um = surfaces["y"].values.astype(np.float64)
    # Through z, a section shows the sheet from above, and its pose has other axes.
    if sections is None or frame.through == "z" or sections_um.size < 4:
        return {}
    across_um = float(surfaces["x"].values.mean())
    height_um = float(np.nanmean(surfaces["centre"].values))
    places = {frame.cols: across_um, frame.through: height_um, frame.rows: sections_um}
    points = points_of(places)
    displacement = comparison.files.to_physical(points, sections) - points
    line_fit = polynomial.polyfit(sections_um, displacement, 1)
    line = polynomial.polyval(sections_um, line_fit).T
    residual = displacement - line
    # In the physical frame x runs along the section, y across the sections and z through the sheet.
    # What varies more slowly than the run's cut-off is like the sheet's own bend: it is left alone.
    # The rest is jitter.
    x_um, place_um, z_um = residual.T
    cutoff_um = float(sections.attrs["cutoff_um"])
    values: Values = {"sections_place_rms": rms(place_um)}
    for axis, error_um in (("x", x_um), ("z", z_um)):
        jitter_um = quick_part(sections_um, error_um, cutoff_um=cutoff_um)
        values[f"sections_{axis}_rms"] = rms(error_um)
        values[f"sections_{axis}_jitter"] = rms(jitter_um)
    return values


def surface_errors(comparison: Comparison) -> Values:
    """Heights of the four faces at the measured columns, along the true normals.

    Material ``s`` counts along the normal, and the true face lies at ``s`` of its field. The shares
    are in % of the columns that have a sheet by the truth.
    """
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
    distances_um = [field_at(sheet, field, u, v) for field in sheet.rim_um]
    is_off_holes = np.fmin(*distances_um) > 0
    status = comparison.at_columns(surfaces["status"].values)
    has_sheet = is_off_holes & (status != Status.RIM)
    has_faces = (status == 0) | (status == Status.NORMAL_LEAVES_SHEET)
    values |= dict.fromkeys(("found_share", "measured_share"))
    if has_sheet.any():
        for name, is_so in (("found", has_faces), ("measured", comparison.measured)):
            values[f"{name}_share"] = 100.0 * float(np.mean(is_so[has_sheet]))
    return values


def centre_errors(comparison: Comparison) -> Values:
    """Return the found centre surface's height over the true one, and their normals' angle.

    The angle between the normals is in degrees. A found normal is across two tangents, each from
    the column so many steps before to that so many steps behind, in space.
    """
    material = np.where(comparison.measured[..., None], comparison.material, np.nan)
    u, v, s = np.moveaxis(material, -1, 0)
    centre = comparison.surfaces["centre"].values
    # Neighbouring sections scatter against each other: their normals are of a wider difference.
    half_width_um = 20.0 if "sections" in comparison.groups else 0.0
    tangents: list[Floats] = []
    for axis, step_um in enumerate(pitch(comparison.surfaces)):
        half_steps = max(1, round(half_width_um / step_um))
        last = centre.shape[axis] - 1
        end_points: list[Floats] = []
        for offset in (-half_steps, half_steps):
            index = list(comparison.columns)
            index[axis] = np.clip(index[axis] + offset, 0, last)
            rows, cols = index
            heights = centre[np.ix_(rows, cols)].astype(np.float64)
            places = comparison.places(heights, rows, cols)
            end_points.append(comparison.physical_at(places))
        before, behind = end_points
        tangents.append(behind - before)
    down, across = tangents
    normals = np.cross(across, down)
    length = np.linalg.norm(normals, axis=-1)
    is_valid = np.isfinite(u) & (length > 0)
    true_normals = comparison.specimen.warp.normals(u[is_valid], v[is_valid])
    # The arc sine of the cross product keeps small angles, which the arc cosine loses to rounding.
    unit_normals = normals[is_valid] / length[is_valid][:, None]
    cross_products = np.cross(unit_normals, true_normals)
    sine = np.linalg.norm(cross_products, axis=-1)
    angle = np.rad2deg(np.arcsin(np.clip(sine, 0.0, 1.0)))
    mean = mean_of(s)
    return {
        "centre_mean": mean,
        "centre_rms": None if mean is None else rms(s - mean),
        "angle_rms": rms(angle),
        "angle_p95": percentile(angle, 95),
    }


def thickness_errors(comparison: Comparison) -> Values:
    """Measured thicknesses of the columns against those of the material that they show.

    Also the standard error that the run states, rms over the same columns, where it states one.
    """
    u, v, _ = np.moveaxis(comparison.material, -1, 0)
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
    coordinates = [comparison.at_columns(flat[name].values) for name in names]
    return np.stack(coordinates, axis=-1)


def flattening_errors(comparison: Comparison) -> Values:
    """Compare flat places of measured columns with the true ones, after the best turn and shift.

    Strain is the change of the distance of columns some 100 um apart, along rows and columns.
    """
    flat_uv = _flat_places(comparison, ("u", "v"))
    flat_uv[~comparison.measured] = np.nan
    true_uv = comparison.material[..., :2]
    is_valid = np.isfinite(flat_uv + true_uv).all(axis=-1)
    if np.count_nonzero(is_valid) < 3:
        return {}
    valid_flat_uv, valid_true_uv = flat_uv[is_valid], true_uv[is_valid]
    stride = max(1, len(valid_flat_uv) // FITTED)
    fit_points = valid_flat_uv[::stride], valid_true_uv[::stride]
    rigid = fit_transform(*fit_points, model="rigid", mirrored=None, robust=False)
    similar = fit_transform(*fit_points, model="similarity", mirrored=None, robust=False)
    error_uv = valid_true_uv - rigid.transform(valid_flat_uv)
    error_uv = error_uv - error_uv.mean(axis=0)
    errors_um = np.hypot(*error_uv.T)
    strains: list[Floats] = []
    for axis, step in enumerate(comparison.pitch_um):
        n = max(1, round(100.0 / step))  # well over the scatter of single columns
        flat_lengths = _lengths(flat_uv, axis, n)
        true_lengths = _lengths(true_uv, axis, n)
        with np.errstate(invalid="ignore", divide="ignore"):
            changes = flat_lengths / true_lengths - 1.0
        strains.append(changes.ravel())
    strain = rms(np.concatenate(strains))
    return {
        "node_rms": rms(errors_um),
        "node_p95": percentile(errors_um, 95),
        # The flat map is the source of the fit: it is too large where the fit has to shrink it.
        "flat_scale": 100.0 * (1.0 / similar.transform.scale - 1.0),
        "strain_rms": None if strain is None else 100.0 * strain,
    }


def _lengths(places: Floats, axis: int, n: int) -> Floats:
    """Distances of places (rows, cols, 2) from those ``n`` steps on along an axis."""
    along_first = np.moveaxis(places, axis, 0)
    return np.linalg.norm(along_first[n:] - along_first[:-n], axis=-1)


# Points on the stretch of an outline within one cell: so close that the nearest one is as good as
# the line.
_PARTS = 4
_EIGHTHS = np.arange(8) * np.pi / 4
_RING = np.stack([np.cos(_EIGHTHS), np.sin(_EIGHTHS)], axis=1)


def pixel_errors(comparison: Comparison) -> Values:
    """Compare linked thicknesses with those of the material that each pixel shows.

    The region where the top coating is thinner than ``correlate.thin_um`` of the study is compared
    too: by the overlap of both regions, and by the distance of their outlines.
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
    if not total:
        return None
    common = int((first_mask & second_mask).sum())
    return 2.0 * common / total


def outline_lag(
    first_map: Floats, second_map: Floats, level: float, pitch_um: Pair
) -> float | None:
    """Return the median distance in um between the contour lines of two maps at ``level``.

    It is taken from both sides.

    No line passes where a map is NaN; None where one of them has no contour. ``pitch_um`` is that
    of rows and columns.
    """
    first_um, second_um = (
        contour_points(values, level) * np.array(pitch_um) for values in (first_map, second_map)
    )
    if not len(first_um) or not len(second_um):
        return None
    from_second, _ = KDTree(second_um).query(first_um)
    from_first, _ = KDTree(first_um).query(second_um)
    away_um = np.concatenate([from_second, from_first])
    return float(np.median(away_um))


def contour_points(values: Floats, level: float) -> Floats:
    """Points (n, 2) as (row, col), in pixels, close together on the contour lines of a map."""
    from contourpy import LineType, contour_generator

    known = np.ma.masked_invalid(values)
    contours = contour_generator(z=known, line_type=LineType.Separate)
    share = (np.arange(_PARTS) + 0.5)[:, None] / _PARTS
    points = [np.empty((0, 2))]
    for line in contours.lines(level):
        vertices = np.asarray(line)
        points += [start + share * (end - start) for start, end in pairwise(vertices)]
    return np.concatenate(points)[:, ::-1]


def hole_errors(comparison: Comparison) -> Values:
    """Compare the holes of either side with the true ones.

    They are found again, with the run's options: in the image, and in the map of how much of each
    pixel of the flat sheet is there. A true hole counts for a side where it lies within the image
    by its radius, or where measured columns lie around all of it.
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
    first_uv = np.array([maps[axis].values[0] for axis in "uv"])  # from which pixels count
    moving = centres_of(holes) + first_uv
    volume_xyz = values_at(maps, ("volume_x", "volume_y", "volume_z"), moving)
    volume_uv = comparison.material_at(volume_xyz)[:, :2]
    column_uv = comparison.material[..., :2]
    column_uv = column_uv[np.isfinite(column_uv[..., 0])]
    # The middle of each hole, and eight places around it.
    offsets = np.concatenate([np.zeros((1, 2)), radius * _RING])
    distances_um, _ = KDTree(column_uv).query(true_uv[:, None] + offsets)
    is_shown = np.all(distances_um < 2.0 * max(comparison.pitch_um), axis=1)
    values |= _side_errors(volume_uv, true_uv, is_shown, "volume")
    image_um = values.get("fle_image")
    volume_um = values.get("fle_volume")
    if image_um is not None and volume_um is not None:
        values["fle_pair"] = float(np.hypot(image_um, volume_um))
    return values


def _side_errors(holes_uv: Floats, true_uv: Floats, is_inside: Bools, side: str) -> Values:
    """Recall, false ones and localisation error of one side.

    All places are material (u, v) in um, those of the search and the true ones. ``is_inside``
    (true holes,) tells which of these the side shows: recall counts them alone, None where there
    are none.
    """
    holes_uv = holes_uv[np.isfinite(holes_uv).all(axis=1)]
    if not len(true_uv):
        return {f"false_{side}": float(len(holes_uv))}
    distances_um = np.linalg.norm(holes_uv[:, None] - true_uv[None], axis=-1)
    errors_um = distances_um.min(axis=1)
    # a third of a hole: nearer than that it is the same one.
    is_true = errors_um < 60.0
    nearest = distances_um.argmin(axis=1)
    is_detected = np.zeros(len(true_uv), dtype=bool)
    is_detected[nearest[is_true]] = True
    recall = float(is_detected[is_inside].mean()) if is_inside.any() else None
    return {
        f"recall_{side}": recall,
        f"false_{side}": float(np.count_nonzero(~is_true)),
        f"fle_{side}": rms(errors_um[is_true]),
    }


def registration_errors(comparison: Comparison) -> Values:
    """Return the error of every pixel in the sheet.

    Also what the marks say of it, and what it would be without flattening. None stands where no
    pixel is valid; ``scale_deviation`` is in % of the scale that is nearest to the true pose.
    """
    fit, errors_um = comparison.fit, comparison.place_error_um
    expected_um = comparison.linked["expected_error"].values[comparison.valid]
    expected_rms = rms(expected_um.astype(np.float64))
    true_rms = rms(errors_um)
    scale = ratio = None
    if true_rms is not None and expected_rms:
        ratio = true_rms / expected_rms
    uv = np.stack(comparison.true_uv, axis=-1)[comparison.valid]
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
    """95th percentile, over the columns that the image shows, of the error without flattening.

    Columns are projected along the axis through the sheet, and registered by the same marks. It is
    the distance in the image, brought to the sheet by ``scale``; None where a mark has no place.
    """
    names = ("projected_u", "projected_v")
    marks_uv = values_at(comparison.groups["maps"], names, fit.moving)
    if scale is None or not np.isfinite(marks_uv).all():
        return None
    projected = fit_transform(marks_uv, fit.fixed, mirrored=fit.transform.mirrored, robust=False)
    run_uv = _flat_places(comparison, names)
    material_uv = comparison.material[..., :2]
    is_valid = comparison.measured & np.isfinite(material_uv[..., 0])
    is_valid &= np.isfinite(run_uv).all(axis=-1)
    true_xy = comparison.specimen.pose(material_uv[is_valid])
    border_xy = [comparison.linked[axis].values[-1] for axis in "xy"]
    is_inside = np.all((true_xy >= 0) & (true_xy <= border_xy), axis=1)
    errors_um = np.linalg.norm(projected(run_uv[is_valid]) - true_xy, axis=1)
    return percentile(errors_um[is_inside] / scale, 95)


def resampling_errors(comparison: Comparison) -> Values:
    """Resample the columns' true thickness as the run does, and compare pixels with the truth.

    Of a large volume, rows in its middle with some 1 500 000 columns are taken.
    """
    surfaces, flat, linked = (comparison.groups[name] for name in ("surfaces", "flat", "linked"))
    has_coating = np.isfinite(linked["coating_top"].values).any()
    name = "coating_top" if has_coating else "thickness"
    height, width = surfaces["centre"].shape
    max_rows = min(height, max(2, 1_500_000 // width))
    rows = np.arange(max_rows) + (height - max_rows) // 2
    cols = np.arange(width)
    centre = surfaces["centre"].values[rows].astype(np.float64)
    u, v, _ = np.moveaxis(comparison.material_over(centre, rows, cols), -1, 0)
    transform = comparison.fit.transform
    uv = np.stack([flat[axis].values[rows] for axis in "uv"], axis=-1)
    least_um = min(pitch(surfaces)) * transform.scale
    places = find_places(transform(uv), Grid.of(linked), least_um=least_um)
    column_um = true_thickness(comparison.specimen.sheet, name, u, v)
    resampled_um = resample(column_um, places)
    pixel_u, pixel_v, _ = np.moveaxis(comparison.linked_material, -1, 0)
    true_um = comparison.pixel_thickness(name, pixel_u, pixel_v)
    errors = np.where(comparison.valid, resampled_um - true_um, np.nan)
    return {"resampling_rmse": rms(errors), "resampling_p95": percentile(errors, 95)}


def statistic_errors(comparison: Comparison) -> Values:
    """Correlate the measured and the true map with the image.

    Both are taken over the same pixels and the run's points. None where an r is not known.
    """
    image = comparison.linked["image"].values.astype(np.float64)
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
        u, v, _ = material.T
        materials.append(material)
        true_um = true_thickness(specimen.sheet, "coating_top", u, v)
        errors_um = layer_maps["coating_top"].values[valid] - true_um
        values[f"pair_coating_{name}_bias"] = mean_of(errors_um)
    first, second = materials
    distance_u, distance_v, _ = (first - second).T
    distances_um = np.hypot(distance_u, distance_v)
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
