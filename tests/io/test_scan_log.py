"""Logs of SkyScan's programs: which one is of the slices, and what holds of a part of a scan."""

import numpy as np
import pytest
from PIL import Image

from folders import refused
from planish.core.errors import FileError, SizeError, VolumeError
from planish.io import describe, read_volume

VALUES = np.random.default_rng(5).integers(0, 200, (6, 7, 9)).astype(np.uint8)


def write_scan(folder, names, logs):
    """Slices with these names, and logs: file name to {section: {key: value}}."""
    folder.mkdir()
    for name, page in zip(names, VALUES, strict=True):
        Image.fromarray(page).save(folder / f"{name}.png")
    for log, sections in logs.items():
        lines = [
            line
            for section, keys in sections.items()
            for line in (f"[{section}]", *(f"{k}={v}" for k, v in keys.items()))
        ]
        (folder / log).write_text("\n".join(lines), encoding="utf-8")
    return folder


def reconstruction(size="2.5", **keys):
    return {"Reconstruction": {"Pixel Size (um)": size} | keys}


def prefixed(prefix):
    return {"File name convention": {"Filename Prefix": prefix}}


def numbered(form, first=0):
    return [form.format(first + k) for k in range(len(VALUES))]


SECTIONS = {"Sections Count": 6, "First Section": 0, "Last Section": 5}
WHOLE = {"Sections Count": 900, "First Section": 0, "Last Section": 899}
VOI = numbered("pap_rec_voi_{:04d}")


@pytest.mark.parametrize(
    ("names", "log", "sections"),
    [
        (VOI, "pap_rec_voi_.log", reconstruction(**SECTIONS) | prefixed("pap_rec_voi_")),
        (VOI, "pap_rec_voi_.log", reconstruction(**SECTIONS)),
        (numbered("pap_rec_tra{:04d}"), "pap_rec_tra.log", reconstruction() | prefixed("pap_rec")),
        (VOI, "pap_rec_voi_.log", {"CTAn": {"Pixel size (um)": "2,5"}}),
        (VOI, "PAP_REC_VOI_.LOG", {"Reconstruction": {"Pixel Size (µm)": "2.5"}}),
        (
            numbered("pap_rec{:08d}_cropped"),
            "pap_rec.log",
            reconstruction(**WHOLE) | prefixed("pap_rec"),
        ),
    ],
)
def test_the_log_of_an_export_states_its_size(tmp_path, names, log, sections):
    folder = write_scan(tmp_path / "v", names, {log: sections})
    volume = read_volume(folder)
    assert volume.attrs["voxel_um"] == [2.5] * 3
    np.testing.assert_array_equal(volume.values, VALUES)


def test_a_part_of_a_scan_keeps_the_size_and_the_log_of_the_scan_is_said(tmp_path):
    extent = {"Result Image Width (pixels)": 900, "Result Image Height (pixels)": 800}
    sections = reconstruction(**WHOLE, **extent) | prefixed("pap_rec")
    folder = write_scan(tmp_path / "v", VOI, {"pap_rec_voi_.log": sections})
    told = describe(folder)
    assert told["size_um"] == [2.5] * 3
    assert any("states 900 x 800 x 900 voxels, the slices have 6 x 7 x 9" in w for w in said(told))


def said(told):
    return told["warnings"] + told.get("notes", [])


@pytest.mark.parametrize(
    ("sections", "rows", "columns", "words"),
    [
        (12, 14, 18, "they were cropped or scaled, or"),  # twice as many along each axis
        (
            12,
            14,
            8,
            "they were cropped or scaled, or the log is another's",
        ),  # wider than the scan itself
    ],
)
def test_a_part_that_cannot_be_cut_out_of_the_scan_is_refused(
    tmp_path, sections, rows, columns, words
):
    keys = {
        "Sections Count": sections,
        "Result Image Height (pixels)": rows,
        "Result Image Width (pixels)": columns,
    }
    logs = {"pap_rec_voi_.log": reconstruction(**keys) | prefixed("pap_rec")}
    refused(VolumeError, words, read_volume, write_scan(tmp_path / "v", VOI, logs))


def test_a_log_of_its_own_has_to_fit(tmp_path):
    logs = {"pap_rec_voi_.log": reconstruction(**WHOLE) | prefixed("pap_rec_voi_")}
    refused(VolumeError, "states 900 sections", read_volume, write_scan(tmp_path / "v", VOI, logs))


def test_logs_that_contradict_each_other_are_named(tmp_path):
    logs = {"pap_rec_voi_.log": reconstruction(), "pap_rec.log": reconstruction("5")}
    folder = write_scan(tmp_path / "v", VOI, logs)
    words = r"contradicts itself: pap_rec_voi_\.log states z 2.5.* and pap_rec\.log states y 5"
    refused(SizeError, words, read_volume, folder)
    (folder / "pap_rec.log").write_text("[Reconstruction]\nPixel Size (um)=2.5", encoding="utf-8")
    assert read_volume(folder).attrs["voxel_um"] == [2.5] * 3


def test_two_logs_that_both_name_slices_are_refused(tmp_path):
    names = [*numbered("a_rec{:04d}")[:3], *numbered("b_rec{:04d}")[3:]]
    logs = {"a_rec.log": reconstruction(), "b_rec.log": reconstruction()}
    refused(
        VolumeError, "holds 2 NRecon logs", read_volume, write_scan(tmp_path / "v", names, logs)
    )


def test_a_copy_of_a_log_has_to_state_the_same_size(tmp_path):
    log = reconstruction() | prefixed("pap_rec")
    logs = {"pap_rec.log": log, "pap_rec - Copy.log": log}
    folder = write_scan(tmp_path / "v", numbered("pap_rec{:08d}"), logs)
    assert read_volume(folder).attrs["voxel_um"] == [2.5] * 3
    other = "[Reconstruction]\nPixel Size (um)=3\n[File name convention]\nFilename Prefix=pap_rec\n"
    (folder / "pap_rec - Copy.log").write_text(other, encoding="utf-8")
    refused(
        SizeError, r"contradicts itself: .* pap_rec - Copy\.log states y 3", read_volume, folder
    )


PROJECTIONS = {"Acquisition": {"Filename Prefix": "pap", "Image Pixel Size (um)": "2.5"}}


def test_the_size_of_the_projections_is_taken_with_a_note(tmp_path):
    folder = write_scan(tmp_path / "v", numbered("pap_rec{:04d}"), {"pap.log": PROJECTIONS})
    told = describe(folder)
    assert told["size_um"] == [2.5] * 3
    assert any("unless the reconstruction was scaled" in w for w in said(told))


def test_projections_are_no_slices(tmp_path):
    folder = write_scan(tmp_path / "v", numbered("pap{:04d}"), {"pap.log": PROJECTIONS})
    refused(VolumeError, "v holds X-ray projections, first pap0000.png", read_volume, folder)


def test_a_log_of_slices_with_other_names_states_no_size(tmp_path):
    folder = write_scan(tmp_path / "v", numbered("s{:04d}"), {"pap.log": PROJECTIONS})
    words = r"states no voxel size \(pap\.log .*: the slices have other names"
    refused(SizeError, words, read_volume, folder)


def test_a_preview_without_a_log_is_left_aside(tmp_path):
    folder = write_scan(tmp_path / "v", numbered("pap_rec{:08d}"), {})
    Image.fromarray(VALUES[0]).save(folder / "pap_rec_spr.png")
    np.testing.assert_array_equal(read_volume(folder, voxel_um=1).values, VALUES)


def test_slices_of_another_scan_are_left_aside_and_counted(tmp_path):
    folder = write_scan(tmp_path / "v", numbered("a_rec{:04d}"), {"a_rec.log": reconstruction()})
    for k, page in enumerate(VALUES[:3]):
        Image.fromarray(page).save(folder / f"b_rec{k:04d}.png")
    np.testing.assert_array_equal(read_volume(folder).values, VALUES)
    note = "a_rec.log names 6 slices. Pictures left aside: 3, first b_rec0000.png."
    assert note in said(describe(folder))


@pytest.mark.parametrize(("step", "is_doubted"), [(1, True), (2, False)])
def test_slices_in_other_steps_than_the_log_states_are_doubted(tmp_path, step, is_doubted):
    names = [f"pap_rec_voi_{2 * k:04d}" for k in range(len(VALUES))]
    keys = reconstruction(**{"Section to Section Step": step})
    folder = write_scan(tmp_path / "v", names, {"pap_rec_voi_.log": keys | prefixed("pap_rec")})
    told = describe(folder)
    assert told["size_um"] == [2.5 * step, 2.5, 2.5]
    assert any("in steps of 2, not 1" in w for w in told["warnings"]) is is_doubted


@pytest.mark.parametrize("content", [b"", b"7", bytes(500), b"[System]\nScanner=SkyScan1272\n"])
def test_a_damaged_log_of_the_slices_is_not_left_aside(tmp_path, content):
    for k in range(3):
        Image.fromarray(np.full((8, 9), k, np.uint8)).save(tmp_path / f"pap_rec{k:04d}.png")
    (tmp_path / "pap_rec.log").write_bytes(content)
    with pytest.raises(FileError, match=r"pap_rec.log .* no section \[Reconstruction\]"):
        read_volume(tmp_path, voxel_um=1)
