"""A specimen as instrument files of the field, with the truth apart from them."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Literal

import numpy as np
import tifffile
import xarray as xr

from planish.core.files import write_text
from planish.core.typing import Entries, Floats, Texts
from planish.synthetic.specimen import InstrumentFiles, Specimen

Instrument = Literal["stack", "scanner", "sections"]
COUNTER = "sections.csv"
_PREFIX = "sheet_rec"
_NODES_UM = 10.0


def write_instruments(
    specimen: Specimen, folder: Path, *, volume: Instrument = "stack", image: bool = True
) -> InstrumentFiles:
    """Write the files of an instrument for volumes, and an image: ``image.tif``.

    Parameters
    ----------
    specimen : Specimen
    folder : Path; made where it is missing
    volume : {"stack", "scanner", "sections"}
        ``volume.tif`` with ImageJ's calibration; slices and a log as NRecon writes them, across the
        axis of rotation, so their rows run through the sheet; photographs with the microtome's
        counter.
    image : bool; whether an image is written

    Returns
    -------
    InstrumentFiles
    """
    folder.mkdir(parents=True, exist_ok=True)
    writers = {"stack": _write_stack, "scanner": _write_scan, "sections": _write_sections}
    files = writers[volume](specimen, folder)
    if not image:
        return files
    return replace(files, image=write_image(specimen, folder / "image.tif"))


def _write_stack(specimen: Specimen, folder: Path) -> InstrumentFiles:
    voxel = specimen.params.scanner.voxel_um
    path = folder / "volume.tif"
    size = (1 / voxel, 1 / voxel)
    metadata = {"spacing": voxel, "unit": "um", "axes": "ZYX"}
    values = specimen.volume.values
    tifffile.imwrite(path, values, imagej=True, resolution=size, metadata=metadata)

    def to_physical(points: Floats, _sections: xr.Dataset | None = None) -> Floats:
        """Return the points (n, 3): those of the stack are (x, y, z) in um, as in space."""
        return points

    return InstrumentFiles(volume=path, through="z", to_physical=to_physical)


def _write_scan(specimen: Specimen, folder: Path) -> InstrumentFiles:
    """Write slices across the axis of rotation, with a log as of NRecon.

    A slice has x along its columns and z along its rows; points of the file are (column, row,
    slice) in um, and slices count against y.
    """
    scanner = specimen.scanner
    voxel = specimen.params.scanner.voxel_um
    scan_folder = folder / "scan"
    scan_folder.mkdir()
    rows = scanner.shape[1]
    for start, tile in scanner.tiles():
        for k, row in enumerate(tile):
            # Slices count down along y: so the sheet keeps its hand with its normal along the rows.
            name = f"{_PREFIX}{rows - 1 - start - k:08d}.tif"
            tifffile.imwrite(scan_folder / name, np.ascontiguousarray(row.T))
    log_path = scan_folder / f"{_PREFIX.removesuffix('_rec')}_rec.log"
    write_text(log_path, _rec_log(specimen))
    last_um = (rows - 1) * voxel

    def to_physical(points: Floats, _sections: xr.Dataset | None = None) -> Floats:
        """Take points (n, 3) of the file, (x, z, slice) in um, to (x, y, z) in space."""
        x, z, slice_um = points.T
        return np.stack([x, last_um - slice_um, z], axis=1)

    return InstrumentFiles(volume=scan_folder, through="y", to_physical=to_physical)


def _rec_log(specimen: Specimen) -> str:
    p = specimen.params.scanner
    depth, rows, width = specimen.scanner.shape
    sections = {
        "System": {"Scanner": "synthetic", "Camera Pixel Size (um)": "7.4"},
        "Acquisition": {
            "Filename Prefix": _PREFIX.removesuffix("_rec"),
            # Before the fine tuning of the reconstruction.
            "Image Pixel Size (um)": f"{p.voxel_um * 1.0006:.6f}",
        },
        "Reconstruction": {
            "Reconstruction Program": "NRecon",
            "Program Version": "Version: synthetic",
            "First Section": "0",
            "Last Section": str(rows - 1),
            "Section to Section Step": "1",
            "Sections Count": str(rows),
            "Result File Type": "TIF",
            "Result File Header Length (bytes)": "Variable",
            "Result Image Width (pixels)": str(width),
            "Result Image Height (pixels)": str(depth),
            "Pixel Size (um)": f"{p.voxel_um:.6f}",
            "Reconstruction from ROI": "OFF",
            "Undersampling factor": "1",
            "Minimum for CS to Image Conversion": "0.000000",
            "Maximum for CS to Image Conversion": "0.100000",
            "HU Calibration": "OFF",
        },
        "File name convention": {"Filename Index Length": "8", "Filename Prefix": _PREFIX},
    }
    lines: list[str] = []
    for name, settings in sections.items():
        lines.append(f"[{name}]")
        lines += [f"{key}={value}" for key, value in settings.items()]
    return "\n".join(lines) + "\n"


def _write_sections(specimen: Specimen, folder: Path) -> InstrumentFiles:
    """Write photographs of the block's face, and the counter of the microtome.

    The counter goes along the cut, from the block's end at large y; points of the file are (column,
    row, position of the section) in um.
    """
    p = specimen.params.sections
    poses = specimen.poses
    microtome = specimen.microtome
    photo_folder = folder / "sections"
    photo_folder.mkdir()
    lines = ["# kind: block-face", "file,position_um"]
    for k, picture in enumerate(microtome.pictures()):
        name = f"section_{int(poses.index[k]):05d}.tif"
        tifffile.imwrite(photo_folder / name, picture, **_per_cm(p.pixel_um))
        lines.append(f"{name},{poses.counter_um[k]:.3f}")
    write_text(photo_folder / COUNTER, "\n".join(lines) + "\n")
    middle = 0.5 * (np.array(microtome.shape[::-1]) - 1) * p.pixel_um

    def to_physical(points: Floats, sections: xr.Dataset | None = None) -> Floats:
        """Undo what the run took off each section, then put on what was truly there.

        ``points`` (n, 3): column, row and position in um, as the run gives them; returned are x, y,
        z in space. Without ``sections`` nothing was taken off, and positions are those of the
        counter; with them, positions begin at ``first_position_um``. Shifts (um) and turns (rad)
        between sections are read off by straight lines; turns are small, about the picture's
        middle.
        """
        x, z, position = points.T
        if sections is not None:
            aligned: list[Floats] = []
            for name in ("shift_row", "shift_col", "rotation"):
                of_sections = (sections["position"].values, sections[name].values)
                aligned.append(np.interp(position, *of_sections))
            shift_row, shift_col, rotation = aligned
            dx = x - middle[0]
            dz = z - middle[1]
            x = x + shift_col - rotation * dz
            z = z + shift_row + rotation * dx
            position = position + float(sections.attrs["first_position_um"])
        true_poses = (poses.shift_x_um, poses.shift_z_um, poses.turn_rad, poses.y_um)
        shift_x, shift_z, turn, true_y = (
            np.interp(position, poses.counter_um, values) for values in true_poses
        )
        true_x = x + shift_x - turn * (z - middle[1])
        true_z = z + shift_z + turn * (x - middle[0])
        return np.stack([true_x, true_y, true_z], axis=1)

    return InstrumentFiles(volume=photo_folder, through="y", to_physical=to_physical)


def write_image(specimen: Specimen, path: Path, *, printed: bool = False) -> Path:
    """Write the image with 16 bit and its pixel size.

    Parameters
    ----------
    specimen : Specimen
    path : Path; a name that ends in ``.ome.tif`` makes it OME-TIFF
    printed : bool; whether the sheet carries a print

    Returns
    -------
    Path; the one given
    """
    reflectance = (specimen.printed if printed else specimen.image).values
    rounded = np.rint(reflectance * 65535)
    grey = np.clip(rounded, 0, 65535).astype(np.uint16)
    pixel = specimen.params.camera.pixel_um
    size = _per_cm(pixel)
    if path.name.endswith(".ome.tif"):
        metadata: Entries = {"axes": "YX"}
        for axis in "XY":
            metadata |= {f"PhysicalSize{axis}": pixel, f"PhysicalSize{axis}Unit": "µm"}
        size |= {"ome": True, "metadata": metadata}
    tifffile.imwrite(path, grey, **size)
    return path


def _per_cm(pixel_um: float) -> Entries:
    return {"resolution": (1e4 / pixel_um, 1e4 / pixel_um), "resolutionunit": "CENTIMETER"}


def write_flatbed(specimen: Specimen, path: Path) -> Path:
    """Write the scan of the office scanner as TIFF with its dpi and a name that says so.

    Parameters
    ----------
    specimen : Specimen
    path : Path

    Returns
    -------
    Path; the one given
    """
    dpi = specimen.params.flatbed.dpi
    values = specimen.flatbed.values
    photometric = "rgb" if values.ndim == 3 else "minisblack"
    tifffile.imwrite(
        path,
        values,
        photometric=photometric,
        resolution=(dpi, dpi),
        resolutionunit="INCH",
        software="planish flatbed scanner",
    )
    return path


def write_nodes(specimen: Specimen, path: Path) -> None:
    """Write nodes of the centre surface, for a sheet too large for voxels.

    Parameters
    ----------
    specimen : Specimen
    path : Path
        Of the ``.npz`` file: ``points`` (rows, cols, 3), ``u, v`` and ``coating_top``, in um.
    """
    x, y, _ = specimen.extent_um
    y_um = np.arange(0.0, y, _NODES_UM)
    x_um = np.arange(0.0, x, _NODES_UM)
    u, v, _ = np.moveaxis(specimen.warp.columns(y_um, x_um), -1, 0)
    top, inner_top = (specimen.sheet.at(face, u, v) for face in specimen.sheet.faces[:2])
    coating = (top - inner_top).astype(np.float32)
    points = specimen.warp.points(u, v)
    np.savez_compressed(path, points=points, u=u, v=v, coating_top=coating)


def write_truth(specimen: Specimen, folder: Path) -> None:
    """Write all that is true: maps on the image's pixels, holes, poses and parameters.

    Parameters
    ----------
    specimen : Specimen
    folder : Path; it is made. Maps are written as float TIFF, in um.
    """
    folder.mkdir(parents=True)
    pixel = specimen.params.camera.pixel_um
    form: Entries = {"imagej": True, "resolution": (1 / pixel, 1 / pixel)}
    metadata = {"unit": "um", "axes": "YX"}
    for name, field in specimen.truth.data_vars.items():
        values = field.values.astype(np.float32)
        tifffile.imwrite(folder / f"{name}.tif", values, **form, metadata=metadata)
    holes = specimen.sheet.holes
    image_xy = specimen.pose(holes)
    volume_xyz = specimen.warp.points(holes[:, 0], holes[:, 1])
    names = ("u_um", "v_um", "image_x_um", "image_y_um", "x_um", "y_um", "z_um")
    rows = np.concatenate([holes, image_xy, volume_xyz], axis=1)
    _table(folder / "holes.csv", names, rows)
    poses = specimen.poses
    names = ("counter_um", "y_um", "shift_x_um", "shift_z_um", "turn_rad")
    of_sections = [getattr(poses, name) for name in names]
    _table(folder / "sections.csv", names, np.stack(of_sections, axis=1))
    data: Entries = {"parameters": asdict(specimen.params)}
    data["warp"] = asdict(specimen.warp)
    data["camera"] = asdict(specimen.pose)
    write_text(folder / "parameters.json", json.dumps(data, indent=2) + "\n")


def _table(path: Path, names: Texts, rows: Floats) -> None:
    np.savetxt(path, rows, "%.6f", ",", header=",".join(names), comments="")
