"""Structure of the base in the plane of the sheet.

Fibre orientation (P-13) and the size of the pores (P-10).

Orientation comes from the structure tensor of the straightened volume: gradients in the tangent
plane are gathered and turned into its own frame by the root of the metric; a fibre lies along the
direction in which the grey changes least. Pores are voids
(:func:`~planish.measure.phases.void_level`) inside the base: chords in the plane of the sheet, and
the largest spheres that fit. What is smaller than two voxels is not seen. Neither size has a
standard error: it depends on which voids were resolved, and a distribution of pores needs 20 mm2 to
be stable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planish.core.axial import axial_angle
from planish.core.options import Params, option
from planish.core.typing import Codes, Floats, Singles, ThreeFields, TwoFields
from planish.measure import phases
from planish.measure.greys import FWHM
from planish.measure.phases import LEVELS, void_level
from planish.measure.registry import Property, cached, ray_property

if TYPE_CHECKING:
    from planish.measure.rays import Rays


_CUT = 3.0  # standard deviations of a Gaussian
_PARTS = ("fibre_cos2", "fibre_sin2")  # an angle has no mean; its two parts do


class Options(Params):
    """Options of the fibre orientation and of the pores' sizes."""

    orientation_sigma_um: float | None = option(
        None,
        gt=0,
        cli=None,
        help="Scale of the gradients of the fibre orientation; one voxel where not given.",
    )
    orientation_rho_um: float = option(
        40.0,
        gt=0,
        cli=None,
        help="Scale over which fibre directions are gathered: one or two fibre widths.",
    )
    pore_limit_um: float = option(
        40.0, gt=0, cli=None, help="Size above which pores are not distinguished."
    )


def _halo(params: Options) -> float:
    # The gradient's own reach is a few voxels, whose size is not known here.
    sigma = params.orientation_sigma_um or 10.0
    return _CUT * (params.orientation_rho_um + sigma) + 20.0


def _width(params: Options) -> float:
    return FWHM * params.orientation_rho_um


_fibre_property = partial(ray_property, halo_um=_halo, support_um=_width)


@cached
def _gradients(rays: Rays) -> tuple[Singles, Singles, slice]:
    """Give the gradient of the samples (slice) that some base reaches.

    Along rows and columns, (rows, cols, samples) each, in grey per um of projection. Derivatives of
    a Gaussian in the plane; a missing voxel counts as base.
    """
    from scipy import ndimage

    samples = rays.samples_within(*rays.core)
    grey = rays.grey[..., samples]
    grey = np.where(np.isfinite(grey), grey, np.float32(rays.greys.base))
    gaussians: list[Floats] = []
    derivatives: list[Floats] = []
    sigma_um = rays.params.of(Options).orientation_sigma_um
    for pitch in rays.pitch_um:
        sigma = max((sigma_um or pitch) / pitch, 0.5)  # in columns
        reach = int(np.ceil(_CUT * sigma))
        x = np.arange(-reach, reach + 1)
        gaussian = np.exp(-0.5 * (x / sigma) ** 2)
        gaussians.append(gaussian / gaussian.sum())
        # So scaled, it gives the slope of a ramp.
        derivatives.append(x * gaussian / np.sum(x * x * gaussian) / pitch)

    def along(axis: int) -> Singles:
        smoothed = ndimage.correlate1d(grey, gaussians[1 - axis], 1 - axis, mode="nearest")
        return ndimage.correlate1d(smoothed, derivatives[axis], axis, mode="nearest")

    return along(0), along(1), samples


@cached
def _tensor(rays: Rays, lowest: float, highest: float) -> ThreeFields:
    """Give trace, cosine part and sine part (rows, cols) of the gathered tensor.

    It is gathered between two relative depths of the base, 0 at its bottom and 1 at its top.
    """
    # With the gradient g in the tangent plane: sums of gx^2 + gy^2, gx^2 - gy^2 and 2 gx gy over
    # the layer, outside voids and the base's edges, then averaged over orientation_rho_um.
    from scipy import ndimage

    by_row, by_col, samples = _gradients(rays)
    bottom = rays.interface_bottom
    base_um = rays.interface_top - bottom
    lower, upper = rays.core
    level = void_level(rays.greys, rays.params.of(phases.Options))
    first_um = np.maximum(lower, bottom + lowest * base_um)
    end_um = np.minimum(upper, bottom + highest * base_um)
    s_um = rays.s_um[samples]
    is_inside = (s_um >= first_um[..., None]) & (s_um < end_um[..., None])
    is_inside &= rays.greys.polarity * (rays.grey[..., samples] - level) > 0
    factors = ((by_col, by_col), (by_row, by_row), (by_row, by_col))
    over_ray = partial(np.einsum, "ijk,ijk,ijk->ij", dtype=np.float64)
    sums = [over_ray(a, b, is_inside) for a, b in factors]
    xx, yy, xy = _in_tangent_plane(sums, rays.slope)
    is_valid = (rays.status == 0) & np.isfinite(xx)
    sigma = np.divide(rays.params.of(Options).orientation_rho_um, rays.pitch_um)
    gather = partial(ndimage.gaussian_filter, sigma=sigma, mode="constant", truncate=_CUT)
    trace = gather(np.where(is_valid, xx + yy, 0.0))
    cosine = gather(np.where(is_valid, xx - yy, 0.0))
    sine = gather(np.where(is_valid, 2 * xy, 0.0))
    return trace, cosine, sine


def _in_tangent_plane(tensor: Sequence[Floats], slope: Floats) -> ThreeFields:
    """Turn a tensor of derivatives along columns (x) and rows (y) into the tangent plane.

    The result is G^(-1/2) J G^(-1/2): its parts xx, yy and xy (rows, cols), as they are given.
    ``slope`` (rows, cols, 2): of the centre surface along rows and columns.
    """
    # G = I + grad z grad z^T is the metric of the centre surface. With a unit vector e up the
    # slope, G^(-1/2) = I - (1 - cos a) e e^T, a the tilt.
    xx, yy, xy = tensor
    q, p = np.moveaxis(slope, -1, 0)
    squared_slope = p * p + q * q
    # (1 - cos a) over the squared slope, which is a half where there is none.
    with np.errstate(divide="ignore", invalid="ignore"):
        shrinkage = (1 - 1 / np.sqrt(1 + squared_slope)) / squared_slope
    shrinkage[squared_slope == 0] = 0.5
    a, b, d = 1 - shrinkage * p * p, -shrinkage * p * q, 1 - shrinkage * q * q
    turned_xx = a * a * xx + 2 * a * b * xy + b * b * yy
    turned_yy = b * b * xx + 2 * b * d * xy + d * d * yy
    turned_xy = a * b * xx + (a * d + b * b) * xy + b * d * yy
    return turned_xx, turned_yy, turned_xy


def _components(rays: Rays, lowest: float = 0.0, highest: float = 1.0) -> TwoFields:
    """Give anisotropy times cosine and sine of the double angle."""
    trace, cosine, sine = _tensor(rays, lowest, highest)
    turn = -1.0 if rays.mirrored else 1.0
    trace = np.where(trace > 0, trace, np.nan)
    # The fibre stands across the gradient: its double angle is the other one's plus half a turn.
    return -cosine / trace, -turn * sine / trace


@_fibre_property(
    "fibre_cos2",
    units="1",
    long_name="Fibre direction, cosine part",
    has_true_zero=False,
)
def fibre_cos2(rays: Rays) -> Floats:
    """Anisotropy times cos(2 angle): may be averaged and interpolated, which an angle may not."""
    return _components(rays)[0]


@_fibre_property(
    "fibre_sin2",
    units="1",
    long_name="Fibre direction, sine part",
    has_true_zero=False,
)
def fibre_sin2(rays: Rays) -> Floats:
    """Anisotropy times sin(2 angle)."""
    return _components(rays)[1]


@_fibre_property(
    "fibre_angle",
    units="deg",
    long_name="Fibre angle",
    together=_PARTS,
    attrs={"period_deg": 180.0},
    has_true_zero=False,
)
def fibre_angle(rays: Rays, **depth: float) -> Floats:
    """P-13: mean axis of the fibres, -90 to 90 degrees from the map's u axis towards its v axis.

    Axial statistics: of doubled angles, each gradient with its square. No standard error: the
    directions of one neighbourhood are those of few fibres. Means and spreads are those of the axis
    wherever planish makes them; for r take ``fibre_cos2`` and ``fibre_sin2``.
    """
    return axial_angle(*_components(rays, **depth))


@_fibre_property("fibre_anisotropy", units="1", long_name="Fibre anisotropy")
def fibre_anisotropy(rays: Rays, **depth: float) -> Floats:
    """P-13: 0 where no direction of the fibres prevails, 1 where all are one.

    (l1 - l2) / (l1 + l2) of the tensor's eigenvalues. Noise adds to both and makes it smaller.
    """
    return np.hypot(*_components(rays, **depth))


def orientation_layers(count: int) -> tuple[Property, ...]:
    """Make orientation properties for each of ``count`` layers of equal share of the base.

    The layers go from the bottom of the base to its top.

    Returns
    -------
    tuple of Property
        ``fibre_angle_layer_k`` and ``fibre_anisotropy_layer_k``, k = 1 to count; to be given to
        :func:`~planish.measure.measure_along_rays` among its names.
    """
    properties: list[Property] = []
    for k in range(count):
        depth_range = {"lowest": k / count, "highest": (k + 1) / count}
        for prop in (fibre_angle, fibre_anisotropy):
            layer_property = replace(
                prop,
                name=f"{prop.name}_layer_{k + 1}",
                long_name=f"{prop.long_name}, layer {k + 1} of {count}",
                function=partial(prop.function, **depth_range),
                together=(),
            )
            properties.append(layer_property)
    return tuple(properties)


@cached
def _voids(rays: Rays) -> tuple[Codes, Floats]:
    """Samples that are void (rows, cols, s), and how many there are on each ray; NaN for none."""
    # Beyond what any base reaches there is no void; one sample more on either side is the wall
    # there.
    samples = rays.samples_within(*rays.core, more=1)
    level = void_level(rays.greys, rays.params.of(phases.Options))
    rise = rays.grey[..., samples] - np.float32(level)
    above_void_level = rays.greys.polarity * rise
    is_void = (above_void_level < 0) & rays.between(*rays.core)[..., samples]
    count = is_void.sum(axis=-1, dtype=np.float64)
    return is_void.astype(np.uint8), np.where(count > 0, count, np.nan)


def _limit(params: Options) -> float:
    return params.pore_limit_um


def chords(void: Codes, axis: int, most: int) -> NDArray[np.int64]:
    """Sum over each ray's void samples of the run of void along an axis, in steps.

    A run counts ``most`` steps to each side.
    """
    total = np.zeros(void.shape, np.int16)
    for direction in (slice(None), slice(None, None, -1)):
        void_lines, sums = (np.moveaxis(a, axis, 0)[direction] for a in (void, total))
        run = np.zeros(void_lines.shape[1:], np.int16)
        for line, run_sum in zip(void_lines, sums, strict=True):
            run = np.minimum(run + 1, most) * line
            run_sum += run
    return (total - (void > 0)).sum(axis=-1)


@ray_property(
    "pore_chord",
    units="um",
    long_name="Pore chord in the plane",
    halo_um=_limit,
    support_um=_limit,
    stated=LEVELS,
)
def pore_chord(rays: Rays) -> Floats:
    """Mean in-plane length of the voids on the ray.

    The mean of the runs through each void sample, along rows and columns.

    Lengths are those in the centre surface. A run counts ``pore_limit_um`` to each side and no
    further. Longer runs hold more samples and count so much more often. NaN where the ray meets no
    void.
    """
    void, count = _voids(rays)
    total_um = np.zeros(count.shape)
    limit_um = rays.params.of(Options).pore_limit_um
    for axis, pitch in enumerate(rays.pitch_um):
        chord_steps = chords(void, axis, max(int(limit_um / pitch), 1))
        total_um += 0.5 * chord_steps * pitch * rays.stretch[..., axis]
    return total_um / count


def distances(void: Codes, step: tuple[float, float, float], most: float) -> Singles:
    """Distance of each void sample to the nearest solid one, no more than ``most``.

    Um, 0 in the solid.
    """
    from scipy import ndimage

    if void.all():
        return np.full(void.shape, most, np.float32)
    distance = ndimage.distance_transform_edt(void, sampling=step)
    return np.minimum(distance, most).astype(np.float32)


@ray_property(
    "pore_diameter",
    units="um",
    long_name="Pore diameter",
    support_um=_limit,
    halo_um=lambda params: 1.5 * params.pore_limit_um,
    stated=LEVELS,
)
def pore_diameter(rays: Rays) -> Floats:
    """Diameter of the largest sphere inside the voids, at most ``pore_limit_um``.

    The mean over the void on the ray.

    Each void sample takes the largest sphere that holds it. The distance to the nearest solid
    sample is half a sample too long; a mean half step is taken off. Distances along slopes are
    stretched by the sheet's mean slope. NaN where the ray meets no void.
    """
    from planish.measure import _pore_kernels

    void, count = _voids(rays)
    row_um, col_um = np.multiply(rays.pitch_um, rays.mean_stretch).tolist()
    step = (row_um, col_um, rays.step_um)
    half_step_um = 0.5 * float(np.mean(step))
    limit_um = rays.params.of(Options).pore_limit_um
    distance = distances(void, step, 0.5 * limit_um + half_step_um)
    radius = _pore_kernels.inscribed(distance, step)
    true_radius = np.maximum(radius - half_step_um, 0.5 * half_step_um)
    diameter_um = np.where(void > 0, 2 * true_radius, 0.0)
    return diameter_um.sum(axis=-1, dtype=np.float64) / count
