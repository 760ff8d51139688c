"""``planish specimen``: files that any program can read, and a link from each of them."""

import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile

from planish.io import read_image, read_volume
from planish.synthetic import SpecimenOptions


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    import planish.synthetic as synthetic
    from planish.cli import main

    out = tmp_path_factory.mktemp("made") / "specimen"
    with pytest.MonkeyPatch.context() as patch:
        # The least that has room for three holes.
        patch.setitem(synthetic.SIZES_UM, "T0", (560.0, 420.0))
        with pytest.raises(SystemExit) as end:
            main(["specimen", "--size", "T0", "--seed", "7", "--out", str(out)])
    assert not end.value.code
    return out


def test_the_files_of_the_instruments_and_of_the_truth(made):
    scan = read_volume(made / "scan")
    # Of the reconstruction, not of the acquisition.
    assert scan.attrs["voxel_um"] == [3.0, 3.0, 3.0]
    assert "NRecon" in scan.attrs["voxel_um_source"]
    for name in ("image", "printed"):
        image = read_image(made / f"{name}.ome.tif")
        assert image.attrs["pixel_um"] == pytest.approx((4.0, 4.0), rel=1e-4)
        with tifffile.TiffFile(made / f"{name}.ome.tif") as file:
            assert file.is_ome
    counter = (made / "sections" / "sections.csv").read_text().splitlines()
    photographs = sorted(p.name for p in (made / "sections").glob("*.tif"))
    assert [line.split(",")[0] for line in counter[2:]] == photographs
    parameters = json.loads((made / "truth" / "parameters.json").read_text())
    assert parameters["parameters"]["seed"] == 7
    u, image = tifffile.imread(made / "truth" / "u.tif"), tifffile.imread(made / "image.ome.tif")
    assert u.shape == image.shape
    holes = np.loadtxt(made / "truth" / "holes.csv", delimiter=",", skiprows=1)
    assert holes.shape == (3, 7)
    # the picture is dark where the truth has a hole
    row, col = np.rint(holes[:, [3, 2]] / 4.0).astype(int).T
    assert image[row, col].max() < 0.3 * np.median(image)


@pytest.mark.ci
def test_a_specimen_too_large_for_voxels(passes, tmp_path, monkeypatch):
    import planish.synthetic as synthetic

    monkeypatch.setitem(synthetic.SIZES_UM, "T3", (2000.0, 1500.0))  # the same way, in a second
    passes("specimen", "--size", "T3", "--instrument", "ct", "-o", tmp_path / "large")
    with np.load(tmp_path / "large" / "nodes.npz") as nodes:
        assert nodes["points"].shape == (150, 200, 3)
    assert not (tmp_path / "large" / "scan").exists()


def test_single_nuisances_are_switched_off():
    usual = SpecimenOptions().params()
    even = SpecimenOptions(without=("shading", "vignetting")).params()
    assert usual.camera.shading > 0
    assert usual.camera.vignetting > 0
    camera = replace(usual.camera, shading=0.0, vignetting=0.0)
    assert even == replace(usual, camera=camera)


def test_wrong_names_are_told(refuses, passes):
    refuses("specimen", "--preset", "newsprint", words="wfc135", code=2)
    refuses("specimen", "--nuisance", "dust", words="dust", code=2)
    refuses("specimen", "--without", "none", words="none", code=2)
    out, _ = passes("specimen", "--list")
    assert "wfc135-calendered" in out
    assert "knife" in out
