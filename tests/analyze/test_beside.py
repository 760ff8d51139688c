import numpy as np
import pytest
from scipy import ndimage

from analyze.fields import gaussian_maps, related_maps
from folders import refused
from planish.analyze import (
    attenuation_limit,
    commonality,
    correlate,
    of_short_waves,
    origins,
    partial,
)
from planish.core.errors import CannotMeasure, InputError, SizeError


def displaced(rng, values, error):
    """The map, each pixel from a place that a slow random field moves by this error (rms of the
    length)."""
    moves = [
        ndimage.gaussian_filter(rng.normal(size=values.shape), 12, mode="wrap") for _ in range(2)
    ]
    moves = [m / m.std() * error / np.sqrt(2) for m in moves]
    at = [k + m for k, m in zip(np.indices(values.shape), moves, strict=True)]
    return ndimage.map_coordinates(values, at, order=1, mode="reflect")


@pytest.mark.parametrize(("kind", "length"), [("gauss", 12.0), ("exp", 12.0)])
@pytest.mark.parametrize("error", [3.0, 8.0])
@pytest.mark.parametrize("point", [None, 6.0])
def test_the_attenuation_limit_is_the_r_of_a_displaced_map(kind, length, error, point):
    rng = np.random.default_rng(0)
    seen, said = [], []
    for _ in range(4):
        a = gaussian_maps(rng, (150, 200), length, kind=kind)[0]
        seen.append(correlate(a, displaced(rng, a, error), pixel_um=1.0, point_um=point).r)
        said.append(attenuation_limit(a, error_um=error, pixel_um=1.0, point_um=point))
    assert np.mean(said) == pytest.approx(np.mean(seen), abs=0.03)


def test_an_attenuation_limit_needs_a_map_and_an_error_and_lies_between_those_of_its_errors():
    a = gaussian_maps(1, (60, 80), 4.0)[0]
    assert attenuation_limit(a, error_um=0.0, pixel_um=1.0) == pytest.approx(1)
    a = gaussian_maps(2, (60, 80), 6.0)[0]
    errors = np.broadcast_to(np.linspace(1.0, 5.0, 80), a.shape)
    low, high = (attenuation_limit(a, error_um=e, pixel_um=1.0) for e in (5.0, 1.0))
    assert low < attenuation_limit(a, error_um=errors, pixel_um=1.0) < high
    a = gaussian_maps(2, (20, 30), 6.0)[0]
    for given in (
        {"error_um": -1.0},
        {"error_um": np.full(a.shape, np.nan)},
    ):
        with pytest.raises(InputError):
            attenuation_limit(a, pixel_um=1.0, **given)
    refused(
        CannotMeasure, "constant", attenuation_limit, np.ones((9, 9)), error_um=1.0, pixel_um=1.0
    )


def test_origins_scatter_about_r():
    a, b = related_maps(3, (90, 120), 5.0, 0.6)
    found = origins(a, b, pixel_um=2.0, point_um=24.0)
    assert found.count == 16
    assert found.least < found.r < found.largest
    assert found.least <= correlate(a, b, pixel_um=2.0, point_um=24.0).r <= found.largest
    refused(SizeError, "smaller points", origins, a[:4, :4], b[:4, :4], pixel_um=2.0, point_um=24.0)


def test_long_waves_are_taken_off():
    rng = np.random.default_rng(4)
    a, b = related_maps(rng, (90, 120), 2.0, 0.6)
    waves = gaussian_maps(rng, (90, 120), 40.0, kind="gauss")
    found, longest = of_short_waves(a + 3 * waves[0], b + 3 * waves[1], pixel_um=1.0)
    assert (longest, found.r) == (pytest.approx(18), pytest.approx(0.6, abs=0.1))
    whole = correlate(a + 3 * waves[0], b + 3 * waves[1], pixel_um=1.0)
    assert found.n_eff > 10 * whole.n_eff


def test_partial_r_leaves_what_the_others_do_not_explain():
    rng = np.random.default_rng(6)
    third = gaussian_maps(rng, (60, 80), 3.0)[0]
    a, b = gaussian_maps(rng, (60, 80), 3.0)
    assert correlate(a + 2 * third, b + 2 * third, pixel_um=1.0).r > 0.6
    found = partial(a + 2 * third, b + 2 * third, [third], pixel_um=1.0)
    assert found.interval[0] < 0 < found.interval[1]
    refused(InputError, "sum", partial, a, b, [a - third, third], pixel_um=1.0)


def test_maps_without_common_pixels_are_refused():
    a, b = related_maps(8, (20, 30), 2.0, 0.5)
    none = np.full(a.shape, np.nan)
    for call in (
        lambda: of_short_waves(none, b, pixel_um=1.0),
        lambda: partial(a, b, [none], pixel_um=1.0),
        lambda: commonality(b, {"x": a, "y": none}),
        lambda: commonality(np.ones(a.shape), {"x": a, "y": b}),
    ):
        with pytest.raises(CannotMeasure):
            call()


def test_commonality_adds_up_and_knows_two_predictors():
    rng = np.random.default_rng(7)
    x, y, z = (gaussian_maps(rng, (40, 50), 3.0)[0] for _ in range(3))
    b = x + 0.5 * y + gaussian_maps(rng, (40, 50), 3.0)[0]
    maps = {"x": x, "both": x + y, "z": z}

    def explained(*names):
        terms = np.stack([np.ones(b.size), *(maps[k].ravel() for k in names)], axis=1)
        rest = b.ravel() - terms @ np.linalg.lstsq(terms, b.ravel(), rcond=None)[0]
        return 1 - rest.var() / b.var()

    two = commonality(b, {k: maps[k] for k in ("x", "both")})
    assert two["x"] == pytest.approx(explained("x", "both") - explained("both"))
    assert two["x and both"] == pytest.approx(
        explained("x") + explained("both") - explained("x", "both")
    )
    three = commonality(b, maps)
    assert (len(three), sum(three.values())) == (7, pytest.approx(explained(*maps)))
    refused(InputError, "sum of others", commonality, b, {"x": x, "y": y, "sum": x + y})
    refused(InputError, "2 to 4", commonality, b, {"x": x})
