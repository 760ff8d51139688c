"""What a user can hand in wrongly: each ends with a sentence that helps, the right exit code, and no run folder."""

import numpy as np
import pytest
import tifffile
from PIL import Image

from folders import disc_image, write_image, write_volume
from planish.io import new_folder
from planish.run import open_run


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


def test_volumes_that_are_truncated_unequal_or_without_a_sheet(refuses, specimen_files, tmp_path):
    noise = np.random.default_rng(0).normal(60, 4, (40, 60, 70)).astype(np.uint8)
    volume = write_volume(tmp_path / "noise.tif", noise)
    refuses("map", volume, words=("no sheet in the volume", "--through"))
    refuses("link", volume, specimen_files[1], words="no sheet")
    data = specimen_files[0].read_bytes()
    broken = tmp_path / "cut.tif"
    broken.write_bytes(data[: len(data) // 2])
    refuses("map", broken, words="cut.tif")
    refuses("info", broken, words="cut.tif", out=False)
    folder = tmp_path / "slices"
    folder.mkdir()
    for k in range(9):
        tifffile.imwrite(folder / f"s{k:03d}.tif", np.zeros((50, 60 if k != 6 else 61), np.uint8))
    refuses("map", folder, "--voxel-um", 3, words=("s006.tif", "60", "61"))


def test_broken_tiffs(refuses, shared_data):
    """Every broken file of the corpus, as volume and as image: exit code 3 and a sentence."""
    files = sorted((shared_data("tiff_corpus") / "fuzz").glob("*.tif"))
    assert len(files) > 100
    for file in files:
        refuses("map", file, "--voxel-um", 3, words="planish: ")
    print(f"{len(files)} broken files refused with exit code 3")


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_holes_in_the_image(refuses, linked_run, holes_um, tmp_path, count):
    image = write_image(tmp_path / "few.tif", disc_image(holes_um[:count], (300, 330)))
    holes = "No hole" if count == 0 else f"Only {count} hole"
    refuses("link", linked_run, image, words=("in the image", "at least 3", "--marks", holes))


@pytest.mark.nightly
def test_too_few_holes_in_the_volume(planish, specimen, specimen_files, holes_um, tmp_path):
    """All holes of the volume but two are filled with the sheet beside them: its texture links, or nothing does."""
    volume = specimen.volume.values.copy()
    for u, v in specimen.sheet.holes[2:]:
        x, y, _ = specimen.warp.points(np.array([u]), np.array([v]))[0] / 4.0
        i, j = slice(max(int(y) - 34, 0), int(y) + 34), slice(max(int(x) - 34, 0), int(x) + 34)
        ys = [k for k in range(volume.shape[1]) if abs(k - y) < 34]
        xs = [k for k in range(volume.shape[2]) if abs(k - x) < 34]
        donor = volume[:, ys][:, :, [max(xs[0] - 1, 0)]]
        volume[:, i, j] = np.broadcast_to(donor, volume[:, i, j].shape)
    path = write_volume(tmp_path / "filled.tif", volume)

    code, _, err = planish("link", path, specimen_files[1], "--out", tmp_path / "run")
    assert code == 0, err
    run = open_run(tmp_path / "run")
    assert run.results.layers[0].registration.source == "texture"
    off_um = np.hypot(*(run.groups["linked"][k] - specimen.truth[k] for k in ("volume_x", "volume_y"))).values
    off_um = off_um[run.groups["linked"]["valid"].values]
    print(f"off by {np.nanmedian(off_um):.2f} um (median), {np.nanquantile(off_um, 0.95):.2f} um (95 %)")
    assert np.nanmedian(off_um) < 3.0

    plain = write_image(tmp_path / "plain.tif", disc_image(holes_um, (300, 330)))
    code, _, err = planish("link", path, plain, "--out", tmp_path / "none")
    assert (code, "in the sheet" in err, "hole" in err) == (3, True, True), err
    assert not (tmp_path / "none").exists()


@pytest.mark.nightly
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
    image = write_image(tmp_path / "square_image.tif", disc_image(square, (260, 260)))
    code, _, err = planish("link", path, image, "--out", tmp_path / "run")
    assert (code, "symmetric" in err, "--marks" in err) == (3, True, True), err
    assert not (tmp_path / "run").exists()


def test_another_pattern_in_the_image_and_marks_that_do_not_fit(refuses, linked_run, tmp_path, specimen_files):
    other = [(200.0, 200.0), (1300.0, 260.0), (1250.0, 1190.0), (260.0, 1250.0), (690.0, 420.0)]
    image = write_image(tmp_path / "other.tif", disc_image(other, (300, 320)))
    refuses("link", linked_run, image, words="5")
    marks = tmp_path / "marks.csv"
    marks.write_text(
        "label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um\na,100,100,100,100\nb,900,100,500,100\nc,100,700,100,400\n"
    )
    refuses("link", linked_run, specimen_files[1], "--marks", marks, words=("scale", "calibration"))
    marks.write_text("label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um\na,100,100,100,100\nb,900,x,500,100\n")
    refuses("link", *specimen_files, "--marks", marks, words="marks.csv")


def test_nan_voxels_everywhere_and_in_part(passes, refuses, corner, tmp_path):
    empty = np.full((20, 40, 40), np.nan, np.float32)
    refuses("map", write_volume(tmp_path / "nan.tif", empty), words="NaN")
    part = corner.astype(np.float32)
    part[:, :15] = np.nan
    path = write_volume(tmp_path / "part.tif", part)
    _, err = passes("map", path, "-o", tmp_path / "run", "--strict", codes=(4,))
    assert "look: missing voxels" in err
    assert "12.0 %" in err
    assert (tmp_path / "run" / "report.html").is_file()


@pytest.mark.nightly
def test_saturated_voxels(passes, corner, tmp_path):
    bright = np.clip(corner.astype(float) * 1.6, 0, 255).astype(np.uint8)
    _, err = passes(
        "map", write_volume(tmp_path / "bright.tif", bright), "-o", tmp_path / "run", "--strict", codes=(4,)
    )
    assert "look: clipped grey" in err
    assert "wider grey window" in err


def test_missing_sizes_and_voxels_a_thousand_times_too_large_or_small(
    refuses, specimen, specimen_files, tmp_path, corner_file
):
    plain = tmp_path / "plain.png"
    Image.fromarray(np.rint(specimen.image.values * 255).clip(0, 255).astype(np.uint8)).save(plain)
    refuses("link", specimen_files[0], plain, words=("plain.png", "pixel size", "--pixel-um"))
    bare = tmp_path / "bare.tif"
    tifffile.imwrite(bare, specimen.volume.values)
    refuses("map", bare, words=("bare.tif", "voxel size", "--voxel-um"))
    refuses("map", corner_file, "--voxel-um", 4000, "--override-size", words="4000")
    refuses("map", corner_file, "--voxel-um", 4000, words=("4000", "--override-size"))
    refuses("map", corner_file, "--voxel-um", 0.02, "--override-size", words="um thick")


def test_wrong_usage_and_an_output_folder_that_exists(refuses, specimen_files, tmp_path):
    refuses("map", specimen_files[0], words="--out", code=2, out=False)
    refuses("map", specimen_files[0], "--voxel-um", "3;3", words="SIZE|Z,Y,X", code=2)
    refuses("flattern", words="flattern", code=2, out=False)
    refuses("map", tmp_path / "nothing.tif", words="nothing.tif")
    out = tmp_path / "kept"
    out.mkdir()
    (out / "mine.txt").write_text("keep")
    refuses("map", specimen_files[0], "-o", out, words=("exists already", "--out"), out=False)
    assert ((out / "mine.txt").read_text(), [p.name for p in out.iterdir()]) == ("keep", ["mine.txt"])


def test_disk_full_while_writing(refuses, corner_file, monkeypatch):
    """A limit on the size of files makes the real write fail half way, as a full disk does."""
    limit = pytest.importorskip("resource")
    before = limit.getrlimit(limit.RLIMIT_FSIZE)

    def limited(path, **where):
        limit.setrlimit(limit.RLIMIT_FSIZE, (40000, before[1]))
        return new_folder(path, **where)

    monkeypatch.setattr("planish.run.save.new_folder", limited)
    try:
        refuses("map", corner_file, words=("disk is full", "Nothing was kept"), code=5)
    finally:
        limit.setrlimit(limit.RLIMIT_FSIZE, before)
