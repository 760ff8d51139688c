"""Laser holes of a flattened sheet: where its faces show them, and how they run through it."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from planish.core.errors import MarkError
from planish.core.facts import HoleTiltFacts, Side
from planish.core.grid import Grid, centres_of
from planish.core.robust import MAD_TO_SD, masked_gaussian
from planish.core.transform import are_known
from planish.core.typing import Entries, Floats, Ints, Pair
from planish.marks.find import find_holes
from planish.marks.params import HoleParams

LAYERS = {
    "top": ("presence", "below the top face"),
    "centre": ("presence_centre", "at the centre surface"),
    "bottom": ("presence_bottom", "above the bottom face"),
}
_OPPOSITE: dict[Side, Side] = {"top": "bottom", "bottom": "top"}
_DIRECTIONS = ("along the columns", "down the rows")  # of x and y
OTHER_SIDE = ("through", "closed", "unclear")
THROUGH, CLOSED, UNCLEAR = range(3)
# How much material in the middle of a hole closes it.
MATERIAL = 0.5
# Sd of the Gaussian that takes noise out of a layer; its square over 2 R moves a rim: by 0.7 um in
# a hole of 150 um.
NOISE_UM = 10.0


def find_sheet_holes(
    maps: xr.Dataset, *, params: HoleParams | None = None, side: Side = "top"
) -> xr.Dataset:
    """Find the laser holes that one side of a flattened sheet shows.

    Also finds where they lie in its other layers.

    Parameters
    ----------
    maps : Dataset, dims (v, u) or (y, x)
        ``presence``, ``presence_centre`` and ``presence_bottom``: share of material in a layer
        below the top face, around the centre surface and above the bottom face, 0 to 1, NaN where
        there is no data. A layer may be missing. Where there is ``presence_faces``: 1 in columns
        with both faces, 0 in openings. Attributes, where known: ``layers_apart_um``, from the
        middle of the top's layer to that of the bottom's, and ``layer_to_face``, from the middle of
        a layer to its face as a share of that.
    params : HoleParams, optional
        Range of diameters on the side; in the other layers they may be 1.4 times off.
    side : {"top", "bottom"}
        Side that is shown. Where its layer is missing the other side's is searched.

    Returns
    -------
    Dataset, dims (mark)
        Holes as :func:`planish.marks.find_holes` gives them, ``x, y`` in the coordinates of the
        maps and at the face. For each layer ``x_top, y_top, cov_xx_top, cov_yy_top, cov_xy_top,
        diameter_top``, and so on with ``_centre`` and ``_bottom``, where they were found; NaN where
        a hole is missing. ``offset_x, offset_y``: from the top to the bottom, um. ``other_side``: 0
        found on the other side, 1 closed there, 2 neither. Attributes:

        - ``side``, that was searched, and ``layers``, those that are there;
        - ``openings``: how many openings within the sheet are as large as a hole and were not taken
          for one;
        - ``through``, ``closed``, ``unclear``: counts of ``other_side``; ``other_side_only``: what
          was found on the other side and has no partner on this one;
        - ``offset_count``, ``offset_um``, ``offset_spread_um``, ``offset_error_um``: holes found on
          both sides, the median (x, y) of their offsets, the robust standard deviation, and the
          standard error of the median;
        - ``to_face_um``: (x, y) that was added to go from the layer to the face;
        - ``tilt_deg``: angle (x, y) of the median offset with the normal, where ``layers_apart_um``
          is known.

    Raises
    ------
    MarkError
        If there is no layer of either side, or the maps have no regular grid.

    Notes
    -----
    An offset that all holes share is a laser that was not perpendicular, or a flattening that
    shears the layers: both move the marks against an image of one side by as much. Where it stands
    out from its error, what it makes from the layer to the face is added. Offsets of single holes
    are mostly the roughness of their rims and are left alone. Rims of one hole lie within half its
    diameter; where it is more oblique, its layers are no longer round.

    Examples
    --------
    >>> y, x = np.mgrid[:100, :120] * 5.0
    >>> at = {"presence": 300, "presence_bottom": 306}
    >>> layers = {name: (("y", "x"), np.hypot(x - u, y - 250) > 80) for name, u in at.items()}
    >>> maps = xr.Dataset(layers, coords={"y": y[:, 0], "x": x[0]})
    >>> find_sheet_holes(maps).offset_x.values.round(0)
    array([6.])
    """
    layers, side = _layers_of(maps, side)
    grid = Grid.of(maps)
    pixel_um = grid.pixel_um
    low, high = diameter_range = (params or HoleParams()).hole_um
    holes: dict[str, xr.Dataset] = {}
    for layer, share in layers.items():
        # A tapered hole is narrower, or wider, on the other side than what was asked for.
        spare = 1.0 if layer == side else 1.4
        searched_range = (low / spare, high * spare)
        layers[layer], holes[layer] = _search(share, pixel_um, searched_range)
    faces = maps.get("presence_faces")
    face_holes = _by_faces(faces, holes[side], pixel_um, diameter_range)
    if faces is None or face_holes is None:
        partner_rows, states, single_count = _in_other_layers(layers, holes, side, pixel_um)
    else:
        # Where neither face is seen a hole runs through; how far it leans the faces do not say.
        layers[side] = faces.values
        holes[side] = face_holes
        states = np.full(face_holes.sizes["mark"], THROUGH, dtype=np.uint8)
        partner_rows = dict[str, Ints]()
        single_count = 0
    centres = centres_of(holes[side])
    # What is as large as a circle of this share of the holes' diameter is an opening that should be
    # one.
    diameters = holes[side]["diameter"].values if len(centres) else [low]
    least_um = 0.6 * float(np.median(diameters))
    openings = _openings(layers[side], pixel_um, centres, least_um)
    holes = {layer: _shifted(dataset, grid.origin_um) for layer, dataset in holes.items()}
    own_rows = np.arange(len(centres))
    layer_holes = _by_layer(holes, {side: own_rows, **partner_rows})
    offset_x = layer_holes["x_bottom"].values - layer_holes["x_top"].values
    offset_y = layer_holes["y_bottom"].values - layer_holes["y_top"].values
    offsets_um = np.stack([offset_x, offset_y], axis=1)
    statistics, to_face_um = _offset_statistics(offsets_um, maps, side)
    out = _shifted(holes[side], to_face_um).merge(layer_holes, combine_attrs="override")
    for name, offset_um, where in zip("xy", offsets_um.T, _DIRECTIONS, strict=True):
        attrs = {"units": "um", "long_name": f"Offset from the top to the bottom {where}"}
        out[f"offset_{name}"] = ("mark", offset_um, attrs)
    states_attrs = {
        "long_name": "What the other side shows of the hole",
        "flag_values": list(range(3)),
        "flag_meanings": " ".join(OTHER_SIDE),
    }
    out["other_side"] = ("mark", states, states_attrs)
    counts = np.bincount(states, minlength=3).tolist()
    state_counts = dict(zip(OTHER_SIDE, counts, strict=True))
    out.attrs |= {"side": side, "layers": list(layers), "openings": openings}
    out.attrs |= state_counts | {"other_side_only": single_count} | statistics
    return out


def _layers_of(maps: xr.Dataset, side: Side) -> tuple[dict[str, Floats], Side]:
    """Give the layers that are there, and the side to search: the other one if that is missing."""
    if side not in _OPPOSITE:
        raise MarkError(f"The side is {side!r}; an image shows the 'top' or the 'bottom'.")
    layers = {layer: maps[name].values for layer, (name, _) in LAYERS.items() if name in maps}
    if side not in layers:
        side = _OPPOSITE[side]
    if side not in layers:
        raise MarkError(
            "The maps hold no layer of the material at a face of the sheet (presence or"
            " presence_bottom). Make them again from the volume."
        )
    return layers, side


def _in_other_layers(
    layers: dict[str, Floats], holes: dict[str, xr.Dataset], side: Side, pixel_um: Pair
) -> tuple[dict[str, Ints], NDArray[np.uint8], int]:
    """Row of each hole of a side in the other layers, and its state on the other side.

    By the layers' names: ``layers`` are shares of material (rows, cols), ``holes`` those found in
    them, the rows are -1 where a hole has no partner. Also gives how many holes of the other side
    have none.
    """
    centres = centres_of(holes[side])
    # From one layer to another a hole moves by less than half its diameter: one that is more
    # oblique is not round.
    reach = 0.5 * holes[side]["diameter"].values
    partner_rows: dict[str, Ints] = {}
    for layer in layers.keys() - {side}:
        partner_rows[layer] = _partners(centres, centres_of(holes[layer]), reach)
    other = _OPPOSITE[side]
    if other not in layers:
        return partner_rows, np.full(len(centres), UNCLEAR, dtype=np.uint8), 0
    rows = partner_rows[other]
    states = _other_side(layers[other], pixel_um, holes[side], holes[other], rows)
    partner_count = int(np.count_nonzero(rows >= 0))
    single_count = holes[other].sizes["mark"] - partner_count
    return partner_rows, states, single_count


def _search(share: Floats, pixel_um: Pair, diameter_range: Pair) -> tuple[Floats, xr.Dataset]:
    """Find the holes of a layer; without its noise, where that shows more of them.

    Returns the layer used, (rows, cols), and them.
    """
    holes = find_holes(share, pixel_um=pixel_um, diameter_um=diameter_range, polarity="dark")
    if holes.sizes["mark"] and not holes.attrs["not_taken"]["no_rim"]:
        return share, holes
    # Where the grey of the sheet is hardly that of what fills its holes, as in resin, noise makes
    # floors uneven.
    smooth, smooth_holes = _smooth_holes(share, pixel_um, diameter_range)
    if smooth_holes.sizes["mark"] > holes.sizes["mark"]:
        return smooth, smooth_holes
    return share, holes


def _smooth_holes(share: Floats, pixel_um: Pair, diameter_range: Pair) -> tuple[Floats, xr.Dataset]:
    """Take the noise out of a layer; give it and its holes."""
    has_data = np.isfinite(share)
    sigmas = [NOISE_UM / step for step in pixel_um]
    sums, weights = masked_gaussian(share, has_data, sigmas)
    weights[~has_data] = np.nan
    smooth = sums / weights
    holes = find_holes(smooth, pixel_um=pixel_um, diameter_um=diameter_range, polarity="dark")
    return smooth, holes


def _by_faces(
    faces: xr.DataArray | None, holes: xr.Dataset, pixel_um: Pair, diameter_range: Pair
) -> xr.Dataset | None:
    """Holes by what both faces of a coated sheet show, where that shows more of them.

    Walls that are charred, or hardly lighter than what fills the holes, blur a rim in the base.
    """
    not_taken = holes.attrs["not_taken"]
    if faces is None or not (not_taken["no_rim"] or not_taken["not_round"]):
        return None
    _, face_holes = _smooth_holes(faces.values, pixel_um, diameter_range)
    return face_holes if face_holes.sizes["mark"] > holes.sizes["mark"] else None


def _other_side(
    material: NDArray[np.generic],
    pixel_um: Pair,
    holes: xr.Dataset,
    partners: xr.Dataset,
    partner_rows: Ints,
) -> NDArray[np.uint8]:
    """What the other side shows of each hole, as one of `THROUGH`, `CLOSED` and `UNCLEAR`.

    ``material`` (rows, cols) is the share of material there, ``partners`` are the holes found
    there, and ``partner_rows`` (n,) the partner of each hole, -1 for none.
    """
    is_through = partner_rows >= 0
    centres = centres_of(holes)
    states = np.where(is_through, THROUGH, UNCLEAR).astype(np.uint8)
    # Where the other side should show a hole: as far from this one as with the partners.
    offset = np.zeros(2)
    if is_through.any():
        moves = centres_of(partners)[partner_rows[is_through]] - centres[is_through]
        offset = np.median(moves, axis=0)
    grid = Grid.regular(material.shape, pixel_um)
    for k in np.flatnonzero(~is_through).tolist():
        # The middle half of a hole is clear of its rim.
        radius_um = 0.25 * float(holes["diameter"].values[k])
        x, y = centres[k] + offset
        dy = grid.y_um - y
        dx = grid.x_um - x
        rows = np.flatnonzero(np.abs(dy) <= radius_um)
        cols = np.flatnonzero(np.abs(dx) <= radius_um)
        is_middle = np.hypot(dy[rows][:, None], dx[cols]) <= radius_um
        shares = material[np.ix_(rows, cols)].astype(np.float64)
        shares = shares[is_middle & np.isfinite(shares)]
        if shares.size and np.median(shares) > MATERIAL:
            states[k] = CLOSED
    return states


def _offset_statistics(offsets: Floats, maps: xr.Dataset, side: Side) -> tuple[Entries, Floats]:
    """Summarise offsets from top to bottom as attributes, and give the move from layer to face.

    ``offsets`` (n, 2) and the move (2,) are x, y in um; NaN where a hole is not on both sides.
    """
    measured = offsets[are_known(offsets)]
    count = len(measured)
    offset_um = spread_um = np.full(2, np.nan)
    if count:
        offset_um = np.median(measured, axis=0)
    if count > 1:
        deviations = np.abs(measured - offset_um)
        spread_um = MAD_TO_SD * np.median(deviations, axis=0)
    # The error of a median over that of a mean.
    error_um = 1.2533 * spread_um / np.sqrt(max(count, 1))
    to_face_um = np.zeros(2)
    # The median offset of fewer holes is no better than none; it counts from three standard errors.
    is_significant = count >= 4 and np.hypot(*offset_um) > 3.0 * np.hypot(*error_um)
    if is_significant and maps.attrs.get("layer_to_face"):
        face_share = float(maps.attrs["layer_to_face"])
        to_face_um = (-face_share if side == "top" else face_share) * offset_um
    arrays = {
        "offset_um": offset_um,
        "offset_spread_um": spread_um,
        "offset_error_um": error_um,
        "to_face_um": to_face_um,
    }
    thickness_um = maps.attrs.get("layers_apart_um")
    if thickness_um is not None:
        arrays["tilt_deg"] = np.rad2deg(np.arctan2(offset_um, thickness_um))
    statistics: Entries = {"offset_count": count}
    for name, pair in arrays.items():
        statistics[name] = pair.tolist()
    return statistics, to_face_um


def hole_tilt(holes: xr.Dataset | None) -> HoleTiltFacts | None:
    """Summarise how the holes of :func:`find_sheet_holes` run through the sheet.

    None for holes of no sheet.
    """
    if holes is None or "through" not in holes.attrs:
        return None
    attrs = holes.attrs
    offset = np.array(attrs["offset_um"], dtype=np.float64)
    error = np.array(attrs["offset_error_um"], dtype=np.float64)
    text = "No hole was found on both sides of the sheet."
    if np.isfinite(offset).all():
        text = (
            f"{attrs['offset_count']} holes run through the sheet, shifted by"
            f" {np.hypot(*offset):.1f} um from its upper to its lower third"
        )
        if np.isfinite(error).all():
            rms_um = np.sqrt(np.mean(error**2))
            text += f" (± {rms_um:.1f} um)"
        text += "."
    closed = attrs["closed"]
    if closed:
        verb = "is" if closed == 1 else "are"
        text += f" {closed} {verb} closed on the other side."
    facts = {k: v for k, v in attrs.items() if k in HoleTiltFacts.model_fields}
    return HoleTiltFacts.model_validate({**facts, "sentence": text})


def _shifted(holes: xr.Dataset, offset: Sequence[float] | Floats) -> xr.Dataset:
    """Move holes by an offset (x, y), in um."""
    dx, dy = offset
    x = holes["x"].copy(data=holes["x"].values + dx)
    y = holes["y"].copy(data=holes["y"].values + dy)
    return holes.assign(x=x, y=y)


def _partners(centres: Floats, candidate_centres: Floats, reach: Floats) -> Ints:
    """Return the candidate's row of each hole, -1 for none.

    Hole and candidate are each the other's nearest, and within ``reach`` (n,), one for each hole.
    """
    rows = np.full(len(centres), -1)
    if not len(centres) or not len(candidate_centres):
        return rows
    distances, nearest = map(np.asarray, KDTree(candidate_centres).query(centres))
    _, reverse_nearest = KDTree(centres).query(candidate_centres)
    is_mutual = np.asarray(reverse_nearest)[nearest] == np.arange(len(centres))
    is_partner = is_mutual & (distances <= reach)
    rows[is_partner] = nearest[is_partner]
    return rows


def _openings(share: NDArray[np.generic], pixel_um: Pair, centres: Floats, least_um: float) -> int:
    """Count openings away from the border that are large enough and hold no hole.

    ``share`` (rows, cols) is that of material; ``centres`` (n, 2) are those of the holes, x and y
    in um from the first pixel. Large enough is as large as a circle of a diameter, or larger.
    """
    material = share.astype(np.float64)
    has_data = np.isfinite(material)
    regions, _ = ndimage.label((material < MATERIAL) | ~has_data)
    row_um, col_um = pixel_um
    sizes = np.bincount(regions.ravel()) * row_um * col_um
    # What touches the border or missing data may be the ground beside the sheet.
    sizes[regions[[0, -1]]] = 0.0
    sizes[regions[:, [0, -1]]] = 0.0
    sizes[regions[~has_data]] = 0.0
    places = np.rint(centres[:, ::-1] / pixel_um).astype(np.intp)
    last = np.subtract(share.shape, 1)
    rows, cols = np.clip(places, 0, last).T
    sizes[regions[rows, cols]] = 0.0
    is_large = sizes[1:] > np.pi / 4 * least_um**2
    return int(np.count_nonzero(is_large))


def _by_layer(holes: dict[str, xr.Dataset], layer_rows: dict[str, Ints]) -> xr.Dataset:
    """Collect each layer's variables of the holes, NaN where a hole is missing.

    ``layer_rows`` says for each hole of the side its row in the holes of a layer, -1 for none.
    """
    variables: dict[str, tuple[str, Floats, dict[str, str]]] = {}
    template = next(iter(holes.values()))
    all_missing = np.full(max(map(len, layer_rows.values())), -1)
    for layer, (_, place_text) in LAYERS.items():
        rows = layer_rows.get(layer, all_missing)
        for name in ("x", "y", "cov_xx", "cov_yy", "cov_xy", "diameter"):
            attrs = dict(template[name].attrs)
            attrs["long_name"] += f", {place_text}"
            # The last row is that of the holes that are missing, -1.
            values = holes.get(layer, template)[name].values
            column = np.append(values, np.nan)[rows]
            variables[f"{name}_{layer}"] = ("mark", column, attrs)
    return xr.Dataset(variables)
