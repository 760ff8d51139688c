"""What a user can hand in wrongly: what planish says, how it ends, what it withholds, and what it
refuses."""

import json
import re
from types import SimpleNamespace

import nibabel
import numpy as np
import pytest
import SimpleITK as itk
import tifffile
from PIL import Image

from folders import write_image, write_volume
from planish.checks import CHECKS
from planish.io import read_volume


def marks_file(path, specimen, count):
    """Pairs set by hand on material points of the sheet."""
    rng = np.random.default_rng(2)
    low, high = specimen.sheet.holes.min(axis=0) - 60, specimen.sheet.holes.max(axis=0) + 60
    sheet = rng.uniform(low, high, (count, 2))
    volume, image = (
        specimen.warp.points(*sheet.T),
        specimen.pose(sheet) + rng.normal(0, 0.5, (count, 2)),
    )
    rows = ["label,volume_x_um,volume_y_um,volume_z_um,fixed_x_um,fixed_y_um"]
    for k, place in enumerate(np.hstack([volume, image])):
        rows.append(",".join([chr(97 + k), *(f"{v:.3f}" for v in place)]))
    path.write_text("\n".join(rows))
    return path


@pytest.fixture
def ended(planish, tmp_path):
    """Run a command into a folder: exit code, results, the checks by name, and all that was
    printed."""

    def run(*arguments):
        out = tmp_path / f"run{len(list(tmp_path.iterdir()))}"
        code, printed, err = planish(*arguments, "-o", out)
        assert code in (0, 4), err
        results = json.loads((out / "results.json").read_text())
        return code, results, {check["name"]: check for check in results["checks"]}, printed + err

    return run


@pytest.mark.ci
def test_spacing_along_z_half_as_large_again(ended, specimen, specimen_files, tmp_path):
    """Base +27.5 um: the marks ask for two thirds of it, thicknesses and correlations are
    withheld."""
    marks = marks_file(tmp_path / "m.csv", specimen, 12)
    wrong = ("--voxel-um", "6,4,4", "--override-size", "--marks", marks)
    code, results, checks, printed = ended("link", *specimen_files, *wrong)
    check = checks["scale through the sheet"]
    assert (code, check["state"]) == (4, "fail"), check
    assert check["value"] == pytest.approx(4 / 6, abs=0.05)
    assert "The marks imply a voxel spacing along z that is 0.6" in check["sentence"]
    assert check["sentence"] in " ".join(printed.split())
    sheet = results["layers"][0]["sheet"]
    assert {p["trust"] for p in sheet["properties"].values()} == {"withheld"}
    assert all(row["trust"] == "withheld" and row["r"] is None for row in results["correlations"])


# --- volumes --------------------------------------------------------------------------------------
def second_sheet(volume):
    """The same sheet once more, lying on the first."""
    shift = 24  # its thickness in voxels
    low = np.full((shift, *volume.shape[1:]), np.median(volume[-3:]), dtype=volume.dtype)
    first, second = np.concatenate([volume, low]), np.concatenate([low, volume])
    return np.maximum(first, second)


def rows_exchanged(volume):
    """Two blocks of forty rows change places."""
    first, one, two, last = np.split(volume, (80, 120, 160), axis=1)
    return np.concatenate([first, two, one, last], axis=1)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("change", "name", "words"),
    [
        (second_sheet, "one sheet", "sheets? lies? on"),
        (rows_exchanged, "slices along y", "not in order"),
    ],
)
def test_what_a_wrong_volume_gives_is_withheld(change, name, words, ended, specimen, tmp_path):
    """It is said, and the command ends with 4."""
    volume = write_volume(tmp_path / "v.tif", np.ascontiguousarray(change(specimen.volume.values)))
    code, results, checks, printed = ended("map", volume)
    check = checks[name]
    assert (code, check["state"]) == (4, "fail"), [
        c for c in checks.values() if c["state"] != "pass"
    ]
    assert re.search(words, check["sentence"])
    assert check["sentence"] in " ".join(printed.split())
    assert check["advice"]
    if name == "one sheet":
        assert {p["trust"] for p in results["layers"][0]["sheet"]["properties"].values()} == {
            "withheld"
        }


def test_a_short_cut_off_is_the_one_that_is_stated(ended, specimen_files, linked_run):
    """250 um gave the surface of 500 um: now it differs from that of 400, and where it is wider is
    counted."""
    _, results, checks, _ = ended("map", specimen_files[0], "--cutoff-um", "250")
    assert checks["cut-off"]["state"] == "pass"
    assert "the stated cut-off of 250 um" in checks["cut-off"]["sentence"]
    usual = json.loads((linked_run / "results.json").read_text())
    short, long = (
        k["layers"][0]["sheet"]["properties"]["topography_top"]["sd"] for k in (results, usual)
    )
    assert short < 0.95 * long  # waves of 250 to 400 um belong to the centre surface now


# --- sides and specimens --------------------------------------------------------------------------
@pytest.fixture
def foreign_image(specimen, specimen_files, tmp_path):
    """An image of another specimen with the same laser program: other paper around the same
    holes."""
    image = tifffile.imread(specimen_files[1])
    rows, cols = np.indices(image.shape)
    far = np.min(
        [np.hypot(rows - y, cols - x) for x, y in specimen.pose(specimen.sheet.holes) / 5.0], axis=0
    )
    sheet = image[far > 34]
    other = np.where(far > 34, image, np.random.default_rng(1).choice(sheet, image.shape)).astype(
        image.dtype
    )
    made = np.where(far > 34, other[::-1, ::-1], image)
    return write_image(tmp_path / "other.tif", made)


@pytest.mark.ci
def test_an_image_of_another_specimen_with_the_same_holes(ended, specimen_files, foreign_image):
    code, results, checks, printed = ended("link", specimen_files[1], foreign_image)
    check = checks["side and specimen"]
    assert (code, check["state"]) == (0, "look"), check
    assert "nothing beside the marks says that both show one specimen" in check["sentence"]
    assert check["sentence"] in " ".join(printed.split())
    assert {row["trust"] for row in results["correlations"]} == {"doubtful"}


@pytest.mark.parametrize("sign", [1, -1])
def test_a_left_handed_volume_is_marked(sign, tmp_path):
    """The affine of a NIfTI file may say that its slices are a mirror image; every map of it would
    be one."""
    image = nibabel.Nifti1Image(np.zeros((9, 8, 7), np.uint8), np.diag([4.0 * sign, 4.0, 4.0, 1.0]))
    image.header.set_xyzt_units("micron")
    nibabel.save(image, tmp_path / "v.nii")
    rule = next(rule for rule in CHECKS if rule.name == "hand of the volume")
    check = rule(SimpleNamespace(volume=read_volume(tmp_path / "v.nii")))
    assert (check is None) == (sign > 0)
    assert check is None or "mirror image of the specimen" in check.sentence


def left_handed(path, volume):
    """A MetaImage by whose matrix the rows run the other way: what is stored is a mirror image."""
    image = itk.GetImageFromArray(np.ascontiguousarray(volume.values[:, ::-1]))
    image.SetSpacing([um / 1000 for um in volume.attrs["voxel_um"][::-1]])
    image.SetDirection(np.diag([1.0, -1.0, 1.0]).ravel().tolist())
    itk.WriteImage(image, str(path))
    return path


@pytest.mark.ci
def test_marks_that_fit_mirrored_name_the_header_that_says_so(
    ended, planish, specimen, specimen_files, tmp_path
):
    volume = left_handed(tmp_path / "left.mha", specimen.volume)
    code, _, error = planish("link", volume, specimen_files[1], "-o", tmp_path / "refused")
    assert code == 3
    for words in ("match if one side is mirrored", "left-handed system", "TransformMatrix"):
        assert words in " ".join(error.split())
    _, results, checks, _ = ended("link", volume, specimen_files[1], "--mirror")
    assert checks["hand of the volume"]["state"] == "pass"
    assert "fit mirrored, which agrees with that" in checks["hand of the volume"]["sentence"]
    orientation = results["layers"][0]["registration"]["orientation"]
    assert "left-handed system" in orientation["sentence"]
    assert "fit on each other mirrored, which agrees with that" in orientation["sentence"]


@pytest.mark.ci
def test_an_image_that_its_tag_mirrors(planish, specimen_files, tmp_path):
    image = tifffile.imread(specimen_files[1])
    tag = [(274, 3, 1, 2, True)]
    path = tmp_path / "tagged.tif"
    resolution = (2000, 2000)  # pixels of 5 um
    tifffile.imwrite(
        path,
        np.ascontiguousarray(image[:, ::-1]),
        metadata=None,
        extratags=tag,
        resolution=resolution,
        resolutionunit="CENTIMETER",
    )
    code, _, error = planish("link", specimen_files[0], path, "-o", tmp_path / "run")
    assert code == 3
    for words in ("match if one side is mirrored", "orientation tag 2", "mirror image"):
        assert words in " ".join(error.split())


# --- what is refused, or doubted ------------------------------------------------------------------
def test_a_volume_that_is_cut_or_holds_no_sheet(refuses, specimen_files, tmp_path):
    noise = np.random.default_rng(0).normal(60, 4, (40, 60, 70)).astype(np.uint8)
    refuses(
        "map",
        write_volume(tmp_path / "noise.tif", noise),
        words=("no sheet in the volume", "--through"),
    )
    empty = np.full((20, 40, 40), np.nan, np.float32)
    refuses("map", write_volume(tmp_path / "nan.tif", empty), words="NaN")
    broken = tmp_path / "cut.tif"
    broken.write_bytes(specimen_files[0].read_bytes()[:-1000])
    refuses("map", broken, words="cut.tif")
    refuses("info", broken, words="cut.tif", out=False)


@pytest.mark.ci
def test_missing_voxels_are_a_look_and_with_strict_exit_code_4(passes, specimen, tmp_path):
    part = specimen.volume.values[:, :125, :200].astype(np.float32)
    part[:, :15] = np.nan
    path = write_volume(tmp_path / "part.tif", part)
    _, err = passes("map", path, "-o", tmp_path / "run", "--strict", codes=(4,))
    assert "look: missing voxels" in err
    assert "12.0 %" in err
    assert (tmp_path / "run" / "report.html").is_file()


def test_missing_sizes_are_asked_for_with_the_option_that_gives_them(
    refuses, specimen_files, tmp_path
):
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
    assert ((out / "mine.txt").read_text(), [p.name for p in out.iterdir()]) == (
        "keep",
        ["mine.txt"],
    )


def test_register_refuses_the_name_of_its_table_before_it_writes(refuses, tmp_path):
    for name in ("sheet.json", "image.json"):
        (tmp_path / name).write_text("{}")
    refuses(
        "register",
        tmp_path / "sheet.json",
        tmp_path / "image.json",
        "-o",
        tmp_path / "marks.csv",
        words="marks.csv is the name of the table",
        code=2,
        out=False,
    )
