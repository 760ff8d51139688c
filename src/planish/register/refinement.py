"""Registration refined by the maps themselves, on top of a fit to marks.

It is optional, and bounded by what the marks allow.
"""

import importlib
import math
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from planish.core.area import area_mean
from planish.core.errors import CannotRegister, SizeError
from planish.core.grid import Grid
from planish.core.transform import Affine, are_known, grid_points
from planish.core.typing import Bools, Floats, Pair, Texts, pair_of
from planish.register.bent import NOTABLE, determinants, range_of
from planish.register.result import FittedTransform

Refinement = Literal["affine", "bspline"]
Metric = Literal["correlation", "mutual information"]
_STEPS = 100
_THREADS_CHANGED = Lock()  # the library has one number of threads for all of its searches


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreeForm:
    """A map ``p -> p + sum of coefficients x cubic B-splines`` of ``(x, y)`` in um.

    As its border outside the mesh.
    """

    # (2, rows + 3, cols + 3), in um: displacements along x and y at the nodes of a mesh of ``rows x
    # cols`` cells and of one more on every side.
    coefficients_um: Floats
    origin_um: Pair  # ``(x, y)`` of the first coefficient
    mesh_um: Pair  # side of a cell along x and y

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points ``(..., 2)``, in um; NaN stays NaN."""
        points_um = np.asarray(points, dtype=np.float64)
        clamped, _ = self._clamped(points_um)
        moved_um = points_um + self._values(clamped, (0, 0))
        moved_um[~are_known(points_um)] = np.nan
        return moved_um

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)``.

        The shape is ``(..., 2, 2)``: a row for x and y of the image.
        """
        points_um = np.asarray(points, dtype=np.float64)
        clamped, is_inside = self._clamped(points_um)
        along_x = self._values(clamped, (0, 1))
        along_y = self._values(clamped, (1, 0))
        slopes = np.stack([along_x, along_y], axis=-1)
        out = slopes * is_inside[..., None, :] + np.eye(2)
        out[~are_known(points_um)] = np.nan
        return out

    def _clamped(self, points: Floats) -> tuple[Floats, Bools]:
        """Nearest points of the mesh, and whether they are the points themselves, along x and y."""
        _, rows, cols = self.coefficients_um.shape
        # The mesh begins at the second coefficient and ends at the last but one.
        low = np.array(self.origin_um) + self.mesh_um
        high = low + np.multiply((cols - 3, rows - 3), self.mesh_um)
        finite_points = np.nan_to_num(points)
        clamped = np.clip(finite_points, low, high)
        return clamped, np.equal(clamped, finite_points)

    def _values(self, points: Floats, nu: tuple[int, int]) -> Floats:
        """Displacement (..., 2) at points of the mesh, or its derivatives.

        The derivatives are of the orders ``nu`` along y and x.
        """
        from scipy.interpolate import NdBSpline

        _, *counts = self.coefficients_um.shape
        # The knots reach two nodes beyond the coefficients on either side.
        knots: list[Floats] = []
        for n, first, mesh in zip(counts, self.origin_um[::-1], self.mesh_um[::-1], strict=True):
            knots.append(first + mesh * (np.arange(n + 4) - 2.0))
        coefficients = np.moveaxis(self.coefficients_um, 0, -1)
        spline: Any = NdBSpline(tuple(knots), coefficients, 3)
        return spline(points[..., ::-1], nu=nu)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refined:
    """Displacement of points that the marks have placed, found by the maps.

    Call it with points ``(..., 2)``, ``(x, y)`` in um of the fixed map as the marks' fit gives
    them, to get points of the fixed map: ``refined(fit(points))`` takes points of the moving map
    there.
    """

    transform: Affine | FreeForm  # close to the identity
    model: Refinement  # affine or bspline
    # What was made as large as possible. Its value is no result: a correlation over refined maps is
    # cross-fitted or stands beside a searched null.
    metric: Metric
    moved_um: Pair  # rms and largest displacement over the known pixels
    # Largest ratio of displacement to expected error of the marks; inf or NaN where that error is 0
    # or not known.
    share: float
    area: Pair  # least and largest local change of area (determinant of the derivatives)
    strain: float  # largest local principal strain without its sign
    warnings: Texts  # what to be careful about
    sentence: str  # model, displacement and strain

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points ``(..., 2)``, in um; NaN stays NaN."""
        return self.transform(points)

    def image_at(self, image: Floats, pixel_um: Pair) -> Floats:
        """Return the image on the pixels of the linked map.

        It is what each pixel of the marks' fit shows once refined.

        Parameters
        ----------
        image : ndarray, shape (rows, cols)
            NaN is missing, and so is what lies within a pixel of it.
        pixel_um : (float, float)
            Along y and x.

        Returns
        -------
        ndarray, shape (rows, cols)
            Cubic interpolation; NaN outside.
        """
        grid = Grid.regular(image.shape, pixel_um)
        source_um = self(grid_points(grid.x_um, grid.y_um))
        row_col = np.moveaxis(source_um[..., ::-1] / pixel_um, -1, 0)
        is_known = np.isfinite(image)
        mean = float(image[is_known].mean()) if is_known.any() else 0.0
        filled = np.where(is_known, image, mean)
        resampled = ndimage.map_coordinates(filled, row_col, order=3, mode="nearest")
        known_weight = ndimage.map_coordinates(is_known.astype(np.float64), row_col, order=1)
        return np.where(known_weight > 0.999, resampled, np.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class RefineOptions:
    """Options of a refinement by the maps."""

    model: Refinement = "affine"  #: 6 parameters, or a cubic B-spline on a mesh
    #: squared correlation, of either sign, or Mattes' mutual information.
    metric: Metric = "correlation"
    grid_um: float = 2000.0  #: mesh of the B-spline, made a little smaller to fit the map
    #: largest displacement that is accepted, in expected errors of the marks at the place.
    most: float = 3.0
    #: False returns what goes too far or folds, with a warning; only for a search's null, whose
    #: maps are unrelated.
    bounded: bool = True


_DEFAULT = RefineOptions()


def refine(
    linked: Floats,
    image: Floats,
    valid: Bools | None,
    *,
    pixel_um: Pair,
    fit: FittedTransform,
    options: RefineOptions = _DEFAULT,
) -> Refined:
    """Find the displacement of a linked map under which it agrees best with the image.

    Parameters
    ----------
    linked : ndarray, shape (rows, cols)
        A property as the marks' fit places it on the image's pixels. NaN is missing.
    image : ndarray, shape (rows, cols)
        The middle of pixel (0, 0) is at (0, 0) um.
    valid : ndarray of bool, shape (rows, cols), or None
        Pixels that may be looked at, of both.
    pixel_um : (float, float)
        Along y and x. Maps of more than 60 000 pixels are averaged to larger ones first.
    fit : FittedTransform
        The fit to the marks.
    options : RefineOptions

    Returns
    -------
    Refined

    Raises
    ------
    CannotRegister
        If SimpleITK is not installed, too few pixels are known, the search fails, the result folds
        the map, or it moves points further than the marks allow.
    SizeError
        If pixel or mesh are not positive.

    Notes
    -----
    One thread, every pixel, nothing random: the same bytes on every run with one version of
    SimpleITK. The search climbs from the marks' fit to the nearest summit, so the marks have to be
    right to about a texture length.

    References
    ----------
    Mattes et al. (2003), IEEE Trans. Med. Imaging 22, 120, doi:10.1109/TMI.2003.809072.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            itk = importlib.import_module("SimpleITK")
    except ImportError as error:
        raise CannotRegister(
            "Refining on the maps needs the library SimpleITK, which is not installed. Run: "
            'pip install "planish[refine]". Or keep the marks only.'
        ) from error
    maps, masks, pixel_um, first_um = _prepare(linked, image, valid, pixel_um, options.grid_um)
    transform = _search(itk, maps, masks, pixel_um, first_um, options)
    is_shared = np.logical_and(*masks)
    # 65 places along either axis, where displacement and derivatives are looked at.
    is_place = np.zeros_like(is_shared)
    places = [np.linspace(0, n - 1, min(n, 65)).round().astype(int) for n in is_shared.shape]
    is_place[np.ix_(*places)] = True
    pixels = np.argwhere(is_shared & is_place).astype(np.float64)
    points = pixels[:, ::-1] * pixel_um[::-1] + first_um
    return _assess(transform, points, fit, options)


def _assess(
    transform: Affine | FreeForm, points: Floats, fit: FittedTransform, options: RefineOptions
) -> Refined:
    """Look at displacement and derivatives at points (n, 2) of the fixed map, in um.

    Refuse folds and what the marks do not allow, which are warnings where not ``bounded``.

    ``fit.expected_error_um`` takes points of the moving map and gives um of the fixed one. It is
    NaN where the marks fit exactly by their number, or where the inverse of the fit finds no point.
    """
    jacobians = transform.jacobian(points)
    areas = determinants(jacobians)
    moved_um = np.linalg.norm(transform(points) - points, axis=1)
    expected_um = fit.expected_error_um(fit.inverse(points))
    is_exact = (expected_um == 0) & (moved_um == 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(is_exact, 0.0, moved_um / expected_um)
    faults: list[str] = []
    worst_point = np.argmin(areas)
    if not areas[worst_point] > 0:
        x, y = points[worst_point]
        faults.append(
            f"The refinement folds the map near ({x:.5g}, {y:.5g}) um. Take a coarser mesh or the"
            " affine model, or keep the marks only."
        )
    if not np.isfinite(ratios).all():
        faults.append(
            "The error of the marks is unknown, so nothing bounds a refinement. Add marks, or keep"
            " the marks only."
        )
    elif ratios.max() > options.most:
        worst_point = np.argmax(ratios)
        x, y = points[worst_point]
        faults.append(
            f"The refinement moves the map by {moved_um[worst_point]:.1f} um near ({x:.5g},"
            f" {y:.5g}) um, where the marks are expected to be right to"
            f" {expected_um[worst_point]:.1f} um; up to {options.most:g} times that is accepted."
            " Either marks are wrong or the maps mislead. Check the marks, or keep them only."
        )
    if faults and options.bounded:
        raise CannotRegister(faults[0])
    stretches = np.linalg.svd(jacobians, compute_uv=False)
    strain = float(np.abs(stretches - 1.0).max())
    if strain > NOTABLE:
        faults.append(
            f"The refinement strains the map by up to {100 * strain:.1f} %. Paper strains by"
            " 0.1-0.5 %: look at the lags of tiles before you believe it."
        )
    rms = float(np.sqrt(np.mean(moved_um**2)))
    largest = float(moved_um.max())
    model_words = {"affine": "affine", "bspline": "B-spline"}[options.model]
    sentence = (
        f"Refined on the maps ({model_words}, {options.metric}): points moved by {rms:.1f} um"
        f" rms, {largest:.1f} um at most, strain up to {100 * strain:.2f} %."
    )
    return Refined(
        transform=transform,
        model=options.model,
        metric=options.metric,
        moved_um=(rms, largest),
        share=float(ratios.max()),
        area=range_of(areas),
        strain=strain,
        warnings=tuple(faults),
        sentence=sentence,
    )


def _search(
    itk: Any,
    maps: list[Floats],
    masks: list[Bools],
    pixel_um: Pair,
    first_um: Pair,
    options: RefineOptions,
) -> Affine | FreeForm:
    """Climb from the identity to where two maps agree best.

    ``maps`` are the linked one and the image, ``masks`` where they are known, ``first_um`` the
    ``(x, y)`` of their first pixel. The library works in pixels (of the columns' axis), so its
    steps are pixels too.
    """
    row_um, unit_um = pixel_um
    row_px = row_um / unit_um
    images: list[Any] = []
    mask_images = [mask.astype(np.uint8) for mask in masks]
    for values in (*maps, *mask_images):
        itk_image = itk.GetImageFromArray(values)
        itk_image.SetSpacing((1.0, row_px))
        images.append(itk_image)
    linked, image, linked_mask, image_mask = images
    search = itk.ImageRegistrationMethod()
    search.SetNumberOfThreads(1)
    if options.metric == "correlation":
        search.SetMetricAsCorrelation()
    else:
        search.SetMetricAsMattesMutualInformation(32)
    search.SetMetricFixedMask(linked_mask)
    search.SetMetricMovingMask(image_mask)
    search.SetMetricSamplingStrategy(search.NONE)
    # A linear interpolation blurs between pixels, and less noise looks like agreement.
    search.SetInterpolator(itk.sitkBSpline3)
    rows, cols = maps[0].shape
    if options.model == "affine":
        transform = itk.AffineTransform(2)
        middle_y = 0.5 * (rows - 1) * row_um / unit_um
        transform.SetCenter((0.5 * (cols - 1), middle_y))
        search.SetOptimizerAsRegularStepGradientDescent(
            learningRate=1.0, minStep=1e-3, numberOfIterations=_STEPS, relaxationFactor=0.5
        )
        search.SetOptimizerScalesFromPhysicalShift()
    else:
        sides_um = (cols * unit_um, rows * row_um)
        mesh = [max(math.ceil(side / options.grid_um), 1) for side in sides_um]
        transform = itk.BSplineTransformInitializer(linked, mesh, 3)
        search.SetOptimizerAsLBFGSB(
            gradientConvergenceTolerance=1e-5,
            numberOfIterations=_STEPS,
            costFunctionConvergenceFactor=1e10,
        )
    search.SetInitialTransform(transform, True)
    try:
        with _one_thread(itk):
            search.Execute(linked, image)
    except RuntimeError as fault:
        reason_text = str(fault).strip().rsplit("\n", 1)[-1]
        raise CannotRegister(
            f"The maps could not be refined ({reason_text}). Check that both show texture at the"
            " same places, or keep the marks only."
        ) from fault
    return _transform_um(itk, transform, unit_um, first_um)


@contextmanager
def _one_thread(itk: Any) -> Generator[None]:
    """Let the library work in one thread, and afterwards in as many as before.

    Mutual information sums up in the order in which threads end, whatever number the search itself
    is given: the last digits change from run to run, and with the processors.
    """
    settings = itk.ProcessObject
    with _THREADS_CHANGED:
        count = settings.GetGlobalDefaultNumberOfThreads()
        settings.SetGlobalDefaultNumberOfThreads(1)
        try:
            yield
        finally:
            settings.SetGlobalDefaultNumberOfThreads(count)


def _transform_um(itk: Any, fitted: Any, unit_um: float, first_um: Pair) -> Affine | FreeForm:
    """Take a transformation of the library from its pixels to um.

    ``fitted`` is an affine transformation of the library or a B-spline; ``unit_um`` is the side of
    its pixels and ``first_um`` the place (x, y) of the first one.
    """
    if hasattr(fitted, "GetMatrix"):
        a, b, c, d = fitted.GetMatrix()
        linear = ((a, b), (c, d))
        centre = np.array(fitted.GetCenter())
        target = centre + np.array(fitted.GetTranslation())
        source_um = pair_of(centre * unit_um + first_um)
        target_um = pair_of(target * unit_um + first_um)
        return Affine(linear=linear, source=source_um, target=target_um)
    coefficient_images = fitted.GetCoefficientImages()
    first_image = coefficient_images[0]
    origin_um = pair_of(np.array(first_image.GetOrigin()) * unit_um + first_um)
    mesh_um = pair_of(np.array(first_image.GetSpacing()) * unit_um)
    coefficients = np.stack([itk.GetArrayFromImage(c) for c in coefficient_images])
    coefficients_um = coefficients.astype(np.float64) * unit_um
    return FreeForm(coefficients_um=coefficients_um, origin_um=origin_um, mesh_um=mesh_um)


def _prepare(
    linked: Floats, image: Floats, valid: Bools | None, pixel_um: Pair, grid_um: float
) -> tuple[list[Floats], list[Bools], Pair, Pair]:
    """Give both maps, averaged, standardised and filled with their means.

    Also gives their masks, the pixel (y, x) in um, and (x, y) of the first one's middle.
    """
    is_allowed = np.ones(linked.shape, dtype=bool) if valid is None else valid
    if linked.ndim != 2 or not linked.shape == image.shape == is_allowed.shape:
        raise CannotRegister(
            f"The maps have the shapes {linked.shape} and {image.shape}. Link them first: a"
            " refinement needs maps and mask on one grid."
        )
    if not all(0 < v < math.inf for v in (*pixel_um, grid_um)):
        raise SizeError(f"Pixel {pixel_um} um and mesh {grid_um} um: positive lengths are needed.")
    factor = math.ceil(math.sqrt(linked.size / 60_000))
    row_um, col_um = pixel_um
    shift_px = 0.5 * (factor - 1)
    maps: list[Floats] = []
    for values in (linked, image):
        is_shown = np.isfinite(values) & is_allowed
        shown = np.where(is_shown, values, np.nan).astype(np.float64)
        maps.append(area_mean(shown, (factor, factor)) if factor > 1 else shown)
    masks = [*map(np.isfinite, maps)]
    count = np.count_nonzero(np.logical_and(*masks))
    if count < 400:
        raise CannotRegister(
            f"{count} pixels are known in both maps; a refinement needs 400. Keep the marks only."
        )
    filled = [*map(_standardised, maps, masks)]
    first_um = (shift_px * col_um, shift_px * row_um)
    return filled, masks, (factor * row_um, factor * col_um), first_um


def _standardised(values: Floats, mask: Bools) -> Floats:
    """Values of mean 0 and standard deviation 1; 0 outside the mask."""
    masked = values[mask]
    sd = masked.std()
    if float(sd) == 0:
        raise CannotRegister(
            "One of the maps is constant: nothing can be refined on it. Keep the marks only."
        )
    return np.where(mask, (values - masked.mean()) / sd, 0.0)
