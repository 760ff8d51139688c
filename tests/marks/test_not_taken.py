"""What was seen and is no hole is counted by reason; texture and contrast are those of the
neighbourhood."""

import numpy as np
import pytest
from benchmarks.hole_scenes import make_scene

from marks.holes import make_hole, scene
from planish.checks import check_holes
from planish.marks import REASONS, candidates, find_holes, holes_from_json, holes_to_json


def row_of_holes(change=None, **more):
    """Six holes of 180 um in a row, pixels of 2.6 um; ``change(k, hole)`` alters one, ``more`` goes
    to the scene."""
    rng = np.random.default_rng(3)
    holes = [make_hole(rng, 300.0 + 450 * k, 350.0) for k in range(6)]
    for k, hole in enumerate(holes):
        if change is not None:
            change(k, hole)
    return scene(rng, (280, 1080), 2.6, holes, **({"mottle": 0.05} | more))


def counted(found):
    assert list(found.attrs["not_taken"]) == list(REASONS)
    return {reason: count for reason, count in found.attrs["not_taken"].items() if count}


def test_nothing_is_counted_where_all_is_taken():
    found = find_holes(row_of_holes().image, pixel_um=2.6)
    assert (found.sizes["mark"], counted(found)) == (6, {})
    check = check_holes(found)
    assert (check.state, check.sentence) == ("pass", "6 holes found.")
    assert holes_from_json(holes_to_json(found)).attrs["not_taken"] == found.attrs["not_taken"]


def test_holes_of_another_size_are_counted():
    def sizes(k, hole):
        hole.outline = hole.outline * (0.48 if k == 1 else 1.9 if k == 4 else 1.0)

    found = find_holes(row_of_holes(sizes).image, pixel_um=2.6)
    assert (found.sizes["mark"], counted(found)) == (4, {"too_small": 1, "too_large": 1})
    assert (
        check_holes(found).sentence
        == "4 holes found; seen and not taken: 1 too small, 1 too large."
    )


def test_a_blot_without_char_is_unlike_the_others():
    def blot(k, hole):
        if k == 2:
            hole.char, hole.outline = 0.0 * hole.char, np.full_like(hole.outline, 105.0)

    found = find_holes(row_of_holes(blot).image, pixel_um=2.6)
    assert (found.sizes["mark"], counted(found)) == (5, {"unlike": 1})


def test_faint_closed_and_cut_holes_are_counted():
    sheet = row_of_holes(mottle=0.08, length_um=60.0)
    image = sheet.image.copy()
    y, x = np.indices(image.shape) * 2.6
    holes = sheet.holes
    # 40 % closed.
    image[(np.hypot(x - holes[1].x, y - holes[1].y) < 100) & (x > holes[1].x + 20)] = 0.9
    found = find_holes(image[:, 95:], pixel_um=2.6)  # the border cuts a fifth off the first
    assert (found.sizes["mark"], counted(found)) == (4, {"cut": 1, "not_round": 1})
    pale = np.hypot(x - holes[4].x, y - holes[4].y) < 150
    for share, reason in ((0.42, "too_faint"), (0.5, "unlike")):
        part = sheet.image.copy()
        part[pale] = 1.0 - share * (1.0 - part[pale])
        found = find_holes(part, pixel_um=2.6)
        assert (found.sizes["mark"], counted(found)) == (5, {reason: 1})


def test_places_beyond_the_limit_of_an_area_are_counted_and_are_a_look(monkeypatch):
    monkeypatch.setattr(
        candidates, "_strongest_by_tile", lambda places, _radius: np.arange(len(places)) < 2
    )
    found = find_holes(row_of_holes().image, pixel_um=2.6)
    assert found.sizes["mark"] == 2
    assert counted(found)["not_measured"] >= 4
    check = check_holes(found)
    assert check.state == "look"
    assert "2 holes found; seen and not taken:" in check.sentence
    assert "`hole_um`" in check.remedy


@pytest.mark.parametrize("shape", [(300, 400), (8, 9)])
@pytest.mark.parametrize("share", [0.25, 0.5])
def test_what_is_usual_around_a_place(shape, share):
    """Beside a slow twin that takes every value of the nine squares."""
    rng = np.random.default_rng(0)
    values = (rng.normal(size=shape) * (1 + 9 * (np.arange(shape[1]) > shape[1] / 2))).astype(
        np.float32
    )
    values[rng.random(shape) < 0.2] = np.nan
    around = candidates.local_spread(candidates.Raster(values, (2.0, 3.0)), 30.0, share)
    down, across = min(15, shape[0]), min(10, shape[1])
    step = max(1, down // candidates.SAMPLES), max(1, across // candidates.SAMPLES)
    down, across = down // step[0] * step[0], across // step[1] * step[1]
    for i, j in ((0, 0), (shape[0] - 1, shape[1] // 3), (shape[0] // 2, shape[1] - 1)):
        y, x = i // down * down, j // across * across
        part = values[
            max(0, y - down) : y + 2 * down : step[0], max(0, x - across) : x + 2 * across : step[1]
        ]
        part = part[np.isfinite(part)]
        deviation = np.sort(np.abs(part - np.sort(part)[round(0.5 * (part.size - 1))]))
        expected = deviation[round(share * (part.size - 1))] / candidates.TO_SD[share]
        assert around.at_points(np.array([[3.0 * j, 2.0 * i]]))[0] == pytest.approx(
            expected, rel=1e-5
        )


def test_texture_far_away_hides_no_hole():
    """The right half shines ten times as bright, with its mottle; the left keeps its holes."""
    sheet = make_scene(5, "mottle", 12)
    columns = np.arange(sheet.image.shape[1])
    light = 1 + 9 / (1 + np.exp((columns.mean() - columns) / 3))
    plain, lit = (
        find_holes(image, pixel_um=sheet.pixel) for image in (sheet.image, sheet.image * light)
    )
    assert lit.sizes["mark"] >= plain.sizes["mark"] - 1
    assert np.isin(np.round(lit.x.values / 30), np.round(plain.x.values / 30)).mean() > 0.9


def test_dark_spots_are_spots_and_no_ground_that_is_dark_all_over():
    """Beside a sheet the ground is as dark as the floors of its holes, and is no place of one."""
    y, x = np.mgrid[:300, :400] * 5.0
    image = np.where(x < 800.0, 200.0, 20.0)
    image[np.hypot(x - 400.0, y - 700.0) < 80.0] = 20.0
    raster = candidates.Raster(image, (5.0, 5.0), np.zeros(2))
    spots = candidates.dark_spots(raster, 1.0, 60.0, 80.0)
    inside = spots[spots[:, 0] < 700.0]
    assert np.hypot(*(inside - (400.0, 700.0)).T).max() < 20.0
    assert len(inside) >= 1
    assert not (spots[:, 0] > 1000.0).any()
