"""Scenario files: what comes with planish is sound, and what is wrong is said."""

from dataclasses import replace

import numpy as np
import pytest

from folders import refused
from planish.core.errors import FileError, InputError
from planish.synthetic import NUISANCES
from planish.validate import FIGURES, Limit, read_scenario, scenario_names


def test_the_scenarios_that_come_with_planish_have_limits_and_nuisances():
    assert {"as-1", "as-2", "ct", "quiet", "small"} <= set(scenario_names())
    for name in scenario_names():
        scenario = read_scenario(name)
        assert scenario.name == name
        assert scenario.limits.keys() <= FIGURES.keys()
        assert all(limit.source for limit in scenario.limits.values())
    scenario = read_scenario("small")
    assert set(scenario.active) <= NUISANCES.keys()
    scenario = read_scenario("small")
    assert "scan_noise" in scenario.active
    assert read_scenario("quiet").active == []
    only = scenario.params(0, ("char",))
    assert (only.scanner.noise, only.holes.char_um) == (0.0, scenario.params(0).holes.char_um)
    assert scenario.params(3).seed == scenario.params(0).seed + 3
    most, least = Limit(limit=0.5), Limit(least=0.95)
    assert most.met(-0.5)
    assert not most.met(-0.51)
    assert not most.met(None)
    assert least.met(1.0)
    assert not least.met(0.9)
    assert (most.worst([0.1, -0.4, 0.3]), least.worst([1.0, 0.96])) == (-0.4, 0.96)


def test_as_2_is_what_the_specification_asks_for():
    scenario = read_scenario("as-2")
    params = scenario.params(0)
    assert params.size_um == (8000.0, 6000.0)
    assert (scenario.instrument, params.sections.pixel_um, params.sections.section_um) == (
        "sections",
        2.43,
        3.0,
    )
    assert params.camera.pixel_um == 12.0
    # The sheet over the 8 mm along x is longer than these by 250 um, wherever one looks.
    warp = replace(params.warp, shift_um=(4000.0, 3000.0, 0.0), reach_um=18_000.0)
    u = warp.columns(np.linspace(0, 6000, 13), np.array([0.0, 8000.0]))[..., 0]
    assert np.mean(u[:, 1] - u[:, 0]) - 8000 == pytest.approx(250, abs=15)
    assert {"jitter", "walk", "missing", "drift", "knife", "stage", "char"} <= set(scenario.active)
    assert "scan_blur" not in scenario.active


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nonsense = 1", "nonsense"),
        ('preset = "newsprint"', "wfc135"),
        ('nuisances = ["hiccup"]', "scan_noise"),
        ("[limits]\nblur = { limit = 1 }", "tre_p95"),
        ("[limits]\ntre_p95 = { limit = 1, least = 1 }", "either limit or least"),
        ('[specimen.warp]\nslope = "steep"', "specimen.warp.slope"),
        ("[specimen]\nwarp = 3", "specimen.warp: .* dictionary"),
        ("[study.surfaces]\ncutoff_um = 100", "study.surfaces"),
        ("[study.surface]\ncutoff = 100", r"surface\.cutoff: Extra"),
    ],
)
def test_wrong_scenarios_are_named(tmp_path, text, said):
    path = tmp_path / "mine.toml"
    path.write_text(f'name = "mine"\ntitle = "Mine"\n{text}\n')
    refused(InputError, said, read_scenario, path)


def test_the_study_of_a_scenario_and_files_that_are_none(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\ntitle = "Mine"\n[study.holes]\nhole_um = [120, 250]\n')
    study = read_scenario(path).study_of([(tmp_path / "v", "y")], tmp_path / "i")
    assert (study.holes.hole_um, study.layers[0].volume.through) == ((120.0, 250.0), "y")
    path.write_text('name = "mine"\ntitle = "Mine"\n[study.surface]\ncutoff_um = -1\n')
    refused(InputError, r"surface\.cutoff_um", read_scenario, path)
    refused(FileError, "small", read_scenario, "smal")
    path = tmp_path / "bad.toml"
    path.write_text("name = ")
    refused(FileError, "not a TOML file", read_scenario, path)
