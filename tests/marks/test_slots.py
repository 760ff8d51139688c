"""Where the floor goes on, no circle closes: slots, keyholes and holes that run into each other."""

import csv

import numpy as np
import pytest
import tifffile
from scipy import ndimage
from scipy.spatial import KDTree

from planish.checks import check_holes
from planish.core.errors import CannotRegister
from planish.marks import find_holes
from planish.register import need_holes

RADIUS, PITCH = 87.5, 600.0


def slot(u, v, length):
    """A slot of two radii's width about (0, 0); ``length`` in widths."""
    half = (length - 1) * RADIUS
    return np.hypot(np.maximum(np.abs(u) - half, 0.0), v) < RADIUS


def keyhole(u, v, width):
    """A hole with a slit to one side; ``width`` in diameters."""
    return (np.hypot(u, v) < RADIUS) | ((u > 0) & (u < 2.2 * RADIUS) & (np.abs(v) < width * RADIUS))


def two(u, v, distance):
    """Two holes; their distance in diameters."""
    away = np.hypot(np.abs(u) - distance * RADIUS, v)
    return away < RADIUS


def square(u, v, side):
    """A square; its side in diameters."""
    return np.maximum(np.abs(u), np.abs(v)) < side * RADIUS


def sheet(shape, value, *, pixel=10.0, bright=False, round_count=4, seed=0):
    """Eight places with a shape at any turn, the first ``round_count`` with a round hole instead.

    Gives the image, the centres (n, 2) of the round holes and all centres, in um.
    """
    rng, sub = np.random.default_rng(seed), 4
    rows, cols = int(2 * PITCH / pixel), int(4 * PITCH / pixel)
    y, x = np.mgrid[: rows * sub, : cols * sub] * (pixel / sub) - 0.5 * pixel * (1 - 1 / sub)
    is_hole = np.zeros(x.shape, bool)
    places = (np.mgrid[:2, :4].reshape(2, -1).T[:, ::-1] + 0.5) * PITCH + rng.uniform(
        -40, 40, (8, 2)
    )
    order = rng.permutation(8)
    for k, (cx, cy) in enumerate(places[order]):
        turn = rng.uniform(0, 2 * np.pi)
        u = (x - cx) * np.cos(turn) + (y - cy) * np.sin(turn)
        v = (y - cy) * np.cos(turn) - (x - cx) * np.sin(turn)
        is_hole |= np.hypot(u, v) < RADIUS if k < round_count else shape(u, v, value)
    share = is_hole.reshape(rows, sub, cols, sub).mean(axis=(1, 3))
    share = ndimage.gaussian_filter(share, 0.6)
    image = (0.2 + 0.7 * share if bright else 0.8 - 0.7 * share) + rng.normal(0, 0.02, share.shape)
    return image, places[order[:round_count]], places[order]


def centres(holes):
    return np.stack([holes.x.values, holes.y.values], axis=1)


@pytest.mark.parametrize("bright", [False, True])
@pytest.mark.parametrize("pixel", [5.0, 20.0])
@pytest.mark.parametrize(
    ("shape", "value"),
    [(slot, 1.5), (slot, 2.0), (slot, 4.0), (keyhole, 0.8), (two, 0.5), (two, 0.8)],
)
def test_only_round_holes_are_taken_beside_open_ones(shape, value, pixel, bright):
    image, truth, _ = sheet(shape, value, pixel=pixel, bright=bright)
    holes = centres(find_holes(image, pixel_um=pixel))
    away = KDTree(truth).query(holes)[0]
    assert len(holes) == len(truth)
    assert away.max() < 0.1 * pixel + 1


@pytest.mark.parametrize("from_border", [50.0, 95.0, 130.0])
def test_a_slot_that_the_border_cuts_is_none(from_border):
    """Its straight sides run out of the image; the centre of its round end lies inside."""
    y, x = np.mgrid[:80, :160] * 10.0
    image = np.full(y.shape, 0.8)
    for cx in (300.0, 700.0, 1100.0):
        image[np.hypot(x - cx, y - 550.0) < RADIUS] = 0.1
    image[(np.abs(x - 900.0) < RADIUS) & (y < from_border)] = 0.1
    image[np.hypot(x - 900.0, y - from_border) < RADIUS] = 0.1
    holes = find_holes(ndimage.gaussian_filter(image, 0.6), pixel_um=10.0)
    assert sorted(holes.x.values.round(-1)) == [300.0, 700.0, 1100.0]


def test_a_hole_with_a_narrow_slit_keeps_its_centre():
    """A gap of a seventh of the diameter: the circle is known as well as any."""
    image, _, truth = sheet(keyhole, 0.15, round_count=0)
    holes = find_holes(image, pixel_um=10.0)
    assert holes.sizes["mark"] == len(truth)
    assert KDTree(truth).query(centres(holes))[0].max() < 3.0


def test_slots_alone_are_no_holes_and_the_messages_count_them():
    image, *_ = sheet(slot, 2.0, round_count=0)
    holes = find_holes(image, pixel_um=10.0).assign_attrs(layer="image")
    counts = holes.attrs["not_taken"]
    assert holes.sizes["mark"] == 0
    assert counts["open"] + counts["not_round"] >= 4
    assert "open to one side" in check_holes(holes).sentence
    with pytest.raises(CannotRegister, match=r"No hole .* Not taken: \d+ not round, or open"):
        need_holes(holes, (100.0, 300.0))


# --- a scan of punched paper ----------------------------------------------------------------------

PIXEL_UM = 84.6667


@pytest.fixture(scope="module", params=["a", "b"])
def roll(request, shared_data):
    """A part of a roll: the holes found, and the holes that are in it, in um."""
    folder = shared_data("punched_paper")
    with (folder / f"roll_{request.param}_truth.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    image = tifffile.imread(folder / f"roll_{request.param}.tif")
    holes = find_holes(image, pixel_um=PIXEL_UM, diameter_um=(900.0, 2500.0))
    columns = ("x_px", "y_px", "width_px", "height_px")
    x, y, width, height = (np.array([float(row[name]) for row in rows]) for name in columns)
    # As wide as high within a fifth; two of them have a notch, and the table calls them "other".
    is_round = np.abs(np.log(width / height)) < np.log(1.2)
    return holes, PIXEL_UM * np.stack([x, y], axis=1), is_round


def test_of_punched_paper_all_round_holes_are_found_and_no_end_of_a_slot(roll):
    holes, truth, is_round = roll
    away, nearest = KDTree(truth).query(centres(holes))
    assert np.count_nonzero(is_round) - holes.sizes["mark"] <= 1
    assert len(set(nearest)) == holes.sizes["mark"]
    is_right = is_round[nearest] & (away < 0.5 * PIXEL_UM)
    assert np.count_nonzero(~is_right) <= 0.02 * len(is_right)
    assert np.sqrt(np.mean(away[is_right] ** 2) / 2) < 0.1 * PIXEL_UM


def test_round_holes_lie_in_the_tracks_of_the_punch_as_closely_as_they_state(roll):
    """The punch aims at tracks, and the paper drifts across them: all openings show both."""
    holes, truth, _ = roll
    _, nearest = KDTree(truth).query(centres(holes))
    order = np.argsort(truth[:, 0])
    steps = np.diff(truth[order, 0]) > 12 * PIXEL_UM
    track = np.empty(len(truth), int)
    track[order] = np.concatenate([[0], np.cumsum(steps)])
    height = 2 * truth[:, 1] / truth[:, 1].max() - 1
    drift = np.stack([height**power for power in range(1, 9)], axis=1)
    design = np.concatenate([track[:, None] == np.unique(track), drift], axis=1).astype(float)
    fit = np.linalg.lstsq(design, truth[:, 0])[0]
    leverage = np.einsum("ij,ji->i", design, np.linalg.pinv(design))[nearest]
    error = holes.x.values - (design @ fit)[nearest]
    is_known = leverage < 0.5  # others are alone in their track
    stated = np.sqrt(holes.cov_xx.values * (1 - leverage))[is_known]
    assert 0.7 < np.sqrt(np.mean((error[is_known] / stated) ** 2)) < 1.4
