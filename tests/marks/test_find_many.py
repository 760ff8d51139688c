"""Thousands of holes: none is lost where the light is poor, and overlaps are judged as pair by
pair."""

import numpy as np
import pytest
from scipy import ndimage

from planish.marks import candidates, find_holes, hole_criteria
from planish.marks._edge_kernels import half_level_edges
from planish.marks.rims import MARK


@pytest.mark.ci
def test_dim_regions_keep_their_holes(monkeypatch):
    """On the left half the sheet has a fifth of the light; with a limit for the whole image that
    would have no hole."""
    monkeypatch.setattr(candidates, "ENOUGH_CANDIDATES", 150)
    rng, across, pitch = np.random.default_rng(0), 18, 300.0
    side = int(across * pitch / 10)
    y, x = np.mgrid[:side, :side] * 10.0
    dot = np.hypot(x % pitch - pitch / 2, y % pitch - pitch / 2) < 80
    light = 0.6 + 0.4 * np.tanh((x - x.max() / 2) / 500)
    image = ndimage.gaussian_filter(light * (1 - 0.8 * dot), 0.7) + rng.normal(
        0, 0.004, (side, side)
    )
    found = find_holes(image, pixel_um=10.0)
    left = np.count_nonzero(found.x.values < 0.5 * across * pitch)
    assert found.sizes["mark"] >= 0.98 * across**2
    assert left >= 0.97 * across**2 / 2


def test_each_part_of_an_image_has_a_limit_of_its_own():
    rng = np.random.default_rng(0)
    crowded, sparse = rng.uniform(0, 1999, (3000, 3)), rng.uniform(2001, 20000, (4000, 3))
    kept = candidates._strongest_by_tile(np.concatenate([crowded, sparse]), 50.0)
    assert np.count_nonzero(kept[:3000]) == 510
    assert kept[:510].all()
    assert kept[3000:].all()
    assert candidates._strongest_by_tile(crowded, 50.0).all(), "a small image keeps all"


def rows_of(rng, count, field):
    numbers = rng.uniform(0.0, 1.0, count * MARK.itemsize // 8)
    rows = numbers.view(MARK).view(np.recarray)
    rows.centre *= field
    rows.radius = rng.uniform(50, 150, count)
    rows.outside = rows.inside + rng.uniform(0.5, 3.0, count)
    return rows


def apart(rows, row):
    x, y = (rows.centre - row.centre).T
    return np.hypot(x, y) - rows.radius - row.radius


def quality(rows):
    rough = np.sqrt(rows.roughness**2 + 0.5 * rows.half_difference**2)
    return rows.coverage - rough / rows.radius


def naive_deepest_disjoint(rows):
    step = rows.outside - rows.inside
    deepest = [
        not np.any((row.inside - rows.inside > hole_criteria.DEEPER * s) & (apart(rows, row) < 0))
        for row, s in zip(rows, step, strict=True)
    ]
    kept = []
    for at in np.argsort(-quality(rows), kind="stable"):
        if deepest[at] and np.all(apart(rows[kept], rows[at]) >= 0):
            kept.append(at)
    return rows[kept]


def naive_joined(rows, floors):
    for k in range(len(floors)):
        floor = floors[k : k + 1]
        on = apart(rows, floors[k]) < 0
        if np.all(quality(rows[on]) + hole_criteria.BETTER < quality(floor)):
            rows = np.concatenate([rows[~on], floor]).view(np.recarray)
    return rows


@pytest.mark.parametrize("count", [0, 1, 40, 300])
def test_overlaps_are_judged_as_pair_by_pair(count):
    rng = np.random.default_rng(count)
    rows, others = rows_of(rng, count, 2000.0), rows_of(rng, count // 2, 2000.0)
    clear, floors = naive_deepest_disjoint(rows), naive_deepest_disjoint(others)
    np.testing.assert_array_equal(hole_criteria.deepest_disjoint(rows), clear)
    both = hole_criteria.merge_floors(clear, floors)
    np.testing.assert_array_equal(both, naive_joined(clear, floors))
    if count == 300:
        assert len(clear) < len(both) < len(clear) + len(floors)


def test_an_outline_that_bends_through_its_centre_has_no_edge_there():
    """Torn holes of a stack in the wrong order: the ellipse of a floor had a half axis below
    zero."""
    image = np.ones((60, 60), np.float32)
    y, x = np.indices(image.shape)
    image[np.hypot(x - 30, y - 30) < 12] = 0.0
    model = np.where(np.arange(96) < 48, 48.0, -60.0)
    radii, *_ = half_level_edges(image, 4.0, 4.0, 1.0, 120.0, 120.0, model, 8.0)
    np.testing.assert_allclose(radii[:48], 48.0, atol=4.0)
    assert np.isnan(radii[48:]).all()
