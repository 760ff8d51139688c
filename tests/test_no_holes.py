"""A sheet of fibres without holes, linked by its texture as a user would; and an image of another sheet, refused."""

from __future__ import annotations

from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np
import pytest
import tifffile
import xarray as xr

import planish as pl
from app.asgi import HOST, TOKEN, Client
from planish.app import Session, create_app
from planish.core.errors import CannotRegister
from planish.io import ImageParams
from planish.run import map_sheet
from planish.synthetic import DEMO, make_specimen, write_instruments

pytestmark = pytest.mark.nightly


def written(folder, seed):
    """Files of a specimen of the demo without holes, turned by any angle under the camera."""
    holes, camera = replace(DEMO.holes, count=0), replace(DEMO.camera, turn_range_deg=180.0)
    size = replace(DEMO, seed=seed, size_um=(1500.0, 1200.0), holes=holes, camera=camera)
    specimen = make_specimen(size)
    return specimen, write_instruments(specimen, folder, volume="stack")


@pytest.fixture(scope="module")
def linked(tmp_path_factory):
    folder = tmp_path_factory.mktemp("no_holes")
    specimen, files = written(folder / "files", 5)
    map_sheet(files.volume, out=folder / "maps")
    return specimen, files, pl.link(folder / "maps", files.image)


@pytest.fixture(scope="module")
def mapped(linked):
    """The folder of the sheet's maps alone, as a refused link leaves it."""
    _, files, _ = linked
    return files.volume.parents[1] / "maps"


def test_a_sheet_without_holes_is_linked_and_says_how_well(linked):
    specimen, _, run = linked
    maps, truth = run.groups["linked"], specimen.truth
    off_um = np.hypot(maps["volume_x"] - truth["volume_x"], maps["volume_y"] - truth["volume_y"]).values
    valid = maps["valid"].values
    stated_um = maps["expected_error"].values[valid]
    assert np.median(off_um[valid]) < 2.5
    assert np.percentile(off_um[valid], 95) < 6.0
    assert np.sqrt(np.mean(off_um[valid] ** 2)) < 2.0 * np.sqrt(np.mean(stated_um**2))
    facts = run.results.layers[0].registration
    assert (facts.source, facts.false_probability < 1e-6) == ("texture", True)
    assert "Found by texture" in facts.match_sentence


def test_checks_rest_on_the_search_and_r_is_held_out(linked):
    _, _, run = linked
    states = {check.name: check.state for check in run.results.checks}
    assert (states["side and specimen"], states["position by texture"]) == ("pass", "unknown")
    assert "fail" not in states.values()
    held_out = run.results.layers[0].registration.held_out
    assert held_out.registration in ("refined (cross-fitted)", "refined (searched null)")
    assert 0.3 < held_out.r < 0.95


def test_marks_are_tiles_and_are_read_again(linked, tmp_path):
    _, _, run = linked
    registration = run.registrations["sheet"]
    registration.save(tmp_path / "marks.json")
    read = pl.Registration.read(tmp_path / "marks.json")
    assert set(read.marks["moving_source"].values) == {"tile"}
    np.testing.assert_allclose(read([[500.0, 400.0]]), registration([[500.0, 400.0]]), atol=1e-6)
    assert (read.fit.shared_um, read.false_probability) == (registration.fit.shared_um, registration.false_probability)


def test_a_run_by_tiles_of_a_file_is_the_run_of_the_search(linked, mapped, tmp_path):
    _, files, run = linked
    registration = run.registrations["sheet"]
    registration.save(tmp_path / "marks.json")
    again = pl.link(mapped, files.image, registration={"marks": str(tmp_path / "marks.json")})
    facts = again.results.layers[0].registration
    assert (facts.source, facts.false_probability) == ("texture", registration.false_probability)
    assert facts.held_out is not None
    share = [float(r.groups["linked"]["valid"].mean()) for r in (run, again)]
    assert share[1] == pytest.approx(share[0], abs=0.01)
    errors = [r.results.layers[0].registration.expected_error.median_um for r in (run, again)]
    assert errors[1] == pytest.approx(errors[0], rel=0.02)


def test_holes_and_texture_are_fitted_in_one_and_compared(specimen, specimen_files):
    run = pl.link(*specimen_files, registration={"by": "both"})
    facts = run.results.layers[0].registration
    marks = run.registrations[run.results.layers[0].name].marks
    assert facts.source == "both"
    assert {"tile", "detected"} <= set(marks["moving_source"].values)
    check = next(check for check in run.results.checks if check.name == "position by texture")
    assert check.state == "pass"
    assert check.value < check.limit
    maps, truth = run.groups["linked"], specimen.truth
    off_um = np.hypot(maps["volume_x"] - truth["volume_x"], maps["volume_y"] - truth["volume_y"]).values
    assert np.median(off_um[maps["valid"].values]) < 1.0


def real_image(values):
    """A picture of cells as if it were paper: its pixels, some .7 um wide, are taken for 8 um."""
    y, x = (8.0 * np.arange(n) for n in values.shape)
    return xr.DataArray(values, dims=("y", "x"), coords={"y": y, "x": x}, attrs={"pixel_um": [8.0, 8.0]})


def test_real_pictures_of_one_tissue_in_two_stains_are_found_and_others_not(shared_data):
    """Two markers in one sheet of cells, and an organoid; a quarter turn and a frame around say what is right."""
    tissue = tifffile.imread(shared_data("tissue_sheet_mesh/basics_example_projected.tif"))[2]
    first, second = (np.where(np.isfinite(m), m, np.nanmedian(m)) for m in tissue)
    turned = np.pad(np.rot90(second), 60, constant_values=np.median(second))
    found = pl.register_texture(real_image(first), real_image(turned))
    points = 8.0 * np.stack(np.meshgrid(np.arange(20, 240, 40), np.arange(20, 240, 40)), axis=-1)
    right = np.stack([points[..., 1], 8.0 * 255 - points[..., 0]], axis=-1) + 8.0 * 60
    assert np.median(np.linalg.norm(found(points) - right, axis=-1)) < 8.0
    organoid = tifffile.imread(shared_data("tissue_sheet_mesh/Neural_tube_organoid_DAPI_betaCat-small.tif"))
    with pytest.raises(CannotRegister, match="stands out by its texture"):
        pl.register_texture(
            real_image(first), real_image(np.pad(organoid[15, 0], 60, constant_values=np.median(organoid[15, 0])))
        )


@contextmanager
def opened(mapped, image):
    with closing(Session.open(mapped, ImageParams(path=str(image)))) as session:
        client = Client(create_app(session, token=TOKEN, hosts=(HOST,)))
        yield session, client
        client.app.state.applying.close()


def test_the_app_finds_the_texture_everywhere_and_about_a_place(linked, mapped):
    specimen, files, _ = linked
    with opened(mapped, files.image) as (session, client):
        for near in (None, list(map(float, specimen.pose([[0.0, 0.0]])[0]))):
            found = client.post("/api/marks/texture", {"near": near})
            assert found.status == 200
            assert "Found by texture" in found.json()["said"]
            assert {mark["source"] for mark in found.json()["marks"]} == {"tile"}
        far = client.post("/api/marks/texture", {"near": [-3000.0, 0.0]})
        assert far.status == 400
        place = found.json()["fit"]["transform"]
        given = client.post("/api/marks/texture", {"place": place})
        assert given.json()["said"].startswith("The place was given; ")
        assert len(given.json()["marks"]) >= 4
        session.undo()


def test_the_app_offers_the_best_places_where_none_is_sure(mapped, tmp_path):
    _, other = written(tmp_path / "other", 6)
    with opened(mapped, other.image) as (session, client):
        refused = client.post("/api/marks/texture", {})
        places = refused.json()["places"]
        assert (refused.status, len(places) > 2, session.can_undo) == (400, True, False)
        assert places[0]["text"] in refused.json()["error"]
        chosen = client.post("/api/marks/texture", {"place": places[0]["place"]})
        assert (chosen.status, "4 are needed" in chosen.json()["error"]) == (400, True)


def test_an_image_of_another_sheet_is_refused(linked, mapped, tmp_path):
    _, _, run = linked
    _, other = written(tmp_path / "other", 6)
    with pytest.raises(CannotRegister, match="stands out by its texture"):
        pl.register_texture(run.groups["maps"], pl.read_image(other.image))
    with pytest.raises(CannotRegister, match="stands out by its texture"):
        pl.link(mapped, other.image, out=tmp_path / "run", registration={"by": "texture"})
    with pytest.raises(CannotRegister, match="No hole found"):
        pl.link(mapped, other.image, registration={"by": "holes"})
