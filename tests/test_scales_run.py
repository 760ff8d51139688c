"""Octaves of a run: on its columns without their noise, of its image, declared in its study."""

import json
from dataclasses import replace

import numpy as np
import pytest

import planish as pl
from planish.analyze.params import ScalesParams
from planish.app import explore
from planish.app.pictures import Pictures
from planish.run.map_scales import with_declared_scales

OF_SHEET = {
    "fibre_length_mm": 0.5,
    "fibre_width_um": 20.0,
    "coarseness_mg_m": 0.15,
    "mean_grammage_g_m2": 80.0,
}


@pytest.mark.ci
def test_maps_of_a_run_are_taken_without_their_noise_and_the_image_in_the_same_octaves(kinds):
    run = pl.open_run(kinds("upright"))
    found = pl.scales(run)
    assert next(iter(found.bands)) == "coating_top"  # the headline leads
    assert "warp" not in found.bands
    coating, image = found.bands["coating_top"], found.bands["image"]
    assert {band.low_um for band in coating} & {band.low_um for band in image}
    assert all(0 < band.noise < band.sd for band in coating)
    assert all(np.isnan(band.noise) for band in image)
    assert np.isnan(found.bands["base_surface_top"][0].cov)
    # Of the same map on the pixels of the image, with its noise: what was resampled varies less.
    linked = pl.scales(run.linked, of=["coating_top"]).bands["coating_top"]
    for band in coating[:1]:
        (same,) = [b for b in linked if b.low_um == band.low_um]
        assert same.sd == pytest.approx(band.sd, rel=0.15)


@pytest.mark.ci
def test_the_coating_levels_its_base_and_the_image_follows_the_coating(kinds, tmp_path, passes):
    run = kinds("upright")
    levelling = pl.scales(run, of=["coating_top"], against="base_surface_top")
    # Along the same normals; by heights at columns coherence falls to .6, where the sheet is bent.
    for band in levelling.bands["coating_top"]:
        assert -1.05 < band.gain < -0.9
        assert band.coherence > 0.8
        assert abs(band.phase_deg) > 175
    asked = ("scales", run, "--map", "image", "--against", "coating_top")
    printed = json.loads(passes(*asked, "--json", "--out", tmp_path / "out")[0])
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "scales.html",
        "scales.json",
        "octaves.csv",
    }
    stored = json.loads((tmp_path / "out" / "scales.json").read_text(encoding="utf-8"))
    assert printed == stored
    (bands,) = stored["bands"].values()
    assert bands[0]["gain"] > 0
    assert stored["declared"] is None


@pytest.mark.ci
def test_declared_octaves_stand_in_run_page_and_layers(kinds, tmp_path, passes):
    run, out = kinds("upright"), tmp_path / "declared"
    passes("run", run / "run.toml", "--set", "scales.of=coating_top", "--out", out)
    declared = pl.open_run(out)
    found = declared.results.scales
    assert found.declared is True
    assert found.bands == pl.scales(run, of=["coating_top"]).bands
    bands = declared.groups["octaves"]
    assert len(bands) >= len(found.bands["coating_top"]) - 1
    for name, values in bands.items():
        low_um = float(str(name).split("_")[2])
        (band,) = [b for b in found.bands["coating_top"] if b.low_um == low_um]
        assert values.dims == declared.linked["image"].dims
        assert float(values.std()) == pytest.approx(band.sd, rel=0.2)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "At which wavelength" in page
    explore(out, tmp_path / "page.html")
    assert "waves of" in (tmp_path / "page.html").read_text(encoding="utf-8")
    assert {*map(str, bands)} <= {picture.name for picture in Pictures.of(out)}
    assert json.loads(passes("scales", out, "--json")[0])["declared"] is True
    other = json.loads(passes("scales", out, "--map", "thickness", "--json")[0])
    assert other["declared"] is False


@pytest.mark.ci
def test_octaves_that_cannot_be_had_leave_the_run_and_small_fields_have_formation_by_octave(kinds):
    run = pl.open_run(kinds("upright"))
    params = ScalesParams(of=("no_such_map",))
    asked = with_declared_scales(
        replace(run, study=run.study.model_copy(update={"scales": params}))
    )
    assert asked.results.scales is None
    assert "no map 'no_such_map'" in asked.results.scales_reason
    assert "octaves" not in asked.groups
    found = pl.scales(run, of=["thickness", "coating_top"], **OF_SHEET)
    assert "a formation number needs 9" in found.maps["thickness"].reason
    assert all(band.formation > 0 for band in found.bands["thickness"])
    assert all(np.isnan(band.formation) for band in found.bands["coating_top"])
    cells = pl.scales(run, of=["thickness"], formation_cell_um=100.0, **OF_SHEET)
    assert cells.maps["thickness"].formation.number > 0
