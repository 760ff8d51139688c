"""What a user can hand in wrongly: each ends with a sentence that helps, the right exit code, and no run folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from planish.io.run_folder import new_folder


def stop(result, code, *words, out: Path | None = None):
    """Check exit code and words; there is no traceback, and nothing is left that looks like a result."""
    got, _, err = result
    assert got == code, err
    for word in words:
        assert word in err, err
    assert "Traceback" not in err
    if out is not None:
        assert not out.exists()
        assert not list(out.parent.glob(".*partial"))


def sheet_image(shape=(220, 280), holes=(), pixel=5.0, seed=0):
    """A grey sheet with dark discs of 170 um."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]] * pixel
    image = 0.8 + 0.01 * np.random.default_rng(seed).normal(size=shape)
    for hx, hy in holes:
        image = np.where(np.hypot(x - hx, y - hy) < 85, 0.05, image)
    return np.rint(image * 60000).astype(np.uint16)


def write_image(path, image, pixel=5.0):
    tifffile.imwrite(path, image, resolution=(1e4 / pixel, 1e4 / pixel), resolutionunit="CENTIMETER")
    return path


def write_volume(path, volume, voxel=4.0):
    meta = {"spacing": voxel, "unit": "um", "axes": "ZYX"}
    tifffile.imwrite(path, volume, imagej=True, resolution=(1 / voxel, 1 / voxel), metadata=meta)
    return path


@pytest.fixture(scope="module")
def corner(specimen):
    """A corner of the specimen's volume, 0.5 x 0.8 mm."""
    return specimen.volume.values[:, :125, :200]


@pytest.fixture(scope="module")
def corner_file(corner, tmp_path_factory):
    return write_volume(tmp_path_factory.mktemp("corner") / "volume.tif", corner)


@pytest.fixture(scope="module")
def holes_um(specimen):
    return specimen.pose(specimen.sheet.holes)


def test_no_sheet_in_the_volume(planish, specimen_files, tmp_path):
    noise = np.random.default_rng(0).normal(60, 4, (40, 60, 70)).astype(np.uint8)
    volume = write_volume(tmp_path / "noise.tif", noise)
    stop(
        planish("map", volume, "--out", tmp_path / "run"),
        3,
        "no sheet in the volume",
        "--through",
        out=tmp_path / "run",
    )
    stop(planish("link", volume, specimen_files[1], "-o", tmp_path / "run"), 3, "no sheet", out=tmp_path / "run")


def test_truncated_volume(planish, specimen_files, tmp_path):
    data = specimen_files[0].read_bytes()
    broken = tmp_path / "cut.tif"
    broken.write_bytes(data[: len(data) // 2])
    stop(planish("map", broken, "--out", tmp_path / "run"), 3, "cut.tif", out=tmp_path / "run")
    stop(planish("info", broken), 3, "cut.tif")


def test_broken_tiffs(planish, shared_data, tmp_path):
    """Every broken file of the corpus, as volume and as image: exit code 3 and a sentence."""
    files = sorted((shared_data("tiff_corpus") / "fuzz").glob("*.tif"))
    assert len(files) > 100
    for file in files:
        stop(planish("map", file, "--voxel-um", 3, "--out", tmp_path / "run"), 3, "planish: ", out=tmp_path / "run")
    print(f"{len(files)} broken files refused with exit code 3")


def test_slices_of_unequal_size(planish, tmp_path):
    folder = tmp_path / "slices"
    folder.mkdir()
    for k in range(9):
        tifffile.imwrite(folder / f"s{k:03d}.tif", np.zeros((50, 60 if k != 6 else 61), np.uint8))
    stop(
        planish("map", folder, "--voxel-um", 3, "-o", tmp_path / "run"), 3, "s006.tif", "60", "61", out=tmp_path / "run"
    )


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_holes_in_the_image(planish, linked_run, holes_um, tmp_path, count):
    image = write_image(tmp_path / "few.tif", sheet_image((300, 330), holes_um[:count]))
    words = ["in the image", "at least 3", "--marks", "No hole" if count == 0 else f"Only {count} hole"]
    stop(planish("link", linked_run, image, "-o", tmp_path / "run"), 3, *words, out=tmp_path / "run")


@pytest.mark.study
def test_too_few_holes_in_the_volume(planish, specimen, specimen_files, tmp_path):
    """Fill all holes of the volume but two with the sheet beside them."""
    volume = specimen.volume.values.copy()
    for u, v in specimen.sheet.holes[2:]:
        x, y, _ = specimen.warp.points(np.array([u]), np.array([v]))[0] / 4.0
        i, j = slice(max(int(y) - 34, 0), int(y) + 34), slice(max(int(x) - 34, 0), int(x) + 34)
        ys = [k for k in range(volume.shape[1]) if abs(k - y) < 34]
        xs = [k for k in range(volume.shape[2]) if abs(k - x) < 34]
        donor = volume[:, ys][:, :, [max(xs[0] - 1, 0)]]
        volume[:, i, j] = np.broadcast_to(donor, volume[:, i, j].shape)
    path = write_volume(tmp_path / "filled.tif", volume)
    stop(
        planish("link", path, specimen_files[1], "-o", tmp_path / "run"),
        3,
        "in the sheet",
        "hole",
        out=tmp_path / "run",
    )


@pytest.mark.study
def test_symmetric_pattern(planish, tmp_path):
    """Four holes on a square fit in four ways."""
    square = [(400.0, 400.0), (900.0, 400.0), (900.0, 900.0), (400.0, 900.0)]
    size, voxel = 325, 4.0
    z, y, x = np.ogrid[0:45, 0:size, 0:size]
    volume = np.where(np.abs(z * voxel - 88) < 40, 150.0, 30.0) * np.ones((1, size, size))
    for hx, hy in square:
        volume = np.where(np.hypot(x * voxel - hx, y * voxel - hy) < 85, 30.0, volume)
    volume += np.random.default_rng(0).normal(0, 4, volume.shape)
    path = write_volume(tmp_path / "square.tif", volume.astype(np.uint8))
    image = write_image(tmp_path / "square_image.tif", sheet_image((260, 260), square))
    stop(planish("link", path, image, "-o", tmp_path / "run"), 3, "symmetric", "--marks", out=tmp_path / "run")


def test_other_pattern_in_the_image(planish, linked_run, tmp_path):
    other = [(200.0, 200.0), (1300.0, 260.0), (1250.0, 1190.0), (260.0, 1250.0), (690.0, 420.0)]
    image = write_image(tmp_path / "other.tif", sheet_image((300, 320), other))
    stop(planish("link", linked_run, image, "-o", tmp_path / "run"), 3, "5", out=tmp_path / "run")


def test_nan_voxels_everywhere_and_in_part(planish, corner, tmp_path):
    empty = np.full((20, 40, 40), np.nan, np.float32)
    path = write_volume(tmp_path / "nan.tif", empty)
    stop(planish("map", path, "-o", tmp_path / "run"), 3, "NaN", out=tmp_path / "run")
    part = corner.astype(np.float32)
    part[:, :15] = np.nan
    path = write_volume(tmp_path / "part.tif", part)
    code, _, err = planish("map", path, "-o", tmp_path / "run", "--strict")
    assert code == 4
    assert "look: missing voxels" in err
    assert "12.0 %" in err
    assert (tmp_path / "run" / "report.html").is_file()


@pytest.mark.study
def test_saturated_voxels(planish, corner, tmp_path):
    bright = np.clip(corner.astype(float) * 1.6, 0, 255).astype(np.uint8)
    code, _, err = planish("map", write_volume(tmp_path / "bright.tif", bright), "-o", tmp_path / "run", "--strict")
    assert code == 4
    assert "look: clipped grey" in err
    assert "wider grey window" in err


def test_voxel_a_thousand_times_too_large_or_small(planish, corner_file, tmp_path):
    stop(
        planish("map", corner_file, "--voxel-um", 4000, "--override-size", "-o", tmp_path / "run"),
        3,
        "4000",
        out=tmp_path / "run",
    )
    stop(
        planish("map", corner_file, "--voxel-um", 4000, "-o", tmp_path / "run"),
        3,
        "4000",
        "--override-size",
        out=tmp_path / "run",
    )
    stop(
        planish("map", corner_file, "--voxel-um", 0.02, "--override-size", "-o", tmp_path / "run"),
        3,
        "um thick",
        out=tmp_path / "run",
    )


def test_missing_sizes(planish, specimen, specimen_files, tmp_path):
    plain = tmp_path / "plain.png"
    Image.fromarray(np.rint(specimen.image.values * 255).clip(0, 255).astype(np.uint8)).save(plain)
    stop(
        planish("link", specimen_files[0], plain, "-o", tmp_path / "run"),
        3,
        "plain.png",
        "pixel size",
        "--pixel-um",
        out=tmp_path / "run",
    )
    bare = tmp_path / "bare.tif"
    tifffile.imwrite(bare, specimen.volume.values)
    stop(planish("map", bare, "-o", tmp_path / "run"), 3, "bare.tif", "voxel size", "--voxel-um", out=tmp_path / "run")


def test_output_folder_that_exists(planish, specimen_files, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine.txt").write_text("keep")
    stop(planish("map", specimen_files[0], "-o", tmp_path / "run"), 3, "exists already", "--out")
    assert (tmp_path / "run" / "mine.txt").read_text() == "keep"
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["mine.txt"]


def test_disk_full_while_writing(planish, corner_file, tmp_path, monkeypatch):
    """A limit on the size of files makes the real write fail half way, as a full disk does."""
    limit = pytest.importorskip("resource")
    before = limit.getrlimit(limit.RLIMIT_FSIZE)

    def limited(path, **where):
        limit.setrlimit(limit.RLIMIT_FSIZE, (40000, before[1]))
        return new_folder(path, **where)

    monkeypatch.setattr("planish.pipeline.save.new_folder", limited)
    out = tmp_path / "run"
    try:
        result = planish("map", corner_file, "--out", out)
    finally:
        limit.setrlimit(limit.RLIMIT_FSIZE, before)
    stop(result, 5, "disk is full", "Nothing was kept", out=out)


def test_wrong_usage(planish, specimen_files, tmp_path):
    stop(planish("map", specimen_files[0]), 2, "--out")
    stop(planish("map", specimen_files[0], "--voxel-um", "3;3", "-o", tmp_path / "run"), 2, "SIZE|Z,Y,X")
    stop(planish("flattern"), 2, "flattern")
    stop(planish("map", tmp_path / "nothing.tif", "-o", tmp_path / "run"), 3, "nothing.tif", out=tmp_path / "run")


def test_marks_that_do_not_fit(planish, linked_run, specimen_files, tmp_path):
    marks = tmp_path / "marks.csv"
    marks.write_text(
        "label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um\na,100,100,100,100\nb,900,100,500,100\nc,100,700,100,400\n"
    )
    stop(
        planish("link", linked_run, specimen_files[1], "--marks", marks, "-o", tmp_path / "run"),
        3,
        "scale",
        "calibration",
        out=tmp_path / "run",
    )
    marks.write_text("label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um\na,100,100,100,100\nb,900,x,500,100\n")
    stop(
        planish("link", *specimen_files, "--marks", marks, "-o", tmp_path / "run"), 3, "marks.csv", out=tmp_path / "run"
    )
