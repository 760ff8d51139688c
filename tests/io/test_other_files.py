"""What no reader takes is named by first bytes, name and counts, and the way on is said."""

import gzip
import io
import tarfile
import zipfile

import h5py
import numpy as np
import pytest
import tifffile
from PIL import Image

from planish.core.errors import FileError, VolumeError
from planish.io import describe, read_image, read_volume


def packed(name, content):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(name, content)
    return stream.getvalue()


def tarred(name, content):
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz") as archive:
        info = tarfile.TarInfo(name)
        info.size = len(content)
        archive.addfile(info, io.BytesIO(content))
    return stream.getvalue()


def numpy_file(array):
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def jpeg_2000():
    stream = io.BytesIO()
    Image.new("L", (9, 7), 80).save(stream, "JPEG2000")
    return stream.getvalue()


def tiff():
    stream = io.BytesIO()
    tifffile.imwrite(stream, np.arange(35, dtype="uint8").reshape(5, 7))
    return stream.getvalue()


def hdf5():
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        file["v"] = np.zeros((3, 4, 5), "uint8")
    return stream.getvalue()


OLE = bytes.fromhex("d0cf11e0a1b11ae1") + bytes(600)
DICOM = bytes(128) + b"DICM" + bytes(range(90))
PAGE = b"\n<!DOCTYPE html><html><body>404</body></html>"
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"
BINARY = bytes(range(200, 256)) * 20
DOORS = (describe, read_volume, read_image)

# What lies there, under which name, and what the message says of it.
FILES = {
    "txm": ("a.txm", OLE, r"a Zeiss Xradia file by its name.*TIFF slices"),
    "vgi": ("a.vgi", b"{volume1}\nsize = 9 9 9\n", r"a VGStudio file by its name.*raw volume"),
    "vgl": ("a.vgl", b"<?xml version='1.0'?>", r"a VGStudio file by its name"),
    "pca": ("a.pca", b"[General]\n", r"a GE phoenix datos\|x file by its name"),
    "xtekct": ("a.XTEKCT", b"[XTekCT]\n", r"a Nikon X-Tek file by its name.*header beside"),
    "amira": ("a.am", b"# AmiraMesh BINARY-LITTLE-ENDIAN 2.1\n", r"Amira.*by its first bytes"),
    "dicom": ("a.dcm", DICOM, r"a DICOM file by its first bytes.*Pixel Spacing × 1000"),
    "dicom without a suffix": ("IM0001", DICOM, r"a DICOM file by its first bytes"),
    "dicom as TIFF": ("a.tif", DICOM, r"a DICOM file by its first bytes"),
    "imaris": ("a.ims", hdf5(), r"an Imaris file by its name.*Fiji"),
    "zeiss": ("a.czi", b"ZISRAWFILE" + bytes(90), r"a Zeiss microscope file by its first bytes"),
    "leica": ("a.lif", b"p\0\0\0" + BINARY, r"a Leica microscope file"),
    "nikon": ("a.nd2", b"\xda\xce\xbe\n" + BINARY, r"a Nikon microscope file"),
    "olympus": ("a.vsi", BINARY, r"an Olympus microscope file by its name"),
    "slide": ("a.svs", BINARY, r"a slide scanner file by its name.*QuPath"),
    "npy": ("a.npy", numpy_file(np.ones((3, 4, 5))), r"a NumPy file.*pl\.volume"),
    "npz": ("a.npz", packed("v.npy", numpy_file(np.ones(3))), r"a NumPy file by its name"),
    "analyze": (
        "a.hdr",
        (348).to_bytes(4, "little") + bytes(340) + b"ni1\0",
        r"detached header file by its name",
    ),
    "envi": ("a.hdr", b"ENVI\nsamples = 9\n", r"detached header.*first bytes"),
    "jpeg 2000": ("a.jp2", jpeg_2000(), r"a JPEG 2000 file by its first bytes.*TIFF or PNG"),
    "raw": ("a.xraw", BINARY, r"a raw values file by its name.*NAME\.raw\.toml"),
    "zip": ("a.zip", packed("s.tif", tiff()), r"a packed archive.*Unpack it"),
    "zarr zip": ("a.zarr.zip", packed("zarr.json", b"{}"), r"a packed archive.*Unpack it"),
    "tar": ("a.tar.gz", tarred("s.tif", tiff()), r"a packed archive.*Unpack it"),
    "gzip": ("a.tif.gz", gzip.compress(tiff()), r"a packed archive"),
    "archive as TIFF": ("a.tif", packed("s.tif", tiff()), r"a packed archive by its first bytes"),
    "page": ("a.tif", PAGE, r"a web page by its first bytes.*Download"),
    "page as NRRD": ("a.nrrd", PAGE, r"a web page by its first bytes"),
    "page as HDF5": ("a.h5", PAGE, r"a web page by its first bytes"),
    "page as MRC": ("a.mrc", PAGE, r"a web page by its first bytes"),
    "page as MATLAB": ("a.mat", PAGE, r"a web page by its first bytes"),
    "page as MetaImage": ("a.mhd", PAGE, r"a web page by its first bytes"),
    "page as raw": ("a.raw", PAGE, r"a web page by its first bytes"),
    "pointer": ("a.tif", POINTER, r"a Git LFS pointer by its first bytes.*git lfs pull"),
    "pointer as NIfTI": ("a.nii", POINTER, r"a Git LFS pointer"),
    "text": ("a.png", b"no such file\n", r"a text that begins with 'no such file'"),
    "text as HDF5": ("a.h5", b"no such file\n", r"a text that begins with 'no such file'"),
    "empty": ("a.tif", b"", r"is empty \(0 bytes\)"),
    "zeros": ("a.tif", bytes(5000), r"has 5000 bytes, and all are 0"),
    "zeros as HDF5": ("a.h5", bytes(5000), r"has 5000 bytes, and all are 0"),
    "shortcut": ("a.tif.lnk", b"L\0\0\0\1\x14\2\0" + BINARY, r"a shortcut by its first bytes"),
    "link": ("a.url", b"[InternetShortcut]\nURL=x\n", r"a shortcut.*leads to"),
    "placeholder": (".a.tif.icloud", b"bplist00" + BINARY, r"a cloud placeholder by its name"),
    "download": ("a.tif.crdownload", BINARY, r"an unfinished download by its name"),
    "HDF5 as TIFF": ("a.tif", hdf5(), r"HDF5 or NeXus by its first bytes\. Rename it to a\.h5"),
    "TIFF as HDF5": ("a.h5", tiff(), r"TIFF by its first bytes\. Rename it to a\.tif"),
    "TIFF as raw": ("a.raw", tiff(), r"TIFF by its first bytes\. Rename it to a\.tif"),
    "NRRD as MetaImage": (
        "a.mha",
        b"NRRD0004\n",
        r"NRRD by its first bytes\. Rename it to a\.nrrd",
    ),
    "unknown": ("a.xyz", BINARY, r"nor another one that planish knows.*c8 c9 ca"),
    "unknown TIFF": ("a.tif", BINARY, r"is no TIFF, PNG, JPEG or BMP file"),
}


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.__name__)
@pytest.mark.parametrize("kind", FILES)
def test_a_file_that_no_reader_takes_is_named_and_the_way_on_is_said(tmp_path, kind, door):
    name, content, words = FILES[kind]
    (tmp_path / name).write_bytes(content)
    if door is read_image and content[:4] == b"II*\0":
        return  # an image is known by its first bytes, whatever its name says
    with pytest.raises(FileError) as refused:
        door(tmp_path / name)
    print(refused.value.text)
    assert refused.value.text.startswith(name)
    refused.match(words)
    refused.match(r"(?i)^(?!.*(JPEG loses|as JPEG|damaged|decoded)).*\.$")


# Names and contents of the files in a folder, and what is said of it.
FOLDERS = {
    "dicom": (
        {f"IM{k:04d}.dcm": DICOM for k in range(5)},
        r"it holds 5 DICOM files \(\.dcm\)\. .*Fiji",
    ),
    "dicom without a suffix": (
        {f"IM{k:04d}": DICOM for k in range(5)},
        r"it holds 5 DICOM files without a suffix\. .*Fiji",
    ),
    "jpeg 2000": (
        {f"s{k}.jp2": jpeg_2000() for k in range(3)},
        r"it holds 3 JPEG 2000 files \(\.jp2\)\. Save it as TIFF or PNG",
    ),
    "n5": ({"attributes.json": b"{}", "s0/attributes.json": b"{}"}, r"it is an N5 container.*Fiji"),
    "above the slices": (
        {f"Rec/s{k}.tif": tiff() for k in range(3)} | {"a.log": b"x"},
        r"1 text file \(\.log\) and a folder Rec with 3 TIFF images \(\.tif\)\. Give f/Rec\.$",
    ),
    "two above": (
        {f"{scan}/Rec/s{k}.png": b"" for scan in "AB" for k in range(3)},
        r"a folder A/Rec with 3 PNG images \(\.png\) and a folder B/Rec.*Give one, as f/A/Rec\.$",
    ),
    "above DICOM": (
        {f"D/{k}.dcm": DICOM for k in range(4)},
        r"a folder D with 4 DICOM files \(\.dcm\)\. .*Pixel Spacing",
    ),
    "a store below": (
        {"sheet.zarr/zarr.json": b"{}", "sheet.zarr/0/zarr.json": b"{}"},
        r"it holds an OME-Zarr store sheet\.zarr\. Give f/sheet\.zarr\.$",
    ),
    "raw": (
        {"a.vol": BINARY, "a.vgi": b"{volume1}"},
        r"1 VGStudio file \(\.vgi\) and 1 raw volume \(\.vol\)\. Give f/a\.vol\.$",
    ),
    "nrrd": ({"a.nrrd": b"NRRD0004\n"}, r"1 NRRD file \(\.nrrd\)\. Give f/a\.nrrd\.$"),
    "unknown": (
        {"a.q1": BINARY, "b.q1": BINARY, "c.q2": b""},
        r"2 files \(\.q1\) and 1 file \(\.q2\)\. Needed are TIFF",
    ),
    "empty": ({}, r"holds no slices: it is empty\. Needed are TIFF"),
    "hidden": ({"._s0.tif": b"x"}, r"it is empty"),
    "run": ({"run.toml": b"", "maps.zarr/zarr.json": b"{}"}, r"it is a run of planish"),
}


@pytest.mark.parametrize("kind", FOLDERS)
def test_a_folder_without_slices_says_what_it_holds_and_what_to_give(tmp_path, kind):
    contents, words = FOLDERS[kind]
    (tmp_path / "f").mkdir()
    for name, content in contents.items():
        path = tmp_path / "f" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    for door in (describe, read_volume):
        with pytest.raises(FileError, match=words) as refused:
            door(tmp_path / "f")
        assert refused.value.text.startswith("f holds no slices")
    with pytest.raises(FileError, match=r"is not a file but a folder: it .*Give one image file"):
        read_image(tmp_path / "f")


def test_one_stack_in_a_folder_is_the_file_to_give(tmp_path):
    (tmp_path / "f").mkdir()
    tifffile.imwrite(tmp_path / "f" / "s.tif", np.zeros((6, 5, 7), "uint8"), imagej=True)
    with pytest.raises(VolumeError, match=r"one stack, s\.tif, of 6 x 5 x 7 .* Give f/s\.tif in"):
        read_volume(tmp_path / "f", voxel_um=1)
    (tmp_path / "g").mkdir()
    (tmp_path / "g" / "preview.tif").write_bytes(tiff())
    for k in range(3):
        (tmp_path / "g" / f"{k}.dcm").write_bytes(DICOM)
    with pytest.raises(VolumeError, match=r"one slice only, preview\.tif: it holds 3 DICOM files"):
        read_volume(tmp_path / "g", voxel_um=1)


def test_a_raw_volume_and_the_file_that_describes_it_are_named_with_each_other(tmp_path):
    (tmp_path / "scan.vol").write_bytes(BINARY)
    (tmp_path / "scan.vgi").write_bytes(b"{volume1}")
    with pytest.raises(FileError, match=r"scan\.vol\.toml beside it.*stand in scan\.vgi\.$"):
        read_volume(tmp_path / "scan.vol")
    with pytest.raises(FileError, match=r"The file scan\.vol lies beside it\.$"):
        read_volume(tmp_path / "scan.vgi")


@pytest.mark.parametrize(
    "words",
    [
        ("info", "a.txm"),
        ("map", "a.txm", "--out", "o"),
        ("import", "a.txm", "--out", "o.zarr"),
        ("holes", "a.txm", "--pixel-um", "4", "--out", "h.csv"),
        ("link", "a.txm", "i.tif", "--out", "o"),
        ("link", "i.tif", "a.txm", "--out", "o"),
    ],
    ids=" ".join,
)
def test_every_command_names_it_and_ends_with_3(tmp_path, monkeypatch, planish, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.txm").write_bytes(OLE)
    (tmp_path / "i.tif").write_bytes(tiff())
    code, _, err = planish(*words)
    assert "a.txm is a Zeiss Xradia file by its name" in err
    assert code == 3


def test_an_hdf5_file_may_begin_with_zeros(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w", userblock_size=1024) as file:
        file["v"] = np.ones((3, 4, 5), "uint8")
    assert read_volume(tmp_path / "a.h5", voxel_um=1).shape == (3, 4, 5)
