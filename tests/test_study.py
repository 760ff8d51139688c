import pytest

from planish.core.errors import FileError, InputError
from planish.study import ImageSection, Study, VolumeSection, read_study, write_study


def test_round_trip_keeps_everything_and_paths_are_relative(tmp_path):
    study = Study(
        volume=VolumeSection(path=str(tmp_path / "in" / "v.tif"), voxel_um=(1.0, 0.1 + 0.2, 3.0), through="x"),
        image=ImageSection(path=str(tmp_path / "i.tif"), channel="red"),
    )
    (tmp_path / "run").mkdir()
    write_study(study, tmp_path / "run", home=tmp_path / "run", version="0")
    text = (tmp_path / "run" / "run.toml").read_text()
    assert str(tmp_path) not in text
    assert read_study(tmp_path / "run" / "run.toml") == study


def test_all_faults_are_named_at_once(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text('[volume]\npath = "v.tif"\naxsi = 3\nvoxel_um = [1.0, -1.0, 1.0]\n[surface]\nrim_um = -4\n')
    with pytest.raises(InputError) as error:
        read_study(path)
    for word in ("volume.axsi", "volume.voxel_um.1", "surface.rim_um", "3 wrong parameters"):
        assert word in str(error.value)


def test_what_is_no_study(tmp_path):
    with pytest.raises(FileError, match="cannot be read"):
        read_study(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("= 3")
    with pytest.raises(FileError, match="not a TOML file"):
        read_study(tmp_path / "bad.toml")
