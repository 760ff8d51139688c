"""An office scanner that looks at the sheet's top side: a lamp and a line of sensors that move.

The carriage goes along y. Lamp and sensors go with it, so the light comes from one side of the line
that is read, and each line of the picture has an error of place of its own.
"""

from dataclasses import dataclass
from io import BytesIO

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from scipy import ndimage

from planish.core.reflectance import LUMINANCE
from planish.core.robust import running_sums
from planish.core.typing import Floats, Shape, TwoFields
from planish.synthetic.params import FlatbedParams, spawned

INCH_UM = 25_400.0
_UNSHARP_PX = 1.0  # Gaussian sigma of the usual unsharp mask
_WANDER_UM = 5000.0  # correlation length of the carriage's slow error
_TRACK_UM = 100_000.0  # on which the slow error has its standard deviation
_MARGIN_UM = 100.0  # of the picture around the scan


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatbedScan:
    """A scan, and where each point of the picture it was taken of lies in it."""

    values: NDArray[np.generic]  #: (rows, columns), or (rows, columns, 3): red, green, blue
    pixel_um: float  #: as the file states it
    lines_um: Floats  #: true place of the middle of each row, in um of the picture
    columns_um: Floats  #: true place of the middle of each column

    def place(self, points: ArrayLike) -> Floats:
        """Carry points (..., 2), (x, y) in um of the picture, to (x, y) in um of the scan.

        NaN outside the scan.
        """
        x, y = np.moveaxis(np.asarray(points, dtype=np.float64), -1, 0)
        scanned: list[Floats] = []
        for place, middles in ((x, self.columns_um), (y, self.lines_um)):
            numbers = np.arange(middles.size)
            scanned.append(np.interp(place, middles, numbers, left=np.nan, right=np.nan))
        return self.pixel_um * np.stack(scanned, axis=-1)


def scan_flatbed(
    reflectance: ArrayLike,
    face_um: ArrayLike,
    *,
    pixel_um: float,
    params: FlatbedParams,
    seed: np.random.SeedSequence,
) -> FlatbedScan:
    """Scan a picture whose pixels are a few times finer than those of the scanner.

    Parameters
    ----------
    reflectance, face_um : array-like, shape (rows, columns)
        Reflectance (0 to 1) of the sheet in even light, and height of its face in um.
    pixel_um : float
        Pixel of both; pixel ``i`` has its centre at ``i * pixel_um``.
    params : FlatbedParams
    seed : SeedSequence
        Of the carriage and of the noise; it is not changed.

    Returns
    -------
    FlatbedScan
        8 or 16 bit. JPEG has been undone again.
    """
    for_carriage, for_noise = spawned(seed, 2)
    light = lamp(face_um, pixel_um=pixel_um, params=params)
    lit = np.asarray(reflectance, dtype=np.float64) * light
    if params.lens_um > 0:
        lit = ndimage.gaussian_filter(lit, params.lens_um / pixel_um, mode="nearest")
    pitch_um = INCH_UM / params.dpi
    pitch_px = pitch_um / pixel_um
    lines_um, columns_um = _carriage(lit.shape, pixel_um, pitch_um, params, for_carriage)
    across = _area_means(lit.T, columns_um / pixel_um, pitch_px).T
    # The lines of red and blue, brought over that of green but for a rest. The grey of all three,
    # as their weights have it, lies where the carriage says.
    shifts_um = np.zeros(1)
    if params.colour:
        shifts = np.array([-1.0, 0.0, 1.0]) - (LUMINANCE[2] - LUMINANCE[0])
        shifts_um = params.colour_shift_px * shifts * pitch_um
    channels: list[Floats] = []
    for shift_um in shifts_um:
        middles_px = (lines_um + shift_um) / pixel_um
        channels.append(_area_means(across, middles_px, pitch_px))
    linear = np.clip(np.stack(channels, axis=-1), 0.0, 1.0)
    coded = 255.0 * encode(linear, params.gamma)
    coded += params.noise * for_noise.standard_normal(coded.shape)
    if params.sharpen > 0:
        sigma = (_UNSHARP_PX, _UNSHARP_PX, 0.0)
        blurred = ndimage.gaussian_filter(coded, sigma, mode="nearest")
        coded += params.sharpen * (coded - blurred)
    values = _stored(coded, params)
    if not params.colour:
        values = values[..., 0]
    return FlatbedScan(
        values=values,
        pixel_um=pitch_um,
        lines_um=lines_um,
        columns_um=columns_um,
    )


def lamp(face_um: ArrayLike, *, pixel_um: float, params: FlatbedParams) -> Floats:
    """Light on each place over that on a level one, by Lambert's law for small slopes.

    The lamp stands at smaller y: what rises along the scan faces it. Light that enters the paper
    leaves it some way off, so that the shading is as smooth as this way is long.
    """
    slope = np.gradient(np.asarray(face_um, dtype=np.float64), pixel_um, axis=0)
    light = 1.0 + params.shading / 0.1 * slope
    return ndimage.gaussian_filter(light, params.spread_um / pixel_um, mode="nearest")


def encode(linear: Floats, gamma: float | str) -> Floats:
    """Code linear grey (0 to 1) as pictures are: by the curve of sRGB, or a power."""
    if gamma == "srgb":
        power = 1.055 * linear ** (1 / 2.4) - 0.055
        return np.where(linear > 0.0031308, power, 12.92 * linear)
    return linear ** (1 / float(gamma))


def _carriage(
    shape: Shape,
    pixel_um: float,
    pitch_um: float,
    params: FlatbedParams,
    rng: np.random.Generator,
) -> TwoFields:
    """Place in the picture of the middle of each row and column of the scan, in um.

    ``shape`` (rows, cols) and ``pixel_um`` are those of the picture, ``pitch_um`` the pixel of the
    scan as it is stated. Along y the true step differs from it by the error of scale, a slow error,
    a ripple and an error of each line; along x by an error of scale.

    Every number is drawn whatever its size, so that one that is off does not move the others.
    """
    along, across, phase = rng.uniform(-1.0, 1.0, 3)
    widest_um = pitch_um * (1 + params.scale_range)
    scanned_um = [n * pixel_um - 2 * _MARGIN_UM for n in shape]
    rows, columns = (int(um / widest_um) for um in scanned_um)
    ramp_um = pitch_um * np.arange(rows)
    jitter = rng.standard_normal(rows)
    white = rng.standard_normal(int(_TRACK_UM / pitch_um))
    wander = ndimage.gaussian_filter1d(white, 0.5 * _WANDER_UM / pitch_um, mode="wrap")
    ripple = np.sin(2 * np.pi * (ramp_um / params.ripple_period_um + phase))
    lines_um = _MARGIN_UM + ramp_um * (1 + params.scale_range * along)
    lines_um += params.wander_um * (wander / wander.std())[:rows]
    lines_um += params.ripple_um * ripple
    lines_um += params.jitter_um * jitter
    across_um = pitch_um * np.arange(columns)
    columns_um = _MARGIN_UM + across_um * (1 + params.scale_range * across)
    return lines_um, columns_um


def _area_means(picture: Floats, middles: Floats, width: float) -> Floats:
    """Means of rows between two places, both in rows; a row ends half a row from its middle."""
    sums = running_sums(picture.T).T
    edges = np.stack([middles - 0.5 * width, middles + 0.5 * width]) + 0.5
    whole = np.clip(edges.astype(int), 0, len(picture) - 1)
    parts = (edges - whole)[..., None] * picture[whole]
    low, high = sums[whole] + parts
    return (high - low) / width


def _stored(coded: Floats, params: FlatbedParams) -> NDArray[np.generic]:
    """Grey of 0 to 255 as the file holds it, after JPEG where that is asked for.

    (rows, columns, channels); 16 bits are 0 to 65535, for which 257 is 65535 / 255, and no JPEG.
    """
    if params.bits == 16:
        rounded = np.rint(257.0 * coded)
        return np.clip(rounded, 0, 65535).astype(np.uint16)
    values = np.clip(np.rint(coded), 0, 255).astype(np.uint8)
    if params.quality is None:
        return values
    file = BytesIO()
    picture = Image.fromarray(values if params.colour else values[..., 0])
    picture.save(file, "JPEG", quality=params.quality)
    return np.asarray(Image.open(file)).reshape(values.shape)
