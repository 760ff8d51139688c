"""Specimens like a run: what is read from a run of a known specimen is what that specimen was made
of."""

import json
import shutil

import pytest

from folders import refused
from planish.core.errors import FileError, InputError, PlanishError
from planish.validate import read_scenario, specimen_template


def test_a_run_of_a_known_specimen(specimen, linked_run):
    true, found = specimen.params, specimen_template.like_run(linked_run).params
    assert found.scanner.voxel_um == pytest.approx(true.scanner.voxel_um)
    assert found.camera.pixel_um == pytest.approx(true.camera.pixel_um, rel=1e-4)
    assert found.paper.coating_top_um == pytest.approx(true.paper.coating_top_um, rel=0.1)
    # holes are rough, oval and burnt at their rims: the circle fitted to one is within a char of 40
    # um, mostly less
    assert found.holes.diameter_um == pytest.approx(true.holes.diameter_um, rel=0.15)
    assert found.holes.count == true.holes.count
    assert found.paper.base_um == pytest.approx(true.paper.base_um, rel=0.05)
    # the search's blur holds that of the voxels and of the sheet's own unevenness within a column
    assert 0.6 * true.scanner.fwhm_um < found.scanner.fwhm_um < 1.6 * true.scanner.fwhm_um
    assert 0.5 * true.scanner.noise < found.scanner.noise < 2.0 * true.scanner.noise
    # slopes are taken about their mean, and the centre surface passes a little less of them
    assert 0.6 * true.warp.slope < found.warp.slope < 1.3 * true.warp.slope
    assert abs(found.warp.ruling_deg - true.warp.ruling_deg) < 10.0
    assert 0.5 * true.warp.wavelength_um < found.warp.wavelength_um < 2.0 * true.warp.wavelength_um


def test_the_template_states_its_sources_and_takes_the_place_of_paper_and_instruments(linked_run):
    found = specimen_template.like_run(linked_run)
    assert "Taken: Voxels of 4 um." in found.notes
    assert any(note.startswith("Assumed: Fringe") for note in found.notes)
    assert all(note.endswith(".") for note in found.notes)
    assert "path" not in json.dumps(found.study)
    scenario = found.scenario(read_scenario("ct"))
    assert (scenario.params(2).paper, scenario.params(2).warp) == (
        found.params.paper,
        found.params.warp,
    )
    assert (scenario.params(2).seed, scenario.limits) == (2, read_scenario("ct").limits)
    assert scenario.instrument == "stack"


@pytest.mark.parametrize("missing", ["results.json", "run.toml", "maps.zarr"])
def test_a_folder_that_is_no_run(linked_run, tmp_path, missing):
    part = tmp_path / "run"
    shutil.copytree(linked_run, part)
    if (part / missing).is_dir():
        shutil.rmtree(part / missing)
    else:
        (part / missing).unlink()
    refused(FileError, r"results\.json|is no run", specimen_template.like_run, part)


@pytest.mark.parametrize(
    "text", ["{", "[1, 2]", "{}", '{"inputs": {"volume": {"voxel_um": [1, 2, 3]}}}']
)
def test_damaged_results(linked_run, tmp_path, text):
    part = tmp_path / "run"
    shutil.copytree(linked_run, part)
    (part / "results.json").write_text(text)
    with pytest.raises(PlanishError, match=r"results\.json") as error:
        specimen_template.like_run(part)
    assert isinstance(error.value, InputError)
