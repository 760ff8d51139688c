"""The fine texture of maps on one grid, and how much two textures have in common beyond chance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from planish.core.area import common_means, valid_in_all
from planish.core.bands import Rows
from planish.core.errors import CannotMeasure, SizeError
from planish.core.typing import Array, Bools, Floats, Ints, Pair
from planish.texture.spectra import padded_shape, padded_spectrum

BAND_UM = (15.0, 250.0)  # shorter waves are noise, longer ones light, print and too few to count
MOST_PIXELS = 300_000
_SPLIT_UM = math.sqrt(BAND_UM[0] * BAND_UM[1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Textures:
    """Band-passed maps (rows, cols) of mean 0 and standard deviation 1.

    This holds over the pixels known in all; elsewhere they are 0.
    """

    maps: dict[str, Floats]
    known: Bools
    pixel_um: Pair

    @property
    def n(self) -> int:
        """Pixels that are known."""
        return int(np.count_nonzero(self.known))

    @property
    def area_um2(self) -> float:
        """Area that is known."""
        return self.n * self.pixel_um[0] * self.pixel_um[1]

    @property
    def middle_um(self) -> Floats:
        """The middle, ``(x, y)`` from that of the first pixel."""
        rows, cols = self.known.shape
        row_um, col_um = self.pixel_um
        return np.array([0.5 * (cols - 1) * col_um, 0.5 * (rows - 1) * row_um])

    def middle_part(self, share: float) -> Textures:
        """A share of both sides, about the same middle."""
        rows, cols = self.known.shape
        first_row, first_col = (round(n * (1 - share) / 2) for n in (rows, cols))
        part = np.s_[first_row : rows - first_row, first_col : cols - first_col]
        maps = {k: m[part] for k, m in self.maps.items()}
        return replace(self, maps=maps, known=self.known[part])

    def with_slopes(self, name: str) -> Textures:
        """Add the slopes of a map along x and y, ``name_x`` and ``name_y``.

        They are what light from one side shows of the map.
        """
        # Where a pixel and its four neighbours are known.
        is_valid = ndimage.binary_erosion(self.known)
        slope_y, slope_x = slopes_of(self.maps[name])
        maps = self.maps | {f"{name}_x": slope_x, f"{name}_y": slope_y}
        standard_maps = {k: standard(m, is_valid) for k, m in maps.items()}
        return replace(self, maps=standard_maps, known=is_valid)

    def halved(self, *names: str) -> Textures:
        """The halves of some maps in their place, each with its number behind the name."""
        maps = {k: m for k, m in self.maps.items() if k not in names}
        for name in names:
            maps |= {f"{name}_{k}": half for k, half in enumerate(self.halves(name))}
        return replace(self, maps=maps)

    def halves(self, name: str) -> list[Floats]:
        """The waves of a map above and below 60 um, each of standard deviation 1.

        Without one that is empty.
        """
        values = self.maps[name]
        low = low_pass_known(values, self.known, _SPLIT_UM, self.pixel_um)
        halves = [standard(half, self.known) for half in (low, values - low)]
        return [half for half in halves if half.any()]


@dataclass(frozen=True, slots=True)
class Relation:
    """Correlation of two textures, and the standard deviation that it has where they are unrelated.

    ``part``: share of the second texture's spread that the first explains, with the standard error
    of what it leaves.
    """

    r: float
    sd: float
    part: float
    part_se: float

    @property
    def z(self) -> float:
        """R in standard deviations of unrelated textures."""
        return self.r / self.sd if self.sd > 0 else 0.0

    def __str__(self) -> str:
        """As sentences name it."""
        return f"r = {self.r:.2f}, z = {self.z:.1f}"


def textures(
    maps: Mapping[str, Rows],
    valid: Bools,
    pixel_um: Pair,
    *,
    band_um: Pair = BAND_UM,
    most_pixels: float = MOST_PIXELS,
) -> Textures:
    """Keep a band of waves of maps, 15 to 250 um by default, with the same spread everywhere.

    Parameters
    ----------
    maps : mapping of ndarray or DataArray, shape (rows, cols)
        NaN is missing; read band by band. Maps known in much less of the field than the others are
        left out.
    valid : ndarray of bool, shape (rows, cols); pixels that may be looked at
    pixel_um : (float, float), along y and x
    band_um : (float, float), optional; shortest and longest wave
    most_pixels : float, optional; maps of more pixels are averaged to larger ones first

    Returns
    -------
    Textures

    Raises
    ------
    CannotMeasure
        If the maps are not on one grid.
    SizeError
        If the pixel is too large for the band.

    Notes
    -----
    Missing pixels have no weight in the Gaussian filters, so holes and borders leave no edge. The
    spread within 1 mm is made equal, which takes uneven light off, what lies beyond 3 standard
    deviations is clipped, and the mean at each distance from holes is taken off, since burnt rims
    of one laser program are alike in all specimens.
    """
    if any(m.shape != valid.shape for m in maps.values()):
        raise CannotMeasure("The maps and the mask do not lie on one grid. Link them first.")
    if not 4 * max(pixel_um) <= band_um[1]:
        raise SizeError(
            f"The pixel of {max(pixel_um):g} um is too large for the texture below {band_um[1]:g}"
            f" um. An image with pixels of {band_um[1] / 4:g} um or less is needed."
        )
    factor = max(1, math.ceil(math.sqrt(valid.size / most_pixels)))
    pixel_um = (factor * pixel_um[0], factor * pixel_um[1])
    means: dict[str, Floats] = {}
    for name, values in maps.items():
        (means[name],) = common_means([values], (factor, factor), masks=[valid])
    counts = {k: np.isfinite(m).sum() for k, m in means.items()}
    # Of the pixels of the map that is known best; maps with fewer are left out.
    least = max(0.7 * max(counts.values(), default=0), 1)
    shown = {k: m for k, m in means.items() if counts[k] >= least}
    if not shown:
        return Textures(maps={}, known=np.zeros_like(valid), pixel_um=pixel_um)
    band = _Band(valid_in_all(shown.values()), pixel_um, band_um)
    band_maps = {k: band(m) for k, m in shown.items()}
    return Textures(maps=band_maps, known=band.is_valid, pixel_um=pixel_um)


def relate(
    a: Floats, b: Floats, is_valid: Bools, pixel_um: Pair, *, of: Floats | None = None
) -> Relation:
    """Correlate two textures (rows, cols) and state how far r of unrelated ones scatters about 0.

    ``pixel_um`` is that along y and x. ``of`` is the texture whose spread ``part`` is a share of,
    where that is not b. Without a known pixel r is 0 with an infinite deviation. The standard
    deviation is the larger of two. Textures that are alike everywhere: ``var(r) = sum over h of
    R_a(h) R_b(h) / n³`` with the sums of products R at the lag h, which is the variance over all
    surrogates of random phases (Theiler et al. 1992), put right for the mask (Clifford et al.
    1989). Others: from the scatter of what tiles of 250 um add to r, so that one stain in both maps
    is one event (Conley 1999).

    Theiler et al. (1992), Physica D 58, 77, doi:10.1016/0167-2789(92)90102-S. Clifford, Richardson
    and Hémon (1989), Biometrics 45, 123, doi:10.2307/2532039. Conley (1999), J. Econometrics 92, 1,
    doi:10.1016/S0304-4076(98)00084-0.

    Examples
    --------
    >>> a, b = np.random.default_rng(0).normal(size=(2, 60, 80))
    >>> is_valid = np.ones((60, 80), dtype=bool)
    >>> relations = [relate(a, m, is_valid, (10.0, 10.0)) for m in (b, a + b)]
    >>> abs(relations[0].z) < 3, relations[1].z > 10
    (True, True)
    """
    n = int(np.count_nonzero(is_valid))
    if n == 0:
        return Relation(0.0, math.inf, 0.0, math.inf)
    whole = b if of is None else of
    sd_whole = np.std(whole[is_valid])
    share = float(np.std(b[is_valid]) / sd_whole) if sd_whole > 0 else 0.0
    a = standard(a, is_valid)
    b = standard(b, is_valid)
    r = float(np.sum(a * b)) / n
    sd = _scatter(a, b, r, n, pixel_um)
    # Of a with what it leaves of b.
    residual = standard(b - r * a, is_valid)
    residual_sd = _scatter(a, residual, 0.0, n, pixel_um)
    unexplained_share = math.sqrt(max(1.0 - r * r, 0.0))
    return Relation(r, sd, share * r, share * unexplained_share * residual_sd)


def _scatter(a: Floats, b: Floats, r: float, n: int, pixel_um: Pair) -> float:
    """Standard deviation of r of unrelated textures like these two; 0 where they are not known.

    Both have mean 0 and standard deviation 1 over their ``n`` known pixels, and the correlation r.
    """
    size = padded_shape(a.shape, (0, 0))
    power = np.abs(padded_spectrum(a, size) * padded_spectrum(b, size)) ** 2
    power[:, 1 : (size[1] + 1) // 2] *= 2.0  # waves that run the other way
    # Parseval: the sum over all lags of the products of both sums of products.
    alike = np.sum(power) / (math.prod(size) * n)
    parts = tile_sums(influence_on_r(a, b, r), pixel_um)
    return math.sqrt(max(alike, np.sum(parts**2))) / n


def slopes_of(values: Floats) -> tuple[Floats, Floats]:
    """Slopes of a map (rows, cols) along y and x, a pixel."""
    return np.gradient(values, axis=0), np.gradient(values, axis=1)


def centred(values: Array, is_valid: Bools) -> Floats:
    """A map (rows, cols) less its mean over the known pixels; 0 elsewhere."""
    return np.where(is_valid, values - values[is_valid].mean(), 0.0)


def influence_on_r(x: Floats, y: Floats, r: float) -> Floats:
    """What each pixel of two maps of mean 0 and standard deviation 1 adds to their r."""
    return x * y - r / 2 * (x * x + y * y)


def standard(values: Floats, is_valid: Bools) -> Floats:
    """Mean 0 and standard deviation 1 over the known pixels of a map (rows, cols).

    0 elsewhere and of a constant.
    """
    out = np.zeros(values.shape)
    if is_valid.any():
        centred = values[is_valid]
        centred = centred - centred.mean()
        sd = math.sqrt(np.square(centred).mean())
        if sd > 0:
            out[is_valid] = centred / sd
    return out


def unexplained(values: Floats, explaining: Floats) -> Floats:
    """What a texture does not share with another one: the residual of least squares."""
    sum_of_squares = np.sum(explaining**2)
    if not sum_of_squares > 0:
        return values
    return values - np.sum(values * explaining) / sum_of_squares * explaining


def low_pass(values: Floats, half_um: float, pixel_um: Pair) -> Floats:
    """Gaussian filter that halves a wave of a length; 0 beyond the borders."""
    sigma = sigma_px(half_um, pixel_um)
    return ndimage.gaussian_filter(values, sigma, mode="constant", truncate=3.0)


def low_pass_known(values: Floats, is_known: Bools, half_um: float, pixel_um: Pair) -> Floats:
    """The same over the known pixels alone."""
    weight = low_pass(is_known.astype(np.float64), half_um, pixel_um)
    total = low_pass(np.where(is_known, values, 0.0), half_um, pixel_um)
    return total / np.maximum(weight, 1e-9)


def sigma_px(half_um: float, pixel_um: Pair) -> list[float]:
    """Standard deviations of the Gaussian that halves a wave of a length, in pixels."""
    sigma_um = half_um * math.sqrt(math.log(2.0) / 2) / math.pi
    return [sigma_um / p for p in pixel_um]


def tile_sums(values: Floats, pixel_um: Pair, tile_um: float = 250.0) -> Floats:
    """Sums over square tiles of a map (..., rows, cols), the last may be cut.

    Waves 250 um apart are unrelated.
    """
    for axis, pitch_um in zip((-2, -1), pixel_um, strict=True):
        side_px = max(round(tile_um / pitch_um), 1)
        starts = np.arange(0, values.shape[axis], side_px)
        values = np.add.reduceat(values, starts, axis=axis)
    return values


class _Band:
    """The band of maps with one mask; its filters' weights are computed once.

    All filters take missing pixels as 0 and divide by what they make of the mask, so that these
    have no weight. ``shown`` are the pixels with a value in all maps.
    """

    def __init__(self, shown: Bools, pixel_um: Pair, band_um: Pair) -> None:
        """Filter the mask as the maps will be, and number the distances from its holes.

        ``shown`` (rows, cols) are the pixels with a value in all maps, ``band_um`` the shortest and
        the longest wave.
        """
        self._pixel_um = pixel_um
        self._band_um = band_um
        # The neighbourhood of 1 mm in which all maps are given the same spread.
        self._local = [max(round(500.0 / p), 1) for p in pixel_um]
        self._shown = shown
        self._fine = low_pass(shown.astype(np.float64), band_um[0], pixel_um)
        self.is_valid: Bools = self._fine >= 0.5  # Single missing pixels are bridged.
        weight = self.is_valid.astype(np.float64)
        self._slow_weight = np.maximum(low_pass(weight, band_um[1], pixel_um), 1e-9)
        self._local_weight = np.maximum(self._neighbourhood(weight), 1e-9)
        # Around holes, the mean at each distance up to 300 um is taken off.
        distance = ndimage.distance_transform_edt(self.is_valid, sampling=pixel_um)
        ring = np.minimum(distance, 300.0) / max(15.0, *pixel_um)
        self._ring: Ints = ring.astype(np.intp)
        pixel_counts = np.bincount(self._ring[self.is_valid])
        self._in_ring = np.maximum(pixel_counts, 1)

    def __call__(self, values: Floats) -> Floats:
        """The band of one map (rows, cols), NaN where missing; 0 where the result is not known.

        Waves below the band are smoothed away, those above it taken off; then the spread is made
        equal, stains are clipped and the mean at each distance from holes is taken off.
        """
        is_valid = self.is_valid
        fine = low_pass(standard(values, self._shown), self._band_um[0], self._pixel_um)
        fine = np.divide(fine, self._fine, out=fine, where=is_valid)
        out = standard(fine, is_valid)
        slow = low_pass(out, self._band_um[1], self._pixel_um) / self._slow_weight
        out = standard(np.where(is_valid, out - slow, 0.0), is_valid)
        variance = self._neighbourhood(out * out) / self._local_weight
        # Where there is next to no texture, what there is, is not made as large as the rest.
        spread = np.sqrt(np.maximum(variance, 0.3**2))
        # A stain is one event, however dark it is.
        clipped = np.clip(out / spread, -3.0, 3.0)
        out = np.where(is_valid, clipped, 0.0)
        # What holes by one laser program do to their surroundings is no sign of one specimen.
        ring_sums = np.bincount(self._ring[is_valid], weights=out[is_valid])
        ring_mean = ring_sums / self._in_ring
        return standard(out - ring_mean[self._ring], is_valid)

    def _neighbourhood(self, values: Floats) -> Floats:
        smoothed = ndimage.uniform_filter(values, self._local, mode="constant")
        return ndimage.uniform_filter(smoothed, self._local, mode="constant")
