"""The sheet in material coordinates: faces, interfaces, fibres, flocs and holes on one fine grid.

Rules after Dahlström and Uesaka (Ind. Eng. Chem. Res. 48, 10472, 2009): the coating's outer face is
a smoothed copy of the base's surface plus the mean layer, so that the coating is thin where fibres
stand up and thick in the pits; what the layer varies beyond that is random deposition.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft, ndimage

from planish.core.grid import bilinear
from planish.core.typing import Complexes, Floats, Pair, Shape, Shape2D, Singles, TwoFields, pair_of
from planish.synthetic import _kernels
from planish.synthetic.fibres import FibreMat, Structure, drawn_angles
from planish.synthetic.params import BurnParams, FilmParams, PaperParams, generator

PITCH_UM = 3.0  # of the sheet's grid
# Length, width of softwood and hardwood fibres together.
_FIBRE_UM = ((1000.0, 2500.0), (20.0, 35.0))


def noise(shape: Shape2D, correlation_um: float, rng: np.random.Generator) -> Floats:
    """Draw a Gaussian random field (rows, cols), mean 0, sd 1.

    Its autocorrelation is ``exp(-(r / correlation_um)^2)``.
    """
    white = rng.standard_normal(_padded(shape))
    smooth = _filtered(white, 0.5 * correlation_um)
    return _unit(smooth[: shape[0], : shape[1]])


def lowpass(field: Floats, half_um: float) -> Floats:
    """Gaussian filter that halves a wave of length ``half_um``.

    The field is mirrored at its borders.
    """
    sigma = half_um * float(np.sqrt(np.log(2.0) / 2)) / np.pi
    rows, cols = field.shape
    pad = min(int(4 * sigma / PITCH_UM) + 1, min(rows, cols) - 1)
    padded = np.pad(field, pad, mode="reflect")
    filtered = _filtered(padded, sigma)
    return filtered[pad : pad + rows, pad : pad + cols]


def streaks(shape: Shape2D, correlation_um: float, rng: np.random.Generator) -> Floats:
    """Random field that does not change along the machine direction (the columns' axis u)."""
    profile = noise((shape[0], 8), correlation_um, rng)[:, :1]
    return np.broadcast_to(_unit(profile), shape).copy()


def fibres(shape: Shape2D, per_mm2: float, anisotropy: float, rng: np.random.Generator) -> Floats:
    """Height, 0 to 1, of fibres laid at random, (rows, cols).

    ``anisotropy``: number along u over across, by von Mises' angles. Fibres begin up to half of the
    longest one outside of the field, and are 8 at least.
    """
    per_pitch2 = per_mm2 * shape[0] * shape[1]
    count = max(int(per_pitch2 * PITCH_UM**2 * 1e-6), 8)
    (shortest, longest), (narrowest, widest) = _FIBRE_UM
    field = np.zeros(shape)
    margin = 0.5 * longest / PITCH_UM
    ends = np.add(shape[::-1], margin)
    starts = rng.uniform(-margin, ends, (count, 2))
    angles = drawn_angles(anisotropy, count, rng)
    lengths = rng.uniform(shortest, longest, count) / PITCH_UM
    widths = rng.uniform(narrowest, widest, count) / PITCH_UM
    curls = rng.normal(0, 4e-4, count) * PITCH_UM
    # The angle is that of a fibre's middle: half of the curl lies before it.
    start_angles = angles - 0.5 * curls * lengths
    _kernels.lay_fibres(field, starts, start_angles, lengths, widths, curls)
    return field


def fibrous(
    shape: Shape2D, anisotropy: float, rng: np.random.Generator, *, per_mm2: float = 29.0
) -> Floats:
    """Draw a random field at fibre scale: fibres and the net between them.

    It has mean 0 and standard deviation 1.
    """
    laid = fibres(shape, per_mm2, anisotropy, rng)
    return _unit(3.0 * laid + noise(shape, 35.0, rng))


def _unit(field: Floats) -> Floats:
    field = field - field.mean()
    return field / field.std()


def _padded(shape: Shape) -> Shape:
    return tuple(fft.next_fast_len(n, True) for n in shape)


def _filtered(field: Floats, sigma_um: float) -> Floats:
    """Gaussian filter (rows, cols) by its transfer function; the field goes on around the border.

    It is padded with its own beginning to a size with a fast Fourier transform.
    """
    rows, cols = field.shape
    shape = _padded(field.shape)
    beyond = [(0, shape[0] - rows), (0, shape[1] - cols)]
    spectrum = fft.rfft2(np.pad(field, beyond, mode="wrap"))
    along_y = fft.fftfreq(shape[0], PITCH_UM)
    along_x = fft.rfftfreq(shape[1], PITCH_UM)
    fy = np.exp(-2 * (np.pi * sigma_um * along_y) ** 2)
    fx = np.exp(-2 * (np.pi * sigma_um * along_x) ** 2)
    filtered = fft.irfft2(spectrum * fy[:, None] * fx, shape)
    return filtered[:rows, :cols]


_BORDER_UM = 260.0  # from the middle of a hole to the end of the field
_APART_UM = 550.0
# Pitches of the lines in um, all different, and so are the sums of neighbours: distances identify
# any few holes.
_PITCHES_UM = (
    (500, 725, 590, 860, 650, 950),
    (545, 905, 620, 770, 510, 830),
    (695, 560, 815, 530, 935, 605),
)
_ROUGH_UM = 30.0  # correlation length along the rim
# Of the waves around the rim, one after the other; order 1 would move the centre.
_ORDERS = np.arange(2, 25)


def hole_pattern(params: BurnParams, low: Floats, high: Floats, seed: int) -> Floats:
    """Centres (n, 2) in um from ``low`` to ``high`` (u, v), with the stage's error.

    ValueError if they do not fit.
    """
    if params.count == 0:
        return np.zeros((0, 2))
    if params.pattern == "coded":
        designed = _coded(params, low, high)
    else:
        designed = _scattered(params, low, high, seed)
    errors = generator(seed, "stage").standard_normal(designed.shape)
    return designed + params.stage_um * errors


def _coded(params: BurnParams, low: Floats, high: Floats) -> Floats:
    """Holes on three sides whose distances identify any few of them.

    One line runs along u from the corner at ``low`` (u, v), two along v from 520 um beside it and
    beside the other corner. A line has a third of ``params.count``, rounded up and 7 at most, so
    there are 21 at most; those left over are taken off the last line. What does not fit is left
    out; ValueError where fewer than 4 do.
    """
    per_line = min(-(-params.count // 3), 7)
    corner = low + _BORDER_UM
    end = high - _BORDER_UM
    side_start_v = low[1] + (_BORDER_UM + 520.0)
    starts = (corner, (corner[0], side_start_v), (end[0], side_start_v))
    lines: list[Floats] = []
    for pitches, start, direction in zip(_PITCHES_UM, starts, (0, 1, 1), strict=True):
        line = np.tile(start, (per_line, 1))
        places_um = np.concatenate([[0.0], np.cumsum(pitches)])
        line[:, direction] += places_um[:per_line]
        fits = np.all(line <= end + 1e-6, axis=1)
        lines.append(line[fits])
    holes = np.concatenate(lines)[: params.count]
    if len(holes) < 4:
        size = " x ".join(f"{v:.0f}" for v in high - low)
        raise ValueError(
            f"Only {len(holes)} coded holes fit into {size} um; 4 are the least. Take a larger"
            " field or pattern='irregular'."
        )
    return holes


def _scattered(params: BurnParams, low: Floats, high: Floats, seed: int) -> Floats:
    """Holes drawn one after the other, none close to another or to the border.

    The distances to keep are smaller where the field is: a fifth of its shorter side from the
    border, and seven tenths of the side of a square that each hole has for itself, but at least 1.4
    diameters between middles. ValueError where 20 000 places were not enough.
    """
    rng = generator(seed, "pattern")
    size_um = high - low
    border = min(_BORDER_UM, 0.2 * float(size_um.min()))
    inner = np.maximum(size_um - 2 * border, 0.0)
    side_of_hole_um = float(np.sqrt(inner.prod() / params.count))
    spacing_um = min(_APART_UM, 0.7 * side_of_hole_um)
    spacing_um = max(spacing_um, 1.4 * params.diameter_um)
    centres: list[Floats] = []
    for _ in range(20_000):
        if len(centres) == params.count:
            return np.array(centres)
        point = rng.uniform(low + border, high - border)
        if all(np.hypot(*(point - other)) > spacing_um for other in centres):
            centres.append(point)
    size = " x ".join(f"{v:.0f}" for v in size_um)
    raise ValueError(
        f"{params.count} holes of {params.diameter_um:g} um do not fit into {size} um."
    )


def burn(
    params: BurnParams,
    holes: Floats,
    shape: Shape2D,
    low: Pair,
    depth_um: float,
    seed: int,
) -> tuple[Singles, Singles]:
    """Burn the holes into a sheet of mean thickness ``depth_um``: its ``rim_um`` and ``char``.

    ``holes`` (n, 2) are centres (u, v); ``shape`` and ``low`` are the nodes (rows, cols) of the
    sheet and the (u, v) of the first one. Far from holes the distance to a rim is 1e4 um.
    """
    rim = np.full((2, *shape), 1e4, dtype=np.float32)
    char = np.ones(shape, dtype=np.float32)
    reach_um = 2.0 * params.diameter_um + 4 * params.char_um
    for k, (u, v) in enumerate(holes):
        rows = _nodes_within(reach_um, v - low[1], shape[0])
        cols = _nodes_within(reach_um, u - low[0], shape[1])
        y = low[1] + PITCH_UM * np.arange(shape[0])[rows, None] - v
        x = low[0] + PITCH_UM * np.arange(shape[1])[None, cols] - u
        if x.size == 0 or y.size == 0:
            continue
        rng = generator(seed, "hole", str(k))
        top, bottom, burnt_um = _hole(params, x, y, depth_um, rng)
        rims = rim[:, rows, cols]
        rims[:] = np.minimum(rims, [top, bottom])
        if burnt_um > 0:
            decay = np.exp(-np.maximum(top, 0) / (0.5 * burnt_um))
            burnt = 1 - 0.5 * decay
            char[rows, cols] = np.minimum(char[rows, cols], burnt)
    return rim, char


def _nodes_within(reach_um: float, middle_um: float, n: int) -> slice:
    first = int((middle_um - reach_um) / PITCH_UM)
    last = int((middle_um + reach_um) / PITCH_UM)
    return slice(max(first, 0), min(last, n))


def _hole(
    params: BurnParams, x: Floats, y: Floats, depth_um: float, rng: np.random.Generator
) -> tuple[Floats, Floats, float]:
    """Distances to one hole's rim at top and bottom face, in um, and the width of its burnt rim.

    At places (x, y) from its centre at the top face; negative inside. The hole is an ellipse with a
    rough rim; at the bottom face it is narrower (taper), lies aside as the beam is tilted, and may
    be half closed.
    """
    # Everything is drawn, also what is off: then one switch does not move the others.
    radius = 0.5 * (params.diameter_um + params.diameter_sd_um * rng.standard_normal())
    ratio = np.sqrt(1 + (params.axis_ratio - 1) * rng.random())
    axis_angle, lean_angle, closed_angle = rng.uniform(0, 2 * np.pi, 3)
    tilt = np.deg2rad(params.tilt_deg * rng.random())
    lean_um = np.tan(tilt) * depth_um
    wave_power = np.exp(-((_ORDERS * _ROUGH_UM / (2 * radius)) ** 2))
    wave_sd_um = params.rim_um * np.sqrt(wave_power / wave_power.sum())
    waves = wave_sd_um[:, None] * rng.standard_normal((_ORDERS.size, 2))
    burnt_um = max(params.char_um + params.char_sd_um * rng.standard_normal(), 0.0)
    is_half_closed = rng.random() < params.half_closed

    def distance(x: Floats, y: Floats, radius: float) -> Floats:
        """Signed distance of places from a rim of this mean radius, in um."""
        # cos(k angle) + i sin(k angle) from one order to the next, without a sine for each
        spin: Complexes = np.exp(1j * np.arctan2(y, x))
        harmonic = spin
        roughness = np.zeros(spin.shape)
        for a, b in waves:
            harmonic = harmonic * spin
            roughness += a * harmonic.real + b * harmonic.imag
        # Along the axes of the ellipse, which has the area of the circle.
        p = (x * np.cos(axis_angle) + y * np.sin(axis_angle)) / ratio
        q = (y * np.cos(axis_angle) - x * np.sin(axis_angle)) * ratio
        return np.hypot(p, q) - radius - roughness

    top = distance(x, y, radius)
    x = x - lean_um * np.cos(lean_angle)
    y = y - lean_um * np.sin(lean_angle)
    bottom = distance(x, y, radius * (1 - params.taper))
    if is_half_closed:
        beyond_line = x * np.cos(closed_angle) + y * np.sin(closed_angle)
        bottom = np.maximum(bottom, beyond_line)
    return top, bottom, burnt_um


_DISC = np.hypot(*np.mgrid[-3:4, -3:4]) < 3.5  # nodes: 20 um
_MIDDLE_UM = 3.0  # sd of the height of the middle of a base of fibres
Field = Singles
# Of the base's texture, from its bottom to its top: a collapsed fibre is some 5 um thick.
LAYERS = 10
_FLOC_UM, _STREAK_UM, _DEPOSIT_UM, _CRACK_UM = 1500.0, 2000.0, 100.0, 300.0  # correlation lengths
_LOOSE_PER_MM2 = 6.0
_FILLER_CONTRAST = 2.2  # grey of the filler over that of fibres, less 1


@dataclass(frozen=True, kw_only=True)
class DrawnSheet:
    """Fields on nodes ``origin + pitch * (col, row)``, all (rows, cols) float32."""

    params: PaperParams
    seed: int
    origin: Pair
    #: (4, rows, cols), signed um from the surface that keeps its lengths where the sheet is bent:
    #: s_T, s_TI, s_BI, s_B.
    faces: Field
    #: (2, rows, cols), signed distance to the nearest hole's rim at top and bottom face, negative
    #: inside.
    rim_um: Field
    char: Field  #: factor on the coating's grey: 1 = untouched, 0.5 at the rim of a hole
    coating_density: Field  #: relative, with a mean of 1
    base_mass: Field  #: relative, with a mean of 1
    #: width of a crack in the resin over the top face; below the bottom one where negative.
    crack_um: Field
    holes: Floats  #: (n, 2), true centres (u, v) at the top face, in um
    #: density of a base of single fibres, and a film below it; None for a slab.
    structure: Structure | None = None

    def covers(self, low: Floats, high: Floats) -> bool:
        """Return True if the fields reach from (u, v) = ``low`` to ``high``, in um."""
        rows, cols = self.faces.shape[1:]
        end = np.add(self.origin, PITCH_UM * np.array([cols - 1, rows - 1]))
        return bool(np.all(low >= self.origin) and np.all(high <= end))

    def at(self, field: Field, u: Floats, v: Floats) -> Floats:
        """Bilinear value of one field at material coordinates.

        The same rule that the renderer uses.
        """
        last_row, last_col = np.subtract(field.shape, 1.000001)
        col = (u - self.origin[0]) / PITCH_UM
        row = (v - self.origin[1]) / PITCH_UM
        row = np.clip(row, 0.0, last_row)
        return bilinear(field, row, np.clip(col, 0.0, last_col))

    @property
    def has_film(self) -> bool:
        """Whether a film lies below it."""
        return self.structure is not None and np.isfinite(self.structure.film_um)

    @cached_property
    def reach_um(self) -> float:
        """Largest distance of a face from the centre surface."""
        crack_um = float(np.abs(self.crack_um).max())
        reach = float(np.abs(self.faces).max()) + crack_um
        if self.structure is None:
            return reach
        return max(reach, self.structure.high_um, -self.structure.low_um)

    @cached_property
    def texture(self) -> Field:
        """Relative density of the base through its depth (LAYERS, rows, cols), bottom to top.

        The net of fibres, and grains of filler, of which the middle has more; each layer has random
        numbers of its own.
        """
        p = self.params
        _, rows, cols = self.faces.shape
        shape = (rows, cols)
        layers = np.empty((LAYERS, *shape), dtype=np.float32)
        for k in range(LAYERS):
            depth = (k + 0.5) / LAYERS
            share_of_filler = 1.2 - 1.6 * (depth - 0.5) ** 2  # more of it in the middle
            filler_sd = _FILLER_CONTRAST * p.filler * share_of_filler
            for_net = generator(self.seed, "net", str(k))
            for_filler = generator(self.seed, "filler", str(k))
            net = p.base_density_sd * fibrous(shape, p.anisotropy, for_net, per_mm2=50.0)
            filler = filler_sd * for_filler.standard_normal(shape)
            layers[k] = np.clip(1 + net + filler, 0.2, 2.5)
        return layers

    @cached_property
    def packed(self) -> Field:
        """All that a renderer needs of a node, side by side.

        The shape is (rows, cols, 9), with LAYERS more for a slab.
        """
        texture = self.texture if self.structure is None else ()
        fields = [*self.faces, *self.rim_um, self.char, self.coating_density, self.crack_um]
        return np.stack([*fields, *texture], axis=-1)


def make_sheet(
    paper: PaperParams,
    holes: BurnParams,
    *,
    low: Floats,
    high: Floats,
    centres: Floats,
    seed: int,
    stiffness: float = 0.0,
    film: FilmParams | None = None,
    crack_um: float = 0.0,
) -> DrawnSheet:
    """Draw one sheet.

    Parameters
    ----------
    paper : PaperParams
    holes : BurnParams
    low, high : (2,), in um; corners (u, v) of the material rectangle that it covers
    centres : (n, 2), in um; of the holes
    seed : int
    stiffness : float
        Of the coatings over the base's; it says where the surface lies that keeps its lengths.
    film : FilmParams, optional; below a base of single fibres
    crack_um : float; spread of the width of cracks between the faces and resin

    Returns
    -------
    DrawnSheet
    """
    cols, rows = (np.ceil((high - low) / PITCH_UM).astype(int) + 2).tolist()
    shape = (rows, cols)
    fibre_mat = None
    if paper.fibres:
        middle_um = _MIDDLE_UM * noise(shape, 400.0, generator(seed, "middle"))
        fibre_mat = FibreMat(paper, shape, PITCH_UM, middle_um, seed)
        upper_height, lower_height = fibre_mat.calendered()
        thickness = upper_height + lower_height
        relief = 0.5 * (upper_height - lower_height)
    else:
        thickness, relief = _base(paper, shape, seed)
    # Grammage of the base follows its thickness; density varies by 3 % beside that.
    mass_noise = 0.03 * noise(shape, 500.0, generator(seed, "mass"))
    mass = thickness / thickness.mean() * (1 + mass_noise)
    mass /= mass.mean()
    faces: list[Floats] = []
    pit_depths: list[Floats | float] = []
    sides = (("top", 1.0, paper.coating_top_um), ("bottom", -1.0, paper.coating_bottom_um))
    for side, sign, mean in sides:
        inner = 0.5 * thickness + sign * relief
        pit_depth = 0.0
        if paper.fibres and mean:
            # Coating colour does not flow into a pore that is narrower than this.
            pit_depth = ndimage.grey_closing(inner, footprint=_DISC) - inner
            inner += pit_depth - pit_depth.mean()  # the paper's base reaches to its coating
        pit_depths.append(pit_depth)
        coating = _coating(paper, inner, mean, side, seed)
        outer = inner + coating
        # A nip presses the outer face flat; the coating keeps its thickness and the base gives way.
        outer = outer.mean() + paper.calendering * (outer - outer.mean())
        faces += [outer, outer - coating]
    top, inner_top, bottom, inner_bottom = faces
    depth_um = float(np.mean(top + bottom))
    rim, char = burn(holes, centres, shape, pair_of(low), depth_um, seed)
    crack = np.zeros(shape)
    if crack_um:
        crack = noise(shape, _CRACK_UM, generator(seed, "cracks"))
    # Open where the noise is beyond one standard deviation, over either face.
    widths = np.maximum(np.abs(crack) - 1.0, 0.0)
    cracks_um = crack_um * np.sign(crack) * widths
    density = noise(shape, 300.0, generator(seed, "grain"))
    from_mass = 0.3 * (mass - mass.mean()) / mass.std()  # r of 0.3 with the base's mass
    density = from_mass + np.sqrt(1 - 0.09) * density
    top_um = float(np.mean(top - inner_top))
    bottom_um = float(np.mean(bottom - inner_bottom))
    base_um = float(np.mean(inner_top + inner_bottom))
    neutral_um = neutral_height(base_um, top_um, bottom_um, stiffness)
    heights = np.stack([top, inner_top, -inner_bottom, -bottom]).astype(np.float32)
    structure = None
    if fibre_mat is not None:
        top_pits, bottom_pits = pit_depths
        structure = fibre_mat.pressed(
            inner_top - top_pits, -(inner_bottom - bottom_pits), neutral_um
        )
        if film is not None:
            structure = structure.on_film(-bottom - neutral_um, film)
    coating_density = 1 + paper.coating_density_sd * density
    return DrawnSheet(
        params=paper,
        seed=seed,
        origin=pair_of(low),
        faces=heights - np.float32(neutral_um),
        rim_um=rim,
        char=char,
        coating_density=coating_density.astype(np.float32),
        base_mass=mass.astype(np.float32),
        crack_um=cracks_um.astype(np.float32),
        holes=centres,
        structure=structure,
    )


def neutral_height(base_um: float, top_um: float, bottom_um: float, stiffness: float) -> float:
    """Height of a bent laminate's unstrained surface over the middle of its base.

    Parameters
    ----------
    base_um, top_um, bottom_um : float; thickness of the base and of the coatings
    stiffness : float; the coatings' modulus over the base's

    Returns
    -------
    float, in um; with a stiffness of 1 the mean of the outer faces

    Notes
    -----
    The layers bend together and no force acts along the sheet: the mean of their middles, weighted
    with thickness times modulus.
    """
    moment = top_um * (base_um + top_um) - bottom_um * (base_um + bottom_um)
    return 0.5 * stiffness * moment / (base_um + stiffness * (top_um + bottom_um))


def _base(p: PaperParams, shape: Shape2D, seed: int) -> TwoFields:
    """Return base thickness, and what bends both faces the same way: single fibres in the net.

    Both (rows, cols) in um. What thickness alone leaves of the roughness of the faces is relief.
    """
    thickness = np.full(shape, p.base_um)
    thickness += p.base_fibre_sd_um * fibrous(shape, p.anisotropy, generator(seed, "fibres"))
    thickness += p.base_floc_sd_um * noise(shape, _FLOC_UM, generator(seed, "flocs"))
    thickness += p.base_streak_sd_um * streaks(shape, _STREAK_UM, generator(seed, "streaks"))
    thickness = np.maximum(thickness, 0.3 * p.base_um)
    variance = p.base_fibre_sd_um**2 + p.base_floc_sd_um**2 + p.base_streak_sd_um**2
    excess_variance = p.roughness_um**2 - 0.25 * variance
    if excess_variance <= 0:
        return thickness, np.zeros(shape)
    # Few fibres lie on top of the others; they stand up and are what a coating leaves bare.
    fibres_of_faces: list[Floats] = []
    for side in ("top", "bottom"):
        rng = generator(seed, "face", side)
        fibres_of_faces.append(fibrous(shape, p.anisotropy, rng, per_mm2=_LOOSE_PER_MM2))
    top, bottom = fibres_of_faces
    relief_sd = float(np.sqrt(0.5 * excess_variance))
    return thickness, relief_sd * (top - bottom)


def _coating(p: PaperParams, inner: Floats, mean_um: float, side: str, seed: int) -> Floats:
    """Thickness of one coating layer over the base's face ``inner``, both outwards, in um.

    It levels: its outer face follows long waves of the base alone. Its own noise and random
    deposition bring its standard deviation to that of the paper.
    """
    rows, cols = inner.shape
    shape = (rows, cols)
    if mean_um == 0:
        return np.zeros(shape)
    coating_change = lowpass(inner, p.levelling_um) - inner
    of_coater = noise(shape, 20.0, generator(seed, "coater", side))
    coating_change += p.coating_noise_sd_um * of_coater
    excess_variance = p.coating_sd_um**2 - float(coating_change.var())
    if excess_variance > 0:
        # Skewed: a spot can lack more than another can carry too much.
        deposit = noise(shape, _DEPOSIT_UM, generator(seed, "deposit", side))
        spots = np.exp(0.6 * deposit)
        coating_change -= np.sqrt(excess_variance) * (spots - spots.mean()) / spots.std()
    coating = np.maximum(mean_um + coating_change, p.least_coating_um)
    if p.fibres is None:
        return coating
    return np.maximum(coating + mean_um - coating.mean(), p.least_coating_um)
