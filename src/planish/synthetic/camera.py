"""A camera that looks at the sheet's top side.

Brightness by Kubelka and Munk, print, and what light and lens add.

What belongs to the paper (scattering of the base, nuisance, tone of the print) is drawn in material
coordinates: two images made with the same seed, one of them printed, show the same paper with noise
of its own in each.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from planish.core.area import area_mean
from planish.core.reflectance import layer_over
from planish.core.typing import Array, Bools, Floats, Shape2D, TwoFields
from planish.synthetic.params import CameraParams, PaperParams, PrintParams, spawned
from planish.synthetic.pose import CameraPose
from planish.synthetic.sheet import PITCH_UM, DrawnSheet, Field, noise

BASE_S_M2_PER_KG = 45.0
BASE_K_M2_PER_KG = 1.2
# A triple coating from the base outwards: scattering of the pre, middle and top layer, and its
# share of the thickness.
COATING_S_M2_PER_KG = (90.0, 110.0, 150.0)
COATING_SHARES = (0.3, 0.3, 0.4)
COATING_K_M2_PER_KG = 0.3
_KG_PER_M2 = 1e-3  # of 1 um with a density of 1 g/cm3
_SHEETS = 200  # of a pile that nothing shines through: 200 sheets of 10 g/m2


def base_weight(paper: PaperParams, base_mass: ArrayLike = 1.0) -> Floats:
    """Return the grammage of the base in kg/m2.

    It is mean thickness times density, times the relative grammage of the place.
    """
    mean_weight = paper.base_um * paper.base_g_per_cm3 * _KG_PER_M2
    return mean_weight * np.asarray(base_mass, dtype=np.float64)


def coated(
    backing: ArrayLike,
    coating_um: ArrayLike,
    density: ArrayLike,
    paper: PaperParams,
    *,
    outwards: bool = True,
) -> Floats:
    """Return the reflectance of the triple coating over what lies below it.

    That is the base unless ``outwards`` is false: then light meets the layers in the other order,
    as those of the bottom face over a ``backing``. All three are reflectance, thickness in um and
    relative density of one shape, or one number.
    """
    mean_density = paper.coating_g_per_cm3 * _KG_PER_M2
    mean_weight = mean_density * np.asarray(coating_um, float)
    weight = mean_weight * np.asarray(density, float)
    layers = list(zip(COATING_S_M2_PER_KG, COATING_SHARES, strict=True))
    if not outwards:
        layers.reverse()
    result = np.asarray(backing, dtype=np.float64)
    for s, share in layers:
        result = layer_over(result, s, COATING_K_M2_PER_KG, share * weight)
    return result


def sheet_reflectance(
    paper: PaperParams,
    backing: Literal["pile", "black"],
    *,
    coating_top_um: ArrayLike,
    coating_bottom_um: ArrayLike,
    coating_density: ArrayLike = 1.0,
    base_mass: ArrayLike = 1.0,
    base_s_m2_per_kg: ArrayLike = BASE_S_M2_PER_KG,
) -> Floats:
    """Reflectance of the sheet's top side: bottom coating, base and top coating over a backing.

    The backing is a pile of the paper or a black hollow; density of coatings and grammage of the
    base have a mean of 1.
    """
    below = pile_reflectance(paper) if backing == "pile" else 0.0
    below = coated(below, coating_bottom_um, coating_density, paper, outwards=False)
    weight = base_weight(paper, base_mass)
    base = layer_over(below, base_s_m2_per_kg, BASE_K_M2_PER_KG, weight)
    return coated(base, coating_top_um, coating_density, paper)


def pile_reflectance(paper: PaperParams) -> float:
    """Reflectance of a pile of mean sheets of this paper that nothing shines through."""
    reflectance = np.zeros(())
    weight = base_weight(paper)
    for _ in range(_SHEETS):
        below = coated(reflectance, paper.coating_bottom_um, 1.0, paper, outwards=False)
        base = layer_over(below, BASE_S_M2_PER_KG, BASE_K_M2_PER_KG, weight)
        reflectance = coated(base, paper.coating_top_um, 1.0, paper)
    return float(reflectance)


_HOLE = 0.04  # reflectance of a hole with nothing in it
_CHAR_GREY = 0.2  # of burnt paper down in a hole: its wall, and what closes its lower end
_CHAR_RIM = 0.6  # share of the reflectance that is left at the rim, where sheet.char is 0.5
_BASE_S_SD_M2_PER_KG = 3.0
# Correlation lengths: of the base's scattering and the nuisance; of the tone.
_PAPER_UM, _TONE_UM = 200.0, 300.0
# Pitches between nodes of those smooth fields: 12 um, where interpolation loses 0.1 % of the
# variance.
_COARSE_STEP = 4
_ORACLE_UM = 100.0  # points at which r2 of the true maps is stated
_HOLE_CLEARANCE_UM = 100.0  # from the holes' rims: two and a half times the burnt width
_FEWEST = 20  # of those points
_BLOCK = 128  # rows of the image at a time
_CELL_SAMPLES = 7  # per side of a print's cell, for the coating under its dot


def photograph(
    sheet: DrawnSheet,
    pose: CameraPose,
    camera: CameraParams,
    *,
    shape: Shape2D,
    seed: np.random.SeedSequence,
    printed: bool = False,
) -> Field:
    """Photograph the sheet's top side.

    Parameters
    ----------
    sheet : DrawnSheet
    pose : CameraPose
    camera : CameraParams; what is 0 is off and changes nothing else
    shape : (rows, cols) of the image
    seed : SeedSequence; it is not changed: the same one gives the same image
    printed : bool
        Whether the sheet carries ``camera.screen``, or the usual screen where that is None.

    Returns
    -------
    (rows, cols), reflectance from 0 to 1 in steps of ``camera.bits``

    Raises
    ------
    ValueError
        If ``camera.oracle_r2`` is out of reach.
    """
    for_scatter, for_nuisance, for_tone, for_noise, for_print_noise = spawned(seed, 5)
    u, v = image_material(pose, shape, camera.pixel_um)
    top, coating, rim, hole, image = _bare_sheet(sheet, camera, u, v, for_scatter)
    nuisance = _coarse_noise(sheet, _PAPER_UM, for_nuisance)
    gain = camera.nuisance_sd
    if camera.oracle_r2 is not None:
        truth_maps = (coating, image, _sample(sheet, nuisance, u, v))
        is_clear = rim > _HOLE_CLEARANCE_UM
        gain = _oracle_gain(truth_maps, is_clear, camera.pixel_um, camera.oracle_r2)
    screen: PrintParams | None = None
    rng = for_noise
    if printed:
        screen = camera.screen or PrintParams()
        rng = for_print_noise
    tone = _coarse_noise(sheet, _TONE_UM, for_tone)
    first_cell = (0, 0)
    radius_um = np.empty((0, 0))
    if screen:
        first_cell, radius_um = _dot_radii(sheet, screen, tone)
    # Added are what is not due to the coating, the print, and the burnt rims.
    for rows in _row_blocks(len(image)):
        uv = (u[rows], v[rows])
        reflectance = image[rows] + gain * _sample(sheet, nuisance, *uv)
        if screen:
            a, b = _screen_coordinates(*uv, screen)
            col = np.floor(a)
            row = np.floor(b)
            distance = screen.pitch_um * np.hypot(a - col - 0.5, b - row - 0.5)
            last_row, last_col = np.subtract(radius_um.shape, 1)
            i = np.clip(row.astype(int) - first_cell[0], 0, last_row)
            j = np.clip(col.astype(int) - first_cell[1], 0, last_col)
            ink_share = _covered(radius_um[i, j] - distance, camera)
            # Murray and Davies.
            reflectance = reflectance * (1 - ink_share) + screen.ink * ink_share
        burnt = 1 - sheet.at(sheet.char, *uv)
        darkening = 2 * (1 - _CHAR_RIM) * burnt  # char is 0.5 at a rim
        image[rows] = reflectance * (1 - darkening)
    paper_share = _covered(rim, camera)
    paper_and_holes = hole + (image - hole) * paper_share
    image = np.asarray(paper_and_holes, dtype=np.float32)
    return _expose(image, top, paper_share, camera, rng)


def _covered(inside_um: Array, camera: CameraParams) -> Array:
    """Share of each pixel on the inner side of a border that lies so far outside its middle."""
    return np.clip(inside_um / camera.pixel_um + 0.5, 0, 1)


def _bare_sheet(
    sheet: DrawnSheet, camera: CameraParams, u: Floats, v: Floats, rng: np.random.Generator
) -> tuple[Field, Field, Field, Field, Field]:
    """What the sheet shows at the material coordinates of each pixel, (rows, cols) each.

    Height of the top face, thickness of the top coating, and distance to the nearest hole's rim at
    that face (negative inside), in um; then the reflectance where a hole is seen, and that of the
    sheet. In a hole the wall and a closed lower end are burnt, where the rim at the bottom face
    lies inside that at the top.
    """
    scattering_field = _BASE_S_SD_M2_PER_KG * _coarse_noise(sheet, _PAPER_UM, rng)
    fields = (np.empty(u.shape, dtype=np.float32) for _ in range(5))
    top_um, coating_um, rim_um, hole_reflectance, reflectance = fields
    for rows in _row_blocks(u.shape[0]):
        uv = (u[rows], v[rows])
        top, inner_top, inner_bottom, bottom = (sheet.at(face, *uv) for face in sheet.faces)
        top_um[rows] = top
        coating_um[rows] = np.maximum(top - inner_top, 0)
        rim_um[rows] = sheet.at(sheet.rim_um[0], *uv)
        lower_share = _covered(sheet.at(sheet.rim_um[1], *uv), camera)
        hole_reflectance[rows] = _HOLE + (_CHAR_GREY - _HOLE) * lower_share
        scattering = BASE_S_M2_PER_KG + _sample(sheet, scattering_field, *uv)
        reflectance[rows] = sheet_reflectance(
            sheet.params,
            camera.backing,
            coating_top_um=coating_um[rows],
            coating_bottom_um=np.maximum(inner_bottom - bottom, 0),
            coating_density=sheet.at(sheet.coating_density, *uv),
            base_mass=sheet.at(sheet.base_mass, *uv),
            base_s_m2_per_kg=np.maximum(scattering, 0),
        )
    return top_um, coating_um, rim_um, hole_reflectance, reflectance


def _expose(
    image: Field, top_um: Field, paper_share: Field, camera: CameraParams, rng: np.random.Generator
) -> Field:
    """Shade the sheet by its topography, holes apart.

    Add blur, vignetting and noise; round to the bits. All are (rows, cols): reflectance, height of
    the top face in um, and share of each pixel that is no hole. ``camera.shading`` is per 0.1 of
    slope.
    """
    shape = (image.shape[0], image.shape[1])
    if camera.shading > 0:
        # The light stands on the left: what rises to the right faces it.
        slope = np.asarray(np.gradient(top_um, camera.pixel_um, axis=1))
        image *= 1 + camera.shading / 0.1 * slope * paper_share
    if camera.lens_um > 0:
        sigma_px = camera.lens_um / camera.pixel_um
        image = ndimage.gaussian_filter(image, sigma_px, mode="nearest")
    if camera.vignetting > 0:
        image *= vignette(shape, camera.vignetting)
    image += np.float32(camera.noise) * rng.standard_normal(shape, dtype=np.float32)
    highest_grey = 2**camera.bits - 1
    grey = np.rint(np.clip(image, 0, 1) * highest_grey)
    return (grey / highest_grey).astype(np.float32)


def vignette(shape: Shape2D, loss: float) -> Field:
    """Share of the light in an image.

    Parameters
    ----------
    shape : (rows, cols)
    loss : float; share that is lost in the corners

    Returns
    -------
    (rows, cols); 1 in the middle, ``1 - loss`` in the corners
    """
    y, x = (np.linspace(-1, 1, n) * n for n in shape)
    corner_squared = shape[0] ** 2 + shape[1] ** 2
    radius_squared = (y[:, None] ** 2 + x**2) / corner_squared
    return 1 - loss * radius_squared.astype(np.float32)


def image_material(pose: CameraPose, shape: Shape2D, pixel_um: float) -> TwoFields:
    """Return the material coordinates shown by each pixel of an image.

    Parameters
    ----------
    pose : CameraPose
    shape : (rows, cols) of the image
    pixel_um : float

    Returns
    -------
    u, v : (rows, cols), in um
    """
    u = np.empty(shape)
    v = np.empty(shape)
    y, x = (np.arange(n) * pixel_um for n in shape)
    for rows in _row_blocks(shape[0]):
        image_xy = np.stack(np.meshgrid(x, y[rows]), axis=-1)
        material_uv = pose.inverse(image_xy)
        u[rows] = material_uv[..., 0]
        v[rows] = material_uv[..., 1]
    return u, v


def _oracle_gain(
    maps: tuple[Field, Field, Floats], is_clear: Bools, pixel_um: float, target: float
) -> float:
    """Return the size of the nuisance that brings r2 of thickness and reflectance to ``target``.

    ``maps`` (rows, cols) are the true thickness of the top coating, the true reflectance, and the
    nuisance of unit standard deviation; ``is_clear`` are pixels away from holes. ValueError where
    no size does.

    Over points of 100 um away from the holes, the covariances of ``R + g N`` with the thickness and
    with itself are polynomials in ``g``, so ``r2 = target`` is a quadratic equation.
    """
    cell_px = (_ORACLE_UM / pixel_um, _ORACLE_UM / pixel_um)
    clear_maps = [np.where(is_clear, m, np.nan) for m in maps]
    means = [area_mean(m, cell_px, least_share=1.0) for m in clear_maps]
    is_finite = np.isfinite(means[0])
    n_points = int(is_finite.sum())
    if n_points < _FEWEST:
        raise ValueError(
            f"oracle_r2 asks for {_FEWEST} points of {_ORACLE_UM:g} um away from the holes and the"
            f" image has {n_points}; take a larger image or fewer holes, or set nuisance_sd"
            " instead."
        )
    points = [m[is_finite] for m in means]
    (tt, tr, tn), (_, rr, rn), (_, _, nn) = np.cov(points)
    clean_r2 = 0.0
    if tt > 0 and tr > 0:
        clean_r2 = float(tr * tr / (tt * rr))
    if not 0 < target <= clean_r2:
        raise ValueError(
            f"oracle_r2 = {target:g} is out of reach: without any nuisance, r2 of coating thickness"
            f" and reflectance is {clean_r2:.3f}, and a nuisance can only lower it. Ask for less,"
            " but more than 0."
        )
    scaled_target = target * tt
    square = tn * tn - scaled_target * nn
    linear = 2 * (tr * tn - scaled_target * rn)
    constant = tr * tr - scaled_target * rr
    roots = np.roots([square, linear, constant])
    gains = roots.real[np.abs(roots.imag) < 1e-12]
    gains = gains[(gains >= 0) & (tr + gains * tn > 0)]
    if not gains.size:
        raise ValueError(
            f"oracle_r2 = {target:g} is out of reach: over {n_points} points even the nuisance"
            f" alone has an r2 of {tn * tn / (tt * nn):.3f} with the thickness. Ask for more, or"
            " take a larger image or another seed."
        )
    return float(gains.min())


def _dot_radii(sheet: DrawnSheet, screen: PrintParams, tone: Floats) -> tuple[Shape2D, Floats]:
    """Return the (row, col) of the sheet's first dot, and the radii of all, (rows, cols) in um.

    There is one dot to each cell of the turned screen. Its area is the tone: less where the coating
    is thicker than the mean, with a random part (``tone``, the coarse field of unit standard
    deviation), both averaged over 7 x 7 samples of the cell.
    """
    rows, cols = sheet.char.shape
    end_u, end_v = PITCH_UM * np.array([cols - 1, rows - 1])
    u = sheet.origin[0] + np.array([0, end_u, 0, end_u])
    v = sheet.origin[1] + np.array([0, 0, end_v, end_v])
    cells = np.floor(_screen_coordinates(u, v, screen)).astype(int)
    first_col, first_row = cells.min(axis=1).tolist()
    n_cols, n_rows = (np.ptp(cells, axis=1) + 1).tolist()
    sample_offsets = (np.arange(_CELL_SAMPLES) + 0.5) / _CELL_SAMPLES
    col_samples = np.arange(n_cols)[:, None] + first_col + sample_offsets
    row_samples = np.arange(n_rows)[:, None] + first_row + sample_offsets
    a, b = np.meshgrid(col_samples.ravel(), row_samples.ravel())
    pitch = screen.pitch_um
    angle = np.deg2rad(screen.angle_deg)
    u = pitch * (a * np.cos(angle) - b * np.sin(angle))
    v = pitch * (a * np.sin(angle) + b * np.cos(angle))
    top_um, inner_um = (sheet.at(face, u, v) for face in sheet.faces[:2])
    coating = np.maximum(top_um - inner_um, 0)
    coating_um = sheet.faces[0] - sheet.faces[1]
    mean_coating_um = float(np.mean(coating_um, dtype=np.float64))
    coating_gain = screen.gain_per_um * (coating - mean_coating_um)
    tone_change = screen.gain_sd * _sample(sheet, tone, u, v) - coating_gain
    samples = tone_change.reshape(n_rows, _CELL_SAMPLES, n_cols, _CELL_SAMPLES)
    # A larger dot would touch its neighbours: then the tone is no longer pi r^2.
    tone_of_cell = screen.tone + samples.mean(axis=(1, 3))
    dot_area = np.clip(tone_of_cell, 0.0, 0.25 * np.pi)
    return (first_row, first_col), pitch * np.sqrt(dot_area / np.pi)


def _screen_coordinates(u: Floats, v: Floats, screen: PrintParams) -> TwoFields:
    angle = np.deg2rad(screen.angle_deg)
    cos = np.cos(angle) / screen.pitch_um
    sin = np.sin(angle) / screen.pitch_um
    return u * cos + v * sin, v * cos - u * sin


def _coarse_noise(sheet: DrawnSheet, correlation_um: float, rng: np.random.Generator) -> Floats:
    """Draw a random field of unit standard deviation over the sheet and a little beyond.

    It lies on every 4th node of the sheet's grid.
    """
    rows, cols = sheet.char.shape
    shape = (rows // _COARSE_STEP + 2, cols // _COARSE_STEP + 2)
    return noise(shape, correlation_um / _COARSE_STEP, rng)


def _sample(sheet: DrawnSheet, coarse_field: Floats, u: Floats, v: Floats) -> Floats:
    """Values of a field of :func:`_coarse_noise` at material coordinates, in um."""
    pitch_um = PITCH_UM * _COARSE_STEP
    row = (v - sheet.origin[1]) / pitch_um
    col = (u - sheet.origin[0]) / pitch_um
    places = np.stack([row, col])
    return ndimage.map_coordinates(coarse_field, places, order=1, mode="nearest")


def _row_blocks(rows: int) -> list[slice]:
    starts = range(0, rows, _BLOCK)
    return [slice(start, min(start + _BLOCK, rows)) for start in starts]
