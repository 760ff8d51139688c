"""Correlation of two maps at every lag.

Where they agree best, how wide that peak is, and what chance reaches.
"""

import math

import numpy as np
from pydantic import Field
from scipy import fft, ndimage, optimize, special

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import LEAST_CLAIMED, check_varying, filled, on_one_grid
from planish.analyze.distributions import normal_tail
from planish.core.errors import CannotMeasure, SizeError
from planish.core.facts import DescribedModel, Interval, Value
from planish.core.typing import Array, Bools, Entries, Floats, Pair, Pixel, Shape2D, pair_of
from planish.texture.covariance import Lags, PairCovariances
from planish.texture.ncc import MaskedNcc

_CHANCE = 0.01  # a band at 95 % is exceeded by 10-18 % of smooth maps
_RAYS = 72


class LagProfile(DescribedModel):
    """r of map a with map b moved along one axis, and what unrelated maps of this texture reach."""

    lags_um: tuple[float, ...]
    """How far one map is shifted."""
    r: tuple[Value, ...]
    """Correlation."""
    limit: tuple[Value, ...]
    """|r| that unrelated maps exceed at this lag with 1 %."""
    limit_of_any: tuple[Value, ...]
    """|r| that they exceed at any of all lags with 1 %."""


class CorrelogramProfiles(DescribedModel):
    """Correlation of map a with map b, moved by every lag along both axes; lags are (y, x)."""

    cell_um: Pair
    """Size of a cell along x and y."""
    reach_um: float
    """Largest shift."""
    r_at_zero: Value
    """Without a shift."""
    peak_r: float
    """Largest r of all shifts."""
    lag_um: Pair
    """Of the largest |r|."""
    inner: bool
    """Whether that is a summit, not a slope that goes on beyond the reach."""
    widths_um: Interval
    """Full widths at half height, the longer one first."""
    angle_deg: Value
    """Direction of the longer width, clockwise from the x axis."""
    n_eff: Value
    """Independent points."""
    limit_of_any: Value
    """|r| at lag 0 that unrelated maps exceed at any lag with 1 %."""
    beyond_chance: bool | None
    """Whether some lag exceeds that; none where nothing is claimed."""
    along_x: LagProfile
    """Through no shift, along x."""
    along_y: LagProfile
    """Through no shift, along y."""


class Correlogram(CorrelogramProfiles):
    """Correlation of map a with map b, moved by each lag; shape (lags along y, lags along x)."""

    r: Floats = Field(exclude=True)
    """Of the pairs a[p], b[p + lag]; NaN where few pairs are left."""
    lag_y_um: Floats = Field(exclude=True)
    """Lags of its rows."""
    lag_x_um: Floats = Field(exclude=True)
    """Lags of its columns."""
    band_99: Floats = Field(exclude=True)
    """|r| that unrelated maps exceed at this lag with 1 %."""
    band_99_of_any: Floats = Field(exclude=True)
    """Limit that they exceed at any of all lags with 1 %."""


def _profile(lags_um: Floats, *along: Floats) -> LagProfile:
    """What lies along one axis, at lag 0 and at most 40 lags to either side.

    ``along`` are r, its limit and the limit of any lag, at ``lags_um``, whose middle is lag 0.
    """
    middle = lags_um.size // 2
    step = math.ceil(middle / 40)
    thinning = slice(middle % step, None, step)
    thinned = [values[thinning] for values in (lags_um, *along)]
    lags, r, limit, of_any = (tuple(values.tolist()) for values in thinned)
    return LagProfile(lags_um=lags, r=r, limit=limit, limit_of_any=of_any)


def cross_correlogram(
    a: Array, b: Array, *, pixel_um: Pixel, reach_um: float = 500.0
) -> Correlogram:
    """Correlate two maps at every lag up to a reach along either axis.

    Parameters
    ----------
    a, b, pixel_um
        As of :func:`planish.correlate`.
    reach_um : float; largest lag along either axis; at most half of the field is looked at

    Returns
    -------
    Correlogram

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`; if the reach holds no lag of one pixel.
    CannotMeasure
        If fewer than 3 pixels are known in both maps, or a map is constant.

    Notes
    -----
    The limits follow from the covariances of both maps as those of :func:`planish.correlate` do,
    wider where fewer pairs are left, by Student's t. Over lags, r of unrelated maps varies
    smoothly: its covariance is the convolution of theirs, and the largest of all lags exceeds a
    limit as often as the mean Euler characteristic of a smooth Gaussian field says (Worsley 1996),
    or as Bonferroni says where that is less.

    References
    ----------
    Padfield (2012), IEEE Trans. Image Process. 21, 2706, doi:10.1109/TIP.2011.2181402. Worsley et
    al. (1996), Human Brain Mapping 4, 58,
    doi:10.1002/(SICI)1097-0193(1996)4:1<58::AID-HBM4>3.0.CO;2-O.

    Examples
    --------
    >>> a = np.random.default_rng(0).normal(size=(60, 80))
    >>> correlogram = cross_correlogram(a, np.roll(a, 3, axis=1), pixel_um=10.0, reach_um=100.0)
    >>> [round(lag) for lag in correlogram.lag_um], round(correlogram.r_at_zero, 1)
    ([0, 30], 0.0)
    """
    pixel = on_one_grid(a, b, pixel_um)
    if not max(pixel) <= reach_um < math.inf:
        raise SizeError(
            f"The reach is {reach_um:g} um, a pixel {max(pixel):g} um. Give a reach of a pixel or"
            " more."
        )
    a_valid = np.isfinite(a)
    b_valid = np.isfinite(b)
    lags = Lags(a_valid & b_valid, pixel)
    return correlogram_of((a, b), (a_valid, b_valid), lags, reach_um=reach_um)


def correlogram_of(
    maps: tuple[Array, Array], valid: tuple[Bools, Bools], lags: Lags, *, reach_um: float
) -> Correlogram:
    """The same for maps (rows, cols).

    Given are the pixels that count in each, and the lags of those that count in both. The reach is
    a whole number of pixels along either axis, one at least and half of the field at most; lag 0 is
    the middle row and column of all arrays by lag. CannotMeasure where no lag has enough pairs.
    """
    a, b = (values.astype(np.float64) for values in maps)
    a_valid, b_valid = valid
    pixel = lags.pixel_um
    check_varying(lags.is_valid)
    check_varying(a_valid, a=a)
    check_varying(b_valid, b=b)
    most = np.array(a.shape) // 2
    asked = np.floor(np.divide(reach_um, pixel) + 1e-9).astype(np.intp)
    zero_row, zero_col = np.clip(asked, 1, np.maximum(most, 1)).tolist()
    reach: Shape2D = (zero_row, zero_col)
    # r at every lag (along y, along x) over the pairs that both masks leave; NaN where few are.
    ncc = MaskedNcc(a, a_valid=a_valid, b_valid=b_valid, reach=reach)
    r = ncc(b)
    if not np.isfinite(r).any():
        raise CannotMeasure(
            "At no lag are there enough pairs that differ. Give a larger map or a smaller mask."
        )
    lags_y_um = np.arange(-zero_row, zero_row + 1) * pixel[0]
    lags_x_um = np.arange(-zero_col, zero_col + 1) * pixel[1]
    summit, peak_r, inner = _summit(r)
    widths = (math.nan, math.nan)
    angle = math.nan
    if inner:
        widths, angle = _widths(r / peak_r, summit, pixel)
    n_eff, band, of_any = _limits([a, b], lags, ncc.pairs, np.isfinite(r))
    beyond_chance = None  # where nothing is claimed
    if np.isfinite(of_any).any():
        beyond_chance = bool(np.any(np.abs(r) > of_any))
    by_lag = np.stack([r, band, of_any])
    lag_um = pair_of((summit - reach) * pixel)
    along_x = _profile(lags_x_um, *by_lag[:, zero_row])
    along_y = _profile(lags_y_um, *by_lag[:, :, zero_col])
    return Correlogram(
        r=r,
        lag_y_um=lags_y_um,
        lag_x_um=lags_x_um,
        band_99=band,
        band_99_of_any=of_any,
        cell_um=pixel,
        reach_um=min(lags_y_um[-1], lags_x_um[-1]),
        r_at_zero=r[reach],
        peak_r=peak_r,
        inner=inner,
        lag_um=lag_um,
        widths_um=widths,
        angle_deg=angle,
        n_eff=n_eff,
        limit_of_any=of_any[reach],
        beyond_chance=beyond_chance,
        along_x=along_x,
        along_y=along_y,
    )


def _summit(r: Floats) -> tuple[Floats, float, bool]:
    """Row and column of the largest ``|r|`` of all lags, r there, and whether it is a summit.

    A summit is that of a parabola through the lag and its 8 neighbours, and lies between them;
    elsewhere row, column and r are those of the lag itself.
    """
    index = int(np.nanargmax(np.abs(r)))
    row, col = divmod(index, r.shape[1])
    place = np.array([row, col], dtype=np.float64)
    highest = r[row, col]
    pixel_peak = place, highest, False
    rows = slice(max(row - 1, 0), row + 2)
    cols = slice(max(col - 1, 0), col + 2)
    neighbours = r[rows, cols]
    if neighbours.shape != (3, 3) or not np.isfinite(neighbours).all():
        return pixel_peak
    y, x = np.mgrid[-1.0:2.0, -1.0:2.0].reshape(2, 9)
    terms = np.stack([np.ones(9), y, x, y * y / 2, x * y, x * x / 2], axis=1)
    c = np.linalg.lstsq(terms, neighbours.ravel(), rcond=None)[0]
    sign = math.copysign(1.0, highest)  # a trough of r is a summit of |r|
    curvature = c[[[3, 4], [4, 5]]] * sign
    if curvature[0, 0] >= 0 or np.linalg.det(curvature) <= 0:
        return pixel_peak
    shift = -np.linalg.solve(curvature, c[1:3] * sign)
    if np.abs(shift).max() > 1:
        return pixel_peak
    r_of_summit = np.clip(c[0] + c[1:3] @ shift / 2, -1.0, 1.0)
    return place + shift, r_of_summit, True


def _widths(height: Floats, summit: Floats, pixel: Pair) -> tuple[Pair, float]:
    """Find the full widths at half height, in um, and the direction of the longer one, in degrees.

    ``height`` (rows, cols) is r over that of the ``summit`` (row, column). The longer width stands
    first; both are along the main axes of what lies above half height. NaN where that reaches the
    border.

    The border is looked for along rays, in steps of a quarter of a pixel; second moments of an
    ellipse are a quarter of its squared half axes.
    """
    rays = np.arange(_RAYS)
    angles = rays * (2 * math.pi / _RAYS)
    directions = np.stack([np.sin(angles), np.cos(angles)])  # along y and x, in um
    n_steps = int(math.hypot(*height.shape) / 0.25)
    steps = np.arange(n_steps) * 0.25 * min(pixel)
    steps_um = directions[:, :, None] * steps
    steps_px = steps_um / np.reshape(pixel, (2, 1, 1))
    places = summit[:, None, None] + steps_px
    ray_heights = ndimage.map_coordinates(height, places, order=1, mode="constant", cval=math.nan)
    ray_heights[:, 0] = 1.0
    below = ~(ray_heights > 0.5)
    first = np.argmax(below, axis=1)
    inner = ray_heights[rays, first - 1]
    outer = ray_heights[rays, first]
    if not np.isfinite(outer).all() or not below.any(axis=1).all():
        return (math.nan, math.nan), math.nan
    part = (inner - 0.5) / (inner - outer)
    inner_um = steps[first - 1]
    half_height_um = inner_um + part * (steps[first] - inner_um)
    area = np.sum(half_height_um**2) / 2
    moments = (directions * half_height_um**4) @ directions.T / 4 / area
    values, vectors = np.linalg.eigh(moments)
    angle = math.degrees(math.atan2(vectors[0, 1], vectors[1, 1]))
    angle = 90 - (90 - angle) % 180  # from -90, without it, to 90
    shorter_um, longer_um = (4 * math.sqrt(value) for value in values)
    return (longer_um, shorter_um), angle


def _limits(
    maps: list[Array], lags: Lags, pairs: Floats, looked_at: Bools
) -> tuple[float, Floats, Floats]:
    """Independent points, and the limits of ``|r|`` by lag: at this lag alone, and at any lag.

    ``pairs`` are the numbers of pairs at each lag (lags along y, along x), and ``looked_at`` the
    lags with enough of them. Limits are NaN elsewhere, and where too few points are independent.
    """
    x, y = filled(lags.is_valid, maps, 0.0)
    pair = PairCovariances(x, y, lags)
    n_eff = pair.n_eff(lags.n)
    unknown = np.full(pairs.shape, math.nan)
    if not n_eff >= LEAST_CLAIMED:
        return n_eff, unknown, unknown
    # Fewer pairs hold as many fewer independent ones.
    n_eff_of_lag = np.maximum(n_eff * np.minimum(pairs / lags.n, 1.0), 3.0)
    # Covariance of r over lags; how fast it falls from lag to lag says how rough r is.
    spectrum_x = np.asarray(fft.rfft2(pair.xx))
    spectrum_y = np.asarray(fft.rfft2(pair.yy))
    together = np.asarray(fft.irfft2(spectrum_x * spectrum_y, pair.xx.shape))
    next_lags = np.array([together[1, 0], together[0, 1]])
    falls = 1 - next_lags / together[0, 0]
    slopes = np.sqrt(2 * np.maximum(falls, 0.0))
    # How long and wide all lags are, in lags over which r changes by a standard deviation.
    edge, face = (np.array(pairs.shape) - 1) * slopes
    count = int(np.count_nonzero(looked_at))

    def chance(u: float) -> float:
        """Probability that r exceeds u standard deviations at any lag, to either side.

        The mean Euler characteristic of what exceeds them: of a point, of the edges and of the face
        of all lags (Worsley 1996); not above that of as many single lags (Bonferroni).
        """
        tail = normal_tail(u)
        bump = math.exp(-u * u / 2)
        mean = tail + (edge + face) * bump / (2 * math.pi)
        mean += edge * face * u * bump / (2 * math.pi) ** 1.5
        return 2 * min(mean, count * tail)

    u = float(optimize.brentq(lambda v: math.log(chance(v) / _CHANCE), 2.0, 12.0))
    # Over the inverse of the points, limits are all but straight: a quantile for each lag would
    # take longest of all.
    inverse = 1 / n_eff_of_lag
    nodes = np.linspace(inverse.min(), inverse.max(), 65)
    free = 1 / nodes - 2
    limits: list[Floats] = []
    for tail in (_CHANCE / 2, normal_tail(u)):
        t = np.asarray(-special.stdtrit(free, tail))
        limit_at_nodes = t / np.sqrt(t * t + free)
        limit = np.interp(inverse, nodes, limit_at_nodes)
        limits.append(np.where(looked_at, limit, math.nan))
    return n_eff, limits[0], limits[1]


def answer_correlogram(pair: ComparedMaps) -> Entries:
    """The correlogram with its profiles through lag 0; nothing where there are too few lags."""
    is_valid = pair.lags.is_valid
    maps = (pair.x, pair.y)
    correlogram = correlogram_of(maps, (is_valid, is_valid), pair.lags, reach_um=500.0)
    return {"correlogram": CorrelogramProfiles.holding(correlogram)}
