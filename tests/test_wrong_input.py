"""What was wrong with an input and came out unnoticed once: what planish says now, how it ends, what it withholds."""

import json
import re

import nibabel
import numpy as np
import pytest
import tifffile

from folders import write_image, write_volume
from planish.run import open_run


def marks_file(path, specimen, count, *, error_um=0.5, wrong=None, wrong_um=80.0):
    """Pairs set by hand on material points of the sheet, one of them wrong."""
    rng = np.random.default_rng(2)
    low, high = specimen.sheet.holes.min(axis=0) - 60, specimen.sheet.holes.max(axis=0) + 60
    sheet = rng.uniform(low, high, (count, 2))
    volume, image = specimen.warp.points(*sheet.T), specimen.pose(sheet) + rng.normal(0, error_um, (count, 2))
    if wrong is not None:
        image[wrong, 0] += wrong_um
    rows = ["label,volume_x_um,volume_y_um,volume_z_um,fixed_x_um,fixed_y_um"]
    for k, place in enumerate(np.hstack([volume, image])):
        rows.append(",".join([chr(97 + k), *(f"{v:.3f}" for v in place)]))
    path.write_text("\n".join(rows))
    return path


@pytest.fixture
def ended(planish, tmp_path):
    """Run a command into a folder: exit code, results, the checks by name, and all that was printed."""

    def run(*arguments):
        out = tmp_path / f"run{len(list(tmp_path.iterdir()))}"
        code, printed, err = planish(*arguments, "-o", out)
        assert code in (0, 4), err
        results = json.loads((out / "results.json").read_text())
        return code, results, {check["name"]: check for check in results["checks"]}, printed + err

    return run


@pytest.mark.nightly
def test_spacing_along_z_half_as_large_again(ended, specimen, specimen_files, tmp_path):
    """Base +27.5 um: the marks ask for two thirds of it, thicknesses and correlations are withheld."""
    marks = marks_file(tmp_path / "m.csv", specimen, 12)
    wrong = ("--voxel-um", "6,4,4", "--override-size", "--marks", marks)
    code, results, checks, printed = ended("link", *specimen_files, *wrong)
    check = checks["scale through the sheet"]
    assert (code, check["state"]) == (4, "fail"), check
    assert check["value"] == pytest.approx(4 / 6, abs=0.05)
    assert "The marks imply a voxel spacing along z that is 0.6" in check["sentence"]
    assert "um for 6." in check["sentence"]
    assert check["sentence"] in " ".join(printed.split())
    sheet = results["layers"][0]["sheet"]
    assert {p["trust"] for p in sheet["properties"].values()} == {"withheld"}
    assert all(row["trust"] == "withheld" and row["r"] is None for row in results["correlations"])


def test_a_right_spacing_with_the_same_marks(ended, specimen, specimen_files, linked_run, tmp_path):
    marks = marks_file(tmp_path / "m.csv", specimen, 12)
    code, results, checks, _ = ended("link", linked_run, specimen_files[1], "--marks", marks)
    check = checks["scale through the sheet"]
    assert (code, check["state"]) == (0, "pass"), check
    assert check["value"] == pytest.approx(1, abs=0.12)
    assert "withheld" not in {p["trust"] for p in results["layers"][0]["sheet"]["properties"].values()}


@pytest.mark.nightly
def test_six_pairs_by_hand_with_one_that_is_80_um_off(ended, specimen, specimen_files, linked_run, tmp_path):
    marks = marks_file(tmp_path / "m.csv", specimen, 6, wrong=3)
    code, _, checks, printed = ended("link", linked_run, specimen_files[1], "--marks", marks)
    check = checks["marks"]
    assert (code, check["state"]) == (0, "look"), check
    assert check["sentence"].startswith("5 of 6 marks agree to ")
    assert "d is " in check["sentence"]
    assert "um off and was left out" in check["sentence"]
    assert check["sentence"].rstrip(".") in " ".join(printed.split())
    strict = ended("link", linked_run, specimen_files[1], "--marks", marks, "--strict")
    assert strict[0] == 4


# --- volumes ---------------------------------------------------------------------------------------------------------
def in_order_of(volume, *parts, axis=0):
    """The volume put together anew of these slices (from, to) along an axis."""
    return np.concatenate([volume.take(range(first, last), axis) for first, last in parts], axis=axis)


def cut_off(volume, _top):
    """Grey clipped where the coating begins."""
    return np.minimum(volume, np.percentile(volume, 97)).astype(volume.dtype)


def cut_off_in_12_bits(volume, _top):
    """4095 of 65535: the scale of the file says nothing."""
    level = float(np.percentile(volume, 97))
    return np.minimum(volume * (4095 / level), 4095).astype(np.uint16)


def second_sheet(volume, _top):
    """The same sheet once more, lying on the first."""
    shift = 24  # its thickness in voxels
    low = np.full((shift, *volume.shape[1:]), np.median(volume[-3:]), dtype=volume.dtype)
    first, second = np.concatenate([volume, low]), np.concatenate([low, volume])
    return np.maximum(first, second)


def dusty(volume, top):
    """Sixty balls of coating of 30 to 50 um on the top face."""
    rng, volume = np.random.default_rng(4), volume.copy()
    rows, cols = (rng.integers(8, n - 8, 60) for n in top.shape)
    z, y, x = np.indices((13, 13, 13)) - 6
    grey = np.percentile(volume, 99)
    for row, col in zip(rows, cols, strict=True):
        if np.isfinite(top[row, col]):
            radius, at = rng.uniform(3.7, 6.2), round(top[row, col] / 4)
            part = volume[at - 4 : at + 9, row - 6 : row + 7, col - 6 : col + 7]
            part[np.hypot(np.hypot(z, y), x)[: len(part)] < radius] = grey
    return volume


MAPPED = {
    "pairs exchanged": (lambda v, _: v[np.clip(np.arange(len(v)) ^ 1, 0, len(v) - 1)],
                        "slices along z", "fail", "exchanged"),
    "second sheet": (second_sheet, "one sheet", "fail", "sheets? lies? on"),
    "five twice": (lambda v, _: in_order_of(v, (0, len(v) // 2), (len(v) // 2 - 5, len(v))),
                   "slices along z", "look", "are copies of"),
    "three missing": (lambda v, _: np.delete(v, np.arange(3) + len(v) // 2, axis=0),
                      "slices along z", "look", "missing"),
    "five rows twice": (lambda v, _: in_order_of(v, (0, 100), (95, v.shape[1]), axis=1),
                        "slices along y", "look", "are copies of"),
    "rows exchanged": (lambda v, _: in_order_of(v, (0, 80), (120, 160), (80, 120), (160, v.shape[1]), axis=1),
                       "slices along y", "fail", "not in order"),
    "cut off": (cut_off, "clipped grey", "look", "where the scale was cut off"),
    "cut off as floats": (lambda v, _: cut_off(v, None).astype(np.float32) / 200,
                          "clipped grey", "look", "where the scale was cut off"),
    "cut off in 12 bits": (cut_off_in_12_bits,
                           "clipped grey", "look", "have the grey 4095, where the scale was cut off"),
    "dusty": (dusty, "dust, top", "look", "particles stick out of the top coating"),
}  # fmt: skip


@pytest.mark.nightly
@pytest.mark.parametrize(("change", "name", "state", "words"), MAPPED.values(), ids=MAPPED)
def test_a_wrong_volume(change, name, state, words, ended, specimen, linked_run, tmp_path):
    """What fails is withheld and ends with 4; what is doubtful is said, and with --strict it ends with 4 too."""
    top = open_run(linked_run).sheet().groups["surfaces"]["top"].values
    volume = write_volume(tmp_path / "v.tif", np.ascontiguousarray(change(specimen.volume.values, top)))
    code, results, checks, printed = ended("map", volume)
    check = checks[name]
    assert check["state"] == state, [c for c in checks.values() if c["state"] != "pass"]
    assert re.search(words, check["sentence"])
    assert check["sentence"] in " ".join(printed.split())
    assert check["advice"]
    assert check["figures"]
    assert code == (4 if "fail" in {c["state"] for c in checks.values()} else 0)
    trusts = {p["trust"] for p in results["layers"][0]["sheet"]["properties"].values()}
    if not set(check["figures"]) <= {"position", "correlation"}:
        assert ("withheld" if state == "fail" else "doubtful") in trusts or "withheld" in trusts


@pytest.mark.nightly
def test_a_sheet_of_three_voxels(ended, specimen, tmp_path):
    """Thinner than four voxels every thickness is too large."""
    every = 8
    values = specimen.volume.values[: len(specimen.volume) // every * every]
    coarse = values.reshape(-1, every, *values.shape[1:]).mean(axis=1).astype(values.dtype)
    volume = write_volume(tmp_path / "v.tif", coarse)
    _, results, checks, _ = ended("map", volume, "--voxel-um", "32,4,4", "--override-size")
    check = checks["voxels through the sheet"]
    assert check["state"] == "look"
    assert check["sentence"].startswith("The sheet is ")
    assert results["layers"][0]["sheet"]["properties"]["thickness"]["trust"] in ("doubtful", "withheld")


@pytest.mark.nightly
def test_a_short_cut_off_is_the_one_that_is_stated(ended, specimen_files, linked_run):
    """250 um gave the surface of 500 um: now it differs from that of 400, and where it is wider is counted."""
    _, results, checks, _ = ended("map", specimen_files[0], "--cutoff-um", "250")
    assert checks["cut-off"]["state"] == "pass"
    assert "the stated cut-off of 250 um" in checks["cut-off"]["sentence"]
    usual = json.loads((linked_run / "results.json").read_text())
    short, long = (k["layers"][0]["sheet"]["properties"]["topography_top"]["sd"] for k in (results, usual))
    assert short < 0.95 * long  # waves of 250 to 400 um belong to the centre surface now


# --- sides and specimens ---------------------------------------------------------------------------------------------
@pytest.mark.nightly
def test_a_stack_of_the_wrong_hand(ended, specimen, specimen_files, tmp_path):
    """Its slices the other way round, and the mirror declared: top and bottom coating are exchanged."""
    volume = write_volume(tmp_path / "v.tif", specimen.volume.values[::-1])
    code, results, checks, _ = ended("link", volume, specimen_files[1], "--mirror")
    found = [c for c in checks.values() if "side" in c["name"]]
    assert (code, [c["state"] for c in found]) == (4, ["fail"]), found
    assert "correlates with the coating of the bottom side" in found[0]["sentence"]
    assert all(row["r"] is None for row in results["correlations"])


@pytest.fixture(scope="module")
def foreign_image(specimen, specimen_files, tmp_path_factory):
    """An image of another specimen with the same laser program: other paper around the same holes."""
    image = tifffile.imread(specimen_files[1])
    rows, cols = np.indices(image.shape)
    far = np.min([np.hypot(rows - y, cols - x) for x, y in specimen.pose(specimen.sheet.holes) / 5.0], axis=0)
    sheet = image[far > 34]
    other = np.where(far > 34, image, np.random.default_rng(1).choice(sheet, image.shape)).astype(image.dtype)
    made = np.where(far > 34, other[::-1, ::-1], image)
    return write_image(tmp_path_factory.mktemp("foreign") / "other.tif", made)


@pytest.mark.nightly
def test_an_image_of_another_specimen_with_the_same_holes(ended, linked_run, foreign_image):
    code, results, checks, printed = ended("link", linked_run, foreign_image)
    check = checks["side and specimen"]
    assert (code, check["state"]) == (0, "look"), check
    assert "nothing beside the marks says that both show one specimen" in check["sentence"]
    assert check["sentence"] in " ".join(printed.split())
    assert checks["marks"]["state"] == "pass"
    assert {row["trust"] for row in results["correlations"]} == {"doubtful"}
    assert ended("link", linked_run, foreign_image, "--strict")[0] == 4


def test_two_images_of_different_specimens_with_the_same_holes(ended, specimen_files, foreign_image):
    code, results, checks, _ = ended("link", specimen_files[1], foreign_image)
    check = checks["side and specimen"]
    assert (code, check["state"]) == (0, "look"), check
    assert "nothing beside the marks says that both show one specimen" in check["sentence"]
    assert {row["trust"] for row in results["correlations"]} == {"doubtful"}


@pytest.mark.nightly
@pytest.mark.parametrize("sign", [1, -1])
def test_a_left_handed_volume_is_marked(sign, ended, specimen, tmp_path):
    """The affine of a NIfTI file may say that its slices are a mirror image; every map of it would be one."""
    image = nibabel.Nifti1Image(specimen.volume.values.T, np.diag([4.0 * sign, 4.0, 4.0, 1.0]))
    image.header.set_xyzt_units("micron")
    nibabel.save(image, tmp_path / "v.nii")
    code, _, checks, printed = ended("map", tmp_path / "v.nii")
    assert (code, "hand of the volume" in checks) == (0, sign < 0)
    assert ("mirror image of the specimen" in printed) == (sign < 0)
