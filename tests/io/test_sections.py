"""Folders of section photographs: what the cut counter may say, and every way in which it can be
wrong."""

from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image

from folders import refused
from planish.core.errors import FileError, ResourceError, SizeError, VolumeError
from planish.io import is_section_folder, read_section_stack

POSITIONS = (10.0, 13.0, 16.5, 25.0)
PER_CM = 1e4 / 2.43  # pixels of 2.43 um


def pictures(count=4, dtype="uint8"):
    return np.random.default_rng(2).integers(0, 200, (count, 7, 9)).astype(dtype)


def counter(*rows, header="file,position_um", before=""):
    return "\n".join([*([before] if before else []), header, *rows]) + "\n"


ROWS = tuple(f"s{i}.tif,{p}" for i, p in enumerate(POSITIONS))


WHOLE = counter(*ROWS)


def write(folder, values=None, text=WHOLE, *, stated=True):
    folder.mkdir(exist_ok=True)
    for i, page in enumerate(pictures() if values is None else values):
        tags: dict[str, Any] = (
            {"resolution": (PER_CM, PER_CM), "resolutionunit": "CENTIMETER"} if stated else {}
        )
        tifffile.imwrite(
            folder / f"s{i}.tif",
            page,
            photometric="rgb" if page.ndim == 3 else "minisblack",
            **tags,
        )
    (folder / "sections.csv").write_text(text, encoding="utf-8")
    return folder


def test_values_positions_and_sizes_are_read(tmp_path):
    folder = write(tmp_path / "v")
    read = read_section_stack(folder)
    np.testing.assert_array_equal(read.values, pictures())
    np.testing.assert_array_equal(read.positions_um, POSITIONS)
    # The tag is a fraction of 32-bit integers.
    assert read.pixel_um == pytest.approx((2.43, 2.43), rel=1e-6)
    assert read.attrs["voxel_um"] == pytest.approx([3.5, 2.43, 2.43], rel=1e-6)  # steps 3, 3.5, 8.5
    assert read.attrs["voxel_um_source"] == "the cut counter and the TIFF resolution"
    assert (read.attrs["full_scale"], read.attrs["file_name"]) == (255, "v")
    assert (read.attrs["file_bytes"], read.kind) == (
        sum(p.stat().st_size for p in folder.iterdir()),
        "",
    )
    assert is_section_folder(folder)
    assert not is_section_folder(tmp_path)


def test_order_and_positions_are_those_of_the_counter_also_with_decimal_commas(tmp_path):
    rows = [f"s{i},{p}".replace(",", ".tif,") for i, p in zip((2, 0, 3, 1), POSITIONS, strict=True)]
    read = read_section_stack(write(tmp_path / "v", text=counter(*rows)))
    np.testing.assert_array_equal(read.values, pictures()[[2, 0, 3, 1]])
    rows = [f"s{i}.tif; {str(p).replace('.', ',')}" for i, p in enumerate(POSITIONS)]
    text = "\ufeff" + counter(
        *rows, header="File;Position_um", before="# kind: Block-Face\n# microtome 3"
    )
    read = read_section_stack(write(tmp_path / "v", text=text))
    np.testing.assert_array_equal(read.positions_um, POSITIONS)
    assert read.kind == read.attrs["section_kind"] == "block-face"


def test_colour_becomes_luminance_and_grey_stored_as_colour_stays_grey(tmp_path):
    colour = np.stack([pictures(), pictures()[::-1], pictures()[:, ::-1]], axis=-1)
    read = read_section_stack(write(tmp_path / "v", colour))
    expected = 0.2126 * colour[..., 0] + 0.7152 * colour[..., 1] + 0.0722 * colour[..., 2]
    np.testing.assert_array_equal(read.values, np.rint(expected).astype(np.uint8))
    values = pictures(dtype="uint16") * 300
    read = read_section_stack(write(tmp_path / "v", np.repeat(values[..., None], 3, axis=-1)))
    np.testing.assert_array_equal(read.values, values)


def test_png_sections_are_read(tmp_path):
    folder = tmp_path / "v"
    folder.mkdir()
    for i, page in enumerate(pictures()):
        Image.fromarray(page).save(folder / f"s{i}.png")
    (folder / "sections.csv").write_text(
        counter(*(row.replace(".tif", ".png") for row in ROWS)), encoding="utf-8"
    )
    read = read_section_stack(folder, voxel_um=2.43)
    np.testing.assert_array_equal(read.values, pictures())
    assert read.pixel_um == (2.43, 2.43)


def test_given_sizes_join_the_counter_and_another_than_stated_needs_the_override(tmp_path):
    folder = write(tmp_path / "v", stated=False)
    assert read_section_stack(folder, voxel_um=2.0).attrs["voxel_um"] == [3.5, 2.0, 2.0]
    assert read_section_stack(folder, voxel_um=(3.5, 1.0, 2.0)).pixel_um == (1.0, 2.0)
    refused(SizeError, "states no voxel size along y and x", read_section_stack, folder)
    with pytest.raises(
        SizeError, match=r"gives z 2 um, but the median step of sections\.csv is 3\.5 um"
    ):
        read_section_stack(folder, voxel_um=(2.0, 2.0, 2.0), override_size=True)
    folder = write(tmp_path / "v")
    refused(SizeError, "override_size=True", read_section_stack, folder, voxel_um=1.0)
    assert read_section_stack(folder, voxel_um=1.0, override_size=True).pixel_um == (1.0, 1.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("# kind: cut\n", "is empty"),
        (counter(*ROWS, header="file,z"), "columns missing: position_um"),
        (counter(*ROWS[:3], "s3.tif,abc"), "row 5: position_um 'abc' is not a finite number"),
        (counter(*ROWS[:3], "../s3.tif,30"), "is not the name of a file in this folder"),
        (counter(*ROWS, "s0.tif,40"), "row 6: s0.tif for the second time"),
        (counter(*ROWS, "s4.tif,40"), "lacks 1 of 5 files.*s4.tif.*take their rows out"),
        (counter(*ROWS[:3]), "holds 1 pictures that sections.csv does not name: s3.tif"),
        (
            counter(ROWS[0], ROWS[2], ROWS[1], ROWS[3]),
            "s1.tif lies at 13 um, s2.tif before it at 16.5 um",
        ),
        (counter(*ROWS[:3], "s3.tif,16.5"), "Positions increase"),
        (counter(ROWS[0]), "names 1 sections"),
        (
            counter(*ROWS, before="# kind: cut\n# kind: block-face"),
            "has both kinds, block-face and cut.*folder of its",
        ),
        (counter(*ROWS, before="# kind: frozen"), "has the kind 'frozen'. Give block-face or cut"),
    ],
)
def test_faults_of_the_counter_are_said(tmp_path, text, words):
    folder = write(tmp_path / "v", text=text)
    refused(VolumeError, words, read_section_stack, folder)


def test_a_folder_without_memory_or_a_counter_is_refused(tmp_path):
    refused(ResourceError, "v needs", read_section_stack, write(tmp_path / "v"), memory_bytes=200)
    refused(FileError, "is not a folder", read_section_stack, tmp_path / "none")
    (tmp_path / "empty").mkdir()
    refused(FileError, r"sections\.csv does not exist", read_section_stack, tmp_path / "empty")


def test_sections_that_differ_are_refused(tmp_path):
    folder = write(tmp_path / "v")
    tifffile.imwrite(folder / "s2.tif", np.zeros((7, 8), np.uint8), photometric="minisblack")
    refused(VolumeError, r"s2\.tif is .*s0\.tif is ", read_section_stack, folder)
    (folder / "s2.tif").write_bytes((folder / "s1.tif").read_bytes()[:100])
    refused(FileError, r"s2\.tif", read_section_stack, folder)
