"""The hole under a mark.

One that was found with all others, or one that is searched around the mark alone.
"""

from contextlib import suppress

import numpy as np
import xarray as xr

from planish.app.changes import ChangeError, End, Mark, Move
from planish.app.picture import PLANES, Plane
from planish.app.session import Session, ends_of
from planish.core.errors import PlanishError
from planish.core.grid import Grid, centres_of
from planish.core.typing import Pair
from planish.marks.exchange import marks_of_holes
from planish.run import find_holes

REACH = 0.75
"""Share of a hole's diameter within which a mark is taken for one of it."""


def snapped(session: Session, layer: str, mark: Mark) -> Move:
    """Give the move of a mark's ends into the holes that they lie in.

    ChangeError where neither end lies in one.
    """
    if mark.is_tile:
        raise ChangeError(
            f"{mark.label} is a tile of texture and no hole: there is nothing to snap it to. Take"
            " it out of use if it is wrong."
        )
    holes: dict[Plane, End | None] = {}
    for plane in PLANES:
        end = getattr(mark, plane)
        if end is not None:
            holes[plane] = hole_at(session, layer, plane, end.xy)
    if not any(holes.values()):
        planes_text = " or ".join(session.where(layer)[plane] for plane in holes)
        low_um, high_um = session.study.holes.hole_um
        raise ChangeError(
            f"No hole of {low_um:g} to {high_um:g} um was found around {mark.label} {planes_text}."
            " Move the mark closer to the middle of the hole, or leave it where it is."
        )
    return Move(layer=layer, id=mark.id, moving=holes.get("moving"), fixed=holes.get("fixed"))


def not_snapped(session: Session, layer: str, mark: Mark, move: Move) -> str:
    """Name the end that lies in no hole, where the other one does."""
    for plane in PLANES:
        if getattr(mark, plane) is not None and getattr(move, plane) is None:
            place = session.where(layer)[plane]
            return f"{mark.label} was not snapped {place}: no hole was found there."
    return ""


def warm(session: Session) -> None:
    """Search once, unasked: what the first search compiles takes seconds."""
    layer = session.layers[0]
    for plane in PLANES:
        pictures = session.pictures.on(*session.shown_by(layer, plane))
        for picture in pictures[:1]:
            middle_um = picture.grid.x_um.mean(), picture.grid.y_um.mean()
            with suppress(PlanishError):
                _search_holes(session, layer, plane, middle_um)


def hole_at(session: Session, layer: str, plane: Plane, point_um: Pair) -> End | None:
    """The hole around a point, with what is known of it; None where there is none."""
    hole = _nearest_hole(session.holes(layer)[plane], plane, point_um)
    if hole is not None:
        return hole
    holes = _search_holes(session, layer, plane, point_um)
    return _nearest_hole(holes, plane, point_um)


def _nearest_hole(holes: xr.Dataset | None, plane: Plane, point_um: Pair) -> End | None:
    """The hole whose middle is nearest to a point, as an end of a mark; None where it is too far.

    Also where there are no holes, or none were searched.
    """
    if holes is None or not holes.sizes["mark"]:
        return None
    offsets_um = centres_of(holes) - point_um
    distance_um = np.hypot(offsets_um[:, 0], offsets_um[:, 1])
    k = int(np.nanargmin(distance_um))
    if not distance_um[k] <= REACH * float(holes["diameter"].values[k]):
        return None
    mark = marks_of_holes(holes.isel(mark=[k]), layer=plane)
    return ends_of(mark, plane)[0]


def _search_holes(session: Session, layer: str, plane: Plane, point_um: Pair) -> xr.Dataset | None:
    """Holes in a window around a point, in um of the plane; None where nothing shows holes."""
    params = session.study.holes
    reach_um = 2.0 * params.hole_um[1]  # half a window: holes at its border are left out
    hole_layers = _hole_layers(session, layer, plane)
    windows: dict[str, xr.DataArray] = {}
    for name, data in hole_layers.items():
        window = _window(data, point_um, reach_um)
        if window is None:
            return None
        windows[name] = window
    if not windows:
        return None
    if "image" in windows:
        image = windows["image"]
        grid = Grid.of(image)
        holes = find_holes(image.assign_attrs(pixel_um=list(grid.pixel_um)), params=params)
        x0_um, y0_um = grid.origin_um  # from which the holes of an image count
    else:
        side = session.side_of(session.target(layer))
        holes = find_holes(xr.Dataset(windows), params=params, side=side)
        x0_um, y0_um = session.to_face_um(layer) if plane == "moving" else (0.0, 0.0)
    return holes.assign(x=holes["x"] + x0_um, y=holes["y"] + y0_um)


def _hole_layers(session: Session, layer: str, plane: Plane) -> dict[str, xr.DataArray]:
    """What shows the holes in a plane, by name: an image, or where a sheet has which material.

    Empty where nothing does.
    """
    if plane == "fixed" and session.image is not None:
        return {"image": session.image}
    shown_plane, shown_layer = session.shown_by(layer, plane)
    pictures = session.pictures.on(shown_plane, shown_layer)
    layer_maps = {p.variable: p.full for p in pictures if p.layer == shown_layer}
    if "image" in layer_maps:
        return {"image": layer_maps["image"]}
    material_maps = {name: data for name, data in layer_maps.items() if name.startswith("presence")}
    if material_maps or shown_plane == "moving":
        return material_maps
    # In the fixed plane that of another layer will do, the first of them.
    images = [picture.full for picture in pictures if picture.variable == "image"]
    return {"image": images[0]} if images else {}


def _window(data: xr.DataArray, point_um: Pair, reach_um: float) -> xr.DataArray | None:
    """A square about a point, of 2 ``reach_um`` a side; None where less than 8 pixels are left."""
    grid = Grid.of(data)
    x_um, y_um = point_um
    rows = np.flatnonzero(np.abs(grid.y_um - y_um) <= reach_um)
    cols = np.flatnonzero(np.abs(grid.x_um - x_um) <= reach_um)
    if min(rows.size, cols.size) < 8:
        return None
    return data[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1].compute()
