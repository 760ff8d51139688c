import importlib

import numpy as np
import pytest
from scipy import ndimage

from analyze.fields import by_shift, texture
from folders import refused
from planish.analyze import cross_fitted
from planish.core.errors import CannotRegister, SizeError
from planish.register import RefineOptions, fit_transform, refine, refinement

itk = pytest.importorskip("SimpleITK")
PIXEL = 10.0
SHAPE = (90, 110)
PAD = 16


def places():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] * PIXEL
    return np.stack([x, y], axis=-1)


def maps(displacement, seed, r=0.9):
    """A linked map that shows at q what the image shows at q + displacement, the dark image, and a
    mask."""
    rng = np.random.default_rng(seed)
    big = texture((SHAPE[0] + 2 * PAD, SHAPE[1] + 2 * PAD), 1.5, rng)
    at = (places() + displacement) / PIXEL + PAD
    linked = ndimage.map_coordinates(big, [at[..., 1], at[..., 0]], order=5)
    image = r * big + np.sqrt(1 - r * r) * texture(big.shape, 1.5, rng)
    hole = np.hypot(*np.moveaxis(places() - (600, 400), -1, 0)) < 80
    return np.where(hole, np.nan, linked), 120.0 - 9.0 * image[PAD:-PAD, PAD:-PAD], ~hole


def marks_fit(noise=12.0, seed=0):
    rng = np.random.default_rng(seed)
    moving = rng.uniform((0, 0), (1090, 890), (8, 2))
    return fit_transform(moving, moving + rng.normal(0, noise, (8, 2)))


def constant(x, y):
    return np.broadcast_to(np.array([x, y]), (*SHAPE, 2))


@pytest.mark.parametrize("metric", ["correlation", "mutual information"])
def test_an_affine_displacement_is_found(metric):
    linear = np.array([[0.004, 0.002], [-0.003, 0.001]])
    true = (places() - (500, 400)) @ linear.T + (7.0, -5.0)
    linked, image, valid = maps(true, 1)
    found = refine(
        linked,
        image,
        valid,
        pixel_um=(PIXEL, PIXEL),
        fit=marks_fit(),
        options=RefineOptions(metric=metric),
    )
    error = np.linalg.norm(found(places()) - places() - true, axis=-1)
    print(
        f"{metric}: error {np.sqrt(np.mean(error**2)):.2f} um rms of"
        f" {np.linalg.norm(true, axis=-1).max():.1f} um"
    )
    assert np.sqrt(np.mean(error**2)) < 1.5  # 0.15 pixels
    # The displacement itself, not its opposite, and the sentence says what was done.
    assert found([500.0, 400.0]) == pytest.approx((507.0, 395.0), abs=1.5)
    assert found.transform.jacobian([[0.0, 0.0]])[0] - np.eye(2) == pytest.approx(linear, abs=0.003)
    assert found.sentence.startswith(f"Refined on the maps (affine, {metric}): points moved by")
    assert 0 < found.share < 3


@pytest.mark.ci
def test_a_bend_is_found_by_the_spline_and_every_run_is_the_same():
    x, y = np.moveaxis(places(), -1, 0)
    true = np.stack([4 * np.sin(x / 1100 * np.pi), 3 * np.cos(y / 900 * np.pi)], axis=-1)
    linked, image, valid = maps(true, 2, r=0.95)
    settings = {
        "pixel_um": (PIXEL, PIXEL),
        "fit": marks_fit(),
        "options": RefineOptions(model="bspline", grid_um=1200.0),
    }
    found = refine(linked, image, valid, **settings)
    error = np.linalg.norm(found(places()) - places() - true, axis=-1)
    print(
        f"error {np.sqrt(np.mean(error**2)):.2f} um rms of"
        f" {np.linalg.norm(true, axis=-1).max():.1f} um"
    )
    assert np.sqrt(np.mean(error**2)) < 1.5
    assert 0.9 < found.area[0] < 1 < found.area[1] < 1.1
    again = refine(linked, image, valid, **settings)
    assert again.transform.coefficients_um.tobytes() == found.transform.coefficients_um.tobytes()
    # What the refined registration makes of the image correlates better than what the marks make of
    # it.
    seen = found.image_at(image, (PIXEL, PIXEL))
    both = np.isfinite(seen) & valid
    assert abs(np.corrcoef(linked[both], seen[both])[0, 1]) > abs(
        np.corrcoef(linked[both], image[both])[0, 1]
    )


def test_mutual_information_gives_the_same_bytes_with_any_number_of_threads():
    true = constant(6.0, -4.0)
    settings = {
        "pixel_um": (PIXEL, PIXEL),
        "fit": marks_fit(),
        "options": RefineOptions(metric="mutual information"),
    }
    maps_and_mask = maps(true, 5)
    before = itk.ProcessObject.GetGlobalDefaultNumberOfThreads()
    transforms = set()
    try:
        for count in (1, 4):
            itk.ProcessObject.SetGlobalDefaultNumberOfThreads(count)
            transforms.add(refine(*maps_and_mask, **settings).transform)
            assert itk.ProcessObject.GetGlobalDefaultNumberOfThreads() == count
    finally:
        itk.ProcessObject.SetGlobalDefaultNumberOfThreads(before)
    assert len({(t.linear, t.source, t.target) for t in transforms}) == 1


def test_the_spline_is_that_of_the_library():
    rng = np.random.default_rng(4)
    made = itk.BSplineTransformInitializer(itk.Image([40, 30], itk.sitkFloat64), [3, 2], 3)
    made.SetParameters(rng.normal(0, 0.5, made.GetNumberOfParameters()).tolist())
    nodes = made.GetCoefficientImages()
    own = refinement.FreeForm(
        coefficients_um=np.stack([itk.GetArrayFromImage(c) for c in nodes]),
        origin_um=nodes[0].GetOrigin(),
        mesh_um=nodes[0].GetSpacing(),
    )
    points = rng.uniform((0.1, 0.1), (38.9, 28.9), (50, 2))
    assert own(points) == pytest.approx(
        np.array([made.TransformPoint(p) for p in points.tolist()]), abs=1e-9
    )
    step = 1e-6
    slopes = np.stack(
        [(own(points + d) - own(points - d)) / (2 * step) for d in step * np.eye(2)], axis=-1
    )
    assert own.jacobian(points) == pytest.approx(slopes, abs=1e-6)
    outside = np.array([[-500.0, 12.0], [np.nan, 1.0]])
    border = np.array([own.origin_um[0] + own.mesh_um[0], 12.0])
    assert own(outside)[0] - outside[0] == pytest.approx(own(border) - border, abs=1e-9)
    assert np.isnan(own(outside)[1]).all()
    assert own.jacobian(outside)[0][:, 0] == pytest.approx((1.0, 0.0))


def test_more_than_the_marks_allow_is_refused():
    linked, image, valid = maps(constant(8.0, 0.0), 3)
    settings = {"pixel_um": (PIXEL, PIXEL), "fit": marks_fit(noise=0.8)}
    with pytest.raises(
        CannotRegister, match=r"moves the map by \d+\.\d um near .* up to 3 times that is accepted"
    ):
        refine(linked, image, valid, **settings)
    found = refine(linked, image, valid, **settings, options=RefineOptions(bounded=False))
    assert found.share > 3
    assert "Check the marks" in found.warnings[0]


def test_a_fold_is_refused_and_a_strain_is_told(monkeypatch):
    module = importlib.import_module("planish.register.refinement")
    linked, image, valid = maps(constant(0.0, 0.0), 4)

    def bent(height):
        nodes = np.zeros((2, 5, 6))
        nodes[0, 2, 2:4] = height, -height
        return refinement.FreeForm(
            coefficients_um=nodes, origin_um=(-600.0, -600.0), mesh_um=(600.0, 600.0)
        )

    settings = {"pixel_um": (PIXEL, PIXEL), "fit": marks_fit(noise=4000.0)}
    monkeypatch.setattr(module, "_search", lambda *_: bent(900.0))
    refused(CannotRegister, "folds the map near", refine, linked, image, valid, **settings)
    monkeypatch.setattr(module, "_search", lambda *_: bent(30.0))
    found = refine(linked, image, valid, **settings)
    assert found.strain > 0.01
    assert "strains the map by up to" in found.warnings[0]


def test_what_cannot_be_refined_is_refused(monkeypatch):
    linked, image, valid = maps(constant(0.0, 0.0), 5)
    settings = {"pixel_um": (PIXEL, PIXEL), "fit": marks_fit()}
    refused(CannotRegister, "one grid", refine, linked[1:], image, None, **settings)
    refused(
        CannotRegister, "400", refine, linked, image, valid & (places()[..., 0] < 30), **settings
    )
    refused(CannotRegister, "constant", refine, linked, 0 * image, valid, **settings)
    refused(
        SizeError,
        "positive lengths",
        refine,
        linked,
        image,
        valid,
        **settings,
        options=RefineOptions(grid_um=0.0),
    )
    exact = fit_transform([[0, 0], [900, 100]], [[0, 0], [900, 100]])
    refused(
        CannotRegister,
        "nothing bounds",
        refine,
        linked,
        image,
        valid,
        pixel_um=(PIXEL, PIXEL),
        fit=exact,
    )

    def missing(_name):
        raise ImportError

    monkeypatch.setattr(importlib, "import_module", missing)
    refused(CannotRegister, r"planish\[refine\]", refine, linked, image, valid, **settings)


def test_a_refined_correlation_is_cross_fitted():
    linked, image, valid = maps(constant(4.0, -3.0), 6)
    fit = marks_fit()

    free = RefineOptions(bounded=False)

    def tune(a, look):
        return refine(a, image, look, pixel_um=(PIXEL, PIXEL), fit=fit, options=free).image_at(
            image, (PIXEL, PIXEL)
        )

    found = cross_fitted(linked, image, tune, valid=valid, pixel_um=(PIXEL, PIXEL))
    assert found.r == pytest.approx(-0.9, abs=0.06)
    coarse = by_shift(image, 4)
    assert cross_fitted(linked, image, coarse, valid=valid, pixel_um=(PIXEL, PIXEL)).r < -0.75
