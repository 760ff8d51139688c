"""Joint alignment of serial sections: each against its neighbours on both sides, and only what changes quickly.

Aligning each section to the one before adds up errors and straightens the specimen's true bend. Here the offsets
between all sections up to five apart are fitted together, and waves longer than some fifty sections, in which the
bend of the sheet cannot be separated from a drift of the stage, are left as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planish.core.typing import Bools, Floats
from planish.sections.band import SectionSeries
from planish.sections.network import LEAST_SHARE, Index, parts, quick_places, slow_part, solve_places
from planish.sections.pairs import FINEST_UM, GROUPS, Bands, SectionPairs, compare

_GAP_SECTIONS = 4.5  # neighbours farther apart show other fibres: three missing sections are bridged, no more
_CUTOFF_SECTIONS = 50.0  # corrections with longer wavelengths are not applied
_REACH, _REACH_FIRST = 5, 2  # each section is compared with so many on either side, and in the first rounds
_ROUNDS = 3  # of measuring the offsets, each with the corrections of the last
_FINE_ROUNDS = 2
_COARSE_FACTOR = 4.0
"""On the sigma of pairs of coarse bands: those over the same sections, and the next ones, share their errors."""
_SURER = 0.5  # sigma of fine over that of coarse pairs of neighbours, above which the fine ones show noise


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """Places of the sections against their neighbours.

    What belongs at (row, col) of section i is found at (row, col) + ``shift_um[i]`` / pixel, turned about the middle
    of the section by ``rotation_rad[i]``: with x, y the distances from the middle along the columns and rows, in um,
    the row is larger by ``rotation x`` and the column smaller by ``rotation y``.

    Attributes
    ----------
    shift_um : ndarray (sections, 2)
        Along (row, col), in um; 0 where a section could not be aligned.
    rotation_rad : ndarray (sections,)
        Shortened by the share that is its own error.
    aligned : ndarray of bool (sections,)
        False for a section with less than two good pairs: torn, blurred, or not of this sheet.
    jitter_left_um : ndarray (2,)
        Standard deviation of what is left of the quick errors along (row, col), from solutions that leave out one
        sixth of the columns each (jackknife). What all columns share is not in it.
    pairs_used, pairs_refused : int
    cutoff_um : float
        Waves longer than this along the cut were left alone, except where something fixed shows them.
    fixed : tuple of bool
        Whether (row, col, rotation) were held by something fixed, slow waves included.
    """

    shift_um: Floats
    rotation_rad: Floats
    aligned: Bools
    jitter_left_um: Floats
    pairs_used: int
    pairs_refused: int
    cutoff_um: float
    fixed: tuple[bool, ...] = (False, False, False)


def align_sections(series: SectionSeries, *, fixed: Floats | None = None) -> Alignment:
    """Align serial sections jointly, leaving the slow waves alone.

    Parameters
    ----------
    series : SectionSeries
    fixed : ndarray (sections, 3), optional
        Places against something that does not move, as :func:`planish.sections.fixed_places` gives them: the slow waves
        are then taken from there instead of being left alone. NaN where it is not visible.

    Returns
    -------
    Alignment

    Raises
    ------
    VolumeError
        If no sheet is found.

    Notes
    -----
    Offsets come from the gradients of texture and faces (Lucas and Kanade 1981) in the band along the sheet; those
    along the columns once more from fine texture of next neighbours, where it determines them better. Robust weighted
    least squares joins them, and a filter with its half amplitude at the cut-off removes the slow part.
    Joint alignment: Saalfeld et al. 2012, Nature Methods 9, 717. A sheet that rises along the cut has a true offset
    from section to section; it belongs to the slow part, and the band follows it before anything is compared.
    """
    away, n = series.away_um, series.away_um.size
    cutoff = _CUTOFF_SECTIONS * series.pitch_um
    first, second = neighbours(away, series.pitch_um, _REACH)
    # Course of the sheet itself as a pose: mean height and slope of the smooth surface, which the pairs do not see.
    course = _sheet_course(series)
    pose = np.zeros((n, 3))
    pose[:, 0] = series.band.jump * series.pixel_um[0]
    # The first rounds only bring the sections near, with few pairs; the offsets that count are those of the last.
    near = second - first <= _REACH_FIRST
    for _ in range(_ROUNDS - 1):
        coarse = _measure_pairs(series, pose, first[near], second[near])
        places, is_used = _join_pairs(coarse, n)
        groups = parts(coarse.first[is_used], coarse.second[is_used], n)
        pose = quick_places(places + course, away, groups, cutoff_um=cutoff)
    coarse = _measure_pairs(series, pose, first, second)
    places, is_used = _join_pairs(coarse, n)
    groups = parts(first[is_used], second[is_used], n)
    pose = quick_places(places + course, away, groups, cutoff_um=cutoff)
    # Coarse texture wanders along the columns with the fibres that come and go; fine texture less. The place along the
    # columns is measured once more in it, now that the sections lie near enough.
    close = (second - first == 1) & is_used
    fine: SectionPairs | None = None
    coarse_pose = pose
    for _ in range(_FINE_ROUNDS if max(series.pixel_um) <= FINEST_UM and close.any() else 0):
        finer = _measure_pairs(series, pose, first[close], second[close], fine=True)
        if not np.median(finer.sigma[:, 1]) < _SURER * np.median(coarse.sigma[close, 1]):
            fine, pose = None, coarse_pose
            break
        fine = finer
        places[:, 1] = _join_columns(coarse, fine, n)
        pose = quick_places(places + course, away, groups, cutoff_um=cutoff)
    # Sections that hang together with others, by two pairs or more.
    pair_counts = np.bincount(np.concatenate([first[is_used], second[is_used]]), minlength=n)
    aligned = np.isin(np.arange(n), np.concatenate([np.zeros(0, np.intp), *groups])) & (pair_counts >= min(2, n - 1))
    pose[~aligned] = 0.0
    variance = np.full(3, np.nan)
    if aligned.any():
        spread = _spread_without_groups(series, coarse, fine, groups, cutoff)
        variance = np.mean(spread[aligned], axis=0) * (GROUPS - 1)
    # A narrow image determines rotations badly: they are shortened to what is more than their own error (Wiener).
    mean_square_turn = float(np.mean(pose[aligned, 2] ** 2)) if aligned.any() else 0.0
    pose[:, 2] *= max(0.0, 1.0 - variance[2] / mean_square_turn) if mean_square_turn > 0 else 0.0
    fixed_axes = _add_fixed_drift(pose, fixed, away, cutoff, aligned) if fixed is not None else (False, False, False)
    return Alignment(
        shift_um=pose[:, :2].copy(),
        rotation_rad=pose[:, 2].copy(),
        aligned=aligned,
        jitter_left_um=np.sqrt(variance[:2]),
        pairs_used=int(np.count_nonzero(is_used)),
        pairs_refused=int(is_used.size - np.count_nonzero(is_used)),
        cutoff_um=cutoff,
        fixed=fixed_axes,
    )


def _measure_pairs(
    series: SectionSeries, pose: Floats, first: Index, second: Index, *, fine: bool = False
) -> SectionPairs:
    """Measure the offsets of pairs of sections in bands that are straightened by their poses."""
    bands = Bands(stack=series.stack, band=series.band, pixel_um=series.pixel_um, fine=fine)
    return compare(bands.sums(pose, first, second), first, second, pose, fine=fine)


def _spread_without_groups(
    series: SectionSeries, coarse: SectionPairs, fine: SectionPairs | None, groups: list[Index], cutoff: float
) -> Floats:
    """Variance of the poses (sections, 3) where one run of columns after the other is left out, of the surface too."""
    poses: list[Floats] = []
    for k in range(GROUPS):
        fewer = coarse.without(k)
        places = _join_pairs(fewer, len(series.away_um))[0]
        if fine is not None:
            places[:, 1] = _join_columns(fewer, fine.without(k), len(series.away_um))
        places += _sheet_course(series, without=k)
        poses.append(quick_places(places, series.away_um, groups, cutoff_um=cutoff))
    return np.var(poses, axis=0)


def _add_fixed_drift(pose: Floats, fixed: Floats, away: Floats, cutoff: float, aligned: Bools) -> tuple[bool, ...]:
    """Add the slow part of what something fixed shows; True for each axis that it shows."""
    is_fixed = [False, False, False]
    for axis in range(3):
        is_measured = np.isfinite(fixed[:, axis])
        if np.count_nonzero(is_measured) < 0.5 * is_measured.size:
            continue
        slow = slow_part(
            away, np.where(is_measured, fixed[:, axis], 0.0), cutoff_um=cutoff, weights=is_measured.astype(np.float64)
        )
        pose[aligned, axis] += slow[aligned]
        is_fixed[axis] = True
    return tuple(is_fixed)


def neighbours(away_um: Floats, pitch_um: float, reach: int) -> tuple[Index, Index]:
    """Give the pairs of sections at most ``reach`` apart with no wide gap between them, ordered by the first."""
    n = away_um.size
    wide = np.cumsum(np.concatenate([[0], np.diff(away_um) > _GAP_SECTIONS * pitch_um]))
    ties = [(i, j) for i in range(n) for j in range(i + 1, min(i + reach, n - 1) + 1) if wide[i] == wide[j]]
    table = np.array(ties, np.intp).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _sheet_course(series: SectionSeries, without: int = -1) -> Floats:
    """Mean height in um, 0, and slope of the smooth surface in each section; (sections, 3).

    ``without`` leaves out the columns of one group of parts.
    """
    band, (_, rows, cols) = series.band, series.stack.shape
    blocks = band.at_col * GROUPS // cols != without
    x = (band.at_col[blocks] - 0.5 * (cols - 1)) * series.pixel_um[1]
    y = (band.row[:, blocks] - 0.5 * (rows - 1)) * series.pixel_um[0]
    slope, mean = np.polynomial.polynomial.polyfit(x, y.T, 1)[::-1]
    return np.stack([mean, np.zeros(mean.size), slope], axis=1)


def _join_pairs(pairs: SectionPairs, n: int) -> tuple[Floats, Bools]:
    """Places of all sections (sections, 3), and which pairs were used."""
    places = np.zeros((n, 3))
    shares = np.zeros((pairs.first.size, 3))
    sound = pairs.sound
    for axis in range(3):
        places[:, axis], shares[sound, axis] = solve_places(
            pairs.first[sound], pairs.second[sound], pairs.offset[sound, axis], pairs.sigma[sound, axis], n
        )
    return places, sound & (np.min(shares, axis=1) > LEAST_SHARE)


def _join_columns(coarse: SectionPairs, fine: SectionPairs, n: int) -> Floats:
    """Places along the columns from the coarse and the fine texture together; (sections,).

    The coarse ones bridge what the fine ones do not hold together, and take over where noise hides fine texture.
    """
    first = np.concatenate([p.first[p.sound] for p in (coarse, fine)])
    second = np.concatenate([p.second[p.sound] for p in (coarse, fine)])
    offset = np.concatenate([p.offset[p.sound, 1] for p in (coarse, fine)])
    sigma = np.concatenate([_COARSE_FACTOR * coarse.sigma[coarse.sound, 1], fine.sigma[fine.sound, 1]])
    return solve_places(first, second, offset, sigma, n)[0]
