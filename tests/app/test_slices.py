"""Slices of a session: they show the file's voxels and the run's surfaces where these are, in every
pose."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy import ndimage

from planish.app import changes, slices, view_routes
from planish.core.errors import InputError
from planish.core.frame import Frame
from planish.run import changed, open_run, read_study, run_study
from planish.surface import Corrections, correct_surfaces


@pytest.fixture(params=["upright", "laid"])
def folder(kinds, request):
    return kinds(request.param)


def opened(folder):
    study = read_study(folder / "run.toml")
    ((name, (params, store)),) = slices.sheets_of(folder, study).items()
    return slices.SlicedSheet.open(name, params, store)


def voxels(folder):
    study = read_study(folder / "run.toml")
    return tifffile.imread(study.layers[0].volume.path)


def test_a_slice_shows_the_voxels_of_the_file_with_the_top_up(folder):
    sheet, whole = opened(folder), voxels(folder)
    for direction in ("z", "y", "x"):
        index = sheet.count(direction) // 3
        cut = sheet.cut(direction, index)
        facts = cut.facts
        assert cut.pixels.shape == (facts.down.count, facts.across.count)
        rng = np.random.default_rng(2)
        for row, col in zip(
            rng.integers(0, facts.down.count, 20),
            rng.integers(0, facts.across.count, 20),
            strict=True,
        ):
            place = {facts.normal: facts.at_um}
            place[facts.across.name] = facts.across.first_um + col * facts.across.step_um
            place[facts.down.name] = facts.down.first_um + row * facts.down.step_um
            at = tuple(round(place[axis] / sheet.voxels_um(axis)[1]) for axis in "zyx")
            assert facts.offset + facts.scale * int(cut.pixels[row, col]) == whole[at]
        if direction != sheet.frame.through:
            assert np.sign(facts.down.step_um) == -sheet.frame.sign  # from the top downwards
    with pytest.raises(InputError, match="There is no slice 9999"):
        sheet.cut("z", 9999)


def test_the_lines_of_a_slice_are_the_surfaces_of_the_run(folder):
    sheet, surfaces = opened(folder), open_run(folder).groups["surfaces"]
    frame = Frame.of(surfaces)
    for direction, axis in ((frame.rows, 0), (frame.cols, 1)):
        index = sheet.count(direction) // 2
        cut = sheet.cut(direction, index)
        row = index // sheet.step
        lines = dict(zip(cut.facts.lines, cut.lines, strict=True))
        for name in (*slices.HEIGHTS, "status", "thickness_se"):
            np.testing.assert_array_equal(
                lines[name], np.take(surfaces[name].values, row, axis).astype(np.float32)
            )
        normal = np.stack([lines[f"normal_{part}"] for part in ("rows", "cols", "through")])
        known = np.isfinite(normal).all(axis=0)
        assert known.mean() > 0.8
        np.testing.assert_allclose((normal[:, known] ** 2).sum(axis=0), 1, rtol=1e-5)
        assert (np.sign(normal[2, known]) == frame.sign).all()  # towards the top
        assert cut.facts.columns.first_um == surfaces["x" if axis == 0 else "y"].values[0]


def test_a_straightened_slice_is_the_volume_along_the_normals(folder):
    sheet, surfaces, whole = opened(folder), open_run(folder).groups["surfaces"], voxels(folder)
    frame, row = Frame.of(surfaces), sheet.count("straight") // 2
    cut = sheet.cut("straight", row)
    facts, lines = cut.facts, dict(zip(cut.facts.lines, cut.lines, strict=True))
    assert (lines["centre"] == 0).all()
    known = np.flatnonzero(np.isfinite(lines["top"] + lines["bottom"]) & (lines["status"] == 0))
    assert known.size > 50
    # The faces along the normals are as far apart as was measured.
    np.testing.assert_allclose(
        (lines["top"] - lines["bottom"])[known], surfaces["thickness"].values[row, known], atol=1e-3
    )
    for col in known[:: max(1, known.size // 10)]:
        for k in (facts.down.count // 3, facts.down.count // 2):
            s = facts.down.first_um + k * facts.down.step_um
            place = {
                frame.rows: facts.at_um,
                frame.cols: facts.across.first_um + col * facts.across.step_um,
                frame.through: float(surfaces["centre"].values[row, col]),
            }
            for part in ("rows", "cols", "through"):
                place[getattr(frame, part)] += s * float(lines[f"normal_{part}"][col])
            at = [[place[axis] / sheet.voxels_um(axis)[1]] for axis in "zyx"]
            grey = ndimage.map_coordinates(whole.astype(np.float32), at, order=1, cval=np.nan)[0]
            code = int(cut.pixels[k, col])
            if np.isnan(grey):  # beside the volume
                assert code == facts.missing
            else:
                assert facts.offset + facts.scale * code == pytest.approx(grey, abs=0.05)


def test_a_slice_along_the_sheet_has_the_contours_of_its_surfaces(folder):
    sheet, surfaces = opened(folder), open_run(folder).groups["surfaces"]
    through = Frame.of(surfaces).through
    height = float(np.nanmedian(surfaces["top"].values))
    index = int(np.abs(sheet.voxels_um(through) - height).argmin())
    cut = sheet.cut(through, index)
    of = dict(zip(cut.facts.segments, cut.contours, strict=True))
    assert len(of["top"]) > 20
    # At the ends of a segment the face lies at the slice's height.
    col = (of["top"][:, 0] - surfaces["x"].values[0]) / np.diff(surfaces["x"].values[:2])
    row = (of["top"][:, 1] - surfaces["y"].values[0]) / np.diff(surfaces["y"].values[:2])
    at = ndimage.map_coordinates(
        np.nan_to_num(surfaces["top"].values, nan=1e6), [row, col], order=1
    )
    assert np.percentile(np.abs(at - cut.facts.at_um), 95) < 1e-2


def test_a_message_has_its_parts_at_places_of_four_bytes_and_contours_are_straight(linked_run):
    sheet = opened(linked_run)
    cut = sheet.cut(sheet.frame.rows, 40)
    data = view_routes.slice_message(cut)
    (length,) = struct.unpack("<I", data[:4])
    facts = json.loads(data[4 : 4 + length])
    assert length % 4 == 0
    count = facts["across"]["count"] * facts["down"]["count"]
    pixels = np.frombuffer(data, "<u2", count, 4 + length)
    assert pixels.tobytes() == cut.pixels.tobytes()
    at = 4 + length + 2 * count + (-2 * count) % 4
    top = np.frombuffer(data, "<f4", facts["columns"]["count"], at)
    np.testing.assert_array_equal(top, cut.lines[0])
    y, x = np.arange(5.0), np.arange(7.0)
    found = slices.contour(np.broadcast_to(x - 2.25, (5, 7)), x, y)
    np.testing.assert_allclose(found[:, [0, 2]], 2.25)
    assert np.hypot(found[:, 2] - found[:, 0], found[:, 3] - found[:, 1]).sum() == pytest.approx(4)
    assert slices.contour(np.full((5, 7), np.nan), x, y).shape == (0, 4)


def stretch_in(surfaces, *, off_um=12.0):
    """Six points above the measured top of a sheet."""
    frame = Frame.of(surfaces)
    rows, cols = np.nonzero(ndimage.binary_erosion(surfaces["status"].values == 0, iterations=12))
    row, col = rows[rows.size // 2], cols[rows.size // 2]
    points = []
    for k in range(-10, 11, 4):
        place = {
            frame.through: surfaces["top"].values[row, col + k] + frame.sign * off_um,
            frame.rows: surfaces["y"].values[row],
            frame.cols: surfaces["x"].values[col + k],
        }
        points.append(
            changes.CorrectedPoint(**{axis: float(place[axis]) for axis in "zyx"}, face="top")
        )
    return int(row), changes.Correct(id="c1", points=tuple(points), reach_um=40.0)


def test_what_is_tried_shows_what_apply_makes(folder):
    sheet, surfaces = opened(folder), open_run(folder).groups["surfaces"]
    row, correction = stretch_in(surfaces)
    asked = changes.stretches_of([correction], "sheet", "sheet")
    cut = sheet.cut(sheet.frame.rows, row * sheet.step, corrections=asked)
    lines = dict(zip(cut.facts.lines, cut.lines, strict=True))
    corrected = correct_surfaces(surfaces, sheet.volume, asked)
    assert (corrected["correction_top"].values[row] > 0).any()
    np.testing.assert_array_equal(
        lines["preview_top"], corrected["top"].values[row].astype(np.float32)
    )
    np.testing.assert_array_equal(lines["top"], surfaces["top"].values[row].astype(np.float32))


def test_corrections_become_a_file_of_the_new_run_and_come_back(linked_run, tmp_path):
    study, surfaces = read_study(linked_run / "run.toml"), open_run(linked_run).groups["surfaces"]
    row, correction = stretch_in(surfaces)
    state = changes.State(marks={}, corrections=(correction,))
    ((name, made),) = changes.changed_corrections(study, (), state.corrections).items()
    file = tmp_path / "made.json"
    file.write_text(made.to_json(), encoding="utf-8")
    layers = tuple(
        (
            changed(one, surface=changed(one.surface, corrections=str(file)))
            if one.name == name
            else one
        )
        for one in study.layers
    )
    run_study(changed(study, layers=layers), tmp_path / "new", old=linked_run)
    file.unlink()
    new = read_study(tmp_path / "new" / "run.toml")
    assert (
        Path(str(new.layers[0].surface.corrections)) == tmp_path / "new" / "edits" / "surface.json"
    )
    corrected = open_run(tmp_path / "new").groups["surfaces"]
    drawn = corrected["correction_top"].values > 0
    assert drawn[row].any()
    assert corrected["bottom"].equals(surfaces["bottom"])
    old, top = (one["top"].values[~drawn] for one in (surfaces, corrected))
    assert (top == old)[np.isfinite(old)].all()
    (back,) = changes.corrections_of(new)
    assert (back.points, back.reach_um) == (correction.points, correction.reach_um)
    assert changes.changed_corrections(new, (back,), (back,)) == {}
    assert changes.changed_corrections(new, (back,), ()) == {"sheet": Corrections()}
    # Taken back, the run has the surfaces that it began with.
    bare = tuple(changed(one, surface=changed(one.surface, corrections=None)) for one in new.layers)
    run_study(changed(new, layers=bare), tmp_path / "back", old=tmp_path / "new")
    assert open_run(tmp_path / "back").groups["surfaces"].identical(surfaces)
    assert (tmp_path / "back" / "results.json").read_bytes() == (
        linked_run / "results.json"
    ).read_bytes()
    assert not (tmp_path / "back" / "edits").exists()
