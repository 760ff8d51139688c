import math

import numpy as np
import pytest

from analyze.fields import gaussian_maps
from folders import refused
from planish.analyze import variogram
from planish.core.errors import CannotMeasure, InputError


@pytest.mark.parametrize(
    ("kind", "length"), [("exp", 3.0), ("exp", 6.0), ("gauss", 3.0), ("gauss", 6.0)]
)
@pytest.mark.parametrize("nugget", [0.0, 0.4])
def test_nugget_sill_and_range_of_known_maps(kind, length, nugget):
    rng, found = np.random.default_rng(0), []
    for _ in range(6):
        a = gaussian_maps(rng, (120, 160), length, kind=kind)[0] + math.sqrt(nugget) * rng.normal(
            size=(120, 160)
        )
        v = variogram(a, pixel_um=2.0)
        found.append((v.nugget, v.sill, v.range_um))
    seen = np.mean(found, axis=0)
    assert (seen[0], seen[1]) == (
        pytest.approx(nugget, abs=0.04),
        pytest.approx(1 + nugget, abs=0.09),
    )
    assert seen[2] == pytest.approx(2 * length, rel=0.09)


def test_white_noise_is_all_nugget():
    found = variogram(np.random.default_rng(6).normal(size=(90, 120)), pixel_um=1.0)
    assert (found.nugget, found.sill) == (
        pytest.approx(found.sill, rel=0.05),
        pytest.approx(1, abs=0.05),
    )


def test_rings_are_sums_over_pairs_of_points():
    a = gaussian_maps(2, (20, 15), 2.0)[0]
    a[2:4, 5:9] = np.nan
    found = variogram(a, pixel_um=(1.0, 2.0))
    at = np.argwhere(np.isfinite(a))
    values = a[tuple(at.T)] - np.nanmean(a)
    pairs, far, products = {}, {}, {}
    for i in range(len(at)):
        for j in range(i):
            dy, dx = (at[i] - at[j]) * (1.0, 2.0)
            h = math.hypot(dy, dx)
            if abs(dx) > 14 or h > 10 or round(h / 2) < 1:
                continue
            ring = round(h / 2)
            pairs[ring] = pairs.get(ring, 0) + 1
            far[ring] = far.get(ring, 0) + h
            products[ring] = products.get(ring, 0) + values[i] * values[j]
    rings = sorted(pairs)
    assert found.distances_um == pytest.approx([far[k] / pairs[k] for k in rings])
    put_back = found.sill - float(np.mean(values**2))
    assert put_back > 0
    assert found.values == pytest.approx(
        [found.sill - put_back - products[k] / pairs[k] for k in rings]
    )


@pytest.mark.parametrize(("length", "md_deg"), [((3, 9), 0.0), ((9, 3), 90.0), ((9, 3), -90.0)])
def test_ranges_along_and_across_the_machine_direction(length, md_deg):
    rng = np.random.default_rng(3)
    found = [
        variogram(m, pixel_um=2.0, md_deg=md_deg)
        for m in gaussian_maps(rng, (150, 200), length, kind="gauss")
    ]
    # Directions of a sector other than its axis see a shorter range: of an ellipse 1 : 3, a mean of
    # about .8.
    along, across = (
        np.mean([getattr(v, k) for v in found]) for k in ("range_along_um", "range_across_um")
    )
    assert 0.7 * 18 < along < 1.1 * 18
    assert across == pytest.approx(6, rel=0.15)  # 2 maps scatter by .07
    assert found[0].ratio == pytest.approx(found[0].range_along_um / found[0].range_across_um)
    assert all(v.range_across_um < v.range_um < v.range_along_um for v in found)


def test_an_isotropic_map_has_a_ratio_of_one_with_a_direction_and_none_without():
    rng = np.random.default_rng(4)
    found = [
        variogram(gaussian_maps(rng, (120, 160), 4.0)[0], pixel_um=1.0, md_deg=30).ratio
        for _ in range(6)
    ]
    assert np.mean(found) == pytest.approx(1, abs=0.1)
    found = variogram(gaussian_maps(7, (60, 80), 3.0)[0], pixel_um=1.0)
    assert math.isnan(found.range_along_um)
    assert math.isnan(found.ratio)


def test_the_machine_direction_turns_clockwise_on_the_screen():
    y, x = np.mgrid[0:150, 0:200]
    # Stripes along 45 deg: towards growing columns and growing rows.
    a = gaussian_maps(5, (1, 400), 4.0)[0][0][(x - y + 150) % 400]
    one, other = (variogram(a, pixel_um=1.0, md_deg=md_deg) for md_deg in (45, -45))
    assert one.range_along_um > 3 * one.range_across_um
    assert (other.range_along_um, other.range_across_um) == (
        one.range_across_um,
        one.range_along_um,
    )


def test_missing_pixels_do_not_count_and_scale_and_offset_carry_over():
    a = gaussian_maps(8, (60, 80), 3.0)[0]
    known = np.ones(a.shape, bool)
    known[10:30, 20:50] = False
    one = variogram(np.where(known, a, np.nan), pixel_um=1.0)
    two = variogram(np.where(known, a, np.nan), pixel_um=1.0)
    assert (one.values, one.nugget) == (
        pytest.approx(two.values),
        pytest.approx(two.nugget, abs=1e-6),
    )
    a = gaussian_maps(9, (60, 80), 3.0)[0]
    one, two = variogram(a, pixel_um=1.0), variogram(3 * a + 50, pixel_um=1.0)
    assert (two.sill, two.range_um) == (
        pytest.approx(9 * one.sill),
        pytest.approx(one.range_um, rel=1e-4),
    )


def test_wrong_input_is_refused():
    a = gaussian_maps(10, (30, 40), 3.0)[0]
    refused(CannotMeasure, "constant", variogram, np.ones((30, 40)), pixel_um=1.0)
    refused(CannotMeasure, "0 pixels", variogram, np.full(a.shape, np.nan), pixel_um=1.0)
    refused(CannotMeasure, "larger map", variogram, a[:5, :5], pixel_um=1.0)
    refused(InputError, "two dimensions", variogram, a.ravel(), pixel_um=1.0)


@pytest.mark.nightly
def test_gstools_says_the_same():
    """Means over the same pairs: gstools takes half the square of differences, planish the
    covariance."""
    gstools = pytest.importorskip("gstools")
    shape = (60, 80)
    a = gaussian_maps(11, shape, 3.0)[0] + 0.5 * np.random.default_rng(12).normal(size=shape)
    found = variogram(a, pixel_um=1.0)
    edges = np.arange(0.5, 15.0)
    at = [np.arange(80.0), np.arange(60.0)]
    _, gamma = gstools.vario_estimate(at, a.T, bin_edges=edges, mesh_type="structured")
    assert found.values[: len(gamma)] == pytest.approx(gamma, rel=0.05)
