"""The whole line on what a scanner and a microtome write: right places, the right hand, and what was done to them."""

from dataclasses import replace

import numpy as np
import pytest

from planish.core.errors import VolumeError
from planish.run import as_study, run_study
from planish.synthetic import (
    BurnParams,
    CameraParams,
    ScannerParams,
    SectionsParams,
    SpecimenParams,
    Warp,
    make_specimen,
    write_instruments,
)
from planish.validate import certify, truth

PARAMS = SpecimenParams(
    size_um=(1000.0, 760.0),
    holes=BurnParams(pattern="irregular", count=5),
    warp=Warp(slope=0.35, wavelength_um=1800.0),
    scanner=ScannerParams(voxel_um=4.0),
    sections=SectionsParams(pixel_um=3.0, section_um=4.0, missing=0.03),
    camera=CameraParams(pixel_um=5.0, radial=0.0, stretch=0.0),
    seed=5,
)


def _link(params, instrument, folder):
    specimen = make_specimen(params)
    files = write_instruments(specimen, folder / "files", volume=instrument)
    study = as_study(
        {"volume": {"path": str(files.volume), "through": files.through}, "image": {"path": str(files.image)}}
    )
    run = run_study(study, folder / "run")
    return specimen, files, run, certify.make_ledger(truth.Comparison(specimen, files, run))


@pytest.mark.nightly
def test_a_scan_across_the_axis_of_rotation_keeps_its_hand(tmp_path):
    _, _, run, ledger = _link(PARAMS, "scanner", tmp_path)
    assert run.results.layers[0].source.size_source.startswith("NRecon")
    assert not run.results.layers[0].registration.mirrored
    assert ledger["recall_image"] == 1
    assert ledger["tre_p95"] < 3.0


@pytest.mark.nightly
def test_sections_are_aligned_and_joined(tmp_path):
    specimen, _, run, ledger = _link(PARAMS, "sections", tmp_path)
    facts = run.results.layers[0].sheet.sections
    assert (facts.count, facts.missing) == (specimen.poses.index.size, 191 - specimen.poses.index.size)
    assert facts.not_aligned == 0
    assert not run.results.layers[0].registration.mirrored
    assert ledger["tre_p95"] < 8.0
    assert abs(ledger["pixel_coating_top_bias"]) < 0.3
    sections = run.groups["sections"]
    assert np.all(np.diff(sections["position"]) > 0)
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "sections were aligned to their neighbours" in page
    assert "sections fit their neighbours" in page
    # 1.5 um of jitter are taken off; what was put on is stated
    assert 1.0 < facts.shift_row_rms_um < 2.2


def test_sections_cannot_be_looked_at_from_above(tmp_path):
    small = replace(PARAMS, size_um=(600.0, 500.0), holes=BurnParams(count=0))
    files = write_instruments(make_specimen(small), tmp_path / "files", volume="sections", image=False)
    study = as_study({"volume": {"path": str(files.volume)}})
    with pytest.raises(VolumeError, match='through="y"'):
        run_study(study, tmp_path / "run")
    assert not (tmp_path / "run").exists()
