"""Marks that a person sets with the mouse: where detection was refused, as good as detection, and with errors."""

import re
import shutil

import numpy as np
import pytest

from app.marks_page import IMAGE, VOLUME, ends, expect, message, pair, settled
from planish.io import read_group
from planish.run import Registration, open_run

pytestmark = pytest.mark.nightly

OFF_PX = 1.5
"""Farthest that a click misses its place, in image pixels."""


def missed(draw, count, pixel_um):
    """By how much clicks miss their places, (count, 2) in um."""
    turn, away = draw.uniform(0, 2 * np.pi, count), OFF_PX * pixel_um * np.sqrt(draw.uniform(0, 1, count))
    return np.stack([away * np.cos(turn), away * np.sin(turn)], 1)


def rms(shown):
    """Residual of the fit that the page states."""
    settled(shown)
    text = shown.page.get_by_text(re.compile("pairs in use, residual .*rms")).inner_text()
    return float(re.search(r"residual ([\d.]+) µm", text)[1])


def test_an_image_with_two_holes_is_linked_by_hand(
    refuses, refused, specimen, specimen_files, linked_run, serve, window, tmp_path
):
    kept, image = refused
    pixel_um = specimen.params.camera.pixel_um
    out = kept.with_name(tmp_path.name)
    maps = kept.with_name(f"{out.name}-map")
    size = ("--pixel-um", str(pixel_um))
    instead = (f"planish map {specimen_files[0]} --out {maps}", f"planish view {maps} {image}")
    words = ("Only 2 holes found in the image", *instead)
    refuses("link", specimen_files[0], image, "--out", out, *size, "--by", "holes", words=words, out=False)
    shutil.copytree(kept, maps)  # that map

    # Places from the run of the whole image: its five holes, of which three are gone in this one, and two beside them.
    whole = Registration.read(linked_run / "marks.json")
    holes = np.stack([whole.marks[f"moving_{axis}"].values for axis in "xy"], 1)
    moving = np.concatenate([holes, [holes[[0, 1]].mean(0), holes[[2, 3]].mean(0)]])
    fixed = whole.fit.transform(moving)
    draw = np.random.default_rng(3)
    moving, fixed = (points + missed(draw, len(points), pixel_um) for points in (moving, fixed))
    shown = window(serve(maps, str(image), *size))
    expect(shown.page.get_by_text(re.compile("^No pair yet"))).to_be_visible()
    shown.page.get_by_label("Move views together").uncheck()
    for view in (VOLUME, IMAGE):
        shown.fill(f"{view}, um per screen pixel", "2")
    for one, other in zip(moving, fixed, strict=True):
        pair(shown, one, other)
    assert ends(settled(shown)) == pytest.approx(np.concatenate([moving, fixed], 1), abs=0.011)
    shown.role("button", "Apply").click()
    expect(shown.page.get_by_role("link", name=re.compile("report"))).to_be_visible(timeout=300_000)

    run = open_run(out)
    assert run.marks.sizes["mark"] == len(moving)
    assert (out / "report.html").is_file()
    found, true = run.linked, specimen.truth
    off = np.hypot(found.volume_x.values - true.volume_x.values, found.volume_y.values - true.volume_y.values)
    measured = found.valid.values & np.isfinite(off)
    assert measured.mean() > 0.3
    said, real = float(np.median(found.expected_error.values[measured])), float(np.sqrt(np.mean(off[measured] ** 2)))
    print(f"off by {real:.1f} um rms, {said:.1f} um said")
    assert real < OFF_PX * pixel_um
    assert real < 2 * said


def test_clicks_that_are_snapped_are_as_good_as_detection(demo_run, serve, window, tmp_path):
    shown = window(serve(shutil.copytree(demo_run, tmp_path / "run")))
    detected, rows = rms(shown), settled(shown)
    pixel_um = float(np.diff(read_group(demo_run / "maps.zarr", "linked").x.values[:2])[0])
    draw = np.random.default_rng(4)
    for row in rows:
        shown.role("button", row[0]).click()
        shown.role("button", "Delete").click()
        expect(message(shown)).to_contain_text(f"{row[0]} deleted")
    shown.page.get_by_label("Move views together").uncheck()
    for at in ends(rows):
        one, other = at.reshape(2, 2) + missed(draw, 2, pixel_um)
        pair(shown, one, other)
    clicked = rms(shown)
    for row in settled(shown):
        shown.role("button", row[0]).click()
        shown.role("button", "Snap").click()
        expect(message(shown)).to_contain_text(f"{row[0]} snapped")
    snapped = rms(shown)
    print(f"rms: detected {detected}, clicked {clicked}, snapped {snapped} um")
    assert clicked > 1.2 * detected
    assert snapped == pytest.approx(detected, rel=0.2)


@pytest.mark.parametrize("count", [6, 12])
def test_two_errors_of_60_um_stand_first_after_one_click_and_are_named(demo_run, serve, window, tmp_path, count):
    shown = window(serve(shutil.copytree(demo_run, tmp_path / "run")))
    known = ends(settled(shown))
    whole = Registration.read(demo_run / "marks.json")
    draw = np.random.default_rng(count)
    shown.page.get_by_label("Move views together").uncheck()
    low, high = known[:, :2].min(0), known[:, :2].max(0)
    moving = known[:, :2]
    while len(moving) < count:
        one = draw.uniform(low, high)
        if np.hypot(*(moving - one).T).min() < 120:  # um: a click at a mark chooses it
            continue
        moving = np.concatenate([moving, [one]])
        off = missed(draw, 2, 4.0)
        pair(shown, one + off[0], whole.fit.transform(one[None])[0] + off[1])
    names = [row[0] for row in settled(shown)]
    wrong = sorted(draw.choice(count, 2, replace=False))
    shown.fill(f"{IMAGE}, um per screen pixel", "6")
    for k in wrong:
        key = draw.choice(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"])
        before = ends(shown.rows())[k]
        shown.role("button", names[k]).click()
        for _ in range(2):
            shown.role("application", IMAGE).press(f"Shift+{key}")
        axis, step = ("x", 60) if key in ("ArrowLeft", "ArrowRight") else ("y", 60)
        there = before[2 if axis == "x" else 3] + (-step if key in ("ArrowLeft", "ArrowUp") else step)
        expect(shown.role("table", "Marks")).to_contain_text(f"{there:.2f}")
    settled(shown)
    shown.role("columnheader", "Leave-one-out um").click()
    first = [row[0] for row in settled(shown)[:2]]
    print(first, message(shown).inner_text())
    assert sorted(first) == sorted(names[k] for k in wrong)
    for k in wrong:
        expect(message(shown)).to_contain_text(names[k])
