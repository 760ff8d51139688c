"""Checks of one sheet.

That it is measured where it is, whole, one and not two, flat without folds, thick enough, and
clean.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy import ndimage

from planish.checks.greys import densest_layer
from planish.checks.scan import TILE_UM, GreyScan, ScannedSheet
from planish.core.checks import Check, CheckRule, State
from planish.core.facts import SIDES, Side
from planish.core.grid import blur_reach_um, pitch
from planish.core.robust import mad_sd
from planish.core.status import Status
from planish.core.typing import Bools, Floats, Pair
from planish.measure.registry import HEIGHTS
from planish.results import SheetFacts
from planish.surface import Corrections

_BRIGHT_SHARE = 0.10  # of the tiles
# Tiles side by side: pores of right sheets open 5 % of all, but 8 at most together; a gap of 300 um
# opens 19.
_SPLIT_TILES = 12
# 114 um are measured of 80 um with 2 voxels, 130 of 120 um with 3; with 4 it is right.
_LEAST_VOXELS = 5.0
_BLUR_REACH = 2.5  # blurs that a face reaches into the air beside it
_COARSE = 10  # cells across the median of what lies around a particle
_LEAST_MM2 = 0.1  # measured
# Sides of a square field by the nesting index. ISO 25178-3 evaluates a square of one index where
# nothing else is stated; below one and a half, Sq of waves to twice the index is some 10 % too low
# (docs/properties.md).
_LEAST_INDICES, _NO_LOSS_INDICES = 1.0, 1.5


@dataclass(frozen=True, slots=True)
class MeasuredSheet:
    """A sheet as it was mapped: its facts, and its surfaces and properties (y, x)."""

    facts: SheetFacts
    measured: xr.Dataset


# --- of a mapped sheet ----------------------------------------------------------------------------


def coverage(rule: CheckRule, sheet: MeasuredSheet) -> Check:
    """Judge how much of the sheet is measured."""
    surfaces = sheet.facts.surfaces
    # Rims of holes are left out on purpose, and beside a small specimen is air: what counts is the
    # rest.
    shares = surfaces.shares
    air_share = min(surfaces.empty_share or 0.0, shares["no_sheet"])
    rest_share = max(1.0 - shares["rim"] - air_share, 1e-9)
    measured_share = shares["measured"] / rest_share
    return rule.at_least(
        measured_share,
        look=0.5,
        units="share",
        sentence=(
            f"{100 * measured_share:.0f} % of the columns with a sheet, away from rims, are"
            " measured."
        ),
        advice=(
            "The maps are mostly blank, and what is left may not stand for the sheet. Look at the"
            " slices."
        ),
    )


def missing_voxels(rule: CheckRule, sheet: MeasuredSheet) -> Check | None:
    """Judge how many voxels have no value."""
    if (share := sheet.facts.surfaces.missing_share) is None:
        return None
    return rule.at_most(
        share,
        look=0.05,
        units="share",
        sentence=f"{100 * share:.1f} % of the voxels are NaN or infinite.",
        advice=(
            "Columns with such voxels near a face are not measured. Export the volume without them."
        ),
    )


def film(rule: CheckRule, sheet: MeasuredSheet) -> Check | None:
    """Name film or tape beside the sheet: what was left out, and what touches and was measured.

    None for neither. The search of the surfaces left both in the attributes: the thickness of what
    covers a side, and what lies beside the sheet, with the gap between, in um.
    """
    attrs = sheet.measured.attrs
    thicknesses_um: list[float] = []
    cover_texts: list[str] = []
    for side in SIDES:
        um = float(attrs.get(f"cover_{side}_um", 0.0))
        if um:
            thicknesses_um.append(um)
            cover_texts.append(f"on the {side} side some {um:.0f} um")
    if cover_texts:
        return rule.check(
            "fail",
            f"An even layer covers one of lighter grey, {' and '.join(cover_texts)} thick: tape,"
            " film or a mount that touches.",
            value=max(thicknesses_um),
            limit=0.0,
            units="um",
            advice=(
                "It is measured as if it were the sheet's: thickness and coatings are wrong there."
                " Take it off, or fill it with the grey of the air, and scan or map again."
            ),
        )
    if not (beside_text := attrs.get("beside")):
        return None
    return rule.at_least(
        float(attrs["beside_gap_um"]),
        look=2 * _BLUR_REACH * blur_reach_um(attrs),
        units="um",
        sentence=f"Beside the sheet lies something flat that was left out: {beside_text}.",
        advice=(
            "The blur reaches across the air between them: look at the slices, and crop the volume"
            " to the sheet."
        ),
    )


def fold_over(rule: CheckRule, sheet: MeasuredSheet) -> Check:
    """Judge whether the flattened mesh is folded."""
    folded = sheet.facts.flatten.folded_cells
    return rule.at_most(
        folded,
        look=0,
        sentence=f"{folded} cells of the flattened mesh are folded.",
        advice=(
            "They are marked invalid. Look at the centre surface there: the sheet is folded, or a"
            " face was lost."
        ),
    )


def alignment(rule: CheckRule, sheet: MeasuredSheet) -> Check | None:
    """Judge whether serial sections fit their neighbours."""
    if (sections := sheet.facts.sections) is None:
        return None
    n_aligned = sections.count - sections.not_aligned
    return rule.at_most(
        sections.not_aligned / sections.count,
        look=0.05,
        units="share",
        sentence=f"{n_aligned} of {sections.count} sections fit their neighbours.",
        advice=(
            "The others are torn, blurred, or not of this sheet, and count as missing. Look at"
            " them, and at the order of the files."
        ),
    )


def cutoff(rule: CheckRule, sheet: MeasuredSheet) -> Check:
    """Judge the cut-off of the centre surface: the stated one wherever it was measured."""
    attrs = sheet.measured.attrs
    bridged_share = float(attrs.get("bridged_off_rims_share", 0.0))
    stated_percent = 100 * (1 - bridged_share)
    end_text = "."
    if bridged_share > 0:
        end_text = ", and twice or four times as much in the alternatives."
    return rule.at_most(
        bridged_share,
        look=0.02,
        sentence=(
            f"The centre surface has the stated cut-off of {float(attrs['cutoff_um']):g} um in"
            f" {stated_percent:.1f} % of the columns away from holes and rims{end_text}"
        ),
        remedy=(
            "Choose a longer `cutoff_um`, or a smaller `rim_um` if the rims take the sheet away."
        ),
    )


def field_of_heights(rule: CheckRule, sheet: MeasuredSheet) -> Check | None:
    """Judge whether the field is large enough for the form of a face; None where it is.

    Beside its border a form follows long waves and takes them off. A strip counts as the square
    that has as much border by its area.
    """
    nesting_um = _nesting_um(sheet.facts)
    if not nesting_um:
        return None
    is_known = np.isfinite(sheet.measured["topography_top"].values)
    n_rows, n_cols = (np.count_nonzero(is_known.any(axis=axis)) for axis in (1, 0))
    row_um, col_um = pitch(sheet.measured)
    height_um, width_um = n_rows * row_um, n_cols * col_um
    side_um = 2 * height_um * width_um / max(height_um + width_um, 1e-9)
    wide_names = [name for name, um in nesting_um.items() if side_um < _NO_LOSS_INDICES * um]
    if not wide_names:
        return None
    index_um = max(nesting_um.values())
    state: State = "pass"
    loss_text = "some 10 %"
    remedy = ""
    if side_um < _LEAST_INDICES * index_um:
        state = "look"
        loss_text = "10 % and more"
        remedy = (
            "Choose a smaller form_um and l_filter_um in [properties] of a study file, or compare"
            " fields of one size only."
        )
    return rule.check(
        state,
        value=side_um / index_um,
        limit=_LEAST_INDICES,
        units="nesting indices",
        sentence=(
            f"The measured field of {height_um:.0f} x {width_um:.0f} um is small for a nesting"
            f" index of {index_um:g} um: long waves are taken for form, and Sq and the sd"
            f" of the topography are too low, by {loss_text} as a rule."
        ),
        remedy=remedy,
        figures=tuple(wide_names),
    )


def _nesting_um(facts: SheetFacts) -> dict[str, float]:
    """Nesting index of the form of each height and roughness that was measured."""
    numbers = facts.numbers
    if numbers is None:
        return {}
    nesting_um = {name: numbers.form_um for name in HEIGHTS if name in facts.properties}
    nesting_um |= {f"roughness_{side}": r.l_filter_um for side, r in numbers.roughness.items()}
    return {name: um for name, um in nesting_um.items() if um}


def corrections(rule: CheckRule, sheet: MeasuredSheet) -> Check | None:
    """Judge how much of the sheet was corrected by hand; None where nothing was.

    Maps ``correction_top`` and ``correction_bottom`` hold 1 where a face was drawn to points and
    follows an edge, 2 where there is none to follow.
    """
    surfaces = sheet.measured
    if "corrections" not in surfaces.attrs:
        return None
    stretches = Corrections.model_validate_json(surfaces.attrs["corrections"]).stretches
    n_points = sum(len(stretch.points) for stretch in stretches)
    flags = np.maximum(*(surfaces[f"correction_{face}"].values for face in SIDES))
    is_measured = surfaces["status"].values == Status.MEASURED
    n_measured = max(int(np.count_nonzero(is_measured)), 1)
    n_drawn = int(np.count_nonzero(flags >= 1))
    n_interpolated = int(np.count_nonzero(flags >= 2))
    return rule.at_most(
        n_drawn / n_measured,
        look=0.1,
        sentence=(
            f"Faces of {n_drawn} columns ({100 * n_drawn / n_measured:.2g} % of the sheet) were"
            f" drawn to {n_points} points of {len(stretches)} corrections by hand; {n_interpolated}"
            " of them show no edge there and are interpolated."
        ),
        remedy=(
            "Search the surfaces with other options (`sheet_grey`, `seed_um`) rather than by hand."
        ),
    )


# --- of a scan ------------------------------------------------------------------------------------


def one_sheet(rule: CheckRule, scan: GreyScan) -> Check:
    """Judge whether a coating, or air, lies inside the base.

    Both are looked for in the greys of the base's middle part (tiles, columns, depths): air where
    the mean over a tile's columns is too near to the air's grey at some depth, a coating where
    their median is too far beyond the base's. What is uncertain of a tile's own mean or median
    does not count.
    """
    greys = scan.greys
    core = scan.core
    profiles = scan.core_grey
    if not scan.voxel_count >= _LEAST_VOXELS:
        return rule.check(
            "unknown", "There are too few voxels across the sheet to tell one sheet from two."
        )
    # In a tile a few columns side by side may lie in one pore.
    n_whole = np.isfinite(profiles).all(axis=2).sum(axis=1)
    is_seen = n_whole >= max(5, 1 / 3 * core.shape[1])
    n_seen = np.count_nonzero(is_seen)
    if n_seen < 10:
        return rule.check(
            "unknown",
            f"The base is seen in {n_seen} tiles of {TILE_UM:g} um only, too few to tell one sheet"
            " from two.",
        )
    profiles = profiles[is_seen]
    root_n = np.sqrt(np.isfinite(profiles).sum(axis=1))
    # Air all over a tile is a gap, pores of some of its columns are none: its mean tells, 3
    # standard errors left out.
    mean = np.nanmean(profiles, axis=1, dtype=np.float64)
    mean_grey = float(np.median(mean))
    contrast = mean_grey - greys.air
    doubt = 3.0 * np.nanstd(profiles, axis=1, dtype=np.float64) / root_n
    toward_air = np.copysign(1.0, contrast) * (mean_grey - mean)
    deficit = (toward_air - doubt) / abs(contrast)  # 1 is air
    is_dark = deficit.max(axis=1) > 0.4
    # The tiles on their places in the sheet, to count those that lie side by side.
    dark_tiles = np.zeros([numbers.max() + 1 for numbers in core.tiles], bool)
    row, col = (numbers[is_seen][is_dark] for numbers in core.tiles)
    dark_tiles[row, col] = True
    side_by_side, _ = ndimage.label(dark_tiles)
    tiles_of_each = np.bincount(side_by_side[dark_tiles])
    n_dark = int(tiles_of_each.max(initial=0))
    median_profiles = np.nanmedian(profiles, axis=1)
    # 3 standard errors of the median of a tile's columns: 1.86 is 1.4826 of the median deviation,
    # 1.253 of the median.
    profiles -= median_profiles[:, None]
    deviations = np.abs(profiles, out=profiles)
    uncertainty = 3.0 * 1.86 * np.nanmedian(deviations, axis=1) / root_n
    median = median_profiles.astype(np.float64)
    base_grey = float(np.median(median))
    # A second sheet whose coatings lie in the middle may be learnt as base; what is lighter is
    # then told by the air.
    layer, coating_grey = densest_layer(greys)
    if layer == "base":
        coating_grey = 2 * base_grey - greys.air
    excess = (median - base_grey - uncertainty) / (coating_grey - base_grey)
    bright_share = float(np.mean(excess.max(axis=1) > 0.5))
    if bright_share > _BRIGHT_SHARE:
        return rule.check(
            "fail",
            value=bright_share,
            limit=_BRIGHT_SHARE,
            units="share",
            sentence=(
                f"In {100 * bright_share:.0f} % of the sheet something as dense as a coating lies"
                " in the middle of the base: a second sheet lies on the first."
            ),
            advice="Crop the volume to one sheet.",
            remedy="Or choose it with `seed_um`.",
        )
    split_text = ": it is split, or two sheets lie on each other."
    end_text = split_text if n_dark >= _SPLIT_TILES else ". No second sheet was found."
    return rule.at_most(
        n_dark,
        fail=_SPLIT_TILES - 1,
        units="tiles",
        sentence=(
            f"Tiles of {TILE_UM:g} um with air inside the base: {n_dark} side by side at"
            f" most{end_text}"
        ),
        advice="Look at the slices. Crop the volume to one intact sheet.",
    )


def voxels_through(rule: CheckRule, scan: ScannedSheet) -> Check:
    """Judge whether the sheet is thick enough for the voxels along its normal."""
    sentence = f"The sheet is {scan.voxel_count:.1f} voxels thick."
    if scan.voxel_count < _LEAST_VOXELS:
        sentence += " It may be thinner: sheets of 2 or 3 voxels are measured too thick."
    return rule.at_least(
        scan.voxel_count,
        look=_LEAST_VOXELS,
        units="voxels",
        sentence=sentence,
        advice=(
            "Scan with smaller voxels: five through the sheet are needed, and two through a"
            " coating."
        ),
    )


def dust(rule: CheckRule, scan: ScannedSheet, *, side: Side) -> Check | None:
    """Judge the particles on a side, which are measured as coating.

    None where no coating was measured, or on less than `_LEAST_MM2`.
    """
    measured = scan.measured
    name = f"coating_{side}"
    if name not in measured:
        return None
    coating = measured[name].values.astype(np.float64)
    heights = measured[side].values.astype(np.float64)
    face = np.abs(heights - measured["centre"].values)
    particles = find_particles(coating, face, pitch(measured))
    if particles.area_mm2 < _LEAST_MM2:
        return None
    n_measured = np.count_nonzero(np.isfinite(coating))
    covered_percent = 100 * np.count_nonzero(particles.mask) / n_measured
    return rule.at_most(
        particles.per_mm2,
        look=1.0,
        units="1/mm2",
        sentence=(
            f"{particles.n_particles} particles stick out of the {side} coating,"
            f" {particles.per_mm2:.2g} per mm², on {covered_percent:.2g} % of it."
        ),
        advice="Blow the specimen clean and scan it again, or leave the particles out of the map.",
    )


class Particles(NamedTuple):
    """Particles on one side."""

    mask: Bools
    n_particles: int
    per_mm2: float
    area_mm2: float  # that was measured


def find_particles(coating: Floats, face: Floats, pitch_um: Pair) -> Particles:
    """Find the particles that stand out of a map of a coating and of its face, (rows, cols) in um.

    ``face`` is the distance of the face from the centre surface: a coating that fills a valley is
    thick, but level. A particle is thicker than what lies around it by 5 standard deviations of
    all such differences, sticks out by half of that, and covers 400 um2 at least.
    """
    cell_um2 = pitch_um[0] * pitch_um[1]
    area_mm2 = np.count_nonzero(np.isfinite(coating)) * cell_um2 * 1e-6
    if area_mm2 < _LEAST_MM2:
        return Particles(np.zeros(coating.shape, bool), 0, 0.0, area_mm2)
    excess = coating - _median_around(coating, pitch_um)
    face_excess = face - _median_around(face, pitch_um)
    limit = 5.0 * max(mad_sd(excess), 1e-6)
    is_particle = (excess > limit) & (face_excess > 0.5 * excess)
    labels, n = ndimage.label(is_particle)
    areas_um2 = np.bincount(labels.ravel(), minlength=n + 1) * cell_um2
    is_large = areas_um2 >= 400.0
    is_large[0] = False  # what lies between particles
    count = int(is_large.sum())
    return Particles(is_large[labels], count, count / area_mm2, area_mm2)


def _median_around(coating: Floats, pitch_um: Pair) -> Floats:
    """Median of 300 um around every column, from medians of cells of a tenth.

    A cell without any value has the median of all; where there is none at all, the map is 0. What
    is left over beside whole cells, at the far ends, has the value of the last ones.
    """
    edges = [max(round(300.0 / _COARSE / p), 1) for p in pitch_um]  # of a cell, in columns
    rows, cols = coating.shape
    height = min(edges[0], rows)
    width = min(edges[1], cols)
    n_rows, n_cols = rows // height, cols // width
    cropped = coating[: n_rows * height, : n_cols * width]
    by_cell = cropped.reshape(n_rows, height, n_cols, width).swapaxes(1, 2)
    cells = by_cell.reshape(n_rows, n_cols, -1)
    medians = np.full((n_rows, n_cols), np.nan)
    is_measured = np.isfinite(cells).any(axis=2)
    medians[is_measured] = np.nanmedian(cells[is_measured], axis=1)
    medians[~is_measured] = np.nanmedian(medians) if is_measured.any() else 0.0
    coarse = ndimage.median_filter(medians, size=_COARSE, mode="nearest")
    # Columns count from the middle of the first cell, in cells.
    row_places = (np.arange(rows) + 0.5) / edges[0] - 0.5
    col_places = (np.arange(cols) + 0.5) / edges[1] - 0.5
    places = np.meshgrid(row_places, col_places, indexing="ij")
    return ndimage.map_coordinates(coarse, places, order=1, mode="nearest")
