import datetime

import numpy as np
import pytest
import tifffile

from planish.core.errors import FileError, InputError
from planish.io import ImageParams, VolumeParams
from planish.register import RegistrationParams
from planish.run import GivenLayer, Study, as_study, read_study, study_of, with_values, write_study


def test_round_trip_keeps_everything_and_paths_are_relative(tmp_path):
    volume = VolumeParams(
        path=str(tmp_path / "in" / "v.tif"),
        voxel_um=(1.0, 0.1 + 0.2, 3.0),
        through="x",
        md_deg=12.0,
    )
    image = ImageParams(path=str(tmp_path / "i.tif"), channel="red", side="bottom")
    layers = (
        GivenLayer(name="sheet", volume=volume),
        GivenLayer(name="lm", run=str(tmp_path / "lm"), marks=str(tmp_path / "pairs.csv")),
        GivenLayer(name="image", image=image),
    )
    design = RegistrationParams(design=str(tmp_path / "pattern.json"))
    study = Study(layers=layers, chain=True, registration=design)
    (tmp_path / "run").mkdir()
    write_study(study, tmp_path / "run", home=tmp_path / "run", version="0")
    text = (tmp_path / "run" / "run.toml").read_text()
    assert 'path = "../in/v.tif"' in text
    assert str(tmp_path) not in text
    assert read_study(tmp_path / "run" / "run.toml") == study


def test_faults_of_a_study_are_named_at_once_and_other_files_refused(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(
        '[volume]\npath = "v.tif"\naxsi = 3\nvoxel_um = [1.0, -1.0, 1.0]\n[surface]\nrim_um = -4\n'
    )
    with pytest.raises(InputError) as error:
        read_study(path)
    for word in ("volume.axsi", "voxel_um.1", "surface.rim_um", "3 wrong parameters"):
        assert word in str(error.value)
    with pytest.raises(FileError, match=r"none\.toml does not exist"):
        read_study(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("= 3")
    with pytest.raises(FileError, match="not a TOML file"):
        read_study(tmp_path / "bad.toml")


def test_the_files_of_planish_0_1_are_read():
    """As that version wrote them: one volume and an image without a list, layers with their volume
    in ``map``."""
    one = as_study(
        {
            "volume": {"path": "v.tif", "voxel_um": [3.0, 3.0, 3.0]},
            "image": {"path": "i.tif"},
            "surface": {"cutoff_um": 300.0},
            "registration": {"hole_um": [80.0, 200.0], "model": "affine"},
        }
    )
    assert [layer.kind for layer in one.layers] == ["volume", "image"]
    assert one.layers[0].surface.cutoff_um == 300.0
    assert (one.holes.hole_um, one.registration.model) == ((80.0, 200.0), "affine")
    ct = {"volume": {"path": "v.tif"}, "flatten": {"rest": "chord"}}
    several = as_study(
        {
            "layers": [
                {"name": "ct", "marks": "pairs.csv", "map": ct},
                {"name": "lm", "run": "lm"},
            ],
            "chain": False,
            "rim_um": 100.0,
            "registration": {"hole_um": [100.0, 300.0]},
        }
    )
    assert [layer.kind for layer in several.layers] == ["volume", "run"]
    assert several.layers[0].flatten.rest == "chord"


def test_title_author_date_and_note_are_fields_of_the_study_and_come_back(tmp_path):
    layers = tmp_path / "v.tif", tmp_path / "i.tif"
    for path in layers:
        tifffile.imwrite(path, np.zeros((4, 4) if path.stem == "i" else (4, 4, 4), np.uint8))
    words = {"title": "Trial 7", "date": datetime.date(2026, 3, 31), "author": "A. Hofer"}
    study = study_of(layers, {"about": words})
    write_study(study, tmp_path, home=tmp_path, version="0")
    text = (tmp_path / "run.toml").read_text()
    assert '[about]\ntitle = "Trial 7"\nauthor = "A. Hofer"\ndate = "2026-03-31"\n' in text
    again = read_study(tmp_path / "run.toml")
    assert again.about == study.about
    assert with_values(again, ["about.note=Coated, 90 g/m2", "about.title=7"]).about.title == "7"
    # Where nothing is given, nothing is written: runs keep their bytes.
    write_study(study_of(layers, {}), tmp_path, home=tmp_path, version="0")
    assert "about" not in (tmp_path / "run.toml").read_text()
