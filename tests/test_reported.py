"""Inputs that people reported as read wrongly, by other programs: what planish says of each.

Each row makes a small file, or an array, as it was described in public, and says what is right: it
is read with the size, the axes and the hand that it states, or refused with the cause and the way
on. The row names the project and the number of its report, or the program.
"""

import gzip
import io
import json
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import mrcfile
import nibabel
import numpy as np
import pytest
import SimpleITK as itk
import tifffile
import xarray as xr
import zarr
from PIL import Image

import planish as pl
from planish.core.errors import PlanishError, SizeError
from planish.io import read_volume
from planish.io.info import describe
from planish.marks.exchange import read_any

VOXEL_UM = (4.0, 3.0, 2.0)  # z, y, x
ROWS = "### #.. ##. #.. #.."


def lettered() -> np.ndarray:
    """A volume (z, y, x) of another length along each axis, with a letter in a corner."""
    values = np.full((20, 9, 11), 40, np.uint8)
    letter = np.array([[dot == "#" for dot in row] for row in ROWS.split()])
    values[0, 1:6, 1:4] += 100 * letter.astype(np.uint8)
    values[:, 0, 0] = np.arange(20)
    return values


GREY = lettered()
PICTURE = np.arange(60 * 80).reshape(60, 80).astype(np.uint8)
MARKS_UM = [(288.6, 531.0), (2895.4, 660.1), (2883.6, 1207.1), (277.9, 1224.4)]
READ = "as written, 4 x 3 x 2 um;"
READ_LEFT = f"{READ} left"
ASKED = "as written, states no voxel size"


class Reported(NamedTuple):
    """An input, and what is right."""

    source: str  # project and number of the report
    make: Callable[[Path], str]  # makes it, and gives what planish says of it
    right: str  # pattern


REPORTED: list[Reported] = []


def reported(source: str, right: str) -> Callable[[Callable[[Path], str]], Callable[[Path], str]]:
    """Put a function into the table."""

    def entered(make: Callable[[Path], str]) -> Callable[[Path], str]:
        REPORTED.append(Reported(source, make, right))
        return make

    return entered


# --- what planish says ----------------------------------------------------------------------------


def volume_text(path: Path | str) -> str:
    """Values, size, and which way the axes run."""
    try:
        volume = read_volume(path)
        size_text = " x ".join(f"{um:.4g}" for um in volume.attrs["voxel_um"]) + " um"
    except SizeError as error:
        volume = read_volume(path, voxel_um=1.0, override_size=True)
        size_text = str(error).partition(" ")[2]
    is_same = volume.shape == GREY.shape and np.array_equal(volume.values, GREY)
    direction = volume.attrs.get("hand", volume.attrs.get("turned", "usual"))
    return f"{'as written' if is_same else 'other values'}, {size_text}; {direction}"


def image_text(path: Path) -> str:
    """Size and warnings."""
    size_um = describe(path)["size_um"]
    return f"{size_um}; {' '.join(describe(path)['warnings'])}"


def array_text(array: xr.DataArray) -> str:
    """Values and size of a volume, or the shape of an image."""
    is_same = array.shape == GREY.shape and np.array_equal(array.values, GREY)
    return f"{'as written' if is_same else array.shape}, {array.attrs.get('voxel_um')}"


def marks_text(*paths: Path, **options: Any) -> str:
    """The first mark of each side."""
    marks = read_any(*paths, **options)
    sides = [str(name)[:-2] for name in marks.variables if str(name).endswith("_x")]
    places = [(float(marks[f"{side}_x"][0]), float(marks[f"{side}_y"][0])) for side in sides]
    return str(
        {side: (round(x, 6), round(y, 6)) for side, (x, y) in zip(sides, places, strict=True)}
    )


# --- axes and sizes -------------------------------------------------------------------------------


def axis_tags(path: Path, order: str, sizes: dict[str, Any]) -> Path:
    """Write a volume with tags of vigra on its axes."""
    axes = [{"key": a, "typeFlags": 2, "description": "", **sizes.get(a, {})} for a in order]
    values = GREY[..., None].transpose(["zyxc".index(a) for a in order + "c" * ("c" not in order)])
    with h5py.File(path, "w") as file:
        data = file.create_dataset("exported_data", data=values.reshape(values.shape[: len(order)]))
        data.attrs["axistags"] = json.dumps({"axes": axes})
    return path


TAG_SIZES = {
    axis: {"resolution": um, "unit": "um"} for axis, um in zip("zyx", VOXEL_UM, strict=True)
}


@reported("ilastik 3045", READ)
def sizes_in_axis_tags(folder):
    return volume_text(axis_tags(folder / "a.h5", "xyz", TAG_SIZES))


@reported("ilastik 3045", READ)
def sizes_in_axis_tags_with_a_channel(folder):
    sizes = TAG_SIZES | {"c": {"resolution": 0}}
    return volume_text(axis_tags(folder / "a.h5", "zyxc", sizes))


@reported("ilastik4ij 36", ASKED)
def axis_tags_that_know_no_size(folder):
    return volume_text(axis_tags(folder / "a.h5", "zyx", {a: {"resolution": 0} for a in "zyx"}))


def with_attributes(path: Path, **attributes: Any) -> Path:
    """Write a volume with attributes."""
    with h5py.File(path, "w") as file:
        file.create_dataset("v", data=GREY).attrs.update(attributes)
    return path


@reported("Image-data-science-with-Python-and-Napari 5", READ)
def a_size_for_each_axis(folder):
    sizes = {"voxel_size_x": 2.0, "voxel_size_y": 3.0, "z_step": 4.0}
    return volume_text(with_attributes(folder / "a.h5", unit="um", **sizes))


@reported(
    "CellProfiler tutorials 45", "contradicts itself: .*pixel_size_um states z 2.* states z 4"
)
def one_pixel_size_and_another_along_z(folder):
    sizes = {"pixel_size_um": 2.0, "slice_spacing_um": 4.0}
    return volume_text(with_attributes(folder / "a.h5", **sizes))


@reported("HDF5_Vibez 10", ASKED)
def two_sizes_for_three_axes(folder):
    return volume_text(with_attributes(folder / "a.h5", element_size_um=[3.0, 2.0]))


def imagej(path: Path, lines: str, resolution: tuple[float, float], unit: str = "NONE") -> Path:
    """Write a stack with the description of ImageJ."""
    description = f"ImageJ=1.53t\nimages=20\nslices=20\n{lines}\nloop=false\n"
    tifffile.imwrite(
        path,
        GREY,
        metadata=None,
        photometric="minisblack",
        description=description,
        resolution=resolution,
        resolutionunit=unit,
    )
    return path


@reported("ilastik 3091", READ)
def imagej_states_the_unit_of_x_only(folder):
    path = imagej(folder / "a.tif", "unit=nm\nspacing=4000", (1 / 2000, 1 / 3000))
    return volume_text(path)


@reported("ilastik 3091", READ)
def imagej_states_a_unit_for_each_axis(folder):
    lines = "unit=um\nyunit=nm\nzunit=mm\nspacing=0.004"
    return volume_text(imagej(folder / "a.tif", lines, (1 / 2, 1 / 3000)))


@reported("bioformats 3676", READ)
def imagej_and_its_tags_in_cm(folder):
    lines = "unit=cm\nspacing=0.0004"
    return volume_text(imagej(folder / "a.tif", lines, (1e4 / 2, 1e4 / 3), "CENTIMETER"))


@reported("imagej-common 86", READ)
def imagej_escapes_the_micro_sign(folder):
    return volume_text(imagej(folder / "a.tif", "unit=\\u00B5m\nspacing=4", (1 / 2, 1 / 3)))


@reported("myOCT 38", "along z: ImageJ metadata states y 3, x 2 um only")
def imagej_without_spacing(folder):
    return volume_text(imagej(folder / "a.tif", "unit=micron", (1 / 2, 1 / 3)))


@reported("scifio 318", READ)
def ome_in_nm_and_um(folder):
    metadata = {"PhysicalSizeX": 2000, "PhysicalSizeY": 3000, "PhysicalSizeZ": 4}
    units = {"PhysicalSizeXUnit": "nm", "PhysicalSizeYUnit": "nm", "PhysicalSizeZUnit": "µm"}
    metadata = {"axes": "ZYX", **metadata, **units}
    tifffile.imwrite(folder / "a.ome.tif", GREY, ome=True, metadata=metadata)
    return volume_text(folder / "a.ome.tif")


@reported("tifffile 152", "not a volume with the axes z, y, x: .*XYZ")
def tifffile_states_the_axes_xyz(folder):
    tifffile.imwrite(folder / "a.tif", GREY.T, metadata={"axes": "XYZ"}, photometric="minisblack")
    return volume_text(folder / "a.tif")


@reported("zarr-java 95", READ)
def zarr_in_fortran_order(folder):
    array = zarr.open_array(
        str(folder / "a.zarr"),
        mode="w",
        zarr_format=2,
        shape=GREY.shape,
        chunks=(7, 5, 4),
        dtype="u1",
        order="F",
        compressor=None,
    )
    array[...] = GREY
    array.attrs.update({"voxel_size": [*VOXEL_UM], "unit": "um"})
    return volume_text(folder / "a.zarr")


@reported("zarr-python 3072", READ)
def zarr_with_transposed_chunks(folder):
    array = zarr.create_array(
        str(folder / "a.zarr"),
        shape=GREY.shape,
        chunks=(7, 5, 4),
        dtype="u1",
        filters=[zarr.codecs.TransposeCodec(order=(2, 1, 0))],
        compressors=None,
    )
    array[...] = GREY
    array.attrs.update({"voxel_size": [*VOXEL_UM], "unit": "um"})
    return volume_text(folder / "a.zarr")


@reported("VAPOR 3333", READ)
def netcdf_with_coordinates_in_mm(folder):
    sizes = dict(zip("zyx", VOXEL_UM, strict=True))
    steps = {a: np.arange(GREY.shape["zyx".index(a)]) * sizes[a] / 1000 for a in "xyz"}
    coordinates = {a: (a, steps[a], {"units": "mm"}) for a in "xyz"}
    data = xr.Dataset({"grey": (("x", "y", "z"), GREY.T)}, coords=coordinates)
    data.to_netcdf(folder / "a.h5", engine="h5netcdf")
    return volume_text(folder / "a.h5")


@reported("pybdv 22", "holds 2 volumes.*20 x 9 x 11.*choose one as")
def levels_of_bigdataviewer(folder):
    with h5py.File(folder / "a.h5", "w") as file:
        file["s00/resolutions"] = np.array([[1.0, 1, 1], [2, 2, 1]])
        file["t00000/s00/0/cells"] = GREY.astype(np.int16)
        file["t00000/s00/1/cells"] = GREY[:, ::2, ::2].astype(np.int16)
    return volume_text(folder / "a.h5")


def meta_image(path: Path, *lines: str, values: bytes = b"") -> Path:
    """Write a MetaImage; the last line names the file of its values."""
    first_lines = ["ObjectType = Image", "NDims = 3", "BinaryData = True", "DimSize = 11 9 20"]
    path.write_bytes("\n".join([*first_lines, *lines, ""]).encode() + values)
    return path


@reported("pnextract 7", READ)
def metaimage_with_the_older_keys(folder):
    lines = ("ElementByteOrderMSB = True", "ElementSize = 0.002 0.003 0.004")
    lines = (*lines, "ElementType = MET_USHORT", "ElementDataFile = LOCAL")
    return volume_text(meta_image(folder / "a.mha", *lines, values=GREY.astype(">u2").tobytes()))


@reported("pnextract 7", "the voxel size along z is 4000 um")
def metaimage_whose_numbers_are_no_mm(folder):
    lines = ("ElementSpacing = 2.0 3.0 4.0", "ElementByteOrderMSB = False")
    lines = (*lines, "ElementType = MET_UCHAR", "ElementDataFile = LOCAL")
    return volume_text(meta_image(folder / "a.mha", *lines, values=GREY.tobytes()))


@reported("PlusLib 829", "contradicts itself: .*ElementSpacing.*ElementSize")
def metaimage_with_two_sizes(folder):
    lines = ("ElementSpacing = 0.002 0.003 0.004", "ElementSize = 0.004 0.003 0.002")
    lines = (*lines, "ElementType = MET_UCHAR", "ElementDataFile = LOCAL")
    return volume_text(meta_image(folder / "a.mha", *lines, values=GREY.tobytes()))


def nrrd_file(path: Path, *lines: str, end: str = "\n", coding: str = "utf-8") -> Path:
    """Write an NRRD file."""
    first_lines = ["NRRD0004", "type: uint8", "dimension: 3", "sizes: 11 9 20", "encoding: raw"]
    header = end.join([*first_lines, *lines, "", ""])
    path.write_bytes(header.encode(coding) + GREY.tobytes())
    return path


@reported("napari 8837", READ)
def nrrd_with_a_micro_sign_in_latin_1(folder):
    lines = ("spacings: 2 3 4", 'units: "µm" "µm" "µm"')
    return volume_text(nrrd_file(folder / "a.nrrd", *lines, coding="latin-1"))


@reported("OpenImageIO 5261", READ)
def nrrd_with_line_ends_of_windows(folder):
    lines = ("spacings: 2 3 4", 'units: "um" "um" "um"')
    return volume_text(nrrd_file(folder / "a.nrrd", *lines, end="\r\n"))


@reported("qfit 110", READ)
def mrc_as_a_stack_of_images(folder):
    with mrcfile.new(folder / "a.mrc") as file:
        file.set_data(GREY.astype(np.int16))
        file.set_image_stack()
        # Of one section, in Angstrom.
        file.header.cella.x, file.header.cella.y, file.header.cella.z = 11 * 2e4, 9 * 3e4, 4e4
    return volume_text(folder / "a.mrc")


@reported("MRIReco.jl 126", "the voxel size along z is 4000 um")
def nifti_whose_numbers_are_no_mm(folder):
    return volume_text(nifti(folder / "a.nii", sizes=(2.0, 3.0, 4.0)))


@reported("Pillow 2817", "None; .*contradicts itself: .*300 dpi.*Exif resolution states y 21")
def jpeg_with_two_resolutions(folder):
    exif = Image.Exif()
    exif[282], exif[283], exif[296] = 1200.0, 1200.0, 2
    Image.fromarray(PICTURE).save(folder / "a.jpg", dpi=(300, 300), exif=exif)
    return image_text(folder / "a.jpg")


# --- hand -----------------------------------------------------------------------------------------


def nifti(
    path: Path,
    sform: np.ndarray | None = None,
    qform: np.ndarray | None = None,
    sizes: tuple[float, float, float] = (0.002, 0.003, 0.004),
) -> Path:
    """Write a NIfTI file in mm."""
    image = nibabel.Nifti1Image(GREY.T, None)
    image.header.set_zooms(sizes)
    image.header.set_xyzt_units("mm")
    if sform is not None:
        image.set_sform(sform, 1)
    if qform is not None:
        image.set_qform(qform, 1)
    nibabel.save(image, path)
    return path


AFFINE = np.diag([0.002, 0.003, 0.004, 1.0])
MIRRORED = np.diag([-0.002, 0.003, 0.004, 1.0])


@reported("leaddbs 31", f"{READ_LEFT}, by the sform")
def nifti_with_a_negative_x(folder):
    return volume_text(nifti(folder / "a.nii", MIRRORED))


@reported("mrtrix3 94", f"{READ_LEFT}, by the sform; but right, by the qform")
def nifti_with_two_hands(folder):
    return volume_text(nifti(folder / "a.nii", MIRRORED, AFFINE))


@reported("niivue 243", f"{READ} usual")
def nifti_that_states_no_hand(folder):
    return volume_text(nifti(folder / "a.nii"))


def nrrd_in(path: Path, space: str, *directions: str) -> Path:
    """Write an NRRD file in a space."""
    units = 'space units: "mm" "mm" "mm"'
    return nrrd_file(path, f"space: {space}", f"space directions: {' '.join(directions)}", units)


ALONG = ("(0.002,0,0)", "(0,0.003,0)", "(0,0,0.004)")


@reported("XTK 29", READ_LEFT)
def nrrd_in_a_left_handed_space(folder):
    return volume_text(nrrd_in(folder / "a.nrrd", "3D-left-handed", *ALONG))


@reported("BodyPartRegression 12", READ_LEFT)
def nrrd_in_las(folder):
    return volume_text(nrrd_in(folder / "a.nrrd", "left-anterior-superior", *ALONG))


@reported("SlicerGitSVNArchive 1270", f"{READ} usual")
def nrrd_in_ras_with_both_axes_reversed(folder):
    directions = ("(-0.002,0,0)", "(0,-0.003,0)", "(0,0,0.004)")
    return volume_text(nrrd_in(folder / "a.nrrd", "right-anterior-superior", *directions))


@reported("three.js 21962", READ_LEFT)
def coronal_nrrd(folder):
    directions = ("(0.002,0,0)", "(0,0,0.003)", "(0,0.004,0)")
    return volume_text(nrrd_in(folder / "a.nrrd", "left-posterior-superior", *directions))


@reported("vtk-js 858", f"{READ_LEFT}, by the Orientation")
def metaimage_with_the_older_matrix(folder):
    lines = ("Orientation = 1 0 0 0 1 0 0 0 -1", "ElementSpacing = 0.002 0.003 0.004")
    lines = (*lines, "ElementType = MET_UCHAR", "ElementDataFile = LOCAL")
    return volume_text(meta_image(folder / "a.mha", *lines, values=GREY.tobytes()))


@reported("Slicer 7627", f"({READ_LEFT}[^;]*(;|$)){{3}}")
def left_handed_by_itk_in_three_formats(folder):
    image = itk.GetImageFromArray(GREY)
    image.SetSpacing((0.002, 0.003, 0.004))
    image.SetDirection((1, 0, 0, 0, 1, 0, 0, 0, -1))
    texts = []
    for name in ("a.mha", "a.nrrd", "a.nii.gz"):
        itk.WriteImage(image, str(folder / name), True)
        texts.append(volume_text(folder / name))
    return ";".join(texts)


def turned(path: Path, tag: int) -> Path:
    """Save a picture with an orientation tag."""
    exif = Image.Exif()
    exif[274] = tag
    Image.fromarray(PICTURE).save(path, exif=exif)
    return path


@reported("coralnet 107", "stored turned .*orientation tag 6")
def photograph_taken_upright(folder):
    return image_text(turned(folder / "a.jpg", 6))


@reported("coco-annotator 228", "stored as a mirror image .*orientation tag 2")
def photograph_of_a_front_camera(folder):
    return image_text(turned(folder / "a.jpg", 2))


@reported("Weed-AI 674", "stored as a mirror image .*orientation tag 5")
def png_with_an_orientation(folder):
    return image_text(turned(folder / "a.png", 5))


@reported("bmp-js 28", "as written")
def bmp_with_its_rows_from_the_top(folder):
    scan = folder / "scan"
    scan.mkdir()
    for k, values in enumerate(GREY):
        text = io.BytesIO()
        Image.fromarray(values).save(text, "BMP")
        data = bytearray(text.getvalue())
        start, row_bytes = struct.unpack_from("<I", data, 10)[0], 12
        rows = [data[at : at + row_bytes] for at in range(start, start + 9 * row_bytes, row_bytes)]
        data[start:] = b"".join(rows[::-1])
        struct.pack_into("<i", data, 22, -9)
        (scan / f"s{k:03d}.bmp").write_bytes(data)
    return volume_text(scan)


# --- arrays ---------------------------------------------------------------------------------------


def two_maps(shift_um: float = 0.0, coordinates: type = np.float64) -> list[xr.DataArray]:
    """Two maps of noise, the second of them shifted."""
    values = np.random.default_rng(0).normal(size=(2, 100, 100))
    places = np.arange(100) * 4.0
    maps = []
    for k, grey in enumerate(values):
        axes = {a: (a, (places + k * shift_um).astype(coordinates), {"units": "um"}) for a in "yx"}
        maps.append(xr.DataArray(grey, dims=("y", "x"), coords=axes))
    return maps


@reported("sdf-xarray 41", r"as written, \[4.0, 3.0, 2.0\]")
def array_with_its_axes_x_y_z(_folder):
    sizes = dict(zip("zyx", VOXEL_UM, strict=True))
    axes = {
        a: (a, np.arange(GREY.shape["zyx".index(a)]) * sizes[a], {"units": "um"}) for a in "xyz"
    }
    return array_text(pl.volume(xr.DataArray(GREY.T, dims=("x", "y", "z"), coords=axes)))


@reported("xarray 7621", "coordinates along y descend; .*isel")
def array_whose_y_falls(_folder):
    a, _ = two_maps()
    return array_text(pl.image(a[::-1]))


@reported("xarray 7045", "maps have other places")
def maps_half_a_pixel_apart(_folder):
    return str(pl.correlate(*two_maps(2.0), point_um=40).n)


@reported("xarray 2694", "^100$")
def map_with_coordinates_of_single_precision(_folder):
    a, _ = two_maps()
    _, b = two_maps(coordinates=np.float32)
    return str(pl.correlate(a, b, point_um=40).n)


@reported("sdf-xarray 41", "maps have other places")
def map_stored_with_x_first(_folder):
    a, b = two_maps()
    return str(pl.correlate(a, b.T, point_um=40).n)


@reported("scipy 3645", "mask would be lost. Write .*filled")
def masks_that_differ(_folder):
    a, b = (np.ma.masked_greater(one.values, 2) for one in two_maps())
    return str(pl.correlate(a, b, pixel_um=4, point_um=40).n)


@reported("tsdat 225", "a holds -9999 2000 times, which its attribute _FillValue calls missing")
def map_with_a_number_for_missing(_folder):
    a, b = two_maps()
    a[:20] = -9999
    a.attrs["_FillValue"] = np.float32(-9999)
    return str(pl.correlate(a, b, point_um=40).n)


@reported("glmtools 78", "The image holds 0 60 times, which its attribute nodata calls missing")
def image_with_a_number_for_missing(_folder):
    values = np.maximum(PICTURE, 1)
    values[:, 0] = 0
    return array_text(pl.image(xr.DataArray(values, dims=("y", "x"), attrs={"nodata": 0})))


@reported("georaster 87", "25 % of the values are missing")
def image_of_gdal_with_a_number_for_missing(folder):
    values = PICTURE.astype(np.float32)
    values[:15] = -9999
    tags = [(42113, "s", 0, "-9999", True)]
    tifffile.imwrite(folder / "a.tif", values, metadata=None, extratags=tags)
    return image_text(folder / "a.tif")


@reported("xarray 7340", "complex128 values; .*abs")
def maps_of_complex_numbers(_folder):
    a, b = (one.values for one in two_maps())
    return str(pl.correlate(a + 1j, b, pixel_um=4, point_um=40).n)


@reported("pylibtiff 29", "as written")
def array_in_the_other_byte_order(_folder):
    return array_text(pl.volume(GREY.astype(">u2"), voxel_um=VOXEL_UM))


# --- positions ------------------------------------------------------------------------------------

FIRST = r"moving': \(288.6, 531.0\)"


def table(path: Path, header: str, row: str, coding: str = "utf-8") -> Path:
    """Write a table with a row for each mark."""
    rows = [row.format(k=k, x=x, y=y) for k, (x, y) in enumerate(MARKS_UM)]
    path.write_bytes("\r\n".join([header, *rows, ""]).encode(coding))
    return path


PAIRS = "label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um"


@reported("Slicer 3731", FIRST)
def slicer_in_ras(folder):
    points = [
        {"id": str(k), "label": f"F-{k}", "position": [-x / 1000, -y / 1000, 0.0]}
        for k, (x, y) in enumerate(MARKS_UM)
    ]
    lists = [
        {"type": "Fiducial", "name": name, "coordinateSystem": "RAS", "controlPoints": points}
        for name in ("moving", "fixed")
    ]
    (folder / "a.mrk.json").write_text(json.dumps({"markups": lists}))
    return marks_text(folder / "a.mrk.json")


@reported("QGIS 46415", "holds points of QGIS, whose y counts upwards. Give .*moving_x_mm")
def points_of_qgis(folder):
    return marks_text(table(folder / "a.points", "mapX,mapY,sourceX,sourceY", "{x},{y},{x},-{y}"))


@reported("ShapeWorks 2207", "holds landmarks of Amira or Avizo. Give .*moving_x_mm")
def landmarks_of_avizo(folder):
    header = "# Avizo 3D ASCII 2.0\n\ndefine Markers 4\n"
    return marks_text(table(folder / "a.landmarkAscii", header, "{x} {y} 0"))


@reported("Momocs 122", "holds landmarks of tpsDig, whose y counts upwards")
def landmarks_of_tps(folder):
    return marks_text(table(folder / "a.tps", "LM=4", "{x} {y}"))


@reported(
    "Name Landmarks and Register of Fiji", "is XML, such as the named landmarks of Fiji. Give"
)
def named_landmarks_of_fiji(folder):
    row = '<pointworld name="P{k}" x="{x}" y="{y}" z="0"/>'
    return marks_text(table(folder / "a.points", '<?xml version="1.0"?>\n<namedpointset>', row))


@reported("csvtk 13", FIRST)
def table_with_the_separator_of_excel(folder):
    path = table(folder / "a.csv", f"sep=;\n{PAIRS}", "P{k},{x},{y},{x},{y}", "utf-8-sig")
    text = path.read_text(encoding="utf-8-sig").replace(",", ";").replace(".", ",")
    path.write_text(text, encoding="utf-8-sig")
    return marks_text(path)


@reported("javarosa 687", FIRST)
def unicode_text_of_excel(folder):
    header, row = PAIRS.replace(",", "\t"), "P{k}\t{x}\t{y}\t{x}\t{y}"
    return marks_text(table(folder / "a.txt", header, row, "utf-16"))


@reported("allotropy 548", FIRST)
def headings_with_the_greek_letter(folder):
    header = "label,moving_x (μm),moving_y (μm),fixed_x (µm),fixed_y (µm)"
    return marks_text(table(folder / "a.csv", header, "P{k},{x},{y},{x},{y}"))


@reported("nhanes 7", "no text in UTF-8. Save .*CSV UTF-8")
def headings_in_the_code_page_of_windows(folder):
    header = "label,moving_x (µm),moving_y (µm),fixed_x (µm),fixed_y (µm)"
    return marks_text(table(folder / "a.csv", header, "P{k},{x},{y},{x},{y}", "cp1252"))


@reported("gerardus 1", FIRST)
def columns_with_y_before_x(folder):
    moving = table(folder / "m.csv", "Label,Y (um),X (um)", "P{k},{y},{x}")
    return marks_text(moving, table(folder / "f.csv", "Label,X (um),Y (um)", "P{k},{x},{y}"))


@reported("hyperspy 3341", "moving_x, moving_y do not state the same unit")
def columns_in_two_units(folder):
    header = "label,moving_x (mm),moving_y (um),fixed_x (um),fixed_y (um)"
    return marks_text(table(folder / "a.csv", header, "P{k},{x},{y},{x},{y}"))


@reported("napari 941", "holds shapes of napari. Save a layer of points")
def shapes_of_napari(folder):
    header = "index,shape-type,vertex-index,axis-0,axis-1"
    return marks_text(table(folder / "a.csv", header, "0,polygon,{k},{y},{x}"))


# --- what is there is said ------------------------------------------------------------------------


@reported("nibabel 966", "a.nii.gz is no packed file but NIfTI. Rename it to a.nii")
def nifti_that_is_not_packed(folder):
    nifti(folder / "a.nii").rename(folder / "a.nii.gz")
    return volume_text(folder / "a.nii.gz")


@reported("porespy 286", "is a VTK file by its name. Open it in ParaView .*MetaImage")
def image_of_vtk(folder):
    (folder / "a.vti").write_text('<?xml version="1.0"?>\n<VTKFile type="ImageData"></VTKFile>')
    return volume_text(folder / "a.vti")


@reported("OpenPNM 2965", "is a VTK file by its first bytes. Open it in ParaView")
def legacy_vtk(folder):
    (folder / "a.dat").write_bytes(b"# vtk DataFile Version 3.0\nvolume\nBINARY\n")
    return volume_text(folder / "a.dat")


@reported("legacy-validator 52", r"is empty \(0 bytes\)")
def file_of_no_bytes(folder):
    (folder / "a.nii.gz").touch()
    return volume_text(folder / "a.nii.gz")


@reported("JXLook 6", "foreign picture file by its first bytes")
def photograph_of_a_phone_renamed(folder):
    (folder / "a.jpg").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0heicmif1" + bytes(500))
    return image_text(folder / "a.jpg")


@reported("ImageMagick 8570", "^None;")
def png_that_states_an_aspect_ratio(folder):
    text = io.BytesIO()
    Image.fromarray(PICTURE).save(text, "PNG")
    body = b"pHYs" + struct.pack(">IIB", 250_000, 250_000, 0)
    chunk = struct.pack(">I", 9) + body + struct.pack(">I", zlib.crc32(body))
    data = text.getvalue()
    (folder / "a.png").write_bytes(data[:33] + chunk + data[33:])
    return image_text(folder / "a.png")


@reported("ImageMagick 8460", "^None;")
def jpeg_that_states_an_aspect_ratio(folder):
    text = io.BytesIO()
    Image.fromarray(PICTURE).save(text, "JPEG")
    data = bytearray(text.getvalue())
    at = data.find(b"JFIF\0") + 7
    data[at : at + 5] = struct.pack(">BHH", 0, 300, 300)
    (folder / "a.jpg").write_bytes(data)
    return image_text(folder / "a.jpg")


# --- daily files ----------------------------------------------------------------------------------

RAW_HEADER = 'shape = [20, 9, 11]\ndtype = "uint8"\nvoxel_um = [4.0, 3.0, 2.0]\n'


def raw(folder: Path, header: str, coding: str = "utf-8") -> Path:
    """Write raw values and their header."""
    (folder / "a.raw").write_bytes(GREY.tobytes())
    (folder / "a.raw.toml").write_text(header, encoding=coding)
    return folder / "a.raw"


@reported("telegraf 1378", READ)
def header_saved_by_notepad(folder):
    return volume_text(raw(folder, RAW_HEADER, "utf-8-sig"))


@reported("lm-proxy 79", READ)
def header_written_by_powershell(folder):
    return volume_text(raw(folder, RAW_HEADER, "utf-16"))


@reported("toml 716", r"line 1, column \d+: .*A path with \\ stands in single quotes")
def header_with_a_path_of_windows(folder):
    return volume_text(raw(folder, f'file = "C:\\Users\\me\\a.raw"\n{RAW_HEADER}'))


@reported("jbr 146", "voxel_um = 1,65. Numbers have a decimal point")
def header_with_a_decimal_comma(folder):
    return volume_text(raw(folder, 'shape = [20, 9, 11]\ndtype = "uint8"\nvoxel_um = 1,65\n'))


@reported("invest 277", READ)
def metaimage_with_a_path_of_windows(folder):
    (folder / "data").mkdir()
    (folder / "data" / "a.raw").write_bytes(GREY.tobytes())
    lines = ("ElementSpacing = 0.002 0.003 0.004", "ElementType = MET_UCHAR")
    lines = (*lines, "BinaryDataByteOrderMSB = False", r"ElementDataFile = data\a.raw")
    return volume_text(meta_image(folder / "a.mhd", *lines))


@reported("biorbd 141", "name (it there|them) without a path")
def metaimage_with_a_drive(folder):
    (folder / "a.raw").write_bytes(GREY.tobytes())
    lines = ("ElementSpacing = 0.002 0.003 0.004", "ElementType = MET_UCHAR")
    lines = (*lines, "BinaryDataByteOrderMSB = False", r"ElementDataFile = C:\scan\a.raw")
    return volume_text(meta_image(folder / "a.mhd", *lines))


@reported("nat 236", READ)
def detached_and_packed_nrrd(folder):
    (folder / "a.raw.gz").write_bytes(gzip.compress(GREY.tobytes()))
    lines = ("NRRD0004", "type: uint8", "dimension: 3", "sizes: 11 9 20", "spacings: 2 3 4")
    lines = (*lines, 'units: "um" "um" "um"', "encoding: gzip", "data file: a.raw.gz", "", "")
    (folder / "a.nhdr").write_text("\n".join(lines))
    return volume_text(folder / "a.nhdr")


def slices(folder: Path, name: str) -> Path:
    """Write slices; the name has a place for the number."""
    scan = folder / "scan"
    scan.mkdir()
    for k, values in enumerate(GREY):
        path = scan / name.format(k=k)
        tifffile.imwrite(path, values, metadata=None, photometric="minisblack")
    return scan


@reported("cellfinder-napari 88", ASKED)
def slices_beside_files_of_windows(folder):
    scan = slices(folder, "s{k:03d}.tif")
    (scan / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0" * 99)
    (scan / "desktop.ini").write_text("[.ShellClassInfo]")
    return volume_text(scan)


@reported("bioformats 2490", ASKED)
def slices_with_names_of_bfconvert(folder):
    return volume_text(slices(folder, "output_xy0z{k}c0t0.ome.tif"))


@reported("SlicerMorph 453", ASKED)
def slices_with_numbers_in_brackets(folder):
    return volume_text(slices(folder, "Probe ä ({k}).tif"))


@reported("SlicerMorph 122", "20 images .* and 1 named otherwise, first s003 - Copy.tif")
def slice_that_was_copied(folder):
    scan = slices(folder, "s{k:03d}.tif")
    (scan / "s003 - Copy.tif").write_bytes((scan / "s003.tif").read_bytes())
    return volume_text(scan)


# --- what is tested -------------------------------------------------------------------------------


@pytest.mark.parametrize("row", REPORTED, ids=lambda row: row.make.__name__)
def test_a_reported_input(row, tmp_path):
    try:
        said = row.make(tmp_path)
    except PlanishError as error:
        said = str(error)
    assert re.search(row.right, said), (row.source, said)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("1,65", "'1,65' may be 1.65 or two numbers. Write numbers with a decimal point."),
        (" 4,1", "may be 4.1 or two numbers"),
        ("1.65um", "'1.65um' is not SIZE|Z,Y,X"),
    ],
)
def test_a_size_on_the_command_line(given, words, planish, tmp_path):
    """A decimal comma and a unit: moveit_commander 11, heekscnc 41."""
    tifffile.imwrite(tmp_path / "a.tif", GREY, metadata=None, photometric="minisblack")
    code, _, err = planish("map", tmp_path / "a.tif", "--out", tmp_path / "o", "--voxel-um", given)
    assert (code, words in " ".join(err.split())) == (2, True), err
