"""One specimen under several instruments, with the truth for every pixel and column."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.arrays import not_taken
from planish.core.errors import FileError
from planish.core.labelled import labelled
from planish.core.typing import Floats
from planish.synthetic.camera import image_material, photograph
from planish.synthetic.instruments import Microtome, Poses, Scanner, draw_poses
from planish.synthetic.params import SpecimenParams, Warp, generator, stream
from planish.synthetic.pose import CameraPose, draw_pose
from planish.synthetic.presets import DEMO
from planish.synthetic.sheet import DrawnSheet, hole_pattern, make_sheet

if TYPE_CHECKING:
    from planish.synthetic.files import InstrumentFiles


_BEYOND_UM = 150.0  # of the sheet around what the instruments see


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
    image_shape: tuple[int, int]
    #: where the files of its instruments are, if they were written.
    files: InstrumentFiles | None = None

    def __repr__(self) -> str:
        """Sizes of sheet, volume and image."""
        (x, y, _), p = self.extent_um, self.params
        shape = " x ".join(map(str, self.scanner.shape))
        return (
            f"Specimen({x / 1000:g} x {y / 1000:g} mm, seed {p.seed}; volume of {shape} voxels (z,"
            f" y, x) of {p.scanner.voxel_um:g} um; image of"
            f" {' x '.join(map(str, self.image_shape))} pixels of {p.camera.pixel_um:g} um;"
            f" {len(self.sheet.holes)} holes)"
        )

    @property
    def scanner(self) -> Scanner:
        """The micro-CT scanner that holds the specimen."""
        voxel_um = self.params.scanner.voxel_um
        x, y, z = self.extent_um
        shape = (int(np.ceil(z / voxel_um)) + 1, round(y / voxel_um), round(x / voxel_um))
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
        shape = (int(np.ceil(self.extent_um[2] / pixel)) + 1, round(self.extent_um[0] / pixel))
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
        return _labelled(
            values,
            ("z", "y", "x"),
            voxel,
            long_name="Grey value",
            voxel_um=[voxel] * 3,
            voxel_um_source="synthetic",
            full_scale=(
                float(np.iinfo(self.params.scanner.dtype).max) if values.dtype.kind == "u" else None
            ),
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

    def _photograph(self, *, printed: bool) -> xr.DataArray:
        p, seed = self.params.camera, stream(self.params.seed, "camera")
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
        values = {
            "u": u,
            "v": v,
            **{f"volume_{axis}": points[..., k] for k, axis in enumerate("xyz")},
            "coating_top": top - inner_top,
            "coating_bottom": inner_bottom - bottom,
            "base_thickness": inner_top - inner_bottom,
            "thickness": top - bottom,
            "rim": sheet.at(sheet.rim_um[0], u, v),
        }
        coords = {
            "y": np.arange(self.image_shape[0]) * pixel,
            "x": np.arange(self.image_shape[1]) * pixel,
        }
        return xr.Dataset(
            {k: (("y", "x"), value, {"units": "um"}) for k, value in values.items()}, coords=coords
        )

    @cached_property
    def columns(self) -> xr.Dataset:
        """The centre surface's ``u, v, centre`` (um) at each column (y, x) of the volume."""
        y, x = (
            np.arange(n, dtype=np.float64) * self.params.scanner.voxel_um
            for n in self.scanner.shape[1:]
        )
        uvz = np.moveaxis(self.warp.columns(y, x), -1, 0)
        values = {
            k: (("y", "x"), field, {"units": "um"})
            for k, field in zip(("u", "v", "centre"), uvz, strict=True)
        }
        return xr.Dataset(values, coords={"y": y, "x": x})


def _labelled(
    values: NDArray[Any], dims: tuple[str, ...], pitch_um: float, **attrs: Any
) -> xr.DataArray:
    name = "volume" if len(dims) == 3 else "image"
    attrs = {"units": "1", "file_name": "synthetic specimen", **attrs}
    return labelled(values, dims, [pitch_um] * len(dims), name=name, attrs=attrs)


def _place_in_volume(params: SpecimenParams) -> tuple[Warp, Floats, float]:
    """Bring the sheet's own origin to the middle of the volume.

    Give the warp, its columns (u, v, z), and the depth.
    """
    (width_um, height_um), p = params.size_um, params.paper
    reach_um = 2.0 * max(params.size_um) / np.cos(np.arctan(params.warp.steepest)) + 1000.0
    warp = replace(params.warp, shift_um=(width_um / 2, height_um / 2, 0.0), reach_um=reach_um)
    uvz = warp.columns(np.linspace(0, height_um, 61), np.linspace(0, width_um, 81))
    thickness_um = p.base_um + p.coating_top_um + p.coating_bottom_um
    film = params.film
    film_depth_um = film.film_um + film.gap_um if film is not None else 0.0
    margin_um = (0.5 * thickness_um + 20.0 + film_depth_um) * float(
        np.hypot(1.0, warp.steepest)
    ) + 60.0
    low_z, high_z = float(uvz[..., 2].min()) - margin_um, float(uvz[..., 2].max()) + margin_um
    return replace(warp, shift_um=(width_um / 2, height_um / 2, -low_z)), uvz, high_z - low_z


def make_specimen(
    params: SpecimenParams | None = None,
    folder: str | Path | None = None,
    *,
    sheet: DrawnSheet | None = None,
) -> Specimen:
    """Make a sheet of paper whose every property is known, as a scanner and a microscope show it.

    Parameters
    ----------
    params : SpecimenParams, optional
        Paper, holes, warp, instruments and seed; the specimen of the demo where not given (1.8 x
        1.3 mm, six holes). The same parameters give the same bytes on any number of threads.
    folder : path, optional
        Folder to make, for ``volume.tif``, ``image.tif`` and ``truth/``; nothing is written where
        not given.
    sheet : DrawnSheet, optional
        That of another specimen: the same piece of paper, bent as ``params`` say.

    Returns
    -------
    Specimen
        ``volume``, ``image``, ``printed`` and ``truth`` are rendered when they are first used;
        ``files`` holds the paths where they were written.

    Raises
    ------
    FileError
        If ``folder`` exists.
    InputError
        If ``params`` are something else.
    ValueError
        If the holes do not fit into the field, or the given sheet does not reach as far as this one
        has to; if a film is asked for under a base that is no single fibres, or under a given sheet
        without one.

    Examples
    --------
    >>> import planish as pl
    >>> specimen = pl.make_specimen()  # doctest: +SKIP
    >>> surfaces = pl.find_surfaces(specimen.volume)  # doctest: +SKIP
    """
    if params is not None and not isinstance(params, SpecimenParams):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise not_taken(
            params, "SpecimenParams", 'pl.make_specimen(folder="sheet")', "pl.make_specimen"
        )
    params = params or DEMO
    if params.film is not None and (
        params.paper.fibres is None if sheet is None else not sheet.has_film
    ):
        raise ValueError(
            "a film lies under a base of fibres only: set paper.fibres, or give a sheet made with a"
            " film"
        )
    warp, uvz, depth_um = _place_in_volume(params)
    field_uv = np.concatenate([uvz[..., :2].min(axis=(0, 1)), uvz[..., :2].max(axis=(0, 1))])
    image_shape, pose = draw_pose(params.camera, field_uv, generator(params.seed, "pose"))
    rows, cols = np.multiply(image_shape, params.camera.pixel_um)
    corners = pose.inverse([[x, y] for x in (0.0, cols) for y in (0.0, rows)])
    low = np.minimum(field_uv[:2], corners.min(axis=0)) - _BEYOND_UM
    high = np.maximum(field_uv[2:], corners.max(axis=0)) + _BEYOND_UM
    if sheet is None:
        inner_low = np.array([uvz[:, 0, 0].max(), uvz[0, :, 1].max()])
        inner_high = np.array([uvz[:, -1, 0].min(), uvz[-1, :, 1].min()])
        centres = hole_pattern(params.holes, inner_low, inner_high, params.seed)
        sheet = make_sheet(
            params.paper,
            params.holes,
            low=low,
            high=high,
            centres=centres,
            seed=params.seed,
            stiffness=params.stiffness,
            film=params.film,
            crack_um=params.crack_um,
        )
    elif not sheet.covers(field_uv[:2], field_uv[2:]):
        raise ValueError(
            "the given sheet does not reach as far as the volume shows it; bend it more or make it"
            " larger"
        )
    specimen = Specimen(
        params=params,
        warp=warp,
        sheet=sheet,
        pose=pose,
        extent_um=(*params.size_um, depth_um),
        image_shape=image_shape,
    )
    if folder is None:
        return specimen
    from planish.synthetic.files import write_instruments, write_truth

    specimen_folder = Path(folder)
    if specimen_folder.exists():
        raise FileError(
            f"{specimen_folder} exists already. Name another folder for the specimen, or remove"
            " that one."
        )
    files = write_instruments(specimen, specimen_folder)
    write_truth(specimen, specimen_folder / "truth")
    return replace(specimen, files=files)
