"""Coefficients against formulas and statsmodels, what is refused, and what changes nothing."""

import math

import numpy as np
import pytest
import statsmodels.api as sm
import xarray as xr
from scipy import ndimage, spatial

import planish as pl
from planish.analyze.explain import covariance_of
from planish.analyze.generalised_least_squares import ExponentialCovariance, weighed_regression
from planish.analyze.multiple_regression import regress
from planish.analyze.shared_errors import covariance_of_errors, sharings_of
from planish.core.errors import CannotMeasure, InputError, SizeError
from planish.texture.covariance import Lags

PIXEL_UM = 20.0


def field(rng, sigma, shape=(60, 64)):
    values = ndimage.gaussian_filter(rng.normal(size=shape), sigma, mode="wrap")
    return values / values.std()


def dataset(**arrays):
    rows, cols = next(iter(arrays.values())).shape
    coords = {"v": np.arange(rows) * PIXEL_UM, "u": np.arange(cols) * PIXEL_UM}
    return xr.Dataset({name: (("v", "u"), m) for name, m in arrays.items()}, coords=coords)


@pytest.fixture
def maps():
    rng = np.random.default_rng(5)
    a, rest = field(rng, 1.2), field(rng, 1.2)
    b = 0.6 * a + 0.8 * rest
    seen = 0.5 * a - 0.3 * b + 0.5 * field(rng, 1.0)
    seen[10:14, 20:26] = np.nan
    return dataset(y=10 + 3 * seen, a=50 + 2 * a, b=b)


def explained(maps, **options):
    return pl.explain(maps, **{"response": "y", "of": ["a", "b"], "cell_um": PIXEL_UM} | options)


def test_coefficients_r2_and_inflation_are_those_of_statsmodels(maps):
    model = explained(maps)
    valid = np.isfinite(maps["y"].values)
    x = np.stack([maps[name].values[valid] for name in ("a", "b")], axis=1)
    ols = sm.OLS(maps["y"].values[valid], sm.add_constant(x)).fit()
    plain = [model.coefficients[name].plain for name in ("a", "b")]
    np.testing.assert_allclose([model.intercept, *plain], ols.params, rtol=1e-9)
    np.testing.assert_allclose(model.r2, ols.rsquared, rtol=1e-10)
    r = np.corrcoef(x.T)[0, 1]
    for name in ("a", "b"):
        assert model.coefficients[name].vif == pytest.approx(1 / (1 - r * r), rel=1e-9)
    assert model.n == valid.sum()
    shares = sum(c.unique for c in model.coefficients.values()) + model.shared
    assert shares == pytest.approx(model.r2, rel=1e-9)


def test_without_neighbours_errors_are_those_of_least_squares():
    rng = np.random.default_rng(1)
    shape = (40, 40)
    x = [rng.normal(size=shape) for _ in range(2)]
    y = x[0] + rng.normal(size=shape)
    lags = Lags(np.ones(shape, bool), (1.0, 1.0))
    fit = regress(y, x, lags)
    ols = sm.OLS(y.ravel(), sm.add_constant(np.stack([m.ravel() for m in x], axis=1))).fit()
    # White maps: n_eff of a sample scatters about n by some per cent.
    np.testing.assert_allclose(fit.standard_errors, ols.bse[1:], rtol=0.1)


def test_generalised_least_squares_are_those_of_statsmodels():
    rng = np.random.default_rng(3)
    shape, pixel = (16, 20), (1.0, 1.5)
    valid = rng.random(shape) > 0.1
    arrays = [field(rng, 2, shape) for _ in range(3)]
    covariance = ExponentialCovariance(shared=0.7, nugget=0.2, range_um=4.0)
    weighed = weighed_regression(arrays[0], arrays[1:], valid, pixel, covariance)
    places = np.argwhere(valid) * pixel
    dense = covariance(spatial.distance.squareform(spatial.distance.pdist(places)))
    x = sm.add_constant(np.stack([m[valid] for m in arrays[1:]], axis=1))
    gls = sm.GLS(arrays[0][valid], x, sigma=dense).fit()
    np.testing.assert_allclose(weighed.plain, gls.params[1:], rtol=1e-8)
    np.testing.assert_allclose(weighed.standard_errors, gls.bse[1:], rtol=1e-8)


def test_the_covariance_of_residuals_is_read_off_them():
    rng = np.random.default_rng(2)
    residuals = field(rng, 3, (120, 120))
    found = covariance_of(pl.analyze.variogram(residuals, pixel_um=1.0))
    # Filtered by a Gaussian of 3 pixels, a field correlates as exp(-h^2 / 36): 1/e at 6 pixels.
    assert found.range_um == pytest.approx(6.0, rel=0.15)
    assert found.shared + found.nugget == pytest.approx(1.0, rel=0.1)


def test_units_and_shifts_change_no_standardised_coefficient(maps):
    model = explained(maps)
    other = explained(maps.assign(a=1000 * maps["a"] - 7, y=0.1 * maps["y"]))
    for name in ("a", "b"):
        first, second = (m.coefficients[name] for m in (model, other))
        assert second.standardised == pytest.approx(first.standardised, rel=1e-9)
        np.testing.assert_allclose(second.interval, first.interval, rtol=1e-8)
    assert other.coefficients["a"].plain == pytest.approx(
        model.coefficients["a"].plain / 1e4, rel=1e-8
    )


def test_ranks_stay_under_monotone_transforms(maps):
    bent = maps.assign(a=np.exp(maps["a"] / 2), b=maps["b"] ** 3)
    model, other = explained(maps), explained(bent)
    for name in ("a", "b"):
        assert other.coefficients[name].rank == pytest.approx(
            model.coefficients[name].rank, abs=1e-12
        )
    assert abs(other.coefficients["a"].plain / model.coefficients["a"].plain - 1) > 0.5


def test_one_predictor_says_what_r_says(maps):
    model = explained(maps, of=["a"])
    valid = np.isfinite(maps["y"].values)
    r = pl.correlate(maps["a"], maps["y"], pixel_um=PIXEL_UM)
    assert model.coefficients["a"].standardised == pytest.approx(r.r, rel=1e-9)
    assert model.coefficients["a"].rank == pytest.approx(r.rho, rel=1e-9)
    assert model.n == valid.sum()
    assert math.isnan(model.lead)


def test_neighbours_make_intervals_wider_than_least_squares_has_them():
    rng = np.random.default_rng(11)
    a, b, rest = (field(rng, 3.0, (100, 100)) for _ in range(3))
    model = explained(dataset(y=a + rest, a=a, b=b))
    found = model.coefficients["a"]
    low, high = found.plain_interval
    valid = np.ones(a.shape, bool)
    ols = sm.OLS((a + rest)[valid], sm.add_constant(np.stack([a[valid], b[valid]], axis=1))).fit()
    assert (high - low) / 2 > 5 * 1.96 * ols.bse[1]
    assert low < 1 < high
    assert model.n_eff < 0.05 * model.n
    assert model.coefficients["b"].direction == 0
    assert model.lead_interval[0] > 0


def test_a_sum_and_its_parts_are_refused_by_name(maps):
    with pytest.raises(InputError, match="total is a sum of a and b"):
        explained(maps.assign(total=maps["a"] - 2 * maps["b"]), of=["total", "a", "b"])
    sheet = dataset(
        y=maps["y"].values,
        base_thickness=maps["a"].values,
        coating_top=maps["b"].values,
        thickness=(maps["a"] + maps["b"]).values,
    )
    with pytest.raises(InputError, match="thickness is a sum of base_thickness and coating_top"):
        explained(sheet, of=["base_thickness", "coating_top", "thickness"])
    no_rest = maps.assign(y=maps["a"] + maps["b"])
    with pytest.raises(InputError, match="y is a sum of a and b: there is nothing to explain"):
        explained(no_rest)


def test_too_few_independent_cells_are_refused_with_what_would_help():
    rng = np.random.default_rng(4)
    a, long_waves, rest = field(rng, 3), field(rng, 14), field(rng, 14)
    data = dataset(y=a + rest, a=a, long_waves=long_waves)
    with pytest.raises(CannotMeasure, match=r"10 for each.*times the area.*without long_waves"):
        explained(data, of=["a", "long_waves"])


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"of": []}, InputError, "No map is given"),
        ({"of": ["a", "y"]}, InputError, "y is given twice"),
        ({"of": ["c"]}, InputError, "no map 'c'. There are"),
        ({"cell_um": 5.0}, SizeError, "smaller than a pixel"),
        ({"cell_um": 1300.0}, SizeError, "larger than the field, 1200 um"),
        ({"corrected": True}, InputError, "No map of this model has a stated error"),
    ],
)
def test_what_means_nothing_is_refused(maps, options, error, words):
    with pytest.raises(error, match=words):
        explained(maps, **options)


def test_a_map_of_labels_is_a_factor(maps):
    rng = np.random.default_rng(8)
    zone = rng.integers(0, 2, (15, 16)).repeat(4, axis=0).repeat(4, axis=1)
    printed = maps["y"] + 30.0 * zone
    data = maps.assign(y=printed, zone=(("v", "u"), zone), is_print=(("v", "u"), zone == 1))
    by_label = explained(data, of=["a", "zone"])
    by_truth = explained(data, of=["a", "is_print"])
    assert by_label.coefficients["zone=1"].plain == pytest.approx(30.0, abs=1.0)
    assert by_truth.coefficients["is_print"].plain == pytest.approx(
        by_label.coefficients["zone=1"].plain, rel=1e-9
    )
    with pytest.raises(InputError, match="different whole numbers"):
        explained(
            data.assign(zone=(("v", "u"), np.arange(zone.size).reshape(zone.shape))), of=["zone"]
        )


def test_other_cell_sizes_stand_beside_the_declared_one(maps):
    model = explained(maps, cell_um=2 * PIXEL_UM)
    assert [row.cell_um for row in model.sizes] == [20.0, 40.0, 80.0, 160.0]
    (declared,) = [row for row in model.sizes if row.cell_um == model.cell_um]
    assert declared.standardised["a"] == model.coefficients["a"].standardised
    finest = explained(maps).coefficients["a"].standardised
    assert model.sizes[0].standardised["a"] == pytest.approx(finest, rel=1e-12)
    assert "needed" in model.sizes[-1].reason or model.sizes[-1].standardised


def test_sizes_end_with_the_field(maps):
    model = explained(maps, of=["a"], cell_um=320.0)
    assert [row.cell_um for row in model.sizes] == [80.0, 160.0, 320.0, 640.0]
    assert "needed" in model.sizes[-1].reason


def test_pixels_count_where_they_are_valid(maps):
    shape = maps["a"].shape
    whole = explained(maps)
    for valid in (np.ones(shape, bool), np.ones(shape, np.uint8), np.ones(shape)):
        assert explained(maps.assign(valid=(("v", "u"), valid))).coefficients == whole.coefficients
    half = np.where(np.arange(shape[1]) < 32, 1.0, np.nan) * np.ones(shape)
    known = explained(maps.assign(valid=(("v", "u"), half)))
    assert known.n == np.isfinite(maps["y"].values[:, :32]).sum()


def test_errors_follow_the_surfaces_that_maps_share():
    # Only the interface is off: both coatings' faces and the other interface are exact.
    stated = {"coating_top": 2.0, "base_thickness": 2.0, "interface_top": 2.0}
    covariance = covariance_of_errors(["coating_top", "base_thickness", "y"], stated)
    np.testing.assert_allclose(covariance, [[4, -4, 0], [-4, 4, 0], [0, 0, 0]], atol=1e-5)
    (sharing,) = sharings_of(["coating_top", "base_thickness"], covariance[:2, :2])
    assert (sharing.a, sharing.b) == ("coating_top", "base_thickness")
    assert sharing.surface == "interface_top"
    assert sharing.correlation == pytest.approx(-1.0, abs=1e-5)
    # What is not said of surfaces is shared out evenly: a coating's two, a base's two.
    even = covariance_of_errors(["coating_top", "base_surface_top"], {"coating_top": 1.0})
    np.testing.assert_allclose(even, [[1, -0.5], [-0.5, 0.5]], atol=1e-5)


def test_correction_takes_the_shared_error_off():
    rng = np.random.default_rng(21)
    shape = (80, 80)
    coating, base = 3 * field(rng, 1.5, shape), 4 * field(rng, 1.5, shape)
    error = 2.0
    shift = error * rng.normal(size=shape)
    stated = {
        f"{name}_se": np.full(shape, error)
        for name in ("coating_top", "base_thickness", "interface_top")
    }
    data = dataset(
        y=coating + 0.5 * base + field(rng, 1.5, shape),
        coating_top=coating - shift,
        base_thickness=base + shift,
        **stated,
    )
    names = ["coating_top", "base_thickness"]
    plain = explained(data, of=names)
    corrected = explained(data, of=names, corrected=True)
    true = {"coating_top": 1.0, "base_thickness": 0.5}
    for name, value in true.items():
        found, put_right = (m.coefficients[name] for m in (plain, corrected))
        assert put_right.plain_interval[0] < value < put_right.plain_interval[1]
        assert found.by_errors == pytest.approx(found.plain - put_right.plain, rel=1e-9)
        assert abs(found.plain - value) > 3 * abs(put_right.plain - value)
    of_layer = {name: f"ct.{name}" for name in names}
    named = explained(data.rename(of_layer), of=[*of_layer.values()], corrected=True)
    for name in names:
        assert named.coefficients[of_layer[name]].plain == corrected.coefficients[name].plain
    assert named.shared_errors[0].a == "ct.coating_top"
    too_large = data.assign({k: 3 * data[k] for k in stated})
    with pytest.raises(CannotMeasure, match="as large as what varies"):
        explained(too_large, of=names, corrected=True)


def test_out_of_sample_is_below_in_sample_and_near_the_truth():
    rng = np.random.default_rng(6)
    shape = (90, 90)
    a, b, rest = (field(rng, 1.2, shape) for _ in range(3))
    model = explained(dataset(y=0.6 * a + 0.8 * rest, a=a, b=b))
    assert model.r2_out < model.r2
    assert model.r2_out == pytest.approx(0.36, abs=0.06)
    assert model.block_um > 2 * model.residuals.range_um
