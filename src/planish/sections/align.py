"""Joint alignment of serial sections: each against its neighbours on both sides, and only what changes quickly.

Aligning each section to the one before adds up errors and straightens the specimen's true bend. Here the offsets
between all sections up to five apart are fitted together, and waves longer than some fifty sections, in which the
bend of the sheet cannot be separated from a drift of the stage, are left as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.sections.band import Band, SectionSeries
from planish.sections.network import HELD, parts, quick_places, slow_part, solve_places
from planish.sections.pairs import FINEST_UM, GROUPS, Bands, Pairs, compare

Array = NDArray[np.float64]

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
    """Where each section lies against its neighbours.

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

    shift_um: Array
    rotation_rad: Array
    aligned: NDArray[np.bool_]
    jitter_left_um: Array
    pairs_used: int
    pairs_refused: int
    cutoff_um: float
    fixed: tuple[bool, ...] = (False, False, False)


def align_sections(series: SectionSeries, *, fixed: Array | None = None) -> Alignment:
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
    stack, band, pixel_um, away, n = series.stack, series.band, series.pixel_um, series.away_um, len(series.away_um)
    cutoff = _CUTOFF_SECTIONS * series.pitch_um
    first, second = neighbours(away, series.pitch_um, _REACH)
    # Course of the sheet itself as a pose: mean height and slope of the smooth surface, which the pairs do not see.
    course = _course(band, stack.shape[1:], pixel_um)
    pose = np.zeros((n, 3))
    pose[:, 0] = band.jump * pixel_um[0]

    def measured(which: NDArray[np.bool_], *, fine: bool = False) -> Pairs:
        one, two = first[which], second[which]
        bands = Bands(stack=stack, band=band, pixel_um=pixel_um, fine=fine)
        return compare(bands.sums(pose, one, two), one, two, pose, fine=fine)

    # The first rounds only bring the sections near, with few pairs; the offsets that count are those of the last.
    near = second - first <= _REACH_FIRST
    for _ in range(_ROUNDS - 1):
        whole = measured(near)
        places, kept = _joined(whole, n)
        groups = parts(whole.first[kept], whole.second[kept], n)
        pose = quick_places(places + course, away, groups, cutoff_um=cutoff)
    whole = measured(near | ~near)
    places, kept = _joined(whole, n)
    groups = parts(first[kept], second[kept], n)
    pose = quick_places(places + course, away, groups, cutoff_um=cutoff)
    # Coarse texture wanders along the columns with the fibres that come and go; fine texture less. The place along the
    # columns is measured once more in it, now that the sections lie near enough.
    close = (second - first == 1) & kept
    fine: Pairs | None = None
    coarse_pose = pose
    for _ in range(_FINE_ROUNDS if max(pixel_um) <= FINEST_UM and close.any() else 0):
        found = measured(close, fine=True)
        if not np.median(found.sigma[:, 1]) < _SURER * np.median(whole.sigma[close, 1]):
            fine, pose = None, coarse_pose
            break
        fine = found
        places[:, 1] = _columns(whole, fine, n)
        pose = quick_places(places + course, away, groups, cutoff_um=cutoff)
    # Sections that hang together with others, by two pairs or more.
    pairs = np.bincount(np.concatenate([first[kept], second[kept]]), minlength=n)
    aligned = np.isin(np.arange(n), np.concatenate([np.zeros(0, np.intp), *groups])) & (pairs >= min(2, n - 1))
    pose[~aligned] = 0.0
    left = np.full(3, np.nan)
    if aligned.any():

        def without(k: int) -> Array:
            fewer = whole.without(k)
            there = _joined(fewer, n)[0]
            if fine is not None:
                there[:, 1] = _columns(fewer, fine.without(k), n)
            there += _course(band, stack.shape[1:], pixel_um, without=k)
            return quick_places(there, away, groups, cutoff_um=cutoff)[aligned]

        # Jackknife: one run of columns after the other is left out, of the surface too.
        left = np.mean(np.var([without(k) for k in range(GROUPS)], axis=0), axis=0) * (GROUPS - 1)
    # A narrow image determines rotations badly: they are shortened to what is more than their own error (Wiener).
    turned = float(np.mean(pose[aligned, 2] ** 2)) if aligned.any() else 0.0
    pose[:, 2] *= max(0.0, 1.0 - left[2] / turned) if turned > 0 else 0.0
    held = _hold(pose, fixed, away, cutoff, aligned) if fixed is not None else (False, False, False)
    return Alignment(
        shift_um=pose[:, :2].copy(),
        rotation_rad=pose[:, 2].copy(),
        aligned=aligned,
        jitter_left_um=np.sqrt(left[:2]),
        pairs_used=int(np.count_nonzero(kept)),
        pairs_refused=int(kept.size - np.count_nonzero(kept)),
        cutoff_um=cutoff,
        fixed=held,
    )


def _hold(pose: Array, fixed: Array, away: Array, cutoff: float, aligned: NDArray[np.bool_]) -> tuple[bool, ...]:
    """Add the slow part of what something fixed shows; True for each axis that it shows."""
    held = [False, False, False]
    for axis in range(3):
        seen = np.isfinite(fixed[:, axis])
        if np.count_nonzero(seen) < 0.5 * seen.size:
            continue
        slow = slow_part(away, np.where(seen, fixed[:, axis], 0.0), cutoff_um=cutoff, weights=seen.astype(np.float64))
        pose[aligned, axis] += slow[aligned]
        held[axis] = True
    return tuple(held)


def neighbours(away_um: Array, pitch_um: float, reach: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of sections at most ``reach`` apart with no wide gap between them, ordered by the first."""
    n = away_um.size
    wide = np.cumsum(np.concatenate([[0], np.diff(away_um) > _GAP_SECTIONS * pitch_um]))
    ties = [(i, j) for i in range(n) for j in range(i + 1, min(i + reach, n - 1) + 1) if wide[i] == wide[j]]
    table = np.array(ties, np.intp).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _course(band: Band, shape: tuple[int, ...], pixel_um: tuple[float, float], without: int = -1) -> Array:
    """Mean height in um, 0, and slope of the smooth surface in each section; (sections, 3).

    ``without`` leaves out the columns of one group of parts.
    """
    held = band.at_col * GROUPS // shape[1] != without
    x = (band.at_col[held] - 0.5 * (shape[1] - 1)) * pixel_um[1]
    y = (band.row[:, held] - 0.5 * (shape[0] - 1)) * pixel_um[0]
    slope, mean = np.polynomial.polynomial.polyfit(x, y.T, 1)[::-1]
    return np.stack([mean, np.zeros(mean.size), slope], axis=1)


def _joined(pairs: Pairs, n: int) -> tuple[Array, NDArray[np.bool_]]:
    """Places of all sections (sections, 3), and which pairs were used."""
    places = np.zeros((n, 3))
    kept = np.zeros((pairs.first.size, 3))
    sound = pairs.sound
    for axis in range(3):
        places[:, axis], kept[sound, axis] = solve_places(
            pairs.first[sound], pairs.second[sound], pairs.offset[sound, axis], pairs.sigma[sound, axis], n
        )
    return places, sound & (np.min(kept, axis=1) > HELD)


def _columns(coarse: Pairs, fine: Pairs, n: int) -> Array:
    """Places along the columns from the coarse and the fine texture together; (sections,).

    The coarse ones bridge what the fine ones do not hold together, and take over where noise hides fine texture.
    """
    both = (coarse, fine)
    first = np.concatenate([p.first[p.sound] for p in both])
    second = np.concatenate([p.second[p.sound] for p in both])
    offset = np.concatenate([p.offset[p.sound, 1] for p in both])
    sigma = np.concatenate([_COARSE_FACTOR * coarse.sigma[coarse.sound, 1], fine.sigma[fine.sound, 1]])
    return solve_places(first, second, offset, sigma, n)[0]
