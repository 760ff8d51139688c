"""What only some formats have: parts to choose, links, axes by name, logs, and libraries that may
be missing."""

import gzip
import sys
from pathlib import Path
from typing import Any

import h5py
import mrcfile
import nibabel
import nrrd
import numpy as np
import pymatreader
import pytest
import scipy.io
import tifffile
import zarr
from mrcfile import dtypes
from PIL import Image

from folders import refused
from formats_written import (
    CASES,
    CUBE,
    NAME,
    VALUES,
    VOXEL,
    multiscales,
    write_hdf5,
    write_mat73,
    write_meta,
    write_nexus,
    write_nrecon,
    write_raw,
    write_zarr,
)
from planish.core.errors import FileError, InputError, SizeError, VolumeError
from planish.io import describe, find_place, fingerprint, formats, read_volume


def edit(path, old, new, encoding="utf-8"):
    text = path.read_text(encoding=encoding)
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


# Which reader, and which volume
def test_every_line_of_the_table_has_its_module(tmp_path):
    for line in formats.FORMATS:
        assert callable(formats.loader(line))
        for suffix in line.suffixes:
            path = tmp_path / f"scan{suffix}"
            path.mkdir() if line.marker_files else path.touch()
            assert formats.format_of(find_place(path)) is line


@pytest.mark.parametrize(
    ("given", "path", "part"),
    [
        ("C:\\data\\scan.tif", "C:\\data\\scan.tif", ""),
        ("C:/data/scan.h5:/entry/data", "C:/data/scan.h5", "/entry/data"),
        ("scan.h5:/a:b", "scan.h5", "/a:b"),
        ("folder:1/scan.tif", "folder:1/scan.tif", ""),
        ("sheet.ome.zarr:1", "sheet.ome.zarr", "1"),
    ],
)
def test_a_drive_is_no_file_with_a_part(given, path, part):
    place = find_place(given)
    assert (str(place.path), place.part) == (str(Path(path)), part)


def test_a_name_that_exists_is_not_split_and_a_part_of_a_plain_file_is_refused(tmp_path):
    (tmp_path / "scan.h5:2").touch()
    assert find_place(tmp_path / "scan.h5:2").part == ""
    tifffile.imwrite(tmp_path / "v.tif", VALUES)
    with pytest.raises(FileError, match=r"v\.tif is TIFF, in which 'a' chooses nothing"):
        read_volume(f"{tmp_path / 'v.tif'}:a", voxel_um=1)


def test_a_missing_library_names_the_command(tmp_path, monkeypatch):
    path = write_meta(tmp_path, VALUES, CUBE, ".mha", True)
    monkeypatch.setitem(sys.modules, "SimpleITK", None)
    np.testing.assert_array_equal(read_volume(path).values, VALUES)  # not needed for what fits
    with pytest.raises(
        FileError, match=r'needs the library SimpleITK, which .* pip install "planish\[formats\]"'
    ):
        read_volume(path, memory_bytes=2500)
    refused(FileError, "no_such_library", formats.extra, "no_such_library", path)


# HDF5 and NeXus
def test_several_volumes_are_listed_with_their_shapes(tmp_path):
    path = write_hdf5(tmp_path, VALUES, VOXEL).partition(":/")[0]
    words = (
        r"holds 2 volumes\. .*/entry/Größe/volume \(12 x 17 x 19 uint16\), /entry/other \(12 x 4 x"
        r" 19 uint16\)"
    )
    refused(VolumeError, words, read_volume, path)
    with pytest.raises(
        VolumeError, match=r"has no 'entry/nothing': 'nothing' is not there\. Its volumes are"
    ):
        read_volume(f"{path}:entry/nothing")
    refused(VolumeError, r"'entry' is a group", read_volume, f"{path}:entry")
    np.testing.assert_array_equal(
        read_volume(f"{path}:entry/other", voxel_um=1).values, VALUES[:, :4]
    )
    assert fingerprint(f"{path}:entry/other") != fingerprint(f"{path}:/entry/Größe/volume")


def test_raw_projections_and_uneven_or_contradicted_axes_are_errors(tmp_path):
    path = write_nexus(tmp_path, VALUES, VOXEL)
    with h5py.File(path, "r+") as file:
        file["entry/data/density"].attrs["voxel_size_um"] = [4.0, 2.5, 2.0]
    words = r"contradicts itself: the spacing of its coordinates states z 3.* voxel_size_um .* z 2"
    refused(SizeError, words, read_volume, path)
    with h5py.File(path, "r+") as file:
        del file["entry/data/density"].attrs["voxel_size_um"]
        file["entry/data/z"][5] *= 1.3
    refused(SizeError, r"along z: .*z is not evenly spaced", read_volume, path)
    with h5py.File(path, "r+") as file:
        del file["entry/definition"]
        file["entry/definition"] = "NXtomo"
    refused(VolumeError, "raw projections", read_volume, path)


@pytest.fixture
def secret(tmp_path):
    """A folder, and beside it a file that must not be read."""
    (tmp_path / "scans").mkdir()
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["v"] = VALUES
    (tmp_path / "secret.raw").write_bytes(VALUES.tobytes())
    return tmp_path / "scans"


@pytest.mark.parametrize("target", ["{folder}/secret.h5", "./../scans/../secret.h5"])
def test_no_link_leads_out_of_the_folder(secret, target):
    path = secret / "scan.h5"
    outside = target.format(folder=secret.parent)
    layout = h5py.VirtualLayout(VALUES.shape, VALUES.dtype)
    layout[...] = h5py.VirtualSource(outside, "v", VALUES.shape)
    with h5py.File(path, "w") as file:
        file["link"] = h5py.ExternalLink(outside, "/v")
        file["soft"] = h5py.SoftLink("/link")
        file.create_virtual_dataset("virtual", layout)
        raw = (str(secret.parent / "secret.raw"), 0, VALUES.nbytes)
        file.create_dataset("stored", VALUES.shape, "u2", external=[raw])
    for part in ("link", "soft", "virtual", "stored"):
        refused(
            FileError,
            r"^scan\.h5.*planish does not open",
            read_volume,
            f"{path}:{part}",
            voxel_um=1,
        )
    refused(VolumeError, "holds 2 volumes", read_volume, path, voxel_um=1)


def test_links_inside_the_folder_are_followed(tmp_path):
    (tmp_path / "parts").mkdir()
    for k in range(2):
        with h5py.File(tmp_path / "parts" / f"{k}.h5", "w") as file:
            file["v"] = VALUES[6 * k : 6 * k + 6]
    layout = h5py.VirtualLayout(VALUES.shape, VALUES.dtype)
    for k in range(2):
        layout[6 * k : 6 * k + 6] = h5py.VirtualSource(f"parts/{k}.h5", "v", (6, 17, 19))
    path = tmp_path / "scan.h5"
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("all", layout)
        file["first"] = h5py.ExternalLink("parts/0.h5", "/v")
        file["again"] = h5py.SoftLink("/first")
        file["a"], file["b"] = h5py.SoftLink("/b"), h5py.SoftLink("/a")
        file["gone"] = h5py.ExternalLink("parts/9.h5", "/v")
    np.testing.assert_array_equal(read_volume(path, voxel_um=1).values, VALUES)
    np.testing.assert_array_equal(read_volume(f"{path}:again", voxel_um=1).values, VALUES[:6])
    refused(FileError, "more than 32 links", read_volume, f"{path}:a", voxel_um=1)
    refused(
        FileError,
        r"takes data from 'parts/9\.h5', which does not exist",
        read_volume,
        f"{path}:gone",
        voxel_um=1,
    )
    whole_before, first_before = fingerprint(path), fingerprint(f"{path}:first")
    with h5py.File(tmp_path / "parts" / "1.h5", "r+") as file:
        file["v"][0, 0, 0] += 1
    assert fingerprint(path) != whole_before
    assert fingerprint(f"{path}:first") == first_before  # it lies in the other file
    assert describe(path, voxel_um=1)["bytes"] == sum(
        p.stat().st_size for p in (path, *(tmp_path / "parts").iterdir())
    )
    (tmp_path / "parts" / "1.h5").unlink()  # HDF5 would read zeros
    refused(
        FileError,
        r"takes data from 'parts/1\.h5', which does not exist",
        read_volume,
        f"{path}:all",
        voxel_um=1,
    )


# OME-Zarr
@pytest.mark.parametrize("version", [2, 3])
def test_levels_of_a_store_can_be_chosen(tmp_path, version):
    path = write_zarr(tmp_path, VALUES, VOXEL, version)
    half = read_volume(f"{path}:1")
    np.testing.assert_array_equal(half.values, VALUES[::2, ::2, ::2])
    assert half.attrs["voxel_um"] == [6.0, 5.0, 4.0]
    refused(FileError, "has nothing at 7", read_volume, f"{path}:7")
    refused(FileError, "leads out of the store", read_volume, f"{path}:../x")


def test_several_channels_are_refused_by_name(tmp_path):
    path = tmp_path / "v.zarr"
    group = zarr.open_group(str(path), mode="w", zarr_format=2)
    group.create_array("0", shape=(1, 2, 12, 17, 19), chunks=(1, 1, 4, 8, 8), dtype="u2")[...] = 5
    labels = [{"label": "CaCO3"}, {"label": "fibre"}]
    group.attrs.update({"multiscales": multiscales(VOXEL, lead=2), "omero": {"channels": labels}})
    words = r"v\.zarr has 2 channels \(CaCO3, fibre\): 1 x 2 x 12 x 17 x 19 \(t, c, z, y, "
    refused(VolumeError, words, read_volume, path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"micrometer"', '"parsec"', "'parsec' is no unit of length"),
        ('"path": "0"', '"path": "../../x"', "leads out of the store"),
        ('"datasets"', '"nothing"', "name no data sets"),
        ('"name": "z"', '"name": "y"', "its axes are y, y, x"),
    ],
)
def test_wrong_metadata_of_a_store(tmp_path, old, new, words):
    path = write_zarr(tmp_path, VALUES, VOXEL, 3)
    edit(path / "zarr.json", old, new)
    refused((FileError, VolumeError, SizeError), words, read_volume, path)


def test_chunks_of_blosc_with_a_checksum_behind_it_are_read(tmp_path):
    codecs = [zarr.codecs.BloscCodec(cname="lz4"), zarr.codecs.Crc32cCodec()]
    zarr.create_array(str(tmp_path / "v.zarr"), data=VALUES, chunks=(4, 8, 8), compressors=codecs)
    np.testing.assert_array_equal(read_volume(tmp_path / "v.zarr", voxel_um=2).values, VALUES)


def test_plain_arrays_and_empty_chunks(tmp_path):
    values = VALUES.copy()
    values[:4, :8, :8] = 0  # left out when it is written
    array = zarr.create_array(
        str(tmp_path / "v.zarr"), shape=values.shape, chunks=(4, 8, 8), dtype="u2", fill_value=0
    )
    array[...] = values
    volume = read_volume(tmp_path / "v.zarr", voxel_um=2)
    np.testing.assert_array_equal(volume.values, values)
    assert any(
        "1 of its 27 chunks are not stored" in w
        for w in describe(tmp_path / "v.zarr", voxel_um=2)["warnings"]
    )


def write_images(path, names, version, attributes):
    """Images below a root with these attributes, as bioformats2raw writes them."""
    root = zarr.open_group(str(path), mode="w", zarr_format=version)
    ome = {"ome": attributes} if version == 3 else attributes
    root.attrs.update(ome)
    root.create_group("OME").attrs.update({"series": names})
    for name in names:
        image = root.create_group(name)
        image.create_array("0", data=VALUES[None, None], chunks=(1, 1, 4, 8, 8))
        keys = {"multiscales": multiscales(VOXEL, lead=2)}
        image.attrs.update({"ome": keys} if version == 3 else keys)
    return path


@pytest.mark.parametrize("version", [2, 3])
def test_the_one_image_of_bioformats2raw_is_read_and_several_are_named(tmp_path, version):
    layout = {"bioformats2raw.layout": 3}
    volume = read_volume(write_images(tmp_path / "v.zarr", ["0"], version, layout))
    np.testing.assert_array_equal(volume.values, VALUES)
    assert volume.attrs["voxel_um"] == list(VOXEL)
    path = write_images(tmp_path / "w.zarr", ["0", "1"], version, layout)
    refused(VolumeError, r"it holds 0, 1\. Choose one as w\.zarr:0", read_volume, path)
    np.testing.assert_array_equal(read_volume(f"{path}:1").values, VALUES)


@pytest.mark.parametrize("version", [2, 3])
def test_a_plate_is_named(tmp_path, version):
    plate = {"plate": {"wells": [{"path": "A/1"}]}}
    path = write_images(tmp_path / "v.zarr", ["A"], version, plate)
    refused(VolumeError, r"is a plate .*v\.zarr:A/1/0", read_volume, path)


# NRecon
def test_the_one_log_is_read_by_section_also_with_decimal_commas_and_kept(tmp_path):
    volume = read_volume(write_nrecon(tmp_path, VALUES, CUBE))
    assert volume.attrs["voxel_um"] == [2.0] * 3  # neither 2.01 nor 11.32
    assert volume.attrs["attenuation_window"] == [-0.01, 0.15]
    told = describe(tmp_path / NAME)
    assert (told["metadata"]["nrecon"]["Source Voltage (kV)"], told["warnings"]) == ("40", [])
    edit(
        tmp_path / NAME / "Núria_rec.log",
        "\nPixel Size (um)=2.00000",
        "\npixel size (UM)=1,5",
        "cp1252",
    )
    assert read_volume(tmp_path / NAME).attrs["voxel_um"] == [1.5] * 3
    (tmp_path / NAME / "other_rec.log").write_text("[Reconstruction]\n")  # of other slices
    assert read_volume(tmp_path / NAME).attrs["voxel_um"] == [1.5] * 3


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("\nPixel Size", "\nOther Size", r"no number for 'Pixel Size \(um\)'"),
        (
            "First Section=20\nLast Section=31\nSections Count=12",
            "Sections Count=13",
            r"states 13 sections.*holds 12",
        ),
        (
            "Sections Count=12",
            "Sections Count=13",
            r"contradicts itself: 13 sections, but from 20 to 31 in steps of 1",
        ),
        ("First Section=20", "First Section=19", r"contradicts itself"),
        ("(pixels)=19", "(pixels)=38", r"states 12 x 17 x 38 voxels.* 12 x 17 x 19:"),
        ("Prefix=Núria_rec", "Prefix=Juan_rec", r"holds no slice named Juan_rec and a number"),
        ("Step=1", "Step=0", r"no number for 'Section to Section Step'"),
    ],
)
def test_a_log_that_does_not_fit_is_an_error(tmp_path, old, new, words):
    folder = write_nrecon(tmp_path, VALUES, CUBE)
    edit(folder / "Núria_rec.log", old, new, "cp1252")
    if "Juan" in new:
        (folder / "Núria_rec.log").rename(folder / "Juan_rec.log")
    refused((VolumeError, SizeError), words, read_volume, folder)


def test_missing_sections_of_a_log_are_named(tmp_path):
    folder = write_nrecon(tmp_path, VALUES, CUBE)
    (folder / "Núria_rec00000024.png").unlink()
    refused(VolumeError, r"states 12 sections, .* holds 11\. Missing: 24\.", read_volume, folder)
    Image.fromarray(VALUES[4]).save(folder / "Núria_rec00000024.png")
    Image.fromarray(VALUES[4]).save(folder / "Núria_rec00000090.png")
    refused(VolumeError, r"slices that .* does not name: 90", read_volume, folder)


def test_sections_in_steps_are_as_far_apart(tmp_path):
    folder = write_nrecon(tmp_path, VALUES, CUBE)
    for k in range(1, 12, 2):
        (folder / f"Núria_rec{k + 20:08d}.png").unlink()
    edit(folder / "Núria_rec.log", "Step=1", "Step=2", "cp1252")
    edit(
        folder / "Núria_rec.log",
        "Last Section=31\nSections Count=12",
        "Last Section=30\nSections Count=6",
    )
    volume = read_volume(folder)
    assert volume.attrs["voxel_um"] == [4.0, 2.0, 2.0]
    np.testing.assert_array_equal(volume.values, VALUES[::2])


def test_eight_bits_of_a_window_are_mentioned(tmp_path):
    told = describe(write_nrecon(tmp_path, (VALUES >> 8).astype(np.uint8), CUBE))
    assert any("grey 0 to 255 is attenuation -0.01 to 0.15" in w for w in told["warnings"])


# Other headers
def test_sizes_of_headers_have_to_agree_and_to_state_their_unit(tmp_path):
    header: dict[str, Any] = {"spacings": [2.0, 2.5, 3.0], "units": ["um"] * 3}
    nrrd.write(str(tmp_path / "v.nrrd"), VALUES, header, index_order="C")
    text = (tmp_path / "v.nrrd").read_bytes()
    more = (
        b"space dimension: 3\nspace directions: (0.004,0,0) (0,0.0025,0) (0,0,0.003)\nspace units:"
        + b' "mm"' * 3
    )
    (tmp_path / "v.nrrd").write_bytes(text.replace(b"\n\n", b"\n" + more + b"\n\n", 1))
    words = r"contradicts itself: the NRRD space directions .* x 4 um and the NRRD spacings"
    refused(SizeError, words, read_volume, tmp_path / "v.nrrd")
    path = write_meta(tmp_path, VALUES, VOXEL, ".mhd", False)
    edit(path, "ElementSpacing", "ElementSize = 0.002 0.0025 0.004\nElementSpacing")
    refused(
        SizeError,
        r"contradicts itself: .*ElementSpacing.* z 3.* ElementSize.* z 4",
        read_volume,
        path,
    )
    path = write_meta(tmp_path, VALUES, VOXEL, ".mhd", False)
    text = path.read_text(encoding="utf-8")
    spacing = next(line for line in text.splitlines() if line.startswith("ElementSpacing"))
    edit(path, spacing, "DistanceUnits = um\nElementSpacing = 2 2.5 3")
    assert read_volume(path).attrs["voxel_um"] == list(VOXEL)
    nrrd.write(str(tmp_path / "v.nrrd"), VALUES, {"spacings": [2.0, 2.5, 3.0]}, index_order="C")
    refused(SizeError, "3 without a unit", read_volume, tmp_path / "v.nrrd")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("type: uint16", "type: block", "has values of the type 'block'"),
        ("endian: little\n", "", r"does not state the byte order \(endian\)"),
        ("encoding: raw", "encoding: raw\nline skip: 3", "skips lines or packed bytes"),
        ("encoding: raw", "encoding: bzip3", "has the encoding 'bzip3'"),
    ],
)
def test_what_a_header_of_nrrd_lacks_is_named(tmp_path, old, new, words):
    CASES["NRRD detached"].write(tmp_path, VALUES, VOXEL)
    header = next(tmp_path.glob("*.nhdr"))
    edit(header, old, new)
    refused(InputError, words, read_volume, header)


def test_a_meta_image_names_its_data(tmp_path):
    path = write_meta(tmp_path, VALUES, VOXEL, ".mhd", False)
    edit(path, "ElementDataFile", "ElementData")
    refused(FileError, "no MetaImage: the line ElementDataFile is missing", read_volume, path)


@pytest.mark.parametrize("kind", [".nhdr", ".mhd", ".toml"])
@pytest.mark.parametrize("target", ["../secret.raw", "{folder}/secret.raw"])
def test_no_header_takes_data_from_outside_its_folder(secret, kind, target):
    case = {".nhdr": "NRRD detached", ".mhd": "MetaImage detached", ".toml": "raw"}[kind]
    CASES[case].write(secret, VALUES, VOXEL)
    header = next(secret.glob(f"*{kind}"))
    outside = target.format(folder=secret.parent)
    if kind == ".toml":
        edit(header, "offset = 4", f"file = '{outside}'")
    else:
        edit(header, f"{NAME}.raw", outside)
    refused(FileError, "outside its folder, which planish does not open", read_volume, header)


def test_every_fault_of_a_raw_header_is_named(tmp_path):
    path = write_raw(tmp_path, VALUES, VOXEL)
    header = tmp_path / f"{NAME}.raw.toml"
    np.testing.assert_array_equal(read_volume(header).values, read_volume(path).values)
    header.write_text(
        'shape = [12, 17]\ndtype = "grey"\nvoxel_um = -1\nsize = 3\n', encoding="utf-8"
    )
    words = (
        r"unknown key 'size'; shape is \[12, 17\].*; dtype is 'grey'.*; voxel_um is -1.*Correct the"
        r" header"
    )
    refused(FileError, words, read_volume, path)
    header.unlink()
    refused(
        FileError,
        r"raw values and no header\. Write Blatt ä 7\.raw\.toml beside it",
        read_volume,
        path,
    )


# MATLAB
def test_rows_columns_and_slices_of_matlab_become_y_x_and_z(tmp_path):
    path = write_mat73(tmp_path, VALUES, VOXEL)
    theirs = pymatreader.read_mat(str(path))["V"]
    assert theirs.shape == (17, 19, 12)
    np.testing.assert_array_equal(read_volume(path).values, np.moveaxis(theirs, -1, 0))


@pytest.mark.parametrize("new", [False, True])
def test_several_variables_are_listed(tmp_path, new):
    path = tmp_path / "v.mat"
    if new:
        write_mat73(tmp_path, VALUES, VOXEL).rename(path)
        with h5py.File(path, "r+") as file:
            file["W"] = VALUES[:, :4]
    else:
        scipy.io.savemat(
            path, {"V": np.moveaxis(VALUES, 0, -1), "W": VALUES[:, :4], "voxel_um": 2.0}
        )
    words = (
        r"v\.mat holds 2 volumes\. Its volumes are V \(17 x 19 x 12 uint16\).*choose one as"
        r" v\.mat:V\."
    )
    refused(VolumeError, words, read_volume, path)
    np.testing.assert_array_equal(read_volume(f"{path}:V").values, VALUES)
    refused(VolumeError, "has no volume 'X'", read_volume, f"{path}:X")


# NIfTI and MRC
def test_a_scaled_nifti_gives_true_values_in_parts_and_at_once(tmp_path):
    path, true = tmp_path / "v.nii", VALUES * 0.01 - 3.0
    image = nibabel.Nifti1Image(VALUES.T.astype(np.int32), np.diag([2.0, 2.0, 2.0, 1.0]))
    image.header.set_xyzt_units("micron")
    nibabel.save(image, path)
    data = bytearray(path.read_bytes())
    data[112:120] = np.array([0.01, -3.0], "<f4").tobytes()
    path.write_bytes(data)
    for packed in (False, True):
        if packed:
            (tmp_path / "v.nii.gz").write_bytes(gzip.compress(bytes(data)))
        volume = read_volume(tmp_path / ("v.nii.gz" if packed else "v.nii"))
        assert volume.dtype == np.float32
        np.testing.assert_allclose(volume.values, true, rtol=1e-6, atol=1e-4)


def test_a_nifti_that_is_left_handed_or_lacks_values_or_units_is_reported(tmp_path):
    for name, affine, told in (
        ("l", np.diag([-2.0, 2.0, 2.0, 1.0]), True),
        ("r", np.diag([2.0, 2, 2, 1]), False),
    ):
        image = nibabel.Nifti1Image(VALUES.T.astype(np.int32), affine)
        image.header.set_xyzt_units("mm")
        nibabel.save(image, tmp_path / f"{name}.nii")
        assert (
            any("mirror image" in note for note in describe(tmp_path / f"{name}.nii")["warnings"])
            is told
        )
    nibabel.save(nibabel.Nifti1Pair(VALUES.T.astype(np.int32), np.eye(4)), tmp_path / "p.img")
    (tmp_path / "p.hdr").rename(tmp_path / "p.nii")
    refused(FileError, r"another file \(.img\)", read_volume, tmp_path / "p.nii")
    nibabel.save(nibabel.Nifti1Image(VALUES.T.astype(np.int32), np.eye(4)), tmp_path / "u.nii")
    refused(SizeError, "without a unit", read_volume, tmp_path / "u.nii")


@pytest.mark.parametrize("order", "<>")
def test_bytes_of_imod_are_unsigned_where_it_says_so(tmp_path, order):
    grey = (VALUES >> 8).astype(np.uint8)
    head = np.zeros((), dtypes.HEADER_DTYPE.newbyteorder(order))
    head["nz"], head["ny"], head["nx"] = grey.shape
    head["mapc"], head["mapr"], head["maps"] = 1, 2, 3
    for flags, dtype in ((0, np.uint8), (1, np.int8)):
        data = bytearray(head.tobytes())
        data[152:160] = np.array([1146047817, flags], f"{order}i4").tobytes()
        (tmp_path / "v.mrc").write_bytes(bytes(data) + grey.tobytes())
        volume = read_volume(tmp_path / "v.mrc", voxel_um=2.0)
        assert volume.dtype == dtype
        np.testing.assert_array_equal(volume.values, grey.view(dtype))


def test_a_turned_cell_of_mrc_and_a_default_of_it(tmp_path):
    with mrcfile.new(tmp_path / "v.mrc") as file:
        file.set_data(VALUES)
        file.voxel_size = (2e4, 2.5e4, 3e4)  # along x, y, z of the cell
        file.header.mapc, file.header.mapr, file.header.maps = 3, 2, 1
        shape = VALUES.shape
        file.header.mx, file.header.my, file.header.mz = shape
        file.header.cella = (2e4 * shape[0], 2.5e4 * shape[1], 3e4 * shape[2])
    volume = read_volume(tmp_path / "v.mrc")
    assert volume.attrs["voxel_um"] == pytest.approx((3.0, 2.5, 2.0))
    np.testing.assert_array_equal(volume.values, VALUES.transpose(2, 1, 0))
    with mrcfile.new(tmp_path / "d.mrc") as file:
        file.set_data(VALUES)
        file.voxel_size = 1.0
    refused(SizeError, "when they do not know", read_volume, tmp_path / "d.mrc")
