"""What a user can hand in wrongly: each ends with a sentence that helps, the right exit code, and no run folder."""

import numpy as np
import pytest
import tifffile
from PIL import Image

from folders import disc_image, write_image, write_volume


def test_a_volume_that_is_cut_or_holds_no_sheet(refuses, specimen_files, tmp_path):
    noise = np.random.default_rng(0).normal(60, 4, (40, 60, 70)).astype(np.uint8)
    refuses("map", write_volume(tmp_path / "noise.tif", noise), words=("no sheet in the volume", "--through"))
    empty = np.full((20, 40, 40), np.nan, np.float32)
    refuses("map", write_volume(tmp_path / "nan.tif", empty), words="NaN")
    broken = tmp_path / "cut.tif"
    broken.write_bytes(specimen_files[0].read_bytes()[:-1000])
    refuses("map", broken, words="cut.tif")
    refuses("info", broken, words="cut.tif", out=False)


def test_another_pattern_in_the_image_and_marks_that_do_not_fit(refuses, linked_run, tmp_path, specimen_files):
    other = [(200.0, 200.0), (1300.0, 260.0), (1250.0, 1190.0), (260.0, 1250.0), (690.0, 420.0)]
    image = write_image(tmp_path / "other.tif", disc_image(other, (300, 320)))
    refuses("link", linked_run, image, words=("5", "--marks"))
    marks = tmp_path / "marks.csv"
    marks.write_text(
        "label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um\na,100,100,100,100\nb,900,100,500,100\nc,100,700,100,400\n"
    )
    refuses("link", linked_run, specimen_files[1], "--marks", marks, words=("scale", "calibration"))


@pytest.mark.ci
def test_missing_voxels_are_a_look_and_with_strict_exit_code_4(passes, specimen, tmp_path):
    part = specimen.volume.values[:, :125, :200].astype(np.float32)
    part[:, :15] = np.nan
    path = write_volume(tmp_path / "part.tif", part)
    _, err = passes("map", path, "-o", tmp_path / "run", "--strict", codes=(4,))
    assert "look: missing voxels" in err
    assert "12.0 %" in err
    assert (tmp_path / "run" / "report.html").is_file()


def test_missing_sizes_are_asked_for_with_the_option_that_gives_them(refuses, specimen_files, tmp_path):
    plain = tmp_path / "plain.png"
    Image.fromarray(np.zeros((20, 30), np.uint8)).save(plain)
    refuses("link", specimen_files[0], plain, words=("plain.png", "pixel size", "--pixel-um"))
    bare = tmp_path / "bare.tif"
    tifffile.imwrite(bare, np.zeros((9, 20, 30), np.uint8))
    refuses("map", bare, words=("bare.tif", "voxel size", "--voxel-um"))
    refuses("map", specimen_files[0], "--voxel-um", 4000, words=("4000", "--override-size"))


def test_wrong_usage_and_an_output_folder_that_exists(refuses, specimen_files, tmp_path):
    refuses("map", specimen_files[0], words="--out", code=2, out=False)
    refuses("map", specimen_files[0], "--voxel-um", "3;3", words="SIZE|Z,Y,X", code=2)
    refuses("flattern", words="flattern", code=2, out=False)
    out = tmp_path / "kept"
    out.mkdir()
    (out / "mine.txt").write_text("keep")
    refuses("map", specimen_files[0], "-o", out, words=("exists already", "--out"), out=False)
    assert ((out / "mine.txt").read_text(), [p.name for p in out.iterdir()]) == ("keep", ["mine.txt"])
