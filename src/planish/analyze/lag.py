"""How far one map lies off another on the same grid, by their common texture alone: the image-based check."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planish.analyze.lag_field import LagField, MapPair, lag_field
from planish.analyze.ncc import MaskedNcc
from planish.analyze.peak import MARGIN, Peak, covariance_of, find_peak, rival_r, within
from planish.analyze.surrogates import Unrelated, unrelated_peaks, without_plane
from planish.core.area import area_mean
from planish.core.errors import CannotMeasure, SizeError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Silence = Literal["few", "texture", "border", "rival", "oblique"]

# 95 % of errors that are normal with the same spread along x and y lie within this many rms lengths.
TRE95 = math.sqrt(-math.log(0.05))
_LEAST_PIXELS = 100
_FLOOR_PIXELS, _FLOOR_WAVES = 0.1, 0.02
_NOWHERE = (math.nan, math.nan)
_MOST_PIXELS = 400_000
_SEED = 20090501
_RIVAL = 0.5  # of the peak's height
_DIFFERENT = -2 * math.log(0.02)  # squared distance of two lags in standard errors that chance exceeds once in 50

_SILENCE: dict[Silence, str] = {
    "few": "Image-based check: inconclusive (too few pixels are known in both maps).",
    "texture": "Image-based check: inconclusive (no common texture).",
    "border": "Image-based check: inconclusive (the correlation still rises at the largest lag searched). Search "
    "further.",
    "rival": "Image-based check: inconclusive (a second peak is nearly as high, as where one map follows the slope of "
    "the other under oblique light, or where a pattern repeats itself).",
    "oblique": "Image-based check: inconclusive (the lag grows with the wavelength: light from one side, not a shift, "
    "moves the peak).",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lag:
    """Where the second map's texture lies, relative to the first's.

    Attributes
    ----------
    lag_um : (float, float)
        ``(x, y)``: what map a shows at p, map b shows at p + lag. NaN unless distinct.
    covariance_um2 : ndarray, shape (2, 2)
        Of ``lag_um``; NaN unless distinct.
    r : float
        Correlation at the peak, with its sign. It was searched for: no measure of the relation of the maps.
    r_at_zero : float
        Correlation without any lag.
    null_95 : float
        ``|r|`` that the same search reaches on 95 of 100 unrelated maps of the same texture.
    null_99 : float
        The same for 99 of 100, by Gumbel's distribution through the mean and spread of what it reaches. A distinct peak
        is higher: a lag of unrelated maps would often look like one that agrees.
    rival_r : float
        Correlation of the other extreme that most puts the peak in doubt.
    silence : {"few", "texture", "border", "rival", "oblique"} or None
        Why the lag is inconclusive; None if the peak is distinct.
    split_um : float
        Wavelength that parts the fine texture from the coarse; NaN where the peak is not distinct in the first place.
    lags_of_bands_um : tuple of (float, float)
        ``(x, y)`` of the fine and of the coarse texture alone; NaN where that is not distinct. A shift is the same in
        both.
    reach_um : float
        Largest lag that was searched.
    pixel_um : (float, float)
        Pixel of the maps that were compared, along y and x: large maps are averaged.
    n : int
        Pixels that are known in both.
    field : LagField or None
        Lags of tiles, if asked for.
    """

    reach_um: float
    pixel_um: tuple[float, float]
    n: int
    silence: Silence | None
    lag_um: tuple[float, float] = _NOWHERE
    covariance_um2: Array = field(default_factory=lambda: np.full((2, 2), np.nan))
    r: float = math.nan
    r_at_zero: float = math.nan
    null_95: float = math.nan
    null_99: float = math.nan
    rival_r: float = math.nan
    split_um: float = math.nan
    lags_of_bands_um: tuple[tuple[float, float], tuple[float, float]] = (_NOWHERE, _NOWHERE)
    field: LagField | None = None

    @property
    def distinct(self) -> bool:
        """Whether the peak is higher than chance puts it, inside the search, the only one, and a shift."""
        return self.silence is None

    @property
    def se_um(self) -> tuple[float, float]:
        """Standard errors along x and y, in um."""
        x, y = np.sqrt(np.diag(self.covariance_um2))
        return float(x), float(y)

    @property
    def length_um(self) -> float:
        """Length of the lag, in um."""
        return math.hypot(*self.lag_um)

    @property
    def length_se_um(self) -> float:
        """Standard error of the lag along its own direction, in um."""
        along = np.array(self.lag_um) / self.length_um if self.length_um > 0 else np.full(2, math.sqrt(0.5))
        return float(np.sqrt(along @ self.covariance_um2 @ along))

    def agrees(self, expected_error_um: float) -> bool | None:
        """Whether the lag is one that the expected error of the registration allows; None if it is inconclusive.

        Parameters
        ----------
        expected_error_um : float, in um
            Rms distance between the fitted and the true place (rms over the map).

        Notes
        -----
        The limit is 1.73 times the rms of expected error and standard error of the lag together: 95 % of normal errors
        are smaller. A lag that is known less well than the registration agrees easily.
        """
        if not self.distinct or not math.isfinite(expected_error_um):
            return None
        return self.length_um <= TRE95 * math.hypot(expected_error_um, *self.se_um)

    def sentence(self, expected_error_um: float | None = None) -> str:
        """The lag, and whether it agrees with the expected error (rms, in um) if that is given."""
        if self.silence is not None:
            return _SILENCE[self.silence]
        text = f"lag {self.length_um:.1f} ± {self.length_se_um:.1f} um"
        if expected_error_um is None or not math.isfinite(expected_error_um):
            return text
        text += f", expected error {expected_error_um:.1f} um: "
        if not self.agrees(expected_error_um):
            return (
                text
                + "larger than the marks allow; either the registration is off, or light from one side moves the peak"
            )
        vague = math.hypot(*self.se_um) > expected_error_um
        return text + ("agrees, but is less certain than the marks" if vague else "agrees")


def masked_lag(
    a: Array,
    b: Array,
    valid: Mask | None,
    pixel_um: tuple[float, float],
    *,
    reach_um: float,
    band_um: tuple[float | None, float | None] | None = None,
    tiles_um: float | None = None,
    surrogates: int = 99,
) -> Lag:
    """Find the lag between two maps on one grid, and whether it is conclusive.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
        NaN is missing.
    valid : ndarray of bool, shape (rows, cols), or None
        Pixels that may be looked at, of both maps.
    pixel_um : (float, float)
        Along y and x. Maps of more than 400 000 pixels are averaged to larger ones first.
    reach_um : float, in um
        Largest lag searched, in every direction; at most a quarter of the map.
    band_um : (float or None, float or None), in um
        Wavelengths kept, shortest and longest. A plane is always taken off.
    tiles_um : float or None, in um
        Side of square tiles, half overlapping, whose lags are found one by one.
    surrogates : int
        Unrelated maps for the null band, 19 or more.

    Returns
    -------
    Lag

    Raises
    ------
    SizeError
        If pixel, reach, band or tiles do not fit the maps.
    CannotMeasure
        If the maps have not one shape.

    Notes
    -----
    The peak of ``|r|`` counts, since a map may follow another with either sign. Its place is that of the maximum of a
    cubic spline through r. The null band repeats the whole search on maps with the power spectrum of b and random
    phases. Same bytes on every run: the phases come from a fixed seed.
    """
    maps = _prepared(a, b, valid, pixel_um)
    pixel_um = maps.pixel_um
    reach = _reach(maps.a.shape, pixel_um, reach_um)
    if surrogates < 19:
        raise SizeError(f"{surrogates} surrogates give no 95 % band; 19 are needed, 99 are better.")
    n = int((maps.known_a & maps.known_b).sum())
    if n < _LEAST_PIXELS:
        return Lag(reach_um=reach_um, pixel_um=pixel_um, n=n, silence="few")
    if band_um is not None:
        _check_band(band_um, pixel_um)
        maps = maps.in_band(band_um)
    found, peak = _search(maps, reach, reach_um, surrogates)
    sign = 0 if peak is None or not found.distinct else int(np.sign(peak.r))
    if peak is not None and found.distinct:
        # For a Gaussian texture of length l the curvature of r is r / l^2, and most of its waves are 2 pi l long.
        square = abs(peak.r) / math.sqrt(float(np.linalg.det(peak.curvature))) * pixel_um[0] * pixel_um[1]
        split = max(2 * math.pi * math.sqrt(square), 4 * max(pixel_um))
        fine, coarse = (
            _search(maps.in_band(band), reach, reach_um, surrogates)[0] for band in ((None, split), (split, None))
        )
        found = replace(found, split_um=split, lags_of_bands_um=(fine.lag_um, coarse.lag_um))
        # Filters at borders and interpolation move the lags of bands a little, even without noise.
        own = (_FLOOR_PIXELS * max(pixel_um)) ** 2 + (_FLOOR_WAVES * split) ** 2
        spread = fine.covariance_um2 + coarse.covariance_um2 + own * np.eye(2)
        apart = np.array(coarse.lag_um) - fine.lag_um
        if (
            fine.distinct
            and coarse.distinct
            and float(apart @ np.linalg.solve(spread, apart)) > _DIFFERENT
            and coarse.length_um > fine.length_um
        ):
            found = replace(found, silence="oblique", lag_um=_NOWHERE, covariance_um2=np.full((2, 2), np.nan))
    if tiles_um is None:
        return found
    rng, unrelated = np.random.default_rng(_SEED), Unrelated(maps.b, maps.known_b)
    draws = [unrelated.draw(rng) for _ in range(19)]
    return replace(found, field=lag_field(maps, reach=reach, tile_um=tiles_um, sign=sign, unrelated=draws))


def _search(maps: MapPair, reach: tuple[int, int], reach_um: float, surrogates: int) -> tuple[Lag, Peak | None]:
    """One search, and its peak."""
    known_a, known_b, pixel_um = maps.known_a, maps.known_b, maps.pixel_um
    a, b = without_plane(maps.a, known_a), without_plane(maps.b, known_b)
    wide = (reach[0] + MARGIN, reach[1] + MARGIN)
    correlate = MaskedNcc(a, a_valid=known_a, b_valid=known_b, reach=wide)
    r = correlate(b)
    allowed = within(reach)
    peak = find_peak(r, allowed, 0)
    highest = unrelated_peaks(a, b, (known_a, known_b), correlate.pairs, reach, surrogates, _SEED)
    null = (float(np.quantile(highest, 0.95, method="higher")), _gumbel_99(highest))
    rival = math.nan if peak is None else rival_r(r, peak, allowed)
    silence: Silence | None = None
    if peak is None or not abs(peak.r) > null[1]:
        silence = "texture"
    elif not peak.inner:
        silence = "border"
    elif abs(rival) > max(null[1], _RIVAL * abs(peak.r)):
        silence = "rival"
    lag, spread = _NOWHERE, np.full((2, 2), np.nan)
    if peak is not None and silence is None:
        step = np.array([pixel_um[1], pixel_um[0]])
        spread = covariance_of(peak, a, b, known_a, known_b)[::-1, ::-1] * np.outer(step, step)
        lag = (float(peak.at[1] * step[0]), float(peak.at[0] * step[1]))
    found = Lag(
        reach_um=reach_um, pixel_um=pixel_um, n=int((known_a & known_b).sum()), silence=silence, lag_um=lag,
        covariance_um2=spread, r=math.nan if peak is None else peak.r, r_at_zero=float(r[wide]), null_95=null[0],
        null_99=null[1], rival_r=rival,
    )  # fmt: skip
    return found, peak


def _gumbel_99(highest: Array) -> float:
    """Value below which 99 % of largest values stay, from the mean and standard deviation of some (of Fisher's z)."""
    z = np.arctanh(np.minimum(highest, 0.999999))
    scale = float(z.std(ddof=1)) * math.sqrt(6.0) / math.pi
    return math.tanh(float(z.mean()) - scale * (np.euler_gamma + math.log(-math.log(0.99))))


def _prepared(a: Array, b: Array, valid: Mask | None, pixel_um: tuple[float, float]) -> MapPair:
    """Both maps in float64 with their masks, averaged if they are large, and the pixel they then have."""
    if a.ndim != 2 or a.shape != b.shape or (valid is not None and valid.shape != a.shape):
        raise CannotMeasure(
            f"The maps have the shapes {a.shape} and {b.shape}. A lag needs two maps and a mask on one grid; link them "
            "first."
        )
    if not all(math.isfinite(p) and p > 0 for p in pixel_um):
        raise SizeError(f"The pixel is given as {pixel_um} um. Two positive lengths are needed, along y and x.")
    maps = [np.where(np.isfinite(m) & (True if valid is None else valid), m, np.nan).astype(np.float64) for m in (a, b)]
    factor = math.ceil(math.sqrt(a.size / _MOST_PIXELS))
    if factor > 1:
        maps = [area_mean(m, (factor, factor)) for m in maps]
        pixel_um = (factor * pixel_um[0], factor * pixel_um[1])
    known = [np.isfinite(m) for m in maps]
    a, b = (np.where(k, m, 0.0) for k, m in zip(known, maps, strict=True))
    return MapPair(a=a, b=b, known_a=known[0], known_b=known[1], pixel_um=pixel_um)


def _reach(shape: tuple[int, ...], pixel_um: tuple[float, float], reach_um: float) -> tuple[int, int]:
    sides = shape[0] * pixel_um[0], shape[1] * pixel_um[1]
    least, most = 3 * max(pixel_um), min(sides) / 4
    if not least <= reach_um <= most:
        raise SizeError(
            f"A reach of {reach_um:g} um does not fit maps of {sides[1]:.0f} x {sides[0]:.0f} um in pixels of "
            f"{max(pixel_um):g} um. Take one from 3 pixels ({least:g} um) to a quarter of the shorter side "
            f"({most:.0f} um)."
        )
    return int(reach_um / pixel_um[0] + 1e-9), int(reach_um / pixel_um[1] + 1e-9)


def _check_band(band_um: tuple[float | None, float | None], pixel_um: tuple[float, float]) -> None:
    short, long = band_um
    low = 2 * max(pixel_um) if short is None else short
    if low < 2 * max(pixel_um) - 1e-9 or (long is not None and not low < long):
        raise SizeError(
            f"The band from {short} to {long} um holds no wave. Its shortest wave needs two pixels "
            f"({2 * max(pixel_um):g} um), and the longest has to be longer than that."
        )
