"""The log of NRecon: the right one of its three pixel sizes."""

import numpy as np
import pytest
import tifffile

from folders import refused
from planish.core.errors import SizeError, VolumeError
from planish.io import read_volume

LOG = """[System]
Scanner=Skyscan1172
Camera Pixel Size (um)=11.32
[Acquisition]
Filename Prefix=sheet
Image Pixel Size (um)=1.66
[Reconstruction]
Sections Count={count}
Section to Section Step={step}
pixel size (UM)={size}
[File name convention]
Filename Prefix=sheet_rec
"""


@pytest.fixture
def scan(tmp_path):
    def make(log=None, count=9, encoding="utf-8", name="sheet_rec.log"):
        for k in range(9):
            tifffile.imwrite(tmp_path / f"sheet_rec{k:08d}.tif", np.full((10, 12), k, np.uint8))
        text = LOG.format(count=count, step=2, size="1.65905") if log is None else log
        (tmp_path / name).write_bytes(text.encode(encoding))
        return tmp_path

    return make


def test_the_size_is_that_of_the_reconstruction_and_a_given_one_must_agree(scan):
    volume = read_volume(scan())
    assert volume.attrs["voxel_um"] == pytest.approx([3.3181, 1.65905, 1.65905])
    assert "NRecon" in volume.attrs["voxel_um_source"]
    refused(SizeError, "NRecon log", read_volume, scan(), voxel_um=2.0)
    assert read_volume(scan(), voxel_um=2.0, override_size=True).attrs["voxel_um"] == [2.0] * 3
    log = "[System]\nUser=Núria\n" + LOG.format(count=9, step=1, size="1,5")
    assert read_volume(scan(log, encoding="cp1252")).attrs["voxel_um"] == pytest.approx([1.5] * 3)


def test_logs_that_are_incomplete_contradictory_or_several_are_refused(scan):
    refused(VolumeError, r"states 12 sections.*holds 9", read_volume, scan(count=12))
    with pytest.raises(SizeError, match=r"no number for 'Pixel Size \(um\)'"):
        read_volume(scan("[Acquisition]\nImage Pixel Size (um)=1.66\n[Reconstruction]\nSections Count=9\n"))
    sections = "[Reconstruction]\nPixel Size (um)=2\nFirst Section=0\nLast Section={last}\nSections Count={count}\n"
    names = "[File name convention]\nFilename Prefix=sheet_rec\n"
    assert read_volume(scan(sections.format(last=8, count=9) + names)).sizes["z"] == 9
    refused(VolumeError, "contradicts itself: 8 sections", read_volume, scan(sections.format(last=8, count=8) + names))
    folder = scan()
    (folder / "other_rec.log").write_text("[Reconstruction]\n")
    refused(VolumeError, "2 NRecon logs", read_volume, folder)
