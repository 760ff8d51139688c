"""One specimen seen by two instruments: a volume, an image, and the truth for every pixel and column."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tifffile
import xarray as xr
from numpy.typing import NDArray

from planish.core.transform import Similarity
from planish.synthetic.render import image_material, photograph, scan
from planish.synthetic.sheet import Sheet, SheetParams, make_sheet
from planish.synthetic.warp import Warp

Array = NDArray[np.float64]

_MARGIN_UM = 60.0  # air above and below the sheet
_HOLE_BORDER_UM = 260.0
_HOLE_DISTANCE_UM = 550.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SpecimenParams:
    """What is made; the defaults are the acceptance specimen.

    Attributes
    ----------
    size_um : (float, float)
        Lateral extent (x, y) of the volume.
    voxel_um, blur_um, noise : float
        Of the scan; ``noise`` is a share of the coating-air contrast.
    grey : (float, float, float)
        Levels of air, base and coating, in units of ``dtype``.
    pixel_um : float
        Of the image.
    rotation_deg, scale : float
        Pose of the camera; ``scale`` is its calibration error.
    holes : int
        Number of laser holes.
    nuisance_sd : float
        Reflectance of the base that does not come from the coating.
    """

    size_um: tuple[float, float] = (3000.0, 2000.0)
    voxel_um: float = 3.0
    blur_um: float = 2.5
    noise: float = 0.04
    grey: tuple[float, float, float] = (40.0, 90.0, 200.0)
    dtype: type = np.uint8
    pixel_um: float = 4.0
    rotation_deg: float = 14.0
    scale: float = 1.006
    holes: int = 8
    nuisance_sd: float = 0.012
    warp: Warp = field(default_factory=Warp)
    sheet: SheetParams = field(default_factory=SheetParams)
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Specimen:
    """A volume (z, y, x), an image (y, x), and what is true of them.

    Attributes
    ----------
    truth : Dataset, dims (y, x) of the image
        ``u, v`` material coordinates; ``volume_x, volume_y, volume_z`` of the centre surface; ``coating_top``,
        ``coating_bottom``, ``base_thickness``, ``thickness``; ``rim``: distance to the nearest hole's rim; all in um.
    columns : Dataset, dims (y, x) of the volume
        ``u, v, centre`` of the centre surface at each column, in um.
    pose : Similarity
        From (u, v) to the image.
    """

    params: SpecimenParams
    volume: NDArray[np.generic]
    image: NDArray[np.float32]
    warp: Warp
    sheet: Sheet
    pose: Similarity
    truth: xr.Dataset
    columns: xr.Dataset


def make_specimen(params: SpecimenParams, *, threads: int = 2) -> Specimen:
    """Make the specimen of ``params.seed``; the same parameters give the same bytes on any number of threads."""
    for_holes, for_sheet, for_scan, for_camera = np.random.SeedSequence(params.seed).spawn(4)
    p = params
    # Put the sheet's own origin in the middle of the volume and find which material the volume shows.
    middle = (p.size_um[0] / 2, p.size_um[1] / 2)
    warp = _moved(p.warp, (*middle, 0.0))
    corners_y, corners_x = np.linspace(0, p.size_um[1], 41), np.linspace(0, p.size_um[0], 61)
    under = warp.columns(corners_y, corners_x)
    thickness = p.sheet.base_um + p.sheet.coating_top_um + p.sheet.coating_bottom_um
    reach = (0.5 * thickness + 20.0) * np.hypot(1.0, p.warp.slope) + _MARGIN_UM
    low_z, high_z = under[..., 2].min() - reach, under[..., 2].max() + reach
    warp = _moved(p.warp, (*middle, -float(low_z)))
    shape = (
        int(np.ceil((high_z - low_z) / p.voxel_um)) + 1,
        round(p.size_um[1] / p.voxel_um),
        round(p.size_um[0] / p.voxel_um),
    )
    spread = np.array([under[..., 0].min(), under[..., 1].min(), under[..., 0].max(), under[..., 1].max()])
    image_shape, pose = _camera(p, spread)
    corners = pose.inverse(
        np.array([[x, y] for x in (0, image_shape[1] * p.pixel_um) for y in (0, image_shape[0] * p.pixel_um)])
    )
    low = np.minimum(spread[:2], corners.min(axis=0)) - 150.0
    high = np.maximum(spread[2:], corners.max(axis=0)) + 150.0
    holes = _hole_pattern(p, warp, np.random.default_rng(for_holes))
    sheet = make_sheet(
        p.sheet,
        low=(float(low[0]), float(low[1])),
        high=(float(high[0]), float(high[1])),
        holes=holes,
        rng=np.random.default_rng(for_sheet),
    )
    volume = scan(
        sheet, warp, shape=shape, voxel_um=p.voxel_um, blur_um=p.blur_um, noise=p.noise, grey=p.grey,
        dtype=p.dtype, seed=for_scan, threads=threads,
    )  # fmt: skip
    image = photograph(
        sheet, pose, shape=image_shape, pixel_um=p.pixel_um, nuisance_sd=p.nuisance_sd,
        rng=np.random.default_rng(for_camera),
    )  # fmt: skip
    return Specimen(
        params=p,
        volume=volume,
        image=image,
        warp=warp,
        sheet=sheet,
        pose=pose,
        truth=_truth(sheet, warp, pose, image_shape, p.pixel_um),
        columns=_columns(warp, shape, p.voxel_um),
    )


def write_specimen(specimen: Specimen, folder: Path) -> tuple[Path, Path]:
    """Write ``volume.tif`` (ImageJ calibration) and ``image.tif`` (16 bit, pixels per cm); return both paths."""
    folder.mkdir(parents=True, exist_ok=True)
    volume, image = folder / "volume.tif", folder / "image.tif"
    p = specimen.params
    tifffile.imwrite(
        volume,
        specimen.volume,
        imagej=True,
        resolution=(1 / p.voxel_um, 1 / p.voxel_um),
        metadata={"spacing": p.voxel_um, "unit": "um", "axes": "ZYX"},
    )
    grey = np.clip(np.rint(specimen.image * 65535), 0, 65535).astype(np.uint16)
    per_cm = 1e4 / p.pixel_um
    tifffile.imwrite(image, grey, resolution=(per_cm, per_cm), resolutionunit="CENTIMETER")
    return volume, image


def _moved(warp: Warp, shift_um: tuple[float, float, float]) -> Warp:
    return replace(warp, shift_um=shift_um)


def _camera(p: SpecimenParams, spread: Array) -> tuple[tuple[int, int], Similarity]:
    """Frame the camera so that it sees about what the volume holds, turned and a little beside it."""
    width, height = spread[2] - spread[0], spread[3] - spread[1]
    shape = (int(1.12 * height / p.pixel_um), int(1.04 * width / p.pixel_um))
    turn = Similarity(scale=p.scale, rotation_rad=float(np.deg2rad(p.rotation_deg)))
    middle = 0.5 * np.array([shape[1] * p.pixel_um, shape[0] * p.pixel_um])
    shift = middle - turn(0.5 * (spread[:2] + spread[2:]) + np.array([15.0, -20.0]))
    pose = Similarity(scale=turn.scale, rotation_rad=turn.rotation_rad, shift_um=(float(shift[0]), float(shift[1])))
    return shape, pose


def _hole_pattern(p: SpecimenParams, warp: Warp, rng: np.random.Generator) -> Array:
    """Draw irregular positions, at a distance from the volume's border and from each other, as (u, v)."""
    found: list[Array] = []
    field = (p.size_um[0] - 2 * _HOLE_BORDER_UM) * (p.size_um[1] - 2 * _HOLE_BORDER_UM)
    apart = min(_HOLE_DISTANCE_UM, 0.7 * float(np.sqrt(max(field, 0.0) / max(p.holes, 1))))
    for _ in range(20_000):
        if len(found) == p.holes:
            break
        border = _HOLE_BORDER_UM
        xy = rng.uniform([border, border], [p.size_um[0] - border, p.size_um[1] - border])
        if all(np.hypot(*(xy - other)) > apart for other in found):
            found.append(xy)
    assert len(found) == p.holes, "the field is too small for so many holes"
    return np.array([warp.columns(xy[1:], xy[:1])[0, 0, :2] for xy in found]).reshape(-1, 2)


def _truth(sheet: Sheet, warp: Warp, pose: Similarity, shape: tuple[int, int], pixel_um: float) -> xr.Dataset:
    u, v = image_material(pose, shape, pixel_um)
    points = warp.points(u, v)
    top, inner_top, inner_bottom, bottom = (sheet.at(face, u, v) for face in sheet.faces)
    values = {
        "u": u,
        "v": v,
        "volume_x": points[..., 0],
        "volume_y": points[..., 1],
        "volume_z": points[..., 2],
        "coating_top": top - inner_top,
        "coating_bottom": inner_bottom - bottom,
        "base_thickness": inner_top - inner_bottom,
        "thickness": top - bottom,
        "rim": sheet.at(sheet.rim_um, u, v),
    }
    coords = {"y": np.arange(shape[0]) * pixel_um, "x": np.arange(shape[1]) * pixel_um}
    return xr.Dataset({k: (("y", "x"), value, {"units": "um"}) for k, value in values.items()}, coords=coords)


def _columns(warp: Warp, shape: tuple[int, int, int], voxel_um: float) -> xr.Dataset:
    y = np.arange(shape[1], dtype=np.float64) * voxel_um
    x = np.arange(shape[2], dtype=np.float64) * voxel_um
    under = warp.columns(y, x)
    names = {"u": 0, "v": 1, "centre": 2}
    return xr.Dataset(
        {k: (("y", "x"), under[..., i], {"units": "um"}) for k, i in names.items()}, coords={"y": y, "x": x}
    )
