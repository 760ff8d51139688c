"""What each format says about axes, sizes, unit and hand: the table in docs/formats.md.

Each cell is a function that writes the same volume with a library of others, and yields what
planish has to say of it. The volume bears a letter on three of its sides, so that no permutation of
its axes and no mirror image of it is the volume itself.
"""

import itertools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import mrcfile
import nibabel
import nrrd
import numpy as np
import pytest
import scipy.io
import SimpleITK as itk
import tifffile
import zarr
from PIL import Image
from tests.folders import refused

from planish.core.errors import VolumeError
from planish.io import read_volume, write_store
from planish.io.info import describe

VOXEL_UM = (4.0, 3.0, 2.0)  # z, y, x
COLUMNS = ("axes", "sizes", "unit", "hand")
DOCUMENT = Path(__file__).parents[2] / "docs" / "formats.md"


def letter(rows: str) -> np.ndarray:
    """Pixels of a letter, one row a word."""
    return np.array([[dot == "#" for dot in row] for row in rows.split()])


def lettered_volume() -> np.ndarray:
    """A volume (z, y, x) with F on its first slice, L on its first row, P on its first column."""
    volume = np.full((20, 9, 11), 40, np.uint8)
    volume[0, 2:7, 3:6] += 100 * letter("### #.. ##. #.. #..").astype(np.uint8)
    volume[4:9, 0, 3:6] += 60 * letter("#.. #.. #.. #.. ###").astype(np.uint8)
    volume[4:9, 3:6, 0] += 30 * letter("##. #.# ##. #.. #..").astype(np.uint8)
    return volume


LETTERS = lettered_volume()


class Said(NamedTuple):
    """A file, and what planish has to say of it."""

    path: Path
    options: dict[str, Any] = {}  # noqa: RUF012
    values: np.ndarray = LETTERS
    voxel_um: tuple[float, float, float] = VOXEL_UM
    hand: str = ""  # with which the attribute begins
    turned: str = ""
    note: str = ""


Cell = Callable[[Path], Iterator[Said]]
CELLS: dict[tuple[str, str], tuple[str, Cell]] = {}


def cell(kind: str, column: str, text: str) -> Callable[[Cell], Cell]:
    """Put a function into the table, with what the document says in its cell."""

    def entered(function: Cell) -> Cell:
        CELLS[kind, column] = (text, function)
        return function

    return entered


# --- TIFF -----------------------------------------------------------------------------------------


def imagej(
    path: Path, values: np.ndarray, unit: str = "um", scale: float = 1.0, **meta: Any
) -> Path:
    """A stack as ImageJ writes it, ``scale`` um a unit."""
    z_um, y_um, x_um = VOXEL_UM
    resolution = (scale / x_um, scale / y_um)
    metadata = {"unit": unit, "spacing": z_um / scale, "axes": "ZYX", **meta}
    tifffile.imwrite(path, values, imagej=True, resolution=resolution, metadata=metadata)
    return path


@cell(
    "TIFF",
    "axes",
    "pages are z; time points or 16 channels in place of z are slices, as reported",
)
def tiff_axes(folder: Path) -> Iterator[Said]:
    yield Said(imagej(folder / "plain.tif", LETTERS))
    times = LETTERS[:, None, None, :, :, None]
    path = imagej(folder / "times.tif", times, axes="TZCYXS")
    yield Said(path, note="20 slices are filed as time points")
    tifffile.imwrite(folder / "channels.ome.tif", LETTERS, ome=True, metadata={"axes": "CYX"})
    yield Said(
        folder / "channels.ome.tif", {"voxel_um": VOXEL_UM}, note="20 slices are filed as channels"
    )


@cell(
    "TIFF", "sizes", "OME physical sizes; ImageJ spacing and resolution; resolution tags for y, x"
)
def tiff_sizes(folder: Path) -> Iterator[Said]:
    yield Said(imagej(folder / "imagej.tif", LETTERS))
    sizes = {f"PhysicalSize{a}": um for a, um in zip("ZYX", VOXEL_UM, strict=True)}
    metadata = {"axes": "ZYX", **sizes}
    tifffile.imwrite(folder / "v.ome.tif", LETTERS, ome=True, metadata=metadata)
    yield Said(folder / "v.ome.tif")


@cell("TIFF", "unit", "of OME (um where none is written) and of ImageJ; cm or inch of the tags")
def tiff_unit(folder: Path) -> Iterator[Said]:
    yield Said(imagej(folder / "mm.tif", LETTERS, unit="mm", scale=1000.0))
    yield Said(imagej(folder / "micron.tif", LETTERS, unit="micron"))
    sizes = {f"PhysicalSize{a}": um / 1000 for a, um in zip("ZYX", VOXEL_UM, strict=True)}
    units = {f"PhysicalSize{a}Unit": "mm" for a in "ZYX"}
    metadata = {"axes": "ZYX", **sizes, **units}
    tifffile.imwrite(folder / "mm.ome.tif", LETTERS, ome=True, metadata=metadata)
    yield Said(folder / "mm.ome.tif")


@cell("TIFF", "hand", "the orientation tag")
def tiff_hand(folder: Path) -> Iterator[Said]:
    for tag, words in (
        (1, {}),
        (2, {"hand": "left"}),
        (3, {"turned": "by"}),
        (7, {"hand": "left"}),
    ):
        path = folder / f"tag{tag}.tif"
        extratags = [(274, 3, 1, tag, True)]
        tifffile.imwrite(
            path, LETTERS, metadata=None, photometric="minisblack", extratags=extratags
        )
        yield Said(path, {"voxel_um": VOXEL_UM}, **words)


# --- folders of slices ----------------------------------------------------------------------------


def slices(folder: Path, tag: int = 1, **options: Any) -> Path:
    """A folder of TIFF slices."""
    folder.mkdir()
    for k, values in enumerate(LETTERS):
        extratags = [(274, 3, 1, tag, True)]
        tifffile.imwrite(
            folder / f"s{k:03d}.tif", values, metadata=None, extratags=extratags, **options
        )
    return folder


@cell("folder of slices", "axes", "z in the order of the numbers in the names")
def slices_axes(folder: Path) -> Iterator[Said]:
    scan = folder / "png"
    scan.mkdir()
    for k, values in enumerate(LETTERS):
        Image.fromarray(values).save(scan / f"slice{k + 1}.png")
    yield Said(scan, {"voxel_um": VOXEL_UM})


@cell("folder of slices", "sizes", "resolution of the slices for y, x; logs of SkyScan for all")
def slices_sizes(folder: Path) -> Iterator[Said]:
    _, y_um, x_um = VOXEL_UM
    scan = slices(folder / "tif", resolution=(1e4 / x_um, 1e4 / y_um), resolutionunit="CENTIMETER")
    yield Said(scan, {"voxel_um": VOXEL_UM})
    logged = slices(folder / "v_rec")
    for file in sorted(logged.iterdir()):
        file.rename(logged / file.name.replace("s", "v_rec0", 1))
    log = "[Reconstruction]\nPixel Size (um)=2.5\n[File name convention]\nFilename Prefix=v_rec\n"
    (logged / "v_rec.log").write_text(log)
    yield Said(logged, voxel_um=(2.5, 2.5, 2.5))


@cell("folder of slices", "unit", "cm or inch of the resolution; um of the logs")
def slices_unit(folder: Path) -> Iterator[Said]:
    _, y_um, x_um = VOXEL_UM
    for unit, length_um in (("CENTIMETER", 1e4), ("INCH", 25400.0)):
        resolution = (length_um / x_um, length_um / y_um)
        scan = slices(folder / unit, resolution=resolution, resolutionunit=unit)
        yield Said(scan, {"voxel_um": VOXEL_UM})


@cell("folder of slices", "hand", "the orientation tag, the same in all slices")
def slices_hand(folder: Path) -> Iterator[Said]:
    yield Said(
        slices(folder / "t4", 4), {"voxel_um": VOXEL_UM}, hand="left, by the orientation tag 4"
    )
    yield Said(slices(folder / "t8", 8), {"voxel_um": VOXEL_UM}, turned="by the orientation tag 8")


# --- zarr -----------------------------------------------------------------------------------------


def ome_zarr(
    path: Path, order: str = "zyx", unit: str = "micrometer", um: float = 1.0, **axis: Any
) -> Path:
    """An OME-Zarr image whose axes are stored in an order, ``um`` a unit."""
    group = zarr.open_group(str(path), mode="w", zarr_format=2 if order == "zyx" else 3)
    values = LETTERS.transpose(["zyx".index(a) for a in order])
    stored = group.create_array("0", shape=values.shape, dtype="u1", chunks=(8, 8, 8))
    stored[...] = values
    axes = [{"name": a, "type": "space", "unit": unit, **axis.get(a, {})} for a in order]
    scale = [VOXEL_UM["zyx".index(a)] / um for a in order]
    levels = [{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": scale}]}]
    image = {"axes": axes, "datasets": levels}
    if order == "zyx":
        group.attrs["multiscales"] = [{"version": "0.4", **image}]
    else:
        group.attrs["ome"] = {"version": "0.5", "multiscales": [image]}
    return path


@cell("OME-Zarr", "axes", "names of the axes")
def ome_axes(folder: Path) -> Iterator[Said]:
    for order in map("".join, itertools.permutations("zyx")):
        note = "" if order == "zyx" else f"stored as {', '.join(order)}"
        yield Said(ome_zarr(folder / f"{order}.zarr", order), note=note)


@cell("OME-Zarr", "sizes", "scales of the level and of the image, along the axes")
def ome_sizes(folder: Path) -> Iterator[Said]:
    yield Said(ome_zarr(folder / "v.zarr", "yxz"), note="stored as y, x, z")


@cell("OME-Zarr", "unit", "`unit` of each axis; without one it is asked for")
def ome_unit(folder: Path) -> Iterator[Said]:
    yield Said(ome_zarr(folder / "mm.zarr", unit="millimeter", um=1000.0))


@cell("OME-Zarr", "hand", "anatomical orientation of the axes (RFC 4)")
def ome_hand(folder: Path) -> Iterator[Said]:
    def anatomical(value: str) -> dict[str, Any]:
        return {"orientation": {"type": "anatomical", "value": value}}

    usual = {"z": "inferior-to-superior", "y": "anterior-to-posterior", "x": "right-to-left"}
    axes = {name: anatomical(value) for name, value in usual.items()}
    yield Said(ome_zarr(folder / "lps.zarr", **axes))
    mirrored = axes | {"x": anatomical("left-to-right")}
    yield Said(ome_zarr(folder / "rps.zarr", **mirrored), hand="left, by the OME-Zarr axes")


def plain_zarr(
    path: Path, order: str, zarr_format: int, steps: dict[str, float], unit: str
) -> Path:
    """An array with named dimensions, as xarray writes it: coordinates lie beside it."""
    group = zarr.open_group(str(path), mode="w", zarr_format=zarr_format)

    def write(name: str, values: np.ndarray, dimensions: list[str], **attrs: Any) -> None:
        named = {"dimension_names": dimensions} if zarr_format == 3 else {}
        stored = group.create_array(name, shape=values.shape, dtype=values.dtype, **named)
        stored[...] = values
        if zarr_format == 2:
            stored.attrs["_ARRAY_DIMENSIONS"] = dimensions
        stored.attrs.update(attrs)

    write("grey", LETTERS.transpose(["zyx".index(a) for a in order]), [*order])
    for name, step in steps.items():
        count = LETTERS.shape["zyx".index(name)]
        write(name, np.arange(count) * step, [name], units=unit)
    return path


UM_STEPS = dict(zip("zyx", VOXEL_UM, strict=True))


@cell("plain zarr", "axes", "dimension names of v3, `_ARRAY_DIMENSIONS` and `axes` of v2")
def zarr_axes(folder: Path) -> Iterator[Said]:
    for order, zarr_format in (("xyz", 2), ("yxz", 3)):
        path = plain_zarr(folder / f"{order}.zarr", order, zarr_format, UM_STEPS, "um")
        yield Said(path, note=f"stored as {', '.join(order)}")
    array = zarr.open_array(str(folder / "a.zarr"), mode="w", zarr_format=2, shape=(11, 20, 9))
    array[...] = LETTERS.transpose(2, 0, 1)
    array.attrs["axes"] = "xzy"
    yield Said(folder / "a.zarr", {"voxel_um": VOXEL_UM}, note="stored as x, z, y")


@cell(
    "plain zarr", "sizes", "evenly spaced coordinates; attributes such as `voxel_size`, as stored"
)
def zarr_sizes(folder: Path) -> Iterator[Said]:
    yield Said(plain_zarr(folder / "c.zarr", "zyx", 3, UM_STEPS, "um"))
    path = plain_zarr(folder / "a.zarr", "xyz", 2, {}, "")
    array = zarr.open_array(str(path / "grey"), mode="r+")
    array.attrs.update({"voxel_size": [2.0, 3.0, 4.0], "unit": "um"})
    yield Said(path, note="stored as x, y, z")


@cell(
    "plain zarr",
    "unit",
    "`units` of the coordinates; of the attribute, or m or mm where no other is sane",
)
def zarr_unit(folder: Path) -> Iterator[Said]:
    steps = {name: um / 1e3 for name, um in UM_STEPS.items()}
    yield Said(plain_zarr(folder / "mm.zarr", "zyx", 2, steps, "mm"))


@cell("plain zarr", "hand", "coordinates that fall")
def zarr_hand(folder: Path) -> Iterator[Said]:
    steps = UM_STEPS | {"y": -3.0}
    path = plain_zarr(folder / "y.zarr", "zyx", 2, steps, "um")
    yield Said(path, hand="left, by the spacing of its coordinates")
    steps |= {"x": -2.0}
    yield Said(plain_zarr(folder / "yx.zarr", "zyx", 3, steps, "um"), turned="by the spacing")


# --- HDF5 -----------------------------------------------------------------------------------------


def hdf5(path: Path, order: str, dress: Callable[[h5py.Dataset], None], name: str = "v") -> Path:
    """A data set with the axes in an order, and attributes by a function."""
    with h5py.File(path, "w") as file:
        dress(file.create_dataset(name, data=LETTERS.transpose(["zyx".index(a) for a in order])))
    return path


def with_coordinates(order: str, steps: dict[str, float], unit: str) -> Callable[[Any], None]:
    def dress(data: h5py.Dataset) -> None:
        data.parent.attrs["axes"] = [*order]
        for name, step in steps.items():
            values = np.arange(LETTERS.shape["zyx".index(name)]) * step
            data.parent.create_dataset(name, data=values).attrs["units"] = unit

    return dress


def by_labels(data: h5py.Dataset) -> None:
    for dimension, label in zip(data.dims, "xyz", strict=True):
        dimension.label = label


def by_scales(data: h5py.Dataset) -> None:
    for axis, name in enumerate("xyz"):
        scale = data.parent.create_dataset(name, data=np.arange(data.shape[axis]) * 1.0)
        scale.make_scale(name)
        data.dims[axis].attach_scale(scale)


def by_axistags(data: h5py.Dataset) -> None:
    tags = [{"key": a, "typeFlags": 2, "resolution": 0, "description": ""} for a in "xyz"]
    data.attrs["axistags"] = json.dumps({"axes": tags})


def by_indices(data: h5py.Dataset) -> None:
    data.parent.attrs.update({"x_indices": 0, "y_indices": 1, "z_indices": 2})


def by_emd(data: h5py.Dataset) -> None:
    data.parent.attrs["emd_group_type"] = 1
    for axis, name in enumerate("xyz"):
        values = np.arange(data.shape[axis]) * UM_STEPS[name] * 1000
        dimension = data.parent.create_dataset(f"dim{axis + 1}", data=values)
        dimension.attrs.update({"name": name, "units": "[n_m]"})


def by_words(key: str, value: Any) -> Callable[[h5py.Dataset], None]:
    return lambda data: data.attrs.update({key: value})


@cell(
    "HDF5, NeXus",
    "axes",
    "labels and scales of the dimensions, `axes` and `NAME_indices` of NeXus, `axistags` of vigra,"
    " EMD, `_ARRAY_DIMENSIONS` and the like",
)
def hdf5_axes(folder: Path) -> Iterator[Said]:
    dresses = {
        "labels": by_labels,
        "scales": by_scales,
        "axistags": by_axistags,
        "indices": by_indices,
        "emd": by_emd,
        "axes": by_words("axes", np.array(["x", "y", "z"], "S1")),
        "word": by_words("axes", "xyz"),
        "colons": by_words("axes", "x:y:z"),
        "xarray": by_words("_ARRAY_DIMENSIONS", ["x", "y", "z"]),
        "spelt": by_words("axes", ["column", "row", "slice"]),
        "two": by_words("axes", ["x_axis (um)", "pos_y", ""]),
    }
    for name, dress in dresses.items():
        path = hdf5(folder / f"{name}.h5", "xyz", dress)
        yield Said(
            path,
            {} if name == "emd" else {"voxel_um": VOXEL_UM},
            note="stored as x, y, z",
        )


@cell(
    "HDF5, NeXus",
    "sizes",
    "evenly spaced coordinates; attributes such as `element_size_um`, as stored",
)
def hdf5_sizes(folder: Path) -> Iterator[Said]:
    yield Said(
        hdf5(folder / "c.nxs", "yzx", with_coordinates("yzx", UM_STEPS, "um")),
        note="stored as y, z, x",
    )

    def sizes(data: h5py.Dataset) -> None:
        data.attrs.update({"axes": ["x", "y", "z"], "voxel_size": [2.0, 3.0, 4.0], "units": "um"})

    yield Said(hdf5(folder / "a.h5", "xyz", sizes), note="stored as x, y, z")
    plain = hdf5(folder / "e.h5", "zyx", lambda data: data.attrs.update(element_size_um=VOXEL_UM))
    yield Said(plain)


@cell("HDF5, NeXus", "unit", "beside the size; m or mm where no other is sane, as reported")
def hdf5_unit(folder: Path) -> Iterator[Said]:
    nm_steps = {name: um * 1e3 for name, um in UM_STEPS.items()}
    yield Said(hdf5(folder / "nm.nxs", "zyx", with_coordinates("zyx", nm_steps, "nm")))

    def bare(data: h5py.Dataset) -> None:
        data.attrs["pixel_size"] = [4e-6, 3e-6, 2e-6]

    yield Said(hdf5(folder / "m.h5", "zyx", bare))

    def other(data: h5py.Dataset) -> None:
        data.attrs.update({"voxel_size": [0.004, 0.003, 0.002], "voxel_size_unit": "mm"})

    yield Said(hdf5(folder / "mm.h5", "zyx", other))


@cell("HDF5, NeXus", "hand", "coordinates that fall")
def hdf5_hand(folder: Path) -> Iterator[Said]:
    falling = with_coordinates("zyx", UM_STEPS | {"z": -4.0}, "um")
    yield Said(
        hdf5(folder / "z.nxs", "zyx", falling), hand="left, by the spacing of its coordinates"
    )


# --- headers --------------------------------------------------------------------------------------


def nrrd_file(path: Path, values: np.ndarray = LETTERS, **header: Any) -> Path:
    """An NRRD file; its header has the fastest axis first."""
    fields = {key.replace("_", " "): field for key, field in header.items()}
    nrrd.write(str(path), np.asfortranarray(values.transpose(2, 1, 0)), fields, index_order="F")
    return path


@cell("NRRD", "axes", "`labels`; `kinds` time in place of z")
def nrrd_axes(folder: Path) -> Iterator[Said]:
    units = ["um", "um", "um"]
    path = nrrd_file(
        folder / "labels.nrrd",
        LETTERS.transpose(2, 1, 0),
        labels=["z", "y", "x"],
        spacings=list(VOXEL_UM),
        units=units,
    )
    yield Said(path, note="stored as x, y, z")
    kinds = ["domain", "domain", "time"]
    times = nrrd_file(folder / "t.nrrd", kinds=kinds, spacings=[2.0, 3.0, 4.0], units=units)
    yield Said(times, note="filed as time points")


def nrrd_directions(path: Path, space: str, signs: tuple[int, int, int], **header: Any) -> Path:
    directions = np.diag([2.0, 3.0, 4.0]) / 1000 * np.array(signs)
    return nrrd_file(path, space=space, space_directions=directions, **header)


@cell("NRRD", "sizes", "`spacings`; lengths of `space directions`")
def nrrd_sizes(folder: Path) -> Iterator[Said]:
    spacings = {"spacings": [2.0, 3.0, 4.0], "units": ["um", "um", "um"]}
    yield Said(nrrd_file(folder / "s.nrrd", **spacings))
    yield Said(nrrd_directions(folder / "d.nrrd", "left-posterior-superior", (1, 1, 1)))


@cell("NRRD", "unit", "`units`, `space units`; mm in anatomical spaces")
def nrrd_unit(folder: Path) -> Iterator[Said]:
    spacings = {"spacings": [0.002, 0.003, 0.004], "units": ["mm", "mm", "mm"]}
    yield Said(nrrd_file(folder / "mm.nrrd", **spacings))
    yield Said(nrrd_directions(folder / "lps.nrrd", "left-posterior-superior", (1, 1, 1)))


@cell("NRRD", "hand", "`space directions` in their `space`")
def nrrd_hand(folder: Path) -> Iterator[Said]:
    lps, las = "left-posterior-superior", "left-anterior-superior"
    yield Said(nrrd_directions(folder / "a.nrrd", lps, (1, 1, -1)), hand="left, by the NRRD space")
    yield Said(nrrd_directions(folder / "b.nrrd", lps, (-1, -1, 1)), turned="by the NRRD space")
    yield Said(nrrd_directions(folder / "c.nrrd", las, (1, 1, 1)), hand="left, by the NRRD space")
    yield Said(nrrd_directions(folder / "d.nrrd", las, (1, -1, 1)))


def meta_image(path: Path, direction: np.ndarray, *extra: str) -> Path:
    """A MetaImage of SimpleITK; lines of its header may be exchanged."""
    image = itk.GetImageFromArray(LETTERS)
    image.SetSpacing([um / 1000 for um in VOXEL_UM[::-1]])
    image.SetDirection(direction.ravel().tolist())
    itk.WriteImage(image, str(path))
    content = path.read_bytes()
    for line in extra:
        key = line.split(" = ")[0].encode()
        head, _, rest = content.partition(b"ElementDataFile")
        lines = [old for old in head.split(b"\n") if old and not old.startswith(key + b" ")]
        content = b"\n".join([*lines, line.encode(), b""]) + b"ElementDataFile" + rest
    path.write_bytes(content)
    return path


@cell("MetaImage", "axes", "x, y, z, fastest first; there are no names")
def meta_axes(folder: Path) -> Iterator[Said]:
    yield Said(meta_image(folder / "v.mha", np.eye(3)))


@cell("MetaImage", "sizes", "`ElementSpacing`, `ElementSize`")
def meta_sizes(folder: Path) -> Iterator[Said]:
    yield Said(meta_image(folder / "v.mha", np.eye(3)))


@cell("MetaImage", "unit", "`DistanceUnits`, otherwise mm as ITK has it")
def meta_unit(folder: Path) -> Iterator[Said]:
    yield Said(meta_image(folder / "mm.mha", np.eye(3)))
    lines = ("ElementSpacing = 2 3 4", "DistanceUnits = um")
    yield Said(meta_image(folder / "um.mha", np.eye(3), *lines))


@cell("MetaImage", "hand", "`TransformMatrix`; without it `AnatomicalOrientation`, as ITK means it")
def meta_hand(folder: Path) -> Iterator[Said]:
    mirrored, turned = np.diag([1.0, 1.0, -1.0]), np.diag([-1.0, 1.0, -1.0])
    yield Said(meta_image(folder / "m.mha", mirrored), hand="left, by the TransformMatrix")
    yield Said(meta_image(folder / "t.mha", turned), turned="by the TransformMatrix")
    path = meta_image(folder / "letters.mha", np.eye(3), "AnatomicalOrientation = RAS")
    content = path.read_bytes()
    lines = [line for line in content.split(b"\n") if not line.startswith(b"TransformMatrix")]
    path.write_bytes(b"\n".join(lines))
    yield Said(path, hand="left, by the AnatomicalOrientation RAS")


def nifti(path: Path, signs: tuple[int, int, int], unit: str = "micron", um: float = 1.0) -> Path:
    """A NIfTI file with both affines, ``um`` a unit."""
    x_um, y_um, z_um = VOXEL_UM[::-1]
    affine = np.diag([*(np.array([x_um, y_um, z_um]) / um * np.array(signs)), 1.0])
    image = nibabel.Nifti1Image(LETTERS.transpose(2, 1, 0), affine)
    image.set_qform(affine, 1)
    image.set_sform(affine, 1)
    image.header.set_xyzt_units(unit)
    nibabel.save(image, path)
    return path


@cell("NIfTI", "axes", "x, y, z; time points in place of z are slices, as reported")
def nifti_axes(folder: Path) -> Iterator[Said]:
    yield Said(nifti(folder / "v.nii", (1, 1, 1)))
    image = nibabel.Nifti1Image(LETTERS.transpose(2, 1, 0)[:, :, None, :], None)
    image.header.set_zooms((2.0, 3.0, 1.0, 4.0))
    image.header.set_xyzt_units("micron", "sec")
    nibabel.save(image, folder / "t.nii")
    yield Said(folder / "t.nii", {"voxel_um": VOXEL_UM}, note="filed as time points")


@cell("NIfTI", "sizes", "`pixdim`, and the affines, which may not contradict it")
def nifti_sizes(folder: Path) -> Iterator[Said]:
    yield Said(nifti(folder / "v.nii.gz", (1, 1, 1)))


@cell("NIfTI", "unit", "`xyzt_units`; without one it is asked for")
def nifti_unit(folder: Path) -> Iterator[Said]:
    yield Said(nifti(folder / "mm.nii", (1, 1, 1), "mm", 1000.0))


@cell("NIfTI", "hand", "`sform` and `qform`")
def nifti_hand(folder: Path) -> Iterator[Said]:
    yield Said(nifti(folder / "m.nii", (-1, 1, 1)), hand="left, by the sform and the qform")
    yield Said(nifti(folder / "t.nii", (-1, -1, 1)), turned="by the sform and the qform")


def mrc(path: Path, order: str) -> Path:
    """An MRC file whose columns, rows and sections are the axes of an order, slowest first."""
    values = np.ascontiguousarray(LETTERS.transpose(["zyx".index(a) for a in order]))
    with mrcfile.new(path) as file:
        file.set_data(values.astype(np.int16))
        header = file.header
        header.maps, header.mapr, header.mapc = ("xyz".index(a) + 1 for a in order)
        header.mz, header.my, header.mx = LETTERS.shape
        z, y, x = (n * um * 1e4 for n, um in zip(LETTERS.shape, VOXEL_UM, strict=True))
        header.cella.x, header.cella.y, header.cella.z = x, y, z
    return path


@cell("MRC", "axes", "`mapc`, `mapr`, `maps`")
def mrc_axes(folder: Path) -> Iterator[Said]:
    for order in map("".join, itertools.permutations("zyx")):
        note = "" if order == "zyx" else f"stored as {', '.join(order)}"
        yield Said(mrc(folder / f"{order}.mrc", order), note=note)


@cell("MRC", "sizes", "the cell by its intervals, x, y and z")
def mrc_sizes(folder: Path) -> Iterator[Said]:
    yield Said(mrc(folder / "v.mrc", "xzy"), note="stored as x, z, y")


@cell("MRC", "unit", "Angstrom")
def mrc_unit(folder: Path) -> Iterator[Said]:
    yield Said(mrc(folder / "v.rec", "zyx"))


@cell("MRC", "hand", "not stated")
def mrc_hand(folder: Path) -> Iterator[Said]:
    yield Said(mrc(folder / "v.map", "zyx"))


# --- MATLAB and raw values ------------------------------------------------------------------------


def matlab(path: Path, **more: Any) -> Path:
    scipy.io.savemat(path, {"V": LETTERS.transpose(1, 2, 0), **more})
    return path


@cell("MATLAB", "axes", "`V(row, column, slice)`")
def matlab_axes(folder: Path) -> Iterator[Said]:
    yield Said(matlab(folder / "v.mat"), {"voxel_um": VOXEL_UM})


@cell("MATLAB", "sizes", "variable `voxel_um`: one number, or z, y, x")
def matlab_sizes(folder: Path) -> Iterator[Said]:
    yield Said(matlab(folder / "v.mat", voxel_um=np.array(VOXEL_UM)))


@cell("MATLAB", "unit", "um, by its name")
def matlab_unit(folder: Path) -> Iterator[Said]:
    yield Said(matlab(folder / "v.mat", voxel_um=2.5), voxel_um=(2.5, 2.5, 2.5))


@cell("MATLAB", "hand", "not stated")
def matlab_hand(folder: Path) -> Iterator[Said]:
    yield Said(matlab(folder / "v.mat"), {"voxel_um": VOXEL_UM})


def raw(folder: Path, line: str = "") -> Path:
    LETTERS.tofile(folder / "v.raw")
    n_z, n_y, n_x = LETTERS.shape
    header = f'shape = [{n_z}, {n_y}, {n_x}]\ndtype = "uint8"\n{line}\n'
    (folder / "v.raw.toml").write_text(header)
    return folder / "v.raw"


@cell("raw", "axes", "`shape = [z, y, x]`")
def raw_axes(folder: Path) -> Iterator[Said]:
    yield Said(raw(folder), {"voxel_um": VOXEL_UM})


@cell("raw", "sizes", "`voxel_um`: one number, or z, y, x")
def raw_sizes(folder: Path) -> Iterator[Said]:
    yield Said(raw(folder, "voxel_um = [4.0, 3.0, 2.0]"))


@cell("raw", "unit", "um, by its name")
def raw_unit(folder: Path) -> Iterator[Said]:
    yield Said(raw(folder, "voxel_um = 1.5"), voxel_um=(1.5, 1.5, 1.5))


@cell("raw", "hand", "not stated")
def raw_hand(folder: Path) -> Iterator[Said]:
    yield Said(raw(folder), {"voxel_um": VOXEL_UM})


# --- what is tested -------------------------------------------------------------------------------


def test_no_permutation_and_no_mirror_image_is_the_volume_itself():
    orders = itertools.permutations(range(3))
    mirrors = itertools.product((slice(None), slice(None, None, -1)), repeat=3)
    seen = [
        LETTERS.transpose(order)[mirror] for order, mirror in itertools.product(orders, mirrors)
    ]
    same = [values for values in seen if np.array_equal(values, LETTERS)]
    assert (len(seen), len(same)) == (48, 1)


@pytest.mark.parametrize(("kind", "column"), [*CELLS], ids=" ".join)
def test_a_cell(kind, column, tmp_path):
    _, write = CELLS[kind, column]
    for said in write(tmp_path):
        volume = read_volume(said.path, **said.options)
        attrs = volume.attrs
        np.testing.assert_array_equal(volume.values, said.values, err_msg=said.path.name)
        assert attrs["voxel_um"] == pytest.approx(said.voxel_um, rel=1e-5), said.path.name
        assert attrs.get("hand", "").startswith(said.hand), attrs
        assert ("hand" in attrs) == bool(said.hand), attrs
        assert attrs.get("turned", "").startswith(said.turned), attrs
        assert ("turned" in attrs) == bool(said.turned), attrs
        notes = " ".join(attrs.get("notes", []))
        assert said.note in notes
        assert bool(said.note) == bool(notes), notes
        info = describe(said.path)
        warnings = " ".join(info["warnings"])
        assert ("mirror image" in warnings) == bool(said.hand), warnings
        assert [*info["notes"]] == [*attrs.get("notes", [])]


def test_the_table_of_the_document_is_that_of_the_cells():
    kinds = dict.fromkeys(kind for kind, _ in CELLS)
    assert {(kind, column) for kind in kinds for column in COLUMNS} == {*CELLS}
    lines = ["| Format | Axes | Sizes | Unit | Hand |", "|---|---|---|---|---|"]
    for kind in kinds:
        texts = [CELLS[kind, column][0] for column in COLUMNS]
        lines.append(f"| {' | '.join([kind, *texts])} |")
    assert "\n".join(lines) in DOCUMENT.read_text(encoding="utf-8")


# --- what is refused ------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("attrs", "words"),
    [
        ({"axes": ["a", "b", "c"]}, "its axes are a, b, c by the attribute axes"),
        ({"axes": ["x", "x", "z"]}, "no volume with the axes z, y and x"),
        ({"axes": ["x", "", ""]}, "one without a name"),
        ({"axes": ["x", "y"]}, "names 2 axes .*x, y.* the array has 3"),
        ({"axes": "zyx", "dims": "xyz"}, "contradicts itself: its axes are z, y, x by .* x, y, z"),
        ({"axes": ["rotation_angle", "y", "x"]}, "rotation_angle, y, x"),
        ({"dimension_order": "xyz"}, "may begin with the fastest or the slowest axis"),
        ({"axis_order": ["z", "x", "y"]}, "axis_order is z, x, y, which may begin"),
    ],
)
def test_names_that_place_no_axis_are_refused(attrs, words, tmp_path):
    path = hdf5(tmp_path / "v.h5", "zyx", lambda data: data.attrs.update(attrs))
    refused(VolumeError, words, read_volume, path, voxel_um=1)


def test_affines_that_contradict_each_other_or_the_size(tmp_path):
    image = nibabel.Nifti1Image(LETTERS.transpose(2, 1, 0), np.diag([2.0, 3.0, 4.0, 1.0]))
    image.set_sform(np.diag([20.0, 30.0, 40.0, 1.0]), 1)
    image.header.set_xyzt_units("micron")
    nibabel.save(image, tmp_path / "v.nii")
    refused(Exception, "contradicts itself: .*pixdim.*sform", read_volume, tmp_path / "v.nii")
    image.set_sform(np.diag([-2.0, 3.0, 4.0, 1.0]), 1)
    image.set_qform(np.diag([2.0, 3.0, 4.0, 1.0]), 1)
    nibabel.save(image, tmp_path / "w.nii")
    hand = read_volume(tmp_path / "w.nii").attrs["hand"]
    assert hand == "left, by the sform; but right, by the qform"


def test_slices_with_different_tags_are_refused(tmp_path):
    scan = slices(tmp_path / "scan")
    tifffile.imwrite(scan / "s004.tif", LETTERS[4], metadata=None, extratags=[(274, 3, 1, 2, True)])
    refused(
        VolumeError, "s004.tif has the orientation tag 2, s000.tif 1", read_volume, scan, voxel_um=1
    )


@pytest.mark.parametrize("memory_bytes", [None, 1], ids=["read at once", "left in the files"])
def test_png_slices_with_different_tags_are_refused(memory_bytes, tmp_path):
    tags = Image.Exif()
    tags[274] = 6
    for i, page in enumerate(LETTERS):
        Image.fromarray(page).save(tmp_path / f"s{i:03}.png")
    if memory_bytes:
        memory_bytes = 3 * LETTERS[0].nbytes
    assert read_volume(tmp_path, voxel_um=1, memory_bytes=memory_bytes).shape == LETTERS.shape
    Image.fromarray(LETTERS[4]).save(tmp_path / "s004.png", exif=tags)
    words = "s004.png has the orientation tag 6, s000.png 1"
    refused(VolumeError, words, read_volume, tmp_path, voxel_um=1, memory_bytes=memory_bytes)


def test_directions_in_one_plane_say_nothing(tmp_path):
    path = nrrd_file(
        tmp_path / "v.nrrd",
        space="left-posterior-superior",
        space_directions=np.array([[0.002, 0, 0], [0.003, 0, 0], [0, 0, 0.004]]),
    )
    volume = read_volume(path)
    assert "hand" not in volume.attrs
    assert "lie in one plane" in volume.attrs["notes"][0]


def test_an_imported_volume_keeps_what_its_file_says(tmp_path):
    axes = {"x": {"orientation": {"type": "anatomical", "value": "left-to-right"}}}
    axes |= {"y": {"orientation": {"type": "anatomical", "value": "anterior-to-posterior"}}}
    axes |= {"z": {"orientation": {"type": "anatomical", "value": "inferior-to-superior"}}}
    volume = read_volume(ome_zarr(tmp_path / "v.zarr", "xzy", **axes))
    for ome in ("0.4", "0.5"):
        write_store(volume, tmp_path / f"{ome}.zarr", ome=ome)
        stored = read_volume(tmp_path / f"{ome}.zarr")
        np.testing.assert_array_equal(stored.values, LETTERS)
        for name in ("hand", "notes", "voxel_um"):
            assert stored.attrs[name] == volume.attrs[name]


def test_sizes_in_the_group_of_a_zarr_array(tmp_path):
    path = plain_zarr(tmp_path / "v.zarr", "yzx", 3, {}, "")
    zarr.open_group(str(path), mode="r+").attrs["voxel_size_um"] = [3.0, 4.0, 2.0]
    assert read_volume(path).attrs["voxel_um"] == pytest.approx(VOXEL_UM)


@pytest.mark.parametrize("name", ["DIMENSION_LABELS", "DIMENSION_LIST"])
def test_damaged_scales_of_dimensions_crash_nothing(name, tmp_path):
    """The library's own functions for labels and scales end the program at such an attribute."""
    path = hdf5(tmp_path / "v.h5", "zyx", lambda data: data.attrs.update({name: "zyx"}))
    np.testing.assert_array_equal(read_volume(path, voxel_um=1).values, LETTERS)
