"""Align serial sections jointly.

Each is aligned against its neighbours on both sides, and only in what changes quickly.

Offsets between all sections up to five apart are fitted together; waves longer than some fifty
sections, in which the bend of the sheet cannot be told from a drift of the stage, stay, unless
something fixed to the stage shows that drift.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from planish.core.errors import VolumeError
from planish.core.threads import map_threads
from planish.core.typing import Bools, Floats, Ints, Pair
from planish.sections.band import SectionSeries, Stack
from planish.sections.network import (
    LEAST_SHARE,
    quick_places,
    section_components,
    slow_part,
    solve_places,
)
from planish.sections.pairs import FINEST_UM, GROUPS, SectionPairs, compare

# Each section is compared with so many on either side, and in the first rounds.
_REACH, _REACH_FIRST = 5, 2
_CUTOFF_PITCHES = 50.0  # corrections with longer wavelengths are not applied
# Sigma of fine over that of coarse pairs of neighbours, above which the fine ones show noise.
_SURER = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """Places of the sections against their neighbours.

    What belongs at (row, col) of section i is found at (row, col) + ``shift_um[i]`` / pixel, turned
    about the middle of the section by ``rotation_rad[i]``: with x, y the distances from the middle
    along the columns and rows, in um, the row is larger by ``rotation x`` and the column smaller by
    ``rotation y``.
    """

    #: (sections, 2): along (row, col), in um; 0 where a section could not be aligned.
    shift_um: Floats
    rotation_rad: Floats  #: (sections,), shortened by the share that is its own error.
    #: (sections,), False for one with less than two good pairs: torn, blurred, or not of this
    #: sheet.
    aligned: Bools
    #: Standard deviation of what is left of the quick errors along (row, col) of the median
    #: section, from solutions that leave out one sixth of the columns each (jackknife). What all
    #: columns share is not in it.
    jitter_left_um: Floats
    pairs_used: int  #: Pairs of sections that were used.
    pairs_refused: int  #: Pairs that were refused.
    #: Waves longer than this along the cut were left alone, except where something fixed shows
    #: them.
    cutoff_um: float
    #: Whether (row, col, rotation) were held by something fixed, slow waves included.
    fixed: tuple[bool, ...] = (False, False, False)


def align_sections(series: SectionSeries, *, fixed: Floats | None = None) -> Alignment:
    """Align serial sections jointly, leaving the slow waves alone.

    Parameters
    ----------
    series : SectionSeries
    fixed : ndarray (sections, 3), optional
        Places against something that does not move, as :func:`planish.sections.fixed_places` gives
        them: the slow waves are then taken from there instead of being left alone. NaN where it is
        not visible.

    Returns
    -------
    Alignment

    Raises
    ------
    VolumeError
        If no sheet is found.

    Notes
    -----
    Offsets come from the gradients of texture and faces (Lucas and Kanade 1981) in the band along
    the sheet; those along the columns once more from fine texture of next neighbours, where it
    determines them better. Robust weighted least squares joins them, and a filter with its half
    amplitude at the cut-off removes the slow part. Joint alignment: Saalfeld et al. 2012, Nature
    Methods 9, 717. A sheet that rises along the cut has a true offset from section to section; it
    belongs to the slow part, and the band follows it before anything is compared.
    """
    away_um = series.away_um
    n = away_um.size
    cutoff_um = _CUTOFF_PITCHES * series.pitch_um
    first, second = neighbours(away_um, series.pitch_um, _REACH)
    # Course of the sheet itself as a pose: mean height and slope of the smooth surface, which the
    # pairs do not see.
    sheet_course = _sheet_course(series)
    pose = np.zeros((n, 3))
    pose[:, 0] = series.band.jump * series.pixel_um[0]
    # The first rounds only bring the sections near, with few pairs; the offsets that count are
    # those of the last.
    is_near = second - first <= _REACH_FIRST
    for is_compared in (is_near, is_near, np.ones_like(is_near)):
        coarse_pairs = compare(series, pose, first[is_compared], second[is_compared])
        places, is_used = _join_pairs(coarse_pairs, n)
        first_used, second_used = coarse_pairs.first[is_used], coarse_pairs.second[is_used]
        components = section_components(first_used, second_used, n)
        pose = quick_places(places + sheet_course, away_um, components, cutoff_um=cutoff_um)
    # Coarse texture wanders along the columns with the fibres that come and go; fine texture less.
    # The place along the columns is measured once more in it, now that the sections lie near
    # enough.
    is_close = (second - first == 1) & is_used
    has_fine = max(series.pixel_um) <= FINEST_UM and is_close.any()
    coarse_sigma = coarse_pairs.sigma[is_close, 1]
    fine_pairs: SectionPairs | None = None
    coarse_pose = pose
    for _ in range(2 if has_fine else 0):
        finer_pairs = compare(series, pose, first[is_close], second[is_close], is_fine=True)
        fine_sigma = finer_pairs.sigma[:, 1]
        if not np.median(fine_sigma) < _SURER * np.median(coarse_sigma):
            fine_pairs, pose = None, coarse_pose
            break
        fine_pairs = finer_pairs
        places[:, 1] = _join_columns(coarse_pairs, fine_pairs, n)
        pose = quick_places(places + sheet_course, away_um, components, cutoff_um=cutoff_um)
    # Sections that hang together with others, by two pairs or more.
    pair_counts = np.bincount(np.concatenate([first_used, second_used]), minlength=n)
    aligned = np.zeros(n, bool)
    for component in components:
        aligned[component] = pair_counts[component] >= min(2, n - 1)
    pose[~aligned] = 0.0
    pose_variance = _jackknife_variance(series, coarse_pairs, fine_pairs, components, aligned)
    # A narrow image determines rotations badly: they are shortened to what is more than their own
    # error (Wiener).
    square_rotation_sum = np.sum(pose[aligned, 2] ** 2)
    known_share = 0.0
    if square_rotation_sum > 0:
        known_share = 1.0 - float(pose_variance[:, 2].sum() / square_rotation_sum)
    pose[:, 2] *= max(0.0, known_share)
    is_fixed = [False] * 3
    if fixed is not None:
        is_fixed = _add_fixed_drift(pose, fixed, away_um, cutoff_um, aligned)
    # The median section: where a hole rules one run of columns, leaving that out tells the error of
    # the others, not of all.
    median_variance = np.median(pose_variance[:, :2], axis=0)
    n_used = int(is_used.sum())
    return Alignment(
        shift_um=pose[:, :2].copy(),
        rotation_rad=pose[:, 2].copy(),
        aligned=aligned,
        jitter_left_um=np.sqrt(median_variance),
        pairs_used=n_used,
        pairs_refused=is_used.size - n_used,
        cutoff_um=cutoff_um,
        fixed=tuple(is_fixed),
    )


def _jackknife_variance(
    series: SectionSeries,
    coarse: SectionPairs,
    fine: SectionPairs | None,
    components: list[Ints],
    aligned: Bools,
) -> Floats:
    """Give the variance of the poses of aligned sections (sections, 3), or NaN.

    It comes from solutions that each leave out a run of columns, of the surface too. ``fine`` pairs
    are those of next neighbours; None where they show no more than the coarse ones.
    """
    if not aligned.any():
        return np.full((1, 3), np.nan)
    away_um = series.away_um
    cutoff_um = _CUTOFF_PITCHES * series.pitch_um
    poses: list[Floats] = []
    for k in range(GROUPS):
        fewer_pairs = coarse.without(k)
        places = _join_pairs(fewer_pairs, away_um.size)[0]
        if fine is not None:
            places[:, 1] = _join_columns(fewer_pairs, fine.without(k), away_um.size)
        places += _sheet_course(series, left_out_group=k)
        poses.append(quick_places(places, away_um, components, cutoff_um=cutoff_um))
    return np.var(poses, axis=0)[aligned] * (GROUPS - 1)


def _add_fixed_drift(
    pose: Floats, fixed: Floats, away_um: Floats, cutoff_um: float, aligned: Bools
) -> list[bool]:
    """Add the slow part of what something fixed shows; True for each axis that it shows.

    ``pose`` (sections, 3), which is changed, and ``fixed`` are along (row, col) in um, and in rad;
    an axis shows it in half of the sections or more.
    """
    shares = np.isfinite(fixed).mean(axis=0)
    is_fixed = (shares >= 0.5).tolist()
    for axis in np.flatnonzero(is_fixed):
        places = fixed[:, axis]
        weights = np.isfinite(places).astype(np.float64)
        drift = slow_part(away_um, np.nan_to_num(places), cutoff_um=cutoff_um, weights=weights)
        pose[aligned, axis] += drift[aligned]
    return is_fixed


def neighbours(away_um: Floats, pitch_um: float, reach: int) -> tuple[Ints, Ints]:
    """Give the pairs of sections at most ``reach`` apart, ordered by the first.

    No wide gap lies between them.
    """
    n = away_um.size
    # Neighbours farther apart show other fibres: three missing sections are bridged, no more.
    is_gap = np.diff(away_um, prepend=away_um[0]) > 4.5 * pitch_um
    n_gaps = np.cumsum(is_gap)
    first = np.repeat(np.arange(n), reach)
    second = first + np.tile(np.arange(reach) + 1, n)
    first, second = first[second < n], second[second < n]
    is_joined = n_gaps[first] == n_gaps[second]
    return first[is_joined], second[is_joined]


def _sheet_course(series: SectionSeries, left_out_group: int = -1) -> Floats:
    """Mean height in um, 0, and slope of the smooth surface in each section, (sections, 3).

    Heights are rows from the middle of the section. One group of the columns is left out, or none
    (-1).
    """
    band = series.band
    _, rows, cols = series.stack.shape
    row_um, col_um = series.pixel_um
    is_included = band.at_col * GROUPS // cols != left_out_group
    from_middle = band.at_col[is_included] - 0.5 * (cols - 1)
    x = from_middle * col_um
    y = (band.row[:, is_included] - 0.5 * (rows - 1)) * row_um
    mean_height_um, slope = np.polynomial.polynomial.polyfit(x, y.T, 1)
    return np.stack([mean_height_um, np.zeros_like(slope), slope], axis=1)


def _join_pairs(pairs: SectionPairs, n: int) -> tuple[Floats, Bools]:
    """Places of all sections (sections, 3), and which pairs were used."""
    places = np.zeros((n, 3))
    weight_shares = np.zeros((pairs.first.size, 3))
    is_sound = pairs.is_sound
    for axis in range(3):
        places[:, axis], shares = solve_places(*pairs.sound(axis), n)
        weight_shares[is_sound, axis] = shares
    return places, is_sound & (np.min(weight_shares, axis=1) > LEAST_SHARE)


def _join_columns(coarse_pairs: SectionPairs, fine_pairs: SectionPairs, n: int) -> Floats:
    """Places along the columns from the coarse and the fine texture together; (sections,).

    The coarse ones bridge what the fine ones do not hold together, and take over where noise hides
    fine texture.
    """
    # Coarse pairs over the same sections, and the next ones, share their errors.
    coarse_pairs = coarse_pairs._replace(sigma=4.0 * coarse_pairs.sigma)
    columns: Any = zip(coarse_pairs.sound(1), fine_pairs.sound(1), strict=True)
    first, second, offset, sigma = map(np.concatenate, columns)
    places, _ = solve_places(first, second, offset, sigma, n)
    return places


Strip = tuple[int, int]
# Pieces along the line: their spread says how sure a place is, their course gives the rotation.
_PARTS = 12
_LEAST = 4  # pixels across a strip


def fixed_places(
    stack: Stack, pixel_um: Pair, *, rows: Strip | None = None, cols: Strip | None = None
) -> Floats:
    """Find the place of every section against lines that lie still.

    Parameters
    ----------
    stack : ndarray (sections, rows, cols)
    pixel_um : (row, col)
    rows : (int, int), optional
        First and last row of a strip that shows a line or edge along the rows, and nothing else
        that changes.
    cols : (int, int), optional
        The same for a line or edge along the columns.

    Returns
    -------
    ndarray (sections, 3)
        Shift along (row, col) in um and rotation in rad, about their means over the sections, signs
        as in :class:`planish.sections.Alignment`; NaN where no strip was given for it or a section
        does not show the line.

    Raises
    ------
    VolumeError
        If a strip lies outside the photographs, is too narrow, or shows no line.
    """
    places = np.full((stack.shape[0], 3), np.nan)
    for axis, strip in ((0, rows), (1, cols)):
        if strip is None:
            continue
        size = stack.shape[1 + axis]
        low, high = strip
        if not 0 <= low <= high - _LEAST < size - _LEAST:
            raise VolumeError(
                f"The strip {low} to {high} of a fixed line does not lie in the photographs, which"
                f" have {size} {'rows' if axis == 0 else 'columns'}, or is narrower than {_LEAST}"
                " pixels. Give first and last one."
            )
        places[:, axis], turn = _line_places(stack, axis, strip, pixel_um)
        if np.isnan(places[:, 2]).all():
            # Along a column the place is smaller by rotation y, along a row larger by rotation x.
            places[:, 2] = turn if axis == 0 else -turn
    for column in places.T:
        if np.isfinite(column).any():
            column -= np.nanmean(column)
    return places


def _line_places(stack: Stack, axis: int, strip: Strip, pixel_um: Pair) -> tuple[Floats, Floats]:
    """Place in um and slope of the line of each section, against their mean.

    ``axis`` 0: a line along the rows' pixels, whose place is a row; 1: one along the columns.
    ``strip`` are the first and the last pixel across it. NaN where a section does not show it.
    """
    across_um = pixel_um[axis]
    length_px = stack.shape[2 - axis]
    strip_slice = slice(strip[0], strip[1] + 1)
    piece_edges = np.linspace(0, length_px, _PARTS + 1).astype(int)

    def cut(i: int) -> Floats:
        greys = np.asarray(stack[i], dtype=np.float64)
        greys = greys[strip_slice] if axis == 0 else greys[:, strip_slice].T
        piece_sums = np.add.reduceat(greys, piece_edges[:-1], axis=1)
        return (piece_sums / np.diff(piece_edges)).T

    profiles = np.stack(map_threads(cut, range(stack.shape[0])))  # (sections, pieces, across)
    shift = np.zeros(profiles.shape[:2])
    correlation = np.zeros(profiles.shape[:2])
    # From coarse to fine: the first reaches as far as sections are off.
    for sigma_um in (12.0, 4.0, 2.0):
        sigma_px = max(sigma_um / across_um, 0.5)
        longest_step = 2 * sigma_um / across_um
        smoothed = gaussian_filter1d(profiles, sigma_px, axis=2, mode="nearest")
        for _ in range(4):
            shifted = _shifted(smoothed, shift)
            shift_step, correlation = _match_template(shifted, np.median(shifted, axis=0))
            shift += np.clip(shift_step, -longest_step, longest_step)
            shift -= np.median(shift)
    # Correlation with the mean profile below which a piece does not show the line.
    shows_line = correlation > 0.7
    is_clear = shows_line.sum(axis=1) >= _PARTS // 2
    if np.count_nonzero(is_clear) < 0.5 * is_clear.size:
        raise VolumeError(
            f"The {'columns' if axis else 'rows'} {strip[0]} to {strip[1]} show no line or edge"
            " that lies still in most sections. Look at a few photographs and give a strip that"
            " shows the same straight line throughout."
        )
    piece_middles = 0.5 * (piece_edges[1:] + piece_edges[:-1] - 1)
    along_um = (piece_middles - 0.5 * (length_px - 1)) * pixel_um[1 - axis]
    # The mean course of all sections is the line's own and is taken off.
    shift *= across_um
    line_course = np.zeros(_PARTS)
    has_line = shows_line.any(axis=0)
    line_shift = np.where(shows_line, shift, np.nan)
    line_course[has_line] = np.nanmedian(line_shift[:, has_line], axis=0)
    line_fits = np.full((is_clear.size, 2), np.nan)
    for i in np.flatnonzero(is_clear):
        is_visible = shows_line[i]
        deviation = shift[i] - line_course
        line_fits[i] = np.polyfit(along_um[is_visible], deviation[is_visible], 1)
    slopes, places = line_fits.T
    return places, slopes


def _shifted(profiles: Floats, shift: Floats) -> Floats:
    """Profiles read at their places plus ``shift``, linearly between pixels."""
    width = profiles.shape[2]
    position = np.clip(np.arange(width) + shift[..., None], 0, width - 1)
    index = np.minimum(position.astype(int), width - 2)
    weight = position - index
    before = np.take_along_axis(profiles, index, axis=2)
    after = np.take_along_axis(profiles, index + 1, axis=2)
    return before * (1 - weight) + after * weight


def _match_template(profiles: Floats, template: Floats) -> tuple[Floats, Floats]:
    """Fit gain x template + offset, moved, to profiles.

    It gives how much further each profile (sections, pieces, across) lies than the template
    (pieces, across), in pixels, and its correlation; 0 where it shows too little of the template.
    Least squares of the profile on the template t and its gradient g.
    """
    gradient = np.gradient(template, axis=1)
    # Without the ends, where shifted profiles repeat themselves.
    interiors = (v[..., 2:-2] for v in (template, gradient, profiles))
    t, g, f = (v - v.mean(axis=-1, keepdims=True) for v in interiors)
    tt = (t * t).sum(axis=-1)
    tg = (t * g).sum(axis=-1)
    gg = (g * g).sum(axis=-1)
    ft = (f * t).sum(axis=-1)
    fg = (f * g).sum(axis=-1)
    ff = (f * f).sum(axis=-1)
    det = np.maximum(tt * gg - tg * tg, 1e-12)
    gain = (ft * gg - fg * tg) / det
    gradient_gain = (fg * tt - ft * tg) / det
    correlation = ft / np.sqrt(np.maximum(ff * tt, 1e-12))
    shift = np.divide(-gradient_gain, gain, out=np.zeros_like(gain), where=gain > 0.2)
    return shift, correlation
