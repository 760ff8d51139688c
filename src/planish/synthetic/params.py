"""Describe what a specimen is made of and how its instruments see it.

Every size has its unit and its reason.

Numbers without another source are those of Hirn et al. (2009) or usual ones of the instruments
named. A field made by :func:`drawn` also holds the range in which real papers and instruments lie.
A nuisance is off when its size is 0; :mod:`planish.synthetic.presets` lists them by name.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar, Literal
from zlib import crc32

import numpy as np

from planish.core.robust import running_sums
from planish.core.typing import Array, Entries, Floats, Pair, TwoFields


def stream(seed: int, *names: str) -> np.random.SeedSequence:
    """Give every name random numbers of its own.

    A nuisance that is switched off does not change the others.
    """
    keys = [crc32(name.encode()) for name in names]
    return np.random.SeedSequence(seed, spawn_key=tuple(keys))


def generator(seed: int, *names: str) -> np.random.Generator:
    """Return the generator of a :func:`stream`."""
    return np.random.default_rng(stream(seed, *names))


def spawned(seed: np.random.SeedSequence, count: int) -> list[np.random.Generator]:
    """Return generators of the first seeds that a stream spawns.

    ``seed.spawn`` would count in the caller's object and give others next time.
    """
    rngs: list[np.random.Generator] = []
    for k in range(count):
        child = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k))
        rngs.append(np.random.default_rng(child))
    return rngs


class Strict:
    """A table in a scenario file with a key that is no field is refused."""

    __slots__ = ()
    __pydantic_config__: ClassVar = {"extra": "forbid"}


def drawn(default: Any, low: float = 0.0, high: float = 0.0, *, of: tuple[Any, ...] = ()) -> Any:
    """Make a dataclass field with a range.

    A value is drawn evenly between two numbers (whole ones where both are), or is one ``of``.
    """
    metadata = {"range": of or (low, high), "choice": bool(of)}
    return field(default=default, metadata=metadata)


def draw_params(params: Any) -> Any:
    """Draw every field with a range by the seed of ``params``; all others stay."""
    return _draw(params, generator(params.seed, "draws"))


def _draw(params: Any, rng: np.random.Generator) -> Any:
    """Draw the fields of a dataclass with a range, and those of the dataclasses in it."""
    changes: Entries = {}
    for parameter in fields(params):
        name = parameter.name
        metadata = parameter.metadata
        section = getattr(params, name)
        if is_dataclass(section):
            changes[name] = _draw(section, rng)
        elif "range" in metadata:
            limits = metadata["range"]
            if metadata["choice"]:
                index = int(rng.integers(len(limits)))
                changes[name] = limits[index]
            elif all(isinstance(limit, int) for limit in limits):
                changes[name] = int(rng.integers(limits[0], limits[1] + 1))
            else:
                changes[name] = float(rng.uniform(*limits))
    return replace(params, **changes)


_STEP_UM = 2.0
_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Warp(Strict):
    """Centre surface ``m(u, v)`` of a bent sheet.

    The sheet is rolled along the direction ``ruling_deg`` from the u axis: its profile curve turns
    by ``psi(p) = tilt + atan(slope) sin(2 pi p / wavelength + phase)`` at arc length ``p``, so that
    lengths in the sheet are exactly those in ``(u, v)``. A curl at a border adds ``curl (1 +
    tanh((p - curl_p) / (2 curl_width))) / 2`` to the angle. The bump is added in height and
    stretches the sheet.
    """

    #: steepest of the profile against its mean plane (tangent of the angle).
    slope: float = drawn(0.5, 0.0, 0.42)
    tilt_deg: float = drawn(0.0, -7.0, 7.0)  #: of the whole sheet along the profile
    wavelength_um: float = drawn(3000.0, 2500.0, 15000.0)  #: of the profile curve
    phase_rad: float = drawn(0.6, 0.0, 6.28)  #: of the profile curve
    #: of the profile curve; the rulings stand perpendicular to it.
    ruling_deg: float = drawn(20.0, -90.0, 90.0)
    bump_um: float = drawn(0.0, of=(0.0, 0.0, 50.0, 100.0, 150.0))  #: height of the bump
    bump_u_um: float = 0.0  #: centre of the bump
    bump_v_um: float = 0.0  #: centre of the bump
    bump_radius_um: float = drawn(800.0, 1500.0, 3000.0)  #: Gaussian radius of the bump
    curl_deg: float = 0.0  #: angle by which the sheet turns at a border
    curl_p_um: float = 0.0  #: where on the profile it turns
    curl_width_um: float = 50.0  #: how softly it turns
    shift_um: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: added to (x, y, z)
    reach_um: float = 8000.0  #: largest ``|u|`` and ``|v|`` that are asked for

    def packed(self) -> TwoFields:
        """Return the parameters and the profile curve as the kernels take them."""
        return _packed(self)

    @property
    def steepest(self) -> float:
        """Steepest slope of the profile, with tilt and curl."""
        turn = np.deg2rad(abs(self.tilt_deg) + abs(self.curl_deg))
        return float(np.tan(turn + np.arctan(abs(self.slope))))

    def points(self, u: Floats, v: Floats) -> Floats:
        """Return ``m(u, v)`` as (..., 3) in the order x, y, z, in um."""
        return self._frames(u, v)[0]

    def normals(self, u: Floats, v: Floats) -> Floats:
        """Return unit normals (..., 3), pointing to the top side (+z)."""
        return self._frames(u, v)[1]

    def material(self, points: Floats) -> Floats:
        """Return ``(u, v, s)`` of points ``(..., 3)`` given as x, y, z.

        This is the exact inverse of ``m + s n``.
        """
        from planish.synthetic import _kernels

        flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        return _kernels.materials(*self.packed(), flat).reshape(points.shape)

    def columns(self, y_um: Floats, x_um: Floats) -> Floats:
        """Return ``(u, v, z)`` of the centre surface at the columns (y, x).

        The shape is (len(y), len(x), 3).
        """
        from planish.synthetic import _kernels

        y_um = np.asarray(y_um, float)
        x_um = np.asarray(x_um, float)
        return _kernels.columns(*self.packed(), y_um, x_um)

    def _frames(self, u: Floats, v: Floats) -> TwoFields:
        from planish.synthetic import _kernels

        uv = np.stack(np.broadcast_arrays(u, v)).astype(float)
        shape = (*uv.shape[1:], 3)
        points, normals = _kernels.frames(*self.packed(), *uv.reshape(2, -1))
        return points.reshape(shape), normals.reshape(shape)


@lru_cache(maxsize=8)
def _packed(warp: Warp) -> TwoFields:
    """Numbers of a warp as the kernels take them, and places and directions (steps, 4) of it.

    What each number is stands at the top of ``_kernels``. Along the profile curve, by arc length p
    from ``-1.5 reach_um`` to ``1.5 reach_um`` in steps of 2 um, the second array has (X, Z) and
    their derivatives. The curve is the integral of its direction, whose angle is psi(p), from the
    middle on.
    """
    angle = np.deg2rad(warp.ruling_deg)
    psi = np.arctan(warp.slope)
    k = 2 * np.pi / warp.wavelength_um
    tilt = np.deg2rad(warp.tilt_deg)
    curl = np.deg2rad(warp.curl_deg)

    def turn_at(p: Array) -> Floats:
        """Angle of the profile's direction at arc length p, in rad."""
        past_curl = (p - warp.curl_p_um) / (2 * warp.curl_width_um)
        curled = 0.5 * (1 + np.tanh(past_curl))
        wave = psi * np.sin(k * p + warp.phase_rad)
        return tilt + wave + curl * curled

    n_steps = int(np.ceil(2 * 1.5 * warp.reach_um / _STEP_UM))
    count = n_steps + 1
    middle = count // 2
    p0 = -middle * _STEP_UM
    # Gauss-Legendre on every step: exact to rounding, because psi is smooth over a step.
    nodes = 0.5 * (1 + _GAUSS_X)
    p = p0 + _STEP_UM * (np.arange(n_steps)[:, None] + nodes)
    turn = turn_at(p)
    mean_directions = np.stack([np.cos(turn) @ _GAUSS_W, np.sin(turn) @ _GAUSS_W])
    steps = 0.5 * _STEP_UM * mean_directions
    places = running_sums(steps).T
    places = places - places[middle]  # the middle is the origin
    turn = turn_at(p0 + _STEP_UM * np.arange(count))
    curve = np.column_stack([places, np.cos(turn), np.sin(turn)])
    parameters = [np.cos(angle), np.sin(angle), psi, k, warp.phase_rad, p0, _STEP_UM]
    parameters += [*warp.shift_um]
    parameters += [warp.bump_um, warp.bump_u_um, warp.bump_v_um, warp.bump_radius_um, tilt]
    parameters += [curl, warp.curl_p_um, warp.curl_width_um]
    return np.array(parameters, dtype=np.float64), curve


SIZES_UM = {
    "T0": (800.0, 600.0),  # a test, seconds
    "T1": (3000.0, 2000.0),  # a first look, a minute
    "T2": (8000.0, 6000.0),  # acceptance: the paper's larger fields
    "T3": (20000.0, 15000.0),  # a whole specimen: surfaces only, no voxels
}
"""Sizes of specimens by name: length and width in um."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FibreParams(Strict):
    """Fibres of a base; ranges are drawn from evenly.

    Sizes are those of pulps for papers of 50 to 135 g/m2.
    """

    g_per_m2: float = 30.0  # of fibres alone
    width_um: Pair = (15.0, 40.0)
    length_um: Pair = (1000.0, 3000.0)
    wall_um: Pair = (1.2, 3.0)
    lumen_um: Pair = (0.0, 3.0)  # to 10 in bulky sheets
    fines: float = 0.75  # share by number
    flexibility: Pair = (0.12, 0.2)  # steepest slope of a fibre over those below it
    fuzz_per_mm2: float = 0.0  # fibres that stand up, on each side; 6 to 10 without coating
    fuzz_um: Pair = (8.0, 40.0)  # how high their ends stand
    void_floor: float = 0.02  # share of a void that the press leaves
    cell_um: float = 1.0  # height of a cell of the structure


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperParams(Strict):
    """The sheet itself, in its flat state; lengths in um, ``_sd`` are standard deviations.

    A correlation length is the distance at which the autocorrelation has fallen to 1/e.
    """

    base_um: float = drawn(55.0, 50.0, 60.0)  # mean thickness of the base paper
    # Thickness at fibre scale, correlation length 35 um.
    base_fibre_sd_um: float = drawn(3.0, 2.0, 4.0)
    base_floc_sd_um: float = drawn(2.5, 1.5, 3.5)  # thickness of flocs, 1.5 mm: formation
    # Along the machine direction; 1 um where the headbox streaks.
    base_streak_sd_um: float = drawn(0.0, 0.0, 1.0)
    # Sq of each face of the base; outward heights correlate by about -0.3.
    roughness_um: float = drawn(3.5, 2.5, 4.5)
    # Fibres along the machine direction (u) over those across.
    anisotropy: float = drawn(1.5, 1.3, 1.8)
    # 135 g/m2 wood-free coated paper before calendering, section 3.3.1.
    coating_top_um: float = drawn(17.4, 9.0, 20.0)
    coating_bottom_um: float = drawn(17.4, 9.0, 20.0)
    # Of the layer: levelling, and random deposition at 100 um.
    coating_sd_um: float = drawn(4.5, 3.0, 5.0)
    coating_noise_sd_um: float = 0.5  # of the outer face, correlation length 20 um
    # Wavelength that the coating's outer face follows by half.
    levelling_um: float = drawn(250.0, 150.0, 350.0)
    # Factor on the outer face's roughness that is left; 0.5 in a nip.
    calendering: float = drawn(1.0, 0.5, 1.0)
    coating_g_per_cm3: float = 1.6  # GCC with 12 pph latex and 30 % voids
    # Relative, 300 um, correlated 0.3 with the base's mass.
    coating_density_sd: float = drawn(0.04, 0.0, 0.06)
    base_g_per_cm3: float = 0.75
    # Of the base's grey, relative: fibres and voids (0.25 +- 0.05).
    base_density_sd: float = drawn(0.20, 0.1, 0.25)
    # Share of the base's mass: grains of 2 um, denser in the middle.
    filler: float = drawn(0.12, 0.05, 0.15)
    # The base as single fibres; where None, a slab with a soft texture.
    fibres: FibreParams | None = None
    least_coating_um: float = 0.0  # left on the highest fibres; 0.3 to 1

    def as_slab(self) -> PaperParams:
        """Return the same paper with a soft texture in place of single fibres.

        Every face is exact, and nothing is void.
        """
        return replace(self, fibres=None, least_coating_um=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmParams(Strict):
    """A film, or a tape, under a sheet of fibres; it bends with the sheet and has no holes."""

    film_um: float = drawn(30.0, 15.0, 60.0)  # thickness
    gap_um: float = drawn(25.0, 10.0, 60.0)  # air between the sheet's lowest point and the film
    grey: float = drawn(0.7, 0.5, 1.0)  # over that of a fibre's wall
    is_tape: bool = False  # touches: its adhesive fills the valleys of the bottom face
    share: float = 1.0  # of the sheet's length that it lies under


@dataclass(frozen=True, slots=True, kw_only=True)
class BurnParams(Strict):
    """The laser's holes, section 2.1."""

    # Lines with coded pitches around the field, or scattered.
    pattern: Literal["coded", "irregular"] = "coded"
    count: int = 21  # 3 lines of 7; fewer where the field is small
    diameter_um: float = drawn(175.0, 150.0, 200.0)  # 150 to 200 by the laser
    diameter_sd_um: float = 8.0
    stage_um: float = drawn(4.0, 0.0, 8.0)  # rms error of the laser's stage, per axis
    axis_ratio: float = drawn(1.12, 1.0, 1.12)  # largest, drawn between 1 and this
    rim_um: float = drawn(4.0, 2.0, 5.0)  # roughness of the rim, correlation length 30 um
    taper: float = drawn(0.15, 0.05, 0.2)  # loss of diameter from the top to the bottom face
    tilt_deg: float = drawn(3.0, 0.0, 3.0)  # largest tilt of the beam
    char_um: float = drawn(40.0, 20.0, 50.0)  # burnt rim
    char_sd_um: float = 10.0
    half_closed: float = drawn(0.05, 0.0, 0.1)  # share of holes whose lower end is half filled


@dataclass(frozen=True, slots=True, kw_only=True)
class ScannerParams(Strict):
    """X-ray micro-CT; shares are of the contrast between coating and air."""

    voxel_um: float = drawn(3.0, 2.4, 3.2)
    # Of the point spread; 3 to 5 on a good scan with 1.37 um voxels.
    fwhm_um: float = drawn(5.9, 3.0, 5.0)
    # Air, base (of fibres: their wall), coating; of dtype.
    grey: tuple[float, float, float] = (40.0, 90.0, 200.0)
    dtype: Literal["uint8", "uint16", "float32"] = "uint8"
    noise: float = drawn(0.04, 0.03, 0.1)  # 0.08 with 1.37 um voxels
    # Correlation length of the noise in voxels; reconstructions have about 2.
    noise_px: float = drawn(0.0, 0.0, 2.0)
    # Phase contrast: minus this times the Laplacian of a Gaussian of 1.5 voxels.
    fringe: float = drawn(0.0, 0.0, 0.12)
    cupping: float = drawn(0.0, 0.0, 0.05)  # beam hardening: loss in the middle of the field, 0.04
    rings: int = drawn(0, 0, 3)  # 0 to 3
    ring: float = 0.03  # size of a ring
    streak: float = drawn(0.0, 0.0, 0.03)  # along the plane of the sheet, 0.03
    # Sd of a factor on each slice across y: photographs of sections, stacked; 0.03.
    section_gain: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SectionsParams(Strict):
    """Serial sections under a light microscope.

    Shares are of the contrast between coating and resin.
    """

    pixel_um: float = drawn(0.81, 2.0, 3.0)
    section_um: float = drawn(3.0, 2.5, 4.0)  # 9 to go faster
    grey: tuple[float, float, float] = (215.0, 150.0, 60.0)  # resin, base, coating
    colour: bool = False  # red, green and blue, or a monochrome camera
    jitter_um: float = drawn(1.5, 0.5, 2.0)  # of each section, along x and z, white
    walk_um: float = drawn(0.15, 0.0, 0.2)  # random walk a section
    rotation_deg: float = drawn(0.02, 0.0, 0.03)
    # Error of a section's position, as a share of its thickness.
    thickness: float = drawn(0.08, 0.0, 0.1)
    missing: float = drawn(0.01, 0.0, 0.02)  # share of sections lost, in runs of at most 3
    drift: float = drawn(0.03, 0.0, 0.04)  # gain of a section, and of each colour
    defocus_um: float = drawn(0.8, 0.3, 1.2)  # Gaussian sigma
    knife: float = drawn(0.02, 0.0, 0.03)  # marks of the knife
    noise: float = drawn(0.02, 0.01, 0.04)
    texture: float = 0.01  # of the resin


@dataclass(frozen=True, slots=True, kw_only=True)
class PrintParams(Strict):
    """An offset print, section 3.3.2."""

    tone: float = 0.4  # area of the dots
    screen_per_cm: float = 60.0
    angle_deg: float = 45.0
    ink: float = 0.08  # reflectance of a dot
    gain_per_um: float = 0.01  # tone by which a coating one um thicker than the mean prints lighter
    gain_sd: float = 0.02  # tone, random, correlation length 300 um

    @property
    def pitch_um(self) -> float:
        """Distance of the dots along the screen's axes."""
        return 1e4 / self.screen_per_cm


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraParams(Strict):
    """A microscope image of the top side in diffuse light."""

    pixel_um: float = drawn(4.0, 2.6, 8.0)  # 2.6 at 2.5x
    # Of the specimen under the camera; +- turn_range_deg.
    turn_deg: float = drawn(0.0, -180.0, 180.0)
    turn_range_deg: float = 8.0
    # Drawn; the frame follows as far as it must to show most of the field.
    shift_range_um: float = 1000.0
    scale_range: float = drawn(0.01, 0.0, 0.01)  # error of the pixel size, drawn within +-
    mirrored: bool = False
    # K1: relative displacement at half the frame's diagonal.
    radial: float = drawn(0.001, -0.001, 0.001)
    stretch: float = drawn(0.002, 0.0, 0.002)  # machine against cross direction, drawn within +-
    backing: Literal["pile", "black"] = drawn("pile", of=("pile", "black"))  # behind the sheet
    # Reflectance not due to the coating, correlation length 200 um.
    nuisance_sd: float = drawn(0.012, 0.004, 0.015)
    # Instead: as much of it as brings r2 of the true maps at 100 um to this.
    oracle_r2: float | None = None
    shading: float = drawn(0.02, 0.0, 0.02)  # of the light, per 0.1 of slope of the surface
    vignetting: float = drawn(0.04, 0.0, 0.06)  # loss in the corners
    lens_um: float = drawn(3.0, 2.0, 4.0)  # Gaussian sigma
    noise: float = drawn(0.005, 0.003, 0.008)
    bits: int = 12
    screen: PrintParams | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatbedParams(Strict):
    """A scan of the top side by an office scanner.

    Lambert's law on paper: Hansson and Johansson (Opt. Eng. 39, 2555, 2000); light that spreads in
    it: Coppel et al. (Opt. Express 19, 25181, 2011). Optics: Simcoe (ASP Conf. Ser. 410, 111,
    2009), 600 to 1200 dpi whatever is stated. Carriage: Boron (IAPRS 31 B1, 1996), 7 um rms along
    the scan, 3 um when each line is corrected; Vicente et al. (A&A 471, 1077, 2007), 3 um.
    """

    dpi: float = drawn(1200.0, of=(1200.0, 2400.0))  # pixels an inch, each the mean of its area
    # Of the light, per 0.1 of slope along the scan; 0.1 where all light comes at 45 degrees.
    shading: float = drawn(0.03, 0.0, 0.1)
    # Gaussian sigma of the way of light in the paper: half of the contrast is left at waves of 0.15
    # to 0.35 mm.
    spread_um: float = drawn(45.0, 28.0, 65.0)
    # Gaussian sigma: a tenth of the contrast is left at 21 to 43 pairs of lines a mm.
    lens_um: float = drawn(12.0, 8.0, 16.0)
    colour: bool = drawn(True, of=(True, False))
    colour_shift_px: float = drawn(0.2, 0.0, 0.5)  # of the lines of red and blue against green
    gamma: float | Literal["srgb"] = drawn("srgb", of=("srgb", 1.0, 1.8, 2.2))
    noise: float = drawn(1.0, 0.5, 2.0)  # grey values of 255, before sharpening
    sharpen: float = drawn(0.0, 0.0, 1.0)  # what an unsharp mask of 1 pixel takes off, put on
    bits: int = drawn(8, of=(8, 16))
    quality: int | None = drawn(None, of=(None, 75, 85, 95))  # of JPEG, of 8 bits
    # Error of the pixel size along the scan and across, each drawn within +-; 0.6 % were seen.
    scale_range: float = drawn(0.003, 0.0, 0.006)
    # The carriage: slow error, sd, correlation length 5 mm; amplitude and period of a gear or a
    # screw; error of each line, white, sd.
    wander_um: float = drawn(4.0, 0.0, 7.0)
    ripple_um: float = drawn(1.0, 0.0, 3.0)
    ripple_period_um: float = drawn(1000.0, 300.0, 5000.0)
    jitter_um: float = drawn(0.5, 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class SpecimenParams(Strict):
    """One specimen, ``size_um`` (x, y) wide.

    The same seed is the same sheet under every instrument.
    """

    size_um: Pair = SIZES_UM["T1"]
    paper: PaperParams = field(default_factory=PaperParams)
    holes: BurnParams = field(default_factory=BurnParams)
    film: FilmParams | None = None
    # Sd of the width of cracks between faces and resin, on some third of the faces.
    crack_um: float = 0.0
    warp: Warp = field(default_factory=Warp)
    scanner: ScannerParams = field(default_factory=ScannerParams)
    sections: SectionsParams = field(default_factory=SectionsParams)
    camera: CameraParams = field(default_factory=CameraParams)
    seed: int = 0
    stiffness: float = drawn(
        0.0, 0.0, 3.0
    )  # modulus of the coatings over the base's: says what a bend leaves unstrained
    flatbed: FlatbedParams = field(default_factory=FlatbedParams)
