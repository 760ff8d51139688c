"""Arrays as volumes and images: the same as from a file, nothing read, and what is refused."""

import subprocess
import sys

import dask.array
import numpy as np
import pytest
import tifffile
import xarray as xr
import zarr

import planish as pl
from folders import refused
from planish.core.errors import InputError, SizeError, VolumeError
from planish.core.frame import Frame

RNG = np.random.default_rng(7)
GREYS = RNG.integers(0, 200, (12, 30, 40)).astype(np.uint8)
IMAGE = RNG.integers(0, 60_000, (30, 40)).astype(np.uint16)
OF_A_FILE = {"file_name", "file_bytes", "voxel_um_source", "pixel_um_source"} | {
    "camera",
    "curve",
    "is_linear",
    "is_scan",
}


def without_file(array):
    return {name: value for name, value in array.attrs.items() if name not in OF_A_FILE}


def test_volumes_and_images_are_what_their_files_give(tmp_path):
    tifffile.imwrite(tmp_path / "v.tif", GREYS)
    expected = pl.read_volume(tmp_path / "v.tif", voxel_um=(3, 1.5, 1.5), through="y", top="low")
    made = pl.volume(GREYS, voxel_um=(3, 1.5, 1.5), through="y", top="low")
    assert made.drop_attrs().identical(expected.drop_attrs())
    assert (without_file(made), Frame.of(made)) == (
        without_file(expected),
        Frame(through="y", top="low"),
    )
    assert made.x.attrs["units"] == "um"
    colour = np.stack([IMAGE, IMAGE // 2, IMAGE // 4], axis=-1)
    for values in (IMAGE, colour):
        tifffile.imwrite(tmp_path / "i.tif", values)
        expected = pl.read_image(tmp_path / "i.tif", pixel_um=5, side="bottom")
        made = pl.image(values, pixel_um=5, side="bottom")
        assert made.drop_attrs().identical(expected.drop_attrs())
        assert without_file(made) == without_file(expected)
        (tmp_path / "i.tif").unlink()


# Which dask is slow to start.
KINDS = [pytest.param(kind, marks=pytest.mark.ci) for kind in ("dask", "xarray of dask")]
KINDS += ["zarr", "xarray", "big-endian", "half"]


@pytest.mark.parametrize("kind", KINDS)
def test_arrays_of_other_libraries_have_the_same_values(kind):
    array = {
        "dask": lambda: dask.array.from_array(GREYS, chunks=(4, 10, 10)),
        "zarr": lambda: zarr.array(GREYS, chunks=(4, 10, 10)),
        "xarray": lambda: xr.DataArray(GREYS.transpose(2, 1, 0), dims=("x", "y", "z")),
        "xarray of dask": lambda: xr.DataArray(GREYS).chunk(10),
        "big-endian": lambda: GREYS.astype(">u2"),
        "half": lambda: GREYS.astype(np.float16),  # the kernels cannot compute in it
    }[kind]()
    made = pl.volume(array, voxel_um=2)
    assert made.dims == ("z", "y", "x")
    assert made.dtype.isnative
    assert made.dtype == {"big-endian": np.uint16, "half": np.float32}.get(kind, np.uint8)
    np.testing.assert_array_equal(made.isel(y=slice(3, 9, 2), x=4).values, GREYS[:, 3:9:2, 4])
    np.testing.assert_array_equal(made.values, GREYS)
    if kind in ("dask", "zarr"):
        assert made.encoding["chunks"] == (4, 10, 10)


class Counted:
    """An array that counts the voxels that were read of it."""

    shape, dtype, voxels = GREYS.shape, GREYS.dtype, 0

    def __getitem__(self, key):
        part = GREYS[key]
        self.voxels += part.size
        return part


def test_nothing_is_read_that_is_not_needed(tmp_path):
    counted = Counted()
    made = pl.volume(counted, voxel_um=2)
    assert (counted.voxels, made.isel(z=slice(2, 4)).values.shape) == (0, (2, 30, 40))
    assert counted.voxels == 2 * 30 * 40
    np.save(tmp_path / "v.npy", GREYS)
    mapped = pl.volume(np.load(tmp_path / "v.npy", mmap_mode="r"), voxel_um=2)
    assert isinstance(mapped.variable._data, np.memmap)
    assert mapped.attrs["file_name"] == "v.npy"


@pytest.mark.ci
def test_zarr_is_imported_only_for_arrays_of_zarr():
    code = (
        "import sys, numpy, planish; planish.volume(numpy.zeros((9, 9, 9)), voxel_um=1);"
        " print('zarr' in sys.modules)"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "False"


def placed(step=2.0, unit="um", count=12):
    coords = {"z": ("z", np.arange(count) * step, {"units": unit} if unit else {})}
    coords |= {
        axis: (axis, np.arange(n) * 2.0, {"units": "um"}) for axis, n in (("y", 30), ("x", 40))
    }
    return xr.DataArray(GREYS, dims=("z", "y", "x"), coords=coords)


def test_coordinates_in_um_are_the_size():
    made = pl.volume(placed())
    assert made.attrs["voxel_um"] == [2.0, 2.0, 2.0]
    assert pl.volume(placed().isel(x=slice(5, None))).x[0] == 10.0  # a part stays where it lies
    assert pl.volume(placed(step=3.0), voxel_um=2, override_size=True).z[1] == 2.0
    coarse = pl.volume(GREYS, voxel_um=2)[::2, ::2, ::2]
    with pytest.raises(
        SizeError, match=r"steps of 4, 4, 4 um .* voxel_um says 2, 2, 2\. .*voxel_um=\(4, 4, 4\)"
    ):
        pl.find_surfaces(coarse)
    assert pl.volume(coarse, voxel_um=(4.0, 4.0, 4.0)).attrs["voxel_um"] == [4.0, 4.0, 4.0]


@pytest.mark.parametrize(
    ("array", "size", "words"),
    [
        (
            placed(step=3.0),
            2,
            "voxel_um= gives z 2, y 2, x 2 um, but its coordinate grid states z 3, y 2, x 2 um",
        ),
        (placed(unit=None), None, "no voxel size along z.*coordinates without a unit"),
        (placed(unit="mm"), None, "The coordinates along z are in mm; needed are lengths in um"),
        (placed()[::-1], None, "The coordinates along z descend; needed are ascending ones"),
        (
            placed()[[0, 1, 2, 5, 6, 9]],
            None,
            "The coordinates along z are not regular: their steps are 2 to 6 um",
        ),
        (GREYS, None, r"The volume states no voxel size. Give it with voxel_um=SIZE"),
        (GREYS, "1.5", "voxel_um: '1.5' is not a size"),
    ],
)
def test_sizes_that_are_refused(array, size, words):
    refused(SizeError, words, pl.volume, array, voxel_um=size)


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (
            GREYS[0],
            r"has the axes \(z, y, x\), and an array of 30 x 40 with .* was given. Write pl.image",
        ),
        (GREYS[:1], "The volume is cut off"),
        (GREYS[:, :0], "The volume is cut off"),
        (GREYS.astype(complex), r"has complex128 values.*abs\(array\)"),
        (GREYS > 90, "has bool values.*grey values"),
        (GREYS.astype(object), "has object values"),
        (
            xr.DataArray(GREYS, dims=("plane", "row", "col")),
            r"\(plane, row, col\).*rename\(plane='z'",
        ),
        (
            xr.Dataset({"grey": (("z", "y", "x"), GREYS)}),
            r'a Dataset with grey was given. .*dataset\["NAME"\]',
        ),
        (np.ma.masked_less(GREYS, 5), "whose mask would be lost"),
        ("v.tif", r"a path \('v.tif'\) was given. Write pl.read_volume\('v.tif'\)"),
        (GREYS.tolist(), "a list was given"),
        (None, "None was given"),
    ],
)
def test_what_is_no_volume_is_refused(array, words):
    refused((InputError, VolumeError), words, pl.volume, array, voxel_um=2)


def test_what_is_no_image_is_refused():
    with pytest.raises(
        VolumeError, match=r"An image has the axes \(y, x\), and an array of 4 x 5 x 7"
    ):
        pl.image(np.zeros((4, 5, 7)), pixel_um=2)
    with pytest.raises(
        InputError, match="side='front' is not possible; needed is 'top' or 'bottom'"
    ):
        pl.image(IMAGE, pixel_um=2, side="front")
    refused(
        SizeError,
        r"The image states no pixel size. Give it with pixel_um=SIZE \(or Y,X\)",
        pl.image,
        IMAGE,
    )
    refused(
        InputError, "Choose luminance with channel=", pl.image, IMAGE, pixel_um=2, channel="red"
    )


def test_holes_follow_the_side_of_the_image():
    blank = np.full((200, 200), 200, np.uint8)
    image = pl.image(blank, pixel_um=5, side="bottom")
    assert pl.find_holes(image).attrs["seen_from"] == "bottom"
    assert pl.find_holes(image, side="top").attrs["seen_from"] == "top"
    assert pl.find_holes(pl.image(blank, pixel_um=5)).attrs["seen_from"] == "top"
