"""One specimen under several instruments, with the truth for every pixel and column."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr

from planish.core.labelled import labelled
from planish.core.typing import Array, Floats, Shape2D, Texts
from planish.synthetic.camera import image_material, photograph
from planish.synthetic.flatbed import FlatbedScan, scan_flatbed
from planish.synthetic.instruments import Microtome, Poses, Scanner, draw_poses
from planish.synthetic.params import SpecimenParams, Warp, stream
from planish.synthetic.pose import CameraPose
from planish.synthetic.sheet import PITCH_UM, DrawnSheet


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentFiles:
    """Paths of the files, and the pose of their axes in space."""

    volume: Path
    through: Literal["z", "y"]  #: axis of the file that runs through the sheet
    #: From points (n, 3) of the file (column, row, slice) in um to points (x, y, z) in space. A
    #: second argument holds what a run found out about the sections: ``position``, ``shift_row``,
    #: ``shift_col`` in um, ``rotation``.
    to_physical: Callable[..., Floats]
    image: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """A sheet in space and the poses of its instruments.

    Pictures are rendered when they are asked for.
    """

    params: SpecimenParams
    warp: Warp  #: from material (u, v, s) to space (x, y, z); the volume begins at the origin
    sheet: DrawnSheet
    pose: CameraPose  #: from (u, v) to the image
    extent_um: tuple[float, float, float]  #: of the volume along x, y, z
    image_shape: Shape2D
    #: where the files of its instruments are, if they were written.
    files: InstrumentFiles | None = None

    def __repr__(self) -> str:
        """Sizes of sheet, volume and image."""
        x, y, _ = self.extent_um
        p = self.params
        shape = " x ".join(map(str, self.scanner.shape))
        pixels = " x ".join(map(str, self.image_shape))
        return (
            f"Specimen({x / 1000:g} x {y / 1000:g} mm, seed {p.seed}; volume of {shape} voxels (z,"
            f" y, x) of {p.scanner.voxel_um:g} um; image of {pixels} pixels of"
            f" {p.camera.pixel_um:g} um; {len(self.sheet.holes)} holes)"
        )

    @property
    def scanner(self) -> Scanner:
        """The micro-CT scanner that holds the specimen."""
        voxel_um = self.params.scanner.voxel_um
        x, y, z = self.extent_um
        depth = int(np.ceil(z / voxel_um)) + 1
        shape = (depth, round(y / voxel_um), round(x / voxel_um))
        return Scanner(
            sheet=self.sheet,
            warp=self.warp,
            params=self.params.scanner,
            shape=shape,
            seed=self.params.seed,
        )

    @cached_property
    def poses(self) -> Poses:
        """True poses of the sections."""
        return draw_poses(self.params.sections, self.extent_um[1], self.params.seed)

    @property
    def microtome(self) -> Microtome:
        """The microtome that cuts the specimen up."""
        pixel = self.params.sections.pixel_um
        width_um, _, depth_um = self.extent_um
        rows = int(np.ceil(depth_um / pixel)) + 1
        shape = (rows, round(width_um / pixel))
        return Microtome(
            sheet=self.sheet,
            warp=self.warp,
            params=self.params.sections,
            poses=self.poses,
            shape=shape,
            seed=self.params.seed,
        )

    @cached_property
    def volume(self) -> xr.DataArray:
        """The scanned volume, as :func:`planish.read_volume` gives it.

        The dims are (z, y, x), with coordinates in um.
        """
        voxel = self.params.scanner.voxel_um
        values = self.scanner.volume()
        full_scale: float | None = None
        if values.dtype.kind == "u":
            full_scale = float(np.iinfo(self.params.scanner.dtype).max)
        return _labelled(
            values,
            ("z", "y", "x"),
            voxel,
            long_name="Grey value",
            voxel_um=[voxel] * 3,
            voxel_um_source="synthetic",
            full_scale=full_scale,
            file_bytes=values.nbytes,
        )

    @cached_property
    def image(self) -> xr.DataArray:
        """Reflectance of the top side, as :func:`planish.read_image` gives it.

        The dims are (y, x), with coordinates in um.
        """
        return self._photograph(printed=False)

    @cached_property
    def printed(self) -> xr.DataArray:
        """Reflectance after printing, as :attr:`image`."""
        return self._photograph(printed=True)

    @cached_property
    def flatbed(self) -> FlatbedScan:
        """The top side under an office scanner; :attr:`pose` leads to the picture it scans.

        The picture is as large as the camera's image, on pixels as wide as the nodes of the sheet.
        """
        p = self.params
        # In even light, as sharp as the sheet's grid is.
        off = dict.fromkeys(("shading", "vignetting", "lens_um", "noise"), 0.0)
        even = replace(p.camera, pixel_um=PITCH_UM, bits=16, **off)
        shape = np.array(self.image_shape) * p.camera.pixel_um / PITCH_UM
        rows, cols = shape.astype(int).tolist()
        seed = stream(p.seed, "camera")
        reflectance = photograph(self.sheet, self.pose, even, shape=(rows, cols), seed=seed)
        uv = image_material(self.pose, (rows, cols), PITCH_UM)
        top_um = self.sheet.at(self.sheet.faces[0], *uv)
        seed = stream(p.seed, "flatbed")
        return scan_flatbed(reflectance, top_um, pixel_um=PITCH_UM, params=p.flatbed, seed=seed)

    def _photograph(self, *, printed: bool) -> xr.DataArray:
        p = self.params.camera
        seed = stream(self.params.seed, "camera")
        values = photograph(
            self.sheet, self.pose, p, shape=self.image_shape, seed=seed, printed=printed
        )
        return _labelled(
            values,
            ("y", "x"),
            p.pixel_um,
            long_name="Reflectance",
            pixel_um=[p.pixel_um] * 2,
            file_bytes=values.nbytes,
            pixel_um_source="synthetic",
            full_scale=1.0,
            channel=None,
            stored_dtype=str(values.dtype),
            orientation=1,
        )

    @cached_property
    def truth(self) -> xr.Dataset:
        """True values at each pixel of the image, dims (y, x), in um.

        ``u, v`` material coordinates; ``volume_x, volume_y, volume_z`` of the centre surface;
        ``coating_top``, ``coating_bottom``, ``base_thickness``, ``thickness``; ``rim``: distance to
        the nearest hole's rim.
        """
        pixel = self.params.camera.pixel_um
        u, v = image_material(self.pose, self.image_shape, pixel)
        sheet = self.sheet
        points = self.warp.points(u, v)
        top, inner_top, inner_bottom, bottom = (sheet.at(face, u, v) for face in sheet.faces)
        places = {f"volume_{axis}": points[..., k] for k, axis in enumerate("xyz")}
        values = {
            "u": u,
            "v": v,
            **places,
            "coating_top": top - inner_top,
            "coating_bottom": inner_bottom - bottom,
            "base_thickness": inner_top - inner_bottom,
            "thickness": top - bottom,
            "rim": sheet.at(sheet.rim_um[0], u, v),
        }
        return _maps_um(values, pixel)

    @cached_property
    def columns(self) -> xr.Dataset:
        """The centre surface's ``u, v, centre`` (um) at each column (y, x) of the volume."""
        voxel_um = self.params.scanner.voxel_um
        y, x = (np.arange(n, dtype=np.float64) * voxel_um for n in self.scanner.shape[1:])
        u, v, centre = np.moveaxis(self.warp.columns(y, x), -1, 0)
        return _maps_um({"u": u, "v": v, "centre": centre}, voxel_um)


def _maps_um(values: Mapping[str, Floats], pitch_um: float) -> xr.Dataset:
    """Maps (rows, cols) in um, whose rows and columns begin at 0."""
    maps = xr.Dataset()
    for name, field in values.items():
        maps[name] = ("y", "x"), field, {"units": "um"}
    for dim, n in maps.sizes.items():
        maps.coords[dim] = pitch_um * np.arange(n)
    return maps


def _labelled(values: Array, dims: Texts, pitch_um: float, **attrs: Any) -> xr.DataArray:
    name = "volume" if len(dims) == 3 else "image"
    attrs = {"units": "1", "file_name": "synthetic specimen", **attrs}
    return labelled(values, dims, [pitch_um] * len(dims), name=name, attrs=attrs)
