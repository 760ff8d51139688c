"""Joint alignment of serial sections: each against its neighbours on both sides, and only what changes quickly.

Offsets between all sections up to five apart are fitted together; waves longer than some fifty sections, in which the
bend of the sheet cannot be told from a drift of the stage, stay, unless something fixed to the stage shows that drift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from planish.core.errors import VolumeError
from planish.core.threads import map_threads
from planish.core.transform import Pair
from planish.core.typing import Bools, Floats
from planish.sections.band import SectionSeries, Stack
from planish.sections.network import LEAST_SHARE, Index, parts, quick_places, slow_part, solve_places
from planish.sections.pairs import FINEST_UM, GROUPS, SectionPairs, compare

_REACH, _REACH_FIRST = 5, 2  # each section is compared with so many on either side, and in the first rounds

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
    cutoff = 50.0 * series.pitch_um  # corrections with longer wavelengths are not applied
    first, second = neighbours(away, series.pitch_um, _REACH)
    # Course of the sheet itself as a pose: mean height and slope of the smooth surface, which the pairs do not see.
    course = _sheet_course(series)
    pose = np.zeros((n, 3))
    pose[:, 0] = series.band.jump * series.pixel_um[0]
    # The first rounds only bring the sections near, with few pairs; the offsets that count are those of the last.
    near = second - first <= _REACH_FIRST
    for chosen in (near, near, np.ones_like(near)):
        coarse = compare(series, pose, first[chosen], second[chosen])
        places, is_used = _join_pairs(coarse, n)
        groups = parts(coarse.first[is_used], coarse.second[is_used], n)
        pose = quick_places(places + course, away, groups, cutoff_um=cutoff)
    # Coarse texture wanders along the columns with the fibres that come and go; fine texture less. The place along the
    # columns is measured once more in it, now that the sections lie near enough.
    close = (second - first == 1) & is_used
    fine: SectionPairs | None = None
    coarse_pose = pose
    for _ in range(2 if max(series.pixel_um) <= FINEST_UM and close.any() else 0):
        finer = compare(series, pose, first[close], second[close], fine=True)
        if not np.median(finer.sigma[:, 1]) < _SURER * np.median(coarse.sigma[close, 1]):
            fine, pose = None, coarse_pose
            break
        fine = finer
        places[:, 1] = _join_columns(coarse, fine, n)
        pose = quick_places(places + course, away, groups, cutoff_um=cutoff)
    # Sections that hang together with others, by two pairs or more.
    pair_counts = np.bincount(np.concatenate([first[is_used], second[is_used]]), minlength=n)
    aligned = np.isin(np.arange(n), [i for group in groups for i in group]) & (pair_counts >= min(2, n - 1))
    pose[~aligned] = 0.0
    variance = np.full(3, np.nan)
    if aligned.any():
        variance = _variance_without_groups(series, coarse, fine, groups, cutoff)[aligned].mean(axis=0) * (GROUPS - 1)
    # A narrow image determines rotations badly: they are shortened to what is more than their own error (Wiener).
    mean_square_turn = float(np.mean(pose[aligned, 2] ** 2)) if aligned.any() else 0.0
    pose[:, 2] *= max(0.0, 1.0 - variance[2] / mean_square_turn) if mean_square_turn > 0 else 0.0
    is_fixed = _add_fixed_drift(pose, fixed, away, cutoff, aligned) if fixed is not None else [False] * 3
    return Alignment(
        shift_um=pose[:, :2].copy(),
        rotation_rad=pose[:, 2].copy(),
        aligned=aligned,
        jitter_left_um=np.sqrt(variance[:2]),
        pairs_used=int(is_used.sum()),
        pairs_refused=int((~is_used).sum()),
        cutoff_um=cutoff,
        fixed=tuple(is_fixed),
    )


def _variance_without_groups(
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


def _add_fixed_drift(pose: Floats, fixed: Floats, away: Floats, cutoff: float, aligned: Bools) -> list[bool]:
    """Add the slow part of what something fixed shows; True for each axis that it shows."""
    is_fixed = [bool(np.isfinite(course).mean() >= 0.5) for course in fixed.T]
    for axis in np.flatnonzero(is_fixed):
        weights = np.isfinite(fixed[:, axis]).astype(np.float64)
        slow = slow_part(away, np.nan_to_num(fixed[:, axis]), cutoff_um=cutoff, weights=weights)
        pose[aligned, axis] += slow[aligned]
    return is_fixed


def neighbours(away_um: Floats, pitch_um: float, reach: int) -> tuple[Index, Index]:
    """Give the pairs of sections at most ``reach`` apart with no wide gap between them, ordered by the first."""
    n = away_um.size
    # Neighbours farther apart show other fibres: three missing sections are bridged, no more.
    wide = np.cumsum(np.concatenate([[0], np.diff(away_um) > 4.5 * pitch_um]))
    ties = [(i, j) for i in range(n) for j in range(i + 1, min(i + reach + 1, n)) if wide[i] == wide[j]]
    first, second = np.array(ties, np.intp).reshape(-1, 2).T
    return first, second


def _sheet_course(series: SectionSeries, without: int = -1) -> Floats:
    """Mean height in um, 0, and slope of the smooth surface in each section, (sections, 3), ``without`` one group."""
    band, (_, rows, cols) = series.band, series.stack.shape
    blocks = band.at_col * GROUPS // cols != without
    x = (band.at_col[blocks] - 0.5 * (cols - 1)) * series.pixel_um[1]
    y = (band.row[:, blocks] - 0.5 * (rows - 1)) * series.pixel_um[0]
    mean, slope = np.polynomial.polynomial.polyfit(x, y.T, 1)
    return np.stack([mean, np.zeros_like(mean), slope], axis=1)


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
    """Places along the columns from the coarse and the fine texture together; (sections,)."""
    # The coarse ones bridge what the fine ones do not hold together, and take over where noise hides fine texture.
    # Coarse pairs over the same sections, and the next ones, share their errors: hence the factor on their sigma.
    columns = [
        (p.first[p.sound], p.second[p.sound], p.offset[p.sound, 1], factor * p.sigma[p.sound, 1])
        for p, factor in ((coarse, 4.0), (fine, 1.0))
    ]
    first, second, offset, sigma = map(np.concatenate, zip(*columns, strict=True))
    return solve_places(first, second, offset, sigma, n)[0]


Strip = tuple[int, int]

_PARTS = 12  # pieces along the line: their spread says how sure a place is, their course gives the rotation
_LEAST = 4  # pixels across a strip


def fixed_places(stack: Stack, pixel_um: Pair, *, rows: Strip | None = None, cols: Strip | None = None) -> Floats:
    """Find the place of every section against lines that lie still.

    Parameters
    ----------
    stack : ndarray (sections, rows, cols)
    pixel_um : (row, col)
    rows : (int, int), optional
        First and last row of a strip that shows a line or edge along the rows, and nothing else that changes.
    cols : (int, int), optional
        The same for a line or edge along the columns.

    Returns
    -------
    ndarray (sections, 3)
        Shift along (row, col) in um and rotation in rad, about their means over the sections, signs as in
        :class:`planish.sections.Alignment`; NaN where no strip was given for it or a section does not show the line.

    Raises
    ------
    VolumeError
        If a strip lies outside the photographs, is too narrow, or shows no line.
    """
    places = np.full((stack.shape[0], 3), np.nan)
    for axis, strip in ((0, rows), (1, cols)):
        if strip is None:
            continue
        size, (low, high) = stack.shape[1 + axis], strip
        if not 0 <= low <= high - _LEAST < size - _LEAST:
            raise VolumeError(
                f"The strip {low} to {high} of a fixed line does not lie in the photographs, which have {size} "
                f"{'rows' if axis == 0 else 'columns'}, or is narrower than {_LEAST} pixels. Give first and last one."
            )
        places[:, axis], turn = _line_places(stack, axis, strip, pixel_um)
        if np.isnan(places[:, 2]).all():
            # Along a column the place is smaller by rotation y, along a row larger by rotation x.
            places[:, 2] = turn if axis == 0 else -turn
    mean = np.array([np.nanmean(c) if np.isfinite(c).any() else 0.0 for c in places.T])
    return places - mean


def _line_places(stack: Stack, axis: int, strip: Strip, pixel_um: Pair) -> tuple[Floats, Floats]:
    """Place in um and slope of the line of each section, against their mean."""
    pixel, length, rows = pixel_um[axis], stack.shape[2 - axis], slice(strip[0], strip[1] + 1)
    edges = np.linspace(0, length, _PARTS + 1).astype(int)

    def cut(i: int) -> Floats:
        grey = np.asarray(stack[i], dtype=np.float64)
        grey = grey[rows] if axis == 0 else grey[:, rows].T
        return np.add.reduceat(grey, edges[:-1], axis=1).T / np.diff(edges)[:, None]

    profiles = np.stack(map_threads(cut, range(stack.shape[0])))  # (sections, pieces, across)
    off = np.zeros(profiles.shape[:2])
    alike = np.zeros(profiles.shape[:2])
    for blur in (12.0, 4.0, 2.0):  # Gaussian sigma, from coarse to fine: the first reaches as far as sections are off
        smooth = gaussian_filter1d(profiles, max(blur / pixel, 0.5), axis=2, mode="nearest")
        for _ in range(4):
            moved = _shifted(smooth, off)
            step, alike = _match_template(moved, np.median(moved, axis=0))
            off += np.clip(step, -2 * blur / pixel, 2 * blur / pixel)
            off -= np.median(off)
    shows_line = alike > 0.7  # correlation with the mean profile below which a piece does not show the line
    is_clear = shows_line.sum(axis=1) >= _PARTS // 2
    if np.count_nonzero(is_clear) < 0.5 * is_clear.size:
        raise VolumeError(
            f"The {'columns' if axis else 'rows'} {strip[0]} to {strip[1]} show no line or edge that lies still in "
            "most sections. Look at a few photographs and give a strip that shows the same straight line throughout."
        )
    along = (0.5 * (edges[1:] + edges[:-1] - 1) - 0.5 * (length - 1)) * pixel_um[1 - axis]
    # The mean course of all sections is the line's own and is taken off.
    off *= pixel
    line_course, counted = np.zeros(_PARTS), shows_line.any(axis=0)
    line_course[counted] = np.nanmedian(np.where(shows_line, off, np.nan)[:, counted], axis=0)
    lines = np.full((is_clear.size, 2), np.nan)
    for i in np.flatnonzero(is_clear):
        pieces = shows_line[i]
        lines[i] = np.polyfit(along[pieces], (off[i] - line_course)[pieces], 1)
    return lines[:, 1], lines[:, 0]


def _shifted(profiles: Floats, off: Floats) -> Floats:
    """Profiles read at their places plus ``off``, linearly between pixels."""
    across = profiles.shape[2]
    position = np.clip(np.arange(across) + off[..., None], 0, across - 1)
    low = np.minimum(position.astype(int), across - 2)
    share = position - low
    a, b = (np.take_along_axis(profiles, k, axis=2) for k in (low, low + 1))
    return a * (1 - share) + b * share


def _match_template(moved: Floats, template: Floats) -> tuple[Floats, Floats]:
    """Match profiles with a template: how much further each lies, in pixels, and its correlation with it.

    A profile is gain x template + offset, moved a little: least squares for the three.
    """
    slope = np.gradient(template, axis=1)
    inner = slice(2, -2)
    t, g, f = template[:, inner], slope[:, inner], moved[..., inner]
    t, g, f = (v - v.mean(axis=-1, keepdims=True) for v in (t, g, f))
    tt, tg, gg = (t * t).sum(axis=-1), (t * g).sum(axis=-1), (g * g).sum(axis=-1)
    ft, fg, ff = (f * t).sum(axis=-1), (f * g).sum(axis=-1), (f * f).sum(axis=-1)
    det = np.maximum(tt * gg - tg * tg, 1e-12)
    gain, move = (ft * gg - fg * tg) / det, (fg * tt - ft * tg) / det
    alike = ft / np.sqrt(np.maximum(ff * tt, 1e-12))
    good = gain > 0.2
    return np.where(good, -move / np.where(good, gain, 1.0), 0.0), alike
