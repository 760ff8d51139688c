"""From parameters to a specimen: in memory, or with the files of its instruments in a folder."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from planish.core.arrays import not_taken
from planish.core.errors import FileError
from planish.core.transform import grid_points
from planish.core.typing import Floats
from planish.synthetic.files import (
    Instrument,
    write_flatbed,
    write_image,
    write_instruments,
    write_nodes,
    write_truth,
)
from planish.synthetic.params import SpecimenParams, Warp, generator
from planish.synthetic.pose import draw_pose
from planish.synthetic.presets import DEMO, SpecimenOptions
from planish.synthetic.sheet import DrawnSheet, hole_pattern, make_sheet
from planish.synthetic.specimen import Specimen

_BEYOND_UM = 150.0  # of the sheet around what the instruments see
_VOLUMES: dict[str, Instrument] = {"ct": "scanner", "sections": "sections", "stack": "stack"}


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
        Paper, holes, warp, instruments and seed; the specimen of the demo where not given (2.4 x
        1.8 mm, six holes). The same parameters give the same bytes on any number of threads.
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
    _check_film(params, sheet)
    warp, uvz, depth_um = _place_in_volume(params)
    uv = uvz[..., :2]
    seen_low = uv.min(axis=(0, 1))
    seen_high = uv.max(axis=(0, 1))
    field_uv = np.concatenate([seen_low, seen_high])
    image_shape, pose = draw_pose(params.camera, field_uv, generator(params.seed, "pose"))
    height_um, width_um = np.multiply(image_shape, params.camera.pixel_um)
    ends_x = np.array([0.0, width_um])
    ends_y = np.array([0.0, height_um])
    corners = pose.inverse(grid_points(ends_x, ends_y))
    # The sheet reaches beyond what volume and image show.
    low = np.minimum(seen_low, corners.min(axis=(0, 1))) - _BEYOND_UM
    high = np.maximum(seen_high, corners.max(axis=(0, 1))) + _BEYOND_UM
    if sheet is None:
        sheet = _sheet_of(params, uv, low, high)
    elif not sheet.covers(seen_low, seen_high):
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
    specimen_folder = Path(folder)
    if specimen_folder.exists():
        raise FileError(
            f"{specimen_folder} exists already. Name another folder for the specimen, or remove"
            " that one."
        )
    files = write_instruments(specimen, specimen_folder)
    write_truth(specimen, specimen_folder / "truth")
    return replace(specimen, files=files)


def _check_film(params: SpecimenParams, sheet: DrawnSheet | None) -> None:
    has_place = sheet.has_film if sheet else params.paper.fibres is not None
    if params.film is not None and not has_place:
        raise ValueError(
            "a film lies under a base of fibres only: set paper.fibres, or give a sheet made with a"
            " film"
        )


def _sheet_of(params: SpecimenParams, uv: Floats, low: Floats, high: Floats) -> DrawnSheet:
    """Draw the sheet from ``low`` to ``high``; its holes lie in all that the volume shows, uv."""
    u, v = np.moveaxis(uv, -1, 0)
    inner_low = np.array([u[:, 0].max(), v[0].max()])
    inner_high = np.array([u[:, -1].min(), v[-1].min()])
    centres = hole_pattern(params.holes, inner_low, inner_high, params.seed)
    return make_sheet(
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


def write_specimen(
    options: SpecimenOptions, folder: Path, *, progress: Callable[[str], None]
) -> None:
    """Make the specimen that a user orders, and write it.

    Parameters
    ----------
    options : SpecimenOptions
    folder : Path; for scan/, sections/, images, and truth/ apart from them
    progress : callable; called with the name of what is written next
    """
    specimen = make_specimen(options.params())
    large = options.size == "T3"  # without voxels: nodes of the centre surface instead
    for name in (*options.instrument, "truth"):
        progress(name)
        if name == "truth":
            write_truth(specimen, folder / "truth")
        elif name == "flatbed":
            write_flatbed(specimen, folder / "flatbed.tif")
        elif name not in _VOLUMES:
            file = "printed.ome.tif" if name == "print" else "image.ome.tif"
            write_image(specimen, folder / file, printed=name == "print")
        elif not large:
            write_instruments(specimen, folder, volume=_VOLUMES[name], image=False)
    if large:
        write_nodes(specimen, folder / "nodes.npz")


def _place_in_volume(params: SpecimenParams) -> tuple[Warp, Floats, float]:
    """Bring the sheet's own origin to the middle of the volume.

    Give the warp, its columns (u, v, z) at 61 x 81 places of the volume (y, x), and the depth of
    the volume, which holds the sheet with its film and some air around.
    """
    width_um, height_um = params.size_um
    p = params.paper
    middle = (width_um / 2, height_um / 2)
    steepest = params.warp.steepest
    reach_um = 2.0 * max(params.size_um) / np.cos(np.arctan(steepest)) + 1000.0
    warp = replace(params.warp, shift_um=(*middle, 0.0), reach_um=reach_um)
    y_um = np.linspace(0, height_um, 61)
    uvz = warp.columns(y_um, np.linspace(0, width_um, 81))
    thickness_um = p.base_um + p.coating_top_um + p.coating_bottom_um
    film = params.film
    film_depth_um = 0.0
    if film is not None:
        film_depth_um = film.film_um + film.gap_um
    depth_um = 0.5 * thickness_um + 20.0 + film_depth_um
    margin_um = depth_um * float(np.hypot(1.0, steepest)) + 60.0
    centre_z = uvz[..., 2]
    low_z = float(centre_z.min()) - margin_um
    high_z = float(centre_z.max()) + margin_um
    return replace(warp, shift_um=(*middle, -low_z)), uvz, high_z - low_z
