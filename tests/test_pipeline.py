"""The whole line on a specimen whose answers are known, through its files."""

import filecmp
import json
import tomllib

import numpy as np
import pytest
import xarray as xr

from folders import write_image
from planish.analyze import compare
from planish.cli import runs
from planish.marks import read_any
from planish.register import fit_transform
from planish.run import cached_maps, link, open_results, open_run, read_study, run, save_run

ROWS = [*(name for name, _, _ in compare.REGISTRATION_VARIANTS[:2]), "flattened, similarity"]


@pytest.fixture(scope="module")
def tree(linked_run):
    with xr.open_datatree(linked_run / "maps.zarr", engine="zarr") as opened:
        return opened.load()


@pytest.fixture(scope="module")
def results(linked_run):
    return json.loads((linked_run / "results.json").read_text())


def test_a_run_folder_holds_its_files_and_a_complete_study(linked_run):
    assert {p.name for p in linked_run.iterdir()} == {
        "figures.csv", "maps.zarr", "marks.csv", "marks.json", "results.json", "report.html", "run.toml",
    }  # fmt: skip
    study = tomllib.loads((linked_run / "run.toml").read_text())
    sheet, image = study["layers"]
    assert sheet["volume"]["voxel_um"] == pytest.approx([4.0] * 3)
    assert {"flatten", "surface", "properties"} <= set(sheet)
    assert {"holes", "registration", "correlate"} <= set(study)
    assert image["image"]["pixel_um"] == pytest.approx([5.0] * 2)
    assert not sheet["volume"]["path"].startswith("/")


def test_figures_are_written_on_request_beside_the_same_page(linked_run, tmp_path):
    save_run(open_run(linked_run), tmp_path, home=linked_run, figures=True)
    drawn = sorted((tmp_path / "figures").glob("*.svg"))
    page = (linked_run / "report.html").read_text(encoding="utf-8")
    assert len(drawn) == page.count("<figcaption>")
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == page


def test_groups_dims_and_variables(tree, specimen):
    assert tree["surfaces"].to_dataset().top.dims == ("y", "x")
    assert {"u", "v"} <= set(tree["flat"].data_vars)
    assert tree["maps"].to_dataset().thickness.dims == ("v", "u")
    linked = tree["linked"].to_dataset()
    assert (linked.image.dims, linked.image.shape) == (("y", "x"), specimen.image.shape)
    needed = {"coating_top", "coating_bottom", "base_thickness", "thickness", "topography_top", "topography_bottom"}
    assert needed | {"image", "valid", "volume_x", "volume_y", "volume_z"} <= set(linked.data_vars)
    assert linked.valid.dtype == bool
    # pixel i has its centre at i x size; the image states its size by a ratio of integers
    np.testing.assert_allclose(linked.x, np.arange(linked.sizes["x"]) * 5.0, rtol=1e-6)
    assert all(linked[name].attrs["units"] == "um" for name in needed)


def test_valid_means_measured_and_away_from_holes(linked, specimen):
    ok = linked.valid.values
    for name in ("coating_top", "base_thickness", "thickness", "volume_z"):
        assert np.isfinite(linked[name].values[ok]).all()
    # 100 um from the fitted circle; the true rim is rough by 4 um rms around an ellipse, 6 % longer than the circle
    assert specimen.truth["rim"].values[ok].min() > 84.0


def test_every_pixel_has_its_place_in_the_volume_and_r2_is_that_of_the_true_maps(linked, specimen):
    truth, ok = specimen.truth, linked.valid.values
    place = np.stack([linked[f"volume_{a}"].values for a in "xyz"], axis=-1)[ok]
    found = specimen.warp.material(place)
    true = np.stack([truth.u.values[ok], truth.v.values[ok]], axis=-1)
    error = np.linalg.norm(found[:, :2] - true, axis=1)
    rms = np.sqrt(np.mean(error**2))
    print(f"position error: median {np.median(error):.2f} um, rms {rms:.2f}, 95 % {np.percentile(error, 95):.2f} um")
    assert rms <= 1.5 * np.sqrt(np.nanmean(linked.expected_error.values[ok] ** 2))
    # Most of it is that of five holes, the same everywhere or growing evenly ...
    assert np.median(error) <= 0.7
    assert rms <= 0.75
    assert np.percentile(error, 95) <= 1.2
    # ... so the flattening is seen where the best similarity of all pixels is taken off; 0.22 um through the faces.
    left = fit_transform(true[::50], found[::50, :2], model="similarity", mirrored=False, robust=False)
    assert np.median(np.linalg.norm(left.residuals_um, axis=1)) <= 0.12
    ok = linked.valid.values
    ours, true = (
        np.corrcoef(values[ok], linked.image.values[ok])[0, 1] ** 2
        for values in (linked.coating_top.values, specimen.truth["coating_top"].values)
    )
    print(f"r2 {ours:.3f}, of the true maps {true:.3f}")
    assert ours == pytest.approx(true, abs=0.03)


@pytest.mark.parametrize(("name", "bias", "rmse"), [("coating_top", 0.3, 1.0), ("base_thickness", 0.6, 1.5)])
def test_properties_against_the_truth(linked, specimen, name, bias, rmse):
    ok = linked.valid.values
    error = linked[name].values[ok] - specimen.truth[name].values[ok]
    print(f"{name}: bias {error.mean():.3f} um, rmse {np.sqrt(np.mean(error**2)):.3f} um")
    assert abs(error.mean()) <= bias
    assert np.sqrt(np.mean(error**2)) <= rmse


def test_all_holes_are_matched_and_flattening_beats_both_projections(results, specimen):
    marks = results["layers"][0]["registration"]
    assert marks["matched"] == len(specimen.sheet.holes)
    assert marks["found_moving"] == marks["found_fixed"] == marks["matched"]
    # 2e-3: five holes, leaning and oval, whose centres err by 1 um over 1 mm
    assert marks["scale"] == pytest.approx(specimen.pose.similarity.scale, abs=2e-3)
    assert marks["leave_one_out_rms_um"] < 2.0
    at_pixel = {r["registration"]: r["r2"] for r in results["comparison"] if r["point_um"] < 50}
    print({k: round(v, 3) for k, v in at_pixel.items()})
    assert list(at_pixel) == ROWS
    # A gentle warp: 15 um of error against a coating that varies over 100 um.
    assert at_pixel[ROWS[2]] > at_pixel[ROWS[1]] + 0.03
    assert at_pixel[ROWS[2]] > at_pixel[ROWS[0]] + 0.05
    assert sorted(r["point_um"] for r in results["comparison"]) == pytest.approx([5.0] * 3 + [100.0] * 3)


@pytest.mark.nightly
def test_a_repeated_run_has_the_same_bytes(passes, linked_run):
    _, err = passes("run", linked_run / "run.toml")
    again = linked_run.with_name("run-again")
    assert f"same bytes as {linked_run}" in err
    files = [p.relative_to(linked_run) for p in linked_run.rglob("*") if p.is_file()]
    assert len(files) > 50
    assert all(filecmp.cmp(linked_run / f, again / f, shallow=False) for f in files)


def test_files_that_differ_are_named_and_those_of_maps_counted(linked_run, run_copy, capsys):
    runs._compare(linked_run, run_copy)
    assert f"{run_copy}: same bytes as {linked_run}" in capsys.readouterr().err
    chunks = sorted((run_copy / "maps.zarr/linked/image/c").rglob("[0-9]"))
    for path in (*chunks, run_copy / "maps.zarr/maps/u/zarr.json", run_copy / "figures.csv"):
        if path.is_file():
            path.write_bytes(path.read_bytes() + b" ")
    count = 1 + sum(path.is_file() for path in chunks)
    runs._compare(linked_run, run_copy)
    said = f"{run_copy}: {count} files of maps.zarr (linked, maps), figures.csv differ from {linked_run}"
    assert said in capsys.readouterr().err


def test_a_run_of_other_code_is_said_to_be_one_and_its_maps_are_not_taken(linked_run, run_copy, capsys):
    """The version alone is the same in all states of the sources between two releases."""
    study = read_study(run_copy / "run.toml")
    hashes = [layer.source.sha256 for layer in open_results(run_copy).layers]
    assert cached_maps.sheets_of(run_copy, study, hashes)[0].keys() == {"sheet"}
    assert run.open_sheet(run_copy).unchanged
    results = open_results(run_copy)
    assert len(results.code) == 16
    (run_copy / "results.json").write_text(results.model_copy(update={"code": ""}).to_json(), encoding="utf-8")
    assert cached_maps.sheets_of(run_copy, study, hashes) == ({}, {})
    assert not run.open_sheet(run_copy).unchanged
    runs._compare(run_copy, linked_run)
    said = f"results.json differs from {run_copy}, which was made by other code (planish {results.planish})"
    assert said in capsys.readouterr().err


@pytest.mark.nightly
def test_a_link_of_a_run_of_other_code_is_no_run_of_this_code(run_copy, specimen_files, tmp_path):
    assert link(run_copy, specimen_files[1], out=tmp_path / "same").results.is_of_this_code
    text = open_results(run_copy).model_copy(update={"code": ""}).to_json()
    (run_copy / "results.json").write_text(text, encoding="utf-8")
    assert not link(run_copy, specimen_files[1], out=tmp_path / "linked").results.is_of_this_code


@pytest.mark.parametrize("group", ["surfaces", "flat", "strain", "maps", "linked"])
def test_places_have_their_unit(tree, group):
    assert {str(k): v.attrs.get("units") for k, v in tree[group].coords.items()} in (
        {"y": "um", "x": "um"}, {"v": "um", "u": "um"},
    )  # fmt: skip


def test_given_marks_replace_the_search(passes, linked_run, specimen_files, tmp_path, results):
    marks = ("--marks", linked_run / "marks.csv")
    out, _ = passes("link", linked_run, specimen_files[1], *marks, "-o", tmp_path / "run", "--json")
    found = json.loads(out)["layers"][0]["registration"]
    assert found["source"] == "csv"
    # Pairs from a file say nothing of their errors: all weigh the same.
    marks = read_any(linked_run / "marks.csv")
    moving, fixed = (np.stack([marks[f"{s}_{a}"].values for a in "xy"], axis=1) for s in ("moving", "fixed"))
    plain = fit_transform(moving, fixed, model="auto", mirrored=False, lowest="similarity")
    assert found["scale"] == pytest.approx(plain.transform.scale, rel=1e-12)
    assert found["scale"] == pytest.approx(results["layers"][0]["registration"]["scale"], rel=3e-4)


def test_marks_given_in_the_volume(passes, specimen, linked_run, specimen_files, tmp_path):
    in_volume = specimen.warp.points(*specimen.sheet.holes.T)
    in_image = specimen.pose(specimen.sheet.holes)
    rows = ["label,volume_x_um,volume_y_um,volume_z_um,fixed_x_um,fixed_y_um"]
    ends = zip(in_volume, in_image, strict=True)
    rows += [f"h{k},{p[0]},{p[1]},{p[2]},{q[0]},{q[1]}" for k, (p, q) in enumerate(ends)]
    (tmp_path / "m.csv").write_text("\n".join(rows))
    files = (linked_run, specimen_files[1])
    out, _ = passes("link", *files, "--marks", tmp_path / "m.csv", "-o", tmp_path / "run", "--json")
    assert json.loads(out)["layers"][0]["registration"]["rms_um"] < 1.0


def test_a_mirrored_image_is_refused_and_matched_when_declared(passes, refuses, specimen, linked_run, tmp_path):
    grey = np.rint(specimen.image.values * 60000).clip(0, 65535).astype(np.uint16)[:, ::-1]
    files = (linked_run, write_image(tmp_path / "m.tif", grey))
    refuses("link", *files, words="--mirror")
    out, _ = passes("link", *files, "-o", tmp_path / "run", "--mirror", "--json")
    assert json.loads(out)["layers"][0]["registration"]["mirrored"] is True


@pytest.mark.nightly
def test_map_stops_after_the_flat_maps(passes, specimen_files, tmp_path):
    out, _ = passes("map", specimen_files[0], "-o", tmp_path / "run", "--json")
    assert json.loads(out)["comparison"] == []
    with xr.open_datatree(tmp_path / "run" / "maps.zarr", engine="zarr") as opened:
        assert "linked" not in opened.children
    assert not (tmp_path / "run" / "marks.json").exists()
