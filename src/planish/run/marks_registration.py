"""Register two layers by marks that are given, or by the holes of both."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from planish.core.errors import MarkError
from planish.core.frame import Frame
from planish.core.grid import values_at
from planish.core.typing import Entries
from planish.marks.exchange import (
    FORMATS,
    LayerPixels,
    about_layer,
    holes_of,
    marks_of_holes,
    pair_of_layers,
    read_any,
)
from planish.marks.exchange.model import paired, points_of, tiles_of, with_holes
from planish.register import FittedTransform, RegistrationParams, fit_pairs
from planish.run.holes import HoleSearch
from planish.run.layers import Groups, MappedLayer
from planish.run.registration import Registration, register_holes, with_residuals
from planish.run.study import Study


def register_by_marks(
    layer: MappedLayer, fixed: MappedLayer, holes: HoleSearch, study: Study
) -> Registration:
    """Register one layer to another by the marks that the study names, or by the holes of both.

    Marks that have no diameters in a layer have those of its holes, which are searched: holes are
    masked, and those without a mark are listed with the marks.
    """
    params = study.registration
    path = layer.params.marks or params.marks
    if path is None:
        hole_um = holes.params.hole_um
        return register_holes(holes.of(layer, fixed), holes.of(fixed, layer), params, hole_um)
    marks = volume_to_map(read_given(path, layer, fixed), layer.name, layer.groups)
    sentence = _shift_sentence(marks, Path(path).name)
    mirrored = None if params.mirror else layer.side != fixed.side
    fit = fit_marks(marks, params=params, mirrored=mirrored)
    usual_um = float(np.mean(holes.params.hole_um))
    sides = (("moving", layer, fixed), ("fixed", fixed, layer))
    for side, own_layer, other_layer in sides:
        is_placed = np.isfinite(marks[f"{side}_x"].values)
        diameters = marks.get(f"{side}_diameter")
        if diameters is None or not np.isfinite(diameters.values[is_placed]).all():
            circles = holes.of(own_layer, other_layer)[["x", "y", "diameter"]]
            names = [f"{side} {k + 1}" for k in range(circles.sizes["mark"])]
            labels = np.array(names, dtype=np.str_)
            hole_marks = marks_of_holes(circles, layer=side).assign(label=("mark", labels))
            marks = with_holes(marks, hole_marks, side, usual_um=usual_um)
    source = str(marks.attrs.get("read_from", {}).get("format", "file"))
    search = Entries()
    is_tile = tiles_of(marks)[paired(marks)]
    if is_tile.any():  # tiles of a run: what was said of them holds still, where the file has it
        saved = marks.attrs.get("registration", {})
        source = "texture" if is_tile.all() else "both"
        search = saved.get("search", {})
        fit = replace(fit, shared_um=float(saved.get("shared_um", 0.0)))
    search.setdefault("sentence", sentence)
    return Registration(fit=fit, marks=with_residuals(marks, fit), source=source, **search)


def fit_marks(
    marks: xr.Dataset, *, params: RegistrationParams, mirrored: bool | None
) -> FittedTransform:
    """Fit the marks in use that lie in both layers, as a run fits marks that it is given."""
    pairs = marks.isel(mark=np.flatnonzero(paired(marks)))
    moving, fixed = (holes_of(pairs, side) for side in ("moving", "fixed"))
    return fit_pairs(moving, fixed, params=params, mirrored=mirrored)


def read_given(path: str, moving: MappedLayer | str, fixed: MappedLayer | str) -> xr.Dataset:
    """Read marks from a file of any known format: three pairs or more.

    A layer is a name where it is a volume that was not read yet.
    """
    name = Path(path).name
    marks = read_any(path, moving=_pixels_of(moving), fixed=_pixels_of(fixed), volume=LayerPixels())
    pair_of_layers(marks, name=name)  # one layer alone is refused
    n_pairs = int(paired(marks).sum())
    if n_pairs < 3:
        raise MarkError(
            f"{name} holds {n_pairs} pairs of marks in use; a registration needs 3 to"
            " say how good it is. Add more, far apart."
        )
    for side, layer in (("moving", moving), ("fixed", fixed)):
        if side in marks.attrs["from_first_pixel"]:
            _refuse_unknown_place(marks, layer, side, name)
    return marks


def _refuse_unknown_place(
    marks: xr.Dataset, layer: MappedLayer | str, side: str, name: str
) -> None:
    """Refuse positions on a map that hold its place or not, as the file of its picture had it."""
    mark_format = FORMATS[marks.attrs["read_from"]["format"]]
    is_image = not isinstance(layer, str) and layer.image is not None
    if is_image or not mark_format.in_space:
        return
    place_text = "X,Y"
    if not isinstance(layer, str):
        place_text = ",".join(f"{um:g}" for um in layer.grid.origin_um)
    raise MarkError(
        f"{name}: positions of {mark_format.title} count from the first pixel of a map that was"
        " opened from a TIFF, and hold its place already where a NRRD stated it. Convert the file"
        f" by planish marks convert, given `{side}_origin_um={place_text}` for a TIFF, 0,0 for a"
        " NRRD."
    )


def _pixels_of(layer: MappedLayer | str) -> LayerPixels:
    """What is known of the pixels from which other programs count.

    A picture of a map may have other pixels than the map, but begins where the map does.
    """
    if isinstance(layer, str):
        return LayerPixels()
    if layer.image is None:
        return LayerPixels(origin_um=layer.grid.origin_um)
    return LayerPixels(pixel_um=layer.grid.pixel_um, shape=layer.grid.shape)


def _shift_sentence(marks: xr.Dataset, name: str) -> str | None:
    """Say what was added to positions that count from the first pixel of a map."""
    place_texts: list[str] = []
    for side in marks.attrs["from_first_pixel"]:
        place = about_layer(marks, side).get("origin_um", {})
        if any(place.values()):
            place_texts.append(f"({place['x']:g}, {place['y']:g}) um")
    if not place_texts:
        return None
    return (
        f"Positions on a map in {name} count from its first pixel, so the place of that pixel,"
        f" {' and '.join(place_texts)}, was added."
    )


def volume_to_map(marks: xr.Dataset, name: str, groups: Groups) -> xr.Dataset:
    """Marks on the flat map of a layer, those too that were set in its volume.

    Places (x, y, z) of the volume become places (u, v) of the map by the column of the sheet that
    they lie in, wherever in its thickness; other marks stay. Without ``groups`` it is an image.
    """
    if "volume_x" not in marks:
        return marks
    if not groups:
        raise MarkError(
            f"The marks have places in a volume, and {name} is an image. Give marks with places in"
            " both images (moving_x_um, moving_y_um), or the volume."
        )
    frame = Frame.of(groups["surfaces"])
    axes = ["xyz".index(axis) for axis in (frame.cols, frame.rows)]
    points = points_of(marks, "volume")[:, axes]
    uv = values_at(groups["flat"], ("u", "v"), points)
    is_placed = np.isfinite(points).all(axis=1)
    is_off_sheet = is_placed & ~np.isfinite(uv).all(axis=1)
    if is_off_sheet.any():
        labels = ", ".join(map(str, marks["label"].values[is_off_sheet]))
        raise MarkError(
            f"The marks {labels} do not lie on the sheet. Check the axes and the unit (um) of the"
            " table."
        )
    marks = marks.drop_vars("volume_z")
    new_names = {name: str(name).replace("volume_", "moving_") for name in marks}
    u, v = uv.T
    return marks.rename(new_names).assign(moving_x=("mark", u), moving_y=("mark", v))
