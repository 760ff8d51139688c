"""One small volume in every format, written by the format's own library: where contract and damage
start from."""

import gzip
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import mrcfile
import nibabel
import nrrd
import numpy as np
import scipy.io
import tifffile
import tomli_w
import zarr
from numpy.typing import NDArray
from PIL import Image

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of the wrapper that SimpleITK is made with
    import SimpleITK as sitk

Volume = NDArray[Any]
Size = tuple[float, float, float] | None  # z, y, x in um

VALUES = np.random.default_rng(11).integers(0, 60000, (12, 17, 19)).astype(np.uint16)
VOXEL = (3.0, 2.5, 2.0)
CUBE = (2.0, 2.0, 2.0)
NAME = "Blatt ä 7"  # neither ASCII nor without spaces
ZYX = "zyx"


@dataclass(frozen=True, kw_only=True)
class Case:
    """How a format is written, and what its reader promises.

    ``write(folder, values, size)`` returns what is given to the reader; without `size` no voxel
    size is written. ``cut`` and ``resize`` find the file to cut and make a declared size wrong.
    """

    write: Callable[[Path, Volume, Size], str | Path]
    source: str
    voxel: tuple[float, float, float] = VOXEL
    lazy: bool = True
    states_size: bool = True
    data: Callable[[Path], Path] = lambda folder: next(
        p for p in sorted(folder.rglob("*")) if p.is_file()
    )
    resize: Callable[[Path], None] | None = None
    dtype: str = "uint16"


def write_tiff(folder, values, size, **options):
    meta = {"axes": "ZYX"}
    if size is not None:
        meta |= {f"PhysicalSize{a.upper()}": v for a, v in zip(ZYX, size, strict=True)}
    path = folder / f"{NAME}.ome.tif"
    tifffile.imwrite(path, values, ome=True, metadata=meta, **options)
    return path


def write_imagej(folder, values, size, **options):
    path = folder / f"{NAME}.tif"
    meta = {"axes": "ZYX"}
    if size is None:
        tifffile.imwrite(path, values, imagej=True, metadata=meta, **options)
    else:
        meta |= {"unit": "um", "spacing": size[0]}
        tifffile.imwrite(
            path,
            values,
            imagej=True,
            metadata=meta,
            resolution=(1 / size[2], 1 / size[1]),
            **options,
        )
    return path


def write_pages(folder, values, size):
    path = folder / f"{NAME}.btf"
    with tifffile.TiffWriter(path, bigtiff=True, byteorder=">") as tif:
        for page in values:
            tif.write(page, contiguous=False, metadata=None, rowsperstrip=5)
    del size
    return path


def write_slices(folder, values, size, suffix, **options):
    del size
    place = folder / NAME
    place.mkdir()
    for k, page in enumerate(values):
        path = place / f"{NAME}_{k:04d}{suffix}"
        if suffix == ".tif":
            tifffile.imwrite(path, page, photometric="minisblack", **options)
        else:
            Image.fromarray(page).save(path)
    return place


def write_nrecon(folder, values, size):
    place = folder / NAME
    place.mkdir()
    for k, page in enumerate(values):
        Image.fromarray(page).save(place / f"Núria_rec{k + 20:08d}.png")
    Image.fromarray(values[0] // 2).save(place / "Núria_rec_spr.png")  # NRecon's own preview
    pixel = "" if size is None else f"Pixel Size (um)={size[0]:.5f}\n"
    log = (
        "[System]\nScanner=Skyscan1172\nCamera Pixel Size (um)=11.32\n[Acquisition]\nFilename"
        " Prefix=Núria\nImage Pixel Size (um)=2.01\nSource Voltage"
        f" (kV)=40\n[Reconstruction]\nFirst Section=20\nLast Section={19 + len(values)}\nSections"
        f" Count={len(values)}\nSection to Section Step=1\n{pixel}Result Image Width"
        f" (pixels)={values.shape[2]}\nResult Image Height (pixels)={values.shape[1]}\nMinimum for"
        " CS to Image Conversion=-0.01\nMaximum for CS to Image Conversion=0.15\n[File name"
        " convention]\nFilename Index Length=8\nFilename Prefix=Núria_rec\n"
    )
    (place / "Núria_rec.log").write_bytes(log.encode("cp1252"))
    return place


def multiscales(size, *, lead=0):
    unit = {} if size is None else {"unit": "micrometer"}
    axes = [{"name": n, "type": t} for n, t in (("t", "time"), ("c", "channel"))][:lead]
    axes += [{"name": n, "type": "space", **unit} for n in ZYX]
    scale = [1.0] * lead + [1.0, 1.0, 1.0] if size is None else [1.0] * lead + list(size)
    transform = [{"type": "scale", "scale": scale}]
    half = [{"type": "scale", "scale": [1.0] * lead + [2 * v for v in scale[lead:]]}]
    datasets = [
        {"path": "0", "coordinateTransformations": transform},
        {"path": "1", "coordinateTransformations": half},
    ]
    return [{"axes": axes, "datasets": datasets, "version": "0.4"}]


def write_zarr(folder, values, size, version):
    path = folder / f"{NAME}.ome.zarr"
    group = zarr.open_group(str(path), mode="w", zarr_format=version)
    lead = 2 if version == 2 else 0
    for name, level in (("0", values), ("1", values[::2, ::2, ::2])):
        shape = (1,) * lead + level.shape
        chunks = (1,) * lead + (4, 8, 8)
        options = {"shards": (8, 16, 16)} if version == 3 else {}
        array = group.create_array(
            name, shape=shape, chunks=chunks, dtype=level.dtype, fill_value=0, **options
        )
        array[...] = level.reshape(shape)
    told = multiscales(size, lead=lead)
    group.attrs.update(
        {"multiscales": told} if version == 2 else {"ome": {"version": "0.5", "multiscales": told}}
    )
    return path


def write_nrrd(folder, values, size, kind, packing):
    path = folder / f"{NAME}{kind}"
    header = {"encoding": packing}
    if size is not None and kind == ".nhdr":
        header |= {
            "space directions": np.diag(size[::-1]) / 1000,
            "space units": ["mm"] * 3,
            "space dimension": 3,
        }
    elif size is not None:
        header |= {"spacings": list(size[::-1]), "units": ["um"] * 3}
    if kind == ".nrrd":
        nrrd.write(str(path), values, header, index_order="C")
        return path
    nrrd.write(str(folder / "a.nhdr"), values, header, index_order="C", detached_header=True)
    # pynrrd writes ASCII only; other programs write names as they are.
    path.write_bytes((folder / "a.nhdr").read_bytes().replace(b"a.raw", f"{NAME}.raw".encode()))
    (folder / "a.nhdr").unlink()
    (folder / "a.raw").rename(folder / f"{NAME}.raw")
    return path


def write_meta(folder, values, size, kind, packed):
    image = sitk.GetImageFromArray(values)
    image.SetSpacing([v / 1000 for v in (size or CUBE)[::-1]])
    path = folder / f"{NAME}{kind}"
    sitk.WriteImage(image, str(path), packed)
    if size is None:
        lines = path.read_bytes().split(b"\n")
        path.write_bytes(
            b"\n".join(line for line in lines if not line.startswith(b"ElementSpacing"))
        )
    return path


def write_hdf5(folder, values, size):
    path = folder / f"{NAME}.h5"
    with h5py.File(path, "w") as file:
        data = file.create_dataset(
            "entry/Größe/volume", data=values, chunks=(4, 8, 8), compression="gzip"
        )
        file.create_dataset("entry/other", data=values[:, :4])
        if size is not None:
            data.attrs["voxel_size"] = [v / 1000 for v in size]
            data.attrs["units"] = "mm"
    return f"{path}:/entry/Größe/volume"


def write_nexus(folder, values, size):
    path = folder / f"{NAME}.nxs"
    with h5py.File(path, "w") as file:
        file.attrs["default"] = "entry"
        entry = file.create_group("entry")
        entry.attrs.update({"NX_class": "NXentry", "default": "data"})
        entry["definition"] = "NXtomoproc"
        data = entry.create_group("data")
        data.attrs.update({"NX_class": "NXdata", "signal": "density", "axes": ["x", "y", "z"]})
        data["density"] = values.transpose(2, 1, 0)  # the axes say which is which
        data["errors"] = values
        for name, step, n in zip(ZYX, size or CUBE, values.shape, strict=True):
            data[name] = np.arange(n) * step * 1e-6
            if size is not None:
                data[name].attrs["units"] = "m"
    return path


def write_mat(folder, values, size, packed):
    path = folder / f"{NAME}.mat"
    content = {"V": np.moveaxis(values, 0, -1), "note": "V(row, column, slice)"}
    if size is not None:
        content["voxel_um"] = list(size)
    scipy.io.savemat(path, content, do_compression=packed)
    return path


def write_mat73(folder, values, size):
    path = folder / f"{NAME}.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        # MATLAB writes its columns first, so that HDF5 sees the axes in reverse.
        data = file.create_dataset(
            "V", data=np.moveaxis(values, 0, -1).T, chunks=(4, 8, 8), compression="gzip"
        )
        data.attrs["MATLAB_class"] = np.bytes_("uint16")
        if size is not None:
            file["voxel_um"] = np.array([size]).T
            file["voxel_um"].attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    with path.open("r+b") as file:
        file.write(head)
    return path


def write_raw(folder, values, size):
    path = folder / f"{NAME}.raw"
    path.write_bytes(b"head" + values.astype(">u2").tobytes())
    keys = {"shape": list(values.shape), "dtype": "uint16", "byte_order": "big", "offset": 4}
    if size is not None:
        keys["voxel_um"] = list(size)
    (folder / f"{NAME}.raw.toml").write_text(tomli_w.dumps(keys), encoding="utf-8")
    return path


def write_nifti(folder, values, size, kind):
    image = nibabel.Nifti1Image(values.T, np.diag([*(size or CUBE)[::-1], 1.0]))
    if size is not None:
        image.header.set_xyzt_units("micron")
    nibabel.save(image, folder / f"{NAME}{kind}")
    return folder / f"{NAME}{kind}"


def write_mrc(folder, values, size, kind):
    path = folder / f"{NAME}{kind}"
    compression = {".gz": "gzip", ".bz2": "bzip2"}.get(path.suffix)
    with mrcfile.new(path, compression=compression) as file:
        file.set_data(values)
        if size is not None:
            file.voxel_size = tuple(1e4 * v for v in size[::-1])
    return path


def resize_at(name, at):
    """Let one byte of a header, in a gzip or not, declare two more slices."""

    def change(folder):
        path = next(folder.rglob(name))
        packed = path.suffix == ".gz"
        data = bytearray(gzip.decompress(path.read_bytes()) if packed else path.read_bytes())
        data[at] += 2
        path.write_bytes(gzip.compress(bytes(data)) if packed else bytes(data))

    return change


def swap(name, old, new):
    """Replace bytes in the file with this name, which has to hold them."""

    def change(folder):
        path = next(folder.rglob(name))
        data = path.read_bytes()
        assert old in data
        path.write_bytes(data.replace(old, new))

    return change


def named(pattern):
    return lambda folder: sorted(folder.rglob(pattern))[len(list(folder.rglob(pattern))) // 2]


def remove(pattern):
    return lambda folder: named(pattern)(folder).unlink()


def reshape_hdf5(folder):
    with h5py.File(next(p for p in folder.iterdir()), "r+") as file:
        names = []
        file.visititems(
            lambda name, item: names.append(name) if getattr(item, "ndim", 0) == 3 else None
        )
        for name in names:
            old = file[name]
            attrs, shape = dict(old.attrs), (old.shape[0] * 3, *old.shape[1:])
            del file[name]
            new = file.create_dataset(name, shape=shape, dtype=old.dtype, chunks=(4, 4, 8))
            new[:4] = 1
            new.attrs.update(attrs)


def with_values(values):
    return (values >> 8).astype(np.uint8)


def slices(suffix, dtype="uint16", **options):
    """A folder of images, which says nothing of the size of its voxels."""
    write, data = partial(write_slices, suffix=suffix, **options), named(f"*{suffix}")
    return Case(
        write=write,
        source="given",
        states_size=False,
        data=data,
        resize=remove(f"*{suffix}"),
        dtype=dtype,
    )


def nrrd_case(kind, packing, sections, **more):
    """NRRD, whose header can be made to state another number of sections than its 12."""
    resize = swap(f"*{kind}", b"sizes: 19 17 12", b"sizes: 19 17 " + sections)
    return Case(write=partial(write_nrrd, kind=kind, packing=packing), resize=resize, **more)


def meta_case(kind, *, packed=False, **more):
    """MetaImage, whose header can be made to state 21 sections in place of its 12."""
    resize = swap(f"*{kind}", b"DimSize = 19 17 12", b"DimSize = 19 17 21")
    return Case(
        write=partial(write_meta, kind=kind, packed=packed),
        source="MetaImage",
        resize=resize,
        **more,
    )


MORE_OF_OME = swap("*.tif", b'SizeZ="12"', b'SizeZ="19"')
CASES = {
    "OME-TIFF": Case(write=write_tiff, source="OME", lazy=False, resize=MORE_OF_OME),
    "OME-TIFF deflate": Case(
        write=partial(write_tiff, compression="zlib"), source="OME", resize=MORE_OF_OME
    ),
    "ImageJ TIFF": Case(
        write=write_imagej,
        source="ImageJ",
        lazy=False,
        resize=swap("*.tif", b"images=12", b"images=19"),
    ),
    "BigTIFF pages": Case(write=write_pages, source="given", states_size=False),
    "TIFF slices": slices(".tif"),
    "TIFF deflate slices": slices(".tif", compression="zlib"),
    "PNG slices": slices(".png"),
    "BMP slices": slices(".bmp", dtype="uint8"),
    "NRecon": Case(
        write=write_nrecon,
        source="NRecon log",
        voxel=CUBE,
        data=named("*_rec0*.png"),
        resize=swap("*.log", b"Last Section=31", b"Last Section=39"),
    ),
    "OME-Zarr 0.4": Case(
        write=partial(write_zarr, version=2),
        source="OME-Zarr",
        data=named("0.0.2.1.1"),
        resize=lambda f: swap(".zarray", b"12,", b"52,")(f / f"{NAME}.ome.zarr" / "0"),
    ),
    "OME-Zarr 0.5": Case(
        write=partial(write_zarr, version=3),
        source="OME-Zarr",
        data=lambda f: next(
            p for p in (f / f"{NAME}.ome.zarr" / "0" / "c").rglob("1") if p.is_file()
        ),
        resize=lambda f: swap("zarr.json", b"12,", b"52,")(f / f"{NAME}.ome.zarr" / "0"),
    ),
    "NRRD": nrrd_case(".nrrd", "raw", b"21", source="NRRD spacings", lazy=False),
    "NRRD gzip": nrrd_case(".nrrd", "gzip", b"11", source="NRRD spacings", lazy=False),
    "NRRD detached": nrrd_case(
        ".nhdr", "raw", b"21", source="NRRD space directions", lazy=False, data=named("*.raw")
    ),
    "MetaImage": meta_case(".mha", lazy=False),
    "MetaImage packed": meta_case(".mha", packed=True),
    "MetaImage detached": meta_case(".mhd", lazy=False, data=named("*.raw")),
    "HDF5": Case(write=write_hdf5, source="attribute voxel_size", resize=reshape_hdf5),
    "NeXus": Case(write=write_nexus, source="spacing of its coordinates", resize=reshape_hdf5),
    "MATLAB 5": Case(write=partial(write_mat, packed=False), source="voxel_um", lazy=False),
    "MATLAB 7": Case(write=partial(write_mat, packed=True), source="voxel_um", lazy=False),
    "MATLAB 7.3": Case(write=write_mat73, source="voxel_um", resize=reshape_hdf5),
    "NIfTI": Case(
        write=partial(write_nifti, kind=".nii"),
        source="NIfTI pixdim",
        lazy=False,
        resize=resize_at("*.nii", 46),
    ),
    "NIfTI gzip": Case(
        write=partial(write_nifti, kind=".nii.gz"),
        source="NIfTI pixdim",
        lazy=False,
        resize=resize_at("*.nii.gz", 46),
    ),
    "MRC": Case(
        write=partial(write_mrc, kind=".mrc"),
        source="MRC cell",
        lazy=False,
        resize=resize_at("*.mrc", 8),
    ),
    "MRC gzip": Case(
        write=partial(write_mrc, kind=".mrc.gz"),
        source="MRC cell",
        lazy=False,
        resize=resize_at("*.mrc.gz", 8),
    ),
    "MRC bzip2": Case(write=partial(write_mrc, kind=".mrc.bz2"), source="MRC cell", lazy=False),
    "raw": Case(
        write=write_raw, source="TOML", data=named("*.raw"), resize=swap("*.toml", b"12,", b"13,")
    ),
}
