"""What was wrong with an input and came out unnoticed once: what planish says now, how it ends, what it withholds."""

from __future__ import annotations

import json

import numpy as np
import pytest
import tifffile


def write_volume(path, volume, voxel=4.0):
    meta = {"spacing": voxel, "unit": "um", "axes": "ZYX"}
    tifffile.imwrite(path, volume, imagej=True, resolution=(1 / voxel, 1 / voxel), metadata=meta)
    return path


def marks_file(path, specimen, count, *, error_um=0.5, wrong=None, wrong_um=80.0):
    """Pairs set by hand on material points of the sheet, one of them wrong."""
    rng = np.random.default_rng(2)
    low, high = specimen.sheet.holes.min(axis=0) - 60, specimen.sheet.holes.max(axis=0) + 60
    sheet = rng.uniform(low, high, (count, 2))
    volume, image = specimen.warp.points(*sheet.T), specimen.pose(sheet) + rng.normal(0, error_um, (count, 2))
    if wrong is not None:
        image[wrong, 0] += wrong_um
    rows = ["label,volume_x_um,volume_y_um,volume_z_um,fixed_x_um,fixed_y_um"]
    rows += [
        f"{chr(97 + k)},{','.join(f'{v:.3f}' for v in (*p, *q))}"
        for k, (p, q) in enumerate(zip(volume, image, strict=True))
    ]
    path.write_text("\n".join(rows))
    return path


@pytest.fixture
def ended(planish, tmp_path):
    """Run a command into a folder: exit code, results, the checks by name, and all that was printed."""

    def run(*arguments):
        out = tmp_path / f"run{len(list(tmp_path.iterdir()))}"
        code, printed, err = planish(*arguments, "-o", out)
        results = json.loads((out / "results.json").read_text())
        return code, results, {check["name"]: check for check in results["checks"]}, printed + err

    return run


def test_spacing_along_z_half_as_large_again(ended, specimen, specimen_files, tmp_path):
    """Base +27.5 um: the marks ask for two thirds of it, thicknesses and correlations are withheld."""
    marks = marks_file(tmp_path / "m.csv", specimen, 12)
    wrong = ("--voxel-um", "6,4,4", "--override-size", "--marks", marks)
    code, results, checks, printed = ended("link", *specimen_files, *wrong)
    check = checks["scale through the sheet"]
    assert (code, check["state"]) == (4, "fail"), check
    assert check["value"] == pytest.approx(4 / 6, abs=0.05)
    assert "The marks ask for a voxel spacing along z that is 0.6" in check["sentence"]
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


def test_slices_in_the_order_of_their_names_without_zeros(ended, specimen, tmp_path):
    """Neighbours exchanged along z: coating -6, base +15 um."""
    order = np.arange(len(specimen.volume)) ^ 1
    volume = specimen.volume.values[np.clip(order, 0, len(order) - 1)]
    code, results, checks, _ = ended("map", write_volume(tmp_path / "v.tif", volume))
    check = checks["slices along z"]
    assert (code, check["state"]) == (4, "fail"), check
    assert "exchanged" in check["sentence"]
    assert {p["trust"] for p in results["layers"][0]["sheet"]["properties"].values()} == {"withheld"}


def test_a_stack_of_the_wrong_hand(ended, specimen, specimen_files, tmp_path):
    """Its slices the other way round, and the mirror declared: top and bottom coating are exchanged."""
    volume = write_volume(tmp_path / "v.tif", specimen.volume.values[::-1])
    code, results, checks, _ = ended("link", volume, specimen_files[1], "--mirror")
    found = [c for c in checks.values() if "side" in c["name"]]
    assert (code, [c["state"] for c in found]) == (4, ["fail"]), found
    assert "goes with the coating of the bottom side" in found[0]["sentence"]
    assert all(row["r"] is None for row in results["correlations"])
