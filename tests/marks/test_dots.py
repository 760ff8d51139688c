"""The dots of a print are taken off, and holes, with which they touch, stay where they are."""

import numpy as np
import pytest

from planish.marks import find_holes, without_dots
from planish.marks._rim_kernels import edge_worth

PITCH, DOT, HOLE, PIXEL = 167.0, 119.0, 175.0, 4.0
CENTRES = np.array([[420.0, 400.0], [1180.0, 480.0], [700.0, 900.0], [1240.0, 1010.0]])  # (x, y)


def printed(shape=(330, 400), *, holes=CENTRES, pixel=PIXEL, noise=0.005):
    """A screen of 40 % at 45 degrees, with holes in it; both are black, with edges one pixel
    wide."""
    y, x = np.mgrid[: shape[0], : shape[1]] * pixel
    a, b = (x + y) / np.sqrt(2) / PITCH, (x - y) / np.sqrt(2) / PITCH
    away = np.hypot(a - np.floor(a) - 0.5, b - np.floor(b) - 0.5) * PITCH
    edge = DOT / 2 - away
    for cx, cy in holes:
        edge = np.maximum(edge, HOLE / 2 - np.hypot(x - cx, y - cy))
    grey = 0.8 - 0.7 * np.clip(edge / pixel + 0.5, 0, 1)
    return (grey + noise * np.random.default_rng(3).standard_normal(shape)).astype(np.float32)


@pytest.mark.ci
def test_holes_in_a_print_are_found_once_its_dots_are_off():
    image = printed()
    spoilt = find_holes(image, pixel_um=PIXEL, diameter_um=(140.0, 300.0))
    clean = find_holes(
        without_dots(image, (PIXEL, PIXEL), 140.0), pixel_um=PIXEL, diameter_um=(140.0, 300.0)
    )
    found = np.stack([clean.x, clean.y], axis=1)
    assert spoilt.sizes["mark"] == 0
    assert clean.sizes["mark"] >= len(CENTRES) - 1  # a dot may hide too much of a rim
    assert np.linalg.norm(found[:, None] - CENTRES[None], axis=2).min(axis=1).max() < 10.0


def test_dots_become_paper_and_nothing_else_changes():
    image = printed(noise=0.0)
    out = without_dots(image, (PIXEL, PIXEL), 140.0)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]] * PIXEL
    inside = np.min([np.hypot(x - a, y - b) for a, b in CENTRES], axis=0) < HOLE / 2 - 10
    assert np.array_equal(out[inside], image[inside])
    # A hole may cut a dot.
    far = np.min([np.hypot(x - a, y - b) for a, b in CENTRES], axis=0) > HOLE / 2 + DOT
    # a dot that the border cuts may stay.
    far[:30], far[-30:], far[:, :30], far[:, -30:] = False, False, False, False
    assert out[far].min() > 0.75
    paper = image > 0.79
    # Beside a dot the paper's median may stand.
    assert np.allclose(out[paper & far], image[paper & far], atol=0.011)


def test_an_image_without_dots_or_without_values_stays_as_it_is():
    plain = np.full((60, 80), 0.5, dtype=np.float32)
    assert np.array_equal(without_dots(plain, (5.0, 5.0), 100.0), plain)
    empty = np.full((60, 80), np.nan, dtype=np.float32)
    assert np.isnan(without_dots(empty, (5.0, 5.0), 100.0)).all()
    image = printed()
    image[100:140, 200:260] = np.nan
    out = without_dots(image, (PIXEL, PIXEL), 140.0)
    assert np.array_equal(np.isnan(out), np.isnan(image))


@pytest.mark.parametrize("pixel", [1.3, 2.6, 8.0])
def test_fine_and_coarse_pixels_give_the_same_holes(pixel):
    shape = tuple(int(n * PIXEL / pixel) for n in (330, 400))
    image = printed(shape, pixel=pixel, noise=0.0)
    out = without_dots(image, (pixel, pixel), 140.0)
    dark = float(np.count_nonzero(out < 0.4)) * pixel**2
    border = 2 * (shape[0] + shape[1]) * pixel * DOT / 3  # of dots that it cuts
    holes = len(CENTRES) * np.pi / 4 * HOLE**2
    assert 0.9 * holes < dark < 1.15 * holes + border


def test_an_edge_is_worth_as_much_where_the_rim_has_no_contrast():
    """On paper that is saturated the rim may rise by nothing at all, which ended the search with a
    fault."""
    rises = np.array([[0.0, 0.0, 2.0, 0.0, 0.0]])
    for step in (0.0, 1.0):
        assert edge_worth(rises, step).tolist() == [[0.0, 1.0, 1.0, 1.0, 0.0]]
    assert edge_worth(rises, 4.0).tolist() == [[0.0, 0.5, 0.5, 0.5, 0.0]]
