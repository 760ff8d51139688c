"""Marks as one dataset: each has one label, and a position or none in each layer.

A layer is a picture of the sheet: the flattened map (``moving``), the volume (``volume``), an image
(``fixed``) ...
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
import xarray as xr

from planish.core.errors import MarkError
from planish.core.tables import raise_faults
from planish.core.transform import are_known
from planish.core.typing import Bools, Entries, Fields, Floats, Ints
from planish.marks.exchange.formats import Unit

NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")
EXTRAS: dict[str, tuple[str, str]] = {
    "cov_xx": ("um2", "Variance of x"),
    "cov_yy": ("um2", "Variance of y"),
    "cov_xy": ("um2", "Covariance of x and y"),
    "diameter": ("um", "Mean diameter of the rim"),
    "axis_ratio": ("1", "Longer over shorter axis of the rim"),
    "arc_coverage": ("1", "Share of the rim that was found"),
}
RESULTS = {
    "residual": "Distance left by the fit",
    "leave_one_out": "Distance left by the fit to all other marks",
}
RESIDUAL = "residual"  # no layer: a run's marks hold ``residual_x`` and ``residual_y``
_TITLES = {"moving": "on the flattened map", "volume": "in the volume", "fixed": "in the image"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MarkPlaces:
    """Places of the marks in one layer."""

    #: (n, 2) ``x, y`` or (n, 3) ``x, y, z``, in um; NaN where a mark is not in this layer.
    um: Floats
    #: (n,) or one: ``detected``, ``clicked``, ``predicted``, ``imported`` or ``tile`` (of texture).
    source: str | Sequence[str] = "imported"
    #: Some of `EXTRAS`, (n,) each; NaN where not known.
    extras: Mapping[str, Floats] = field(default_factory=dict[str, Floats])

    @classmethod
    def of_holes(cls, holes: xr.Dataset, rows: Ints, source: str = "detected") -> MarkPlaces:
        """Give places of some holes of `find_holes`, ``x``, ``y`` and any of `EXTRAS`.

        NaN where the row is -1.
        """
        values: dict[str, Floats] = {}
        for name in filter(holes.__contains__, ("x", "y", *EXTRAS)):
            # The last row is that of the holes that are missing, -1.
            values[name] = np.append(holes[name].values, np.nan)[rows]
        um = np.stack([values.pop("x"), values.pop("y")], axis=1)
        return cls(um=um, source=source, extras=values)


def make_marks(
    labels: Sequence[str],
    layers: Mapping[str, MarkPlaces],
    *,
    used: Sequence[bool] | None = None,
    about: Mapping[str, Fields] | None = None,
    results: Mapping[str, Floats] | None = None,
) -> xr.Dataset:
    """Put marks together.

    Parameters
    ----------
    labels : sequence of str, length n
    layers : mapping of str to MarkPlaces
        Names in small letters, digits and underscores, in the order in which they are kept.
    used : sequence of bool, length n, optional
        Whether a mark takes part in a fit; all where not given.
    about : mapping of str to mapping, optional
        What is known of a layer: ``title``, ``pixel_um``, ``origin_um`` and ``size_px`` as ``{"x":
        ..., "y": ...}``, ``side`` (top or bottom), ``machine_direction_deg``.
    results : mapping of str to ndarray, shape (n,), in um, optional
        ``residual`` and ``leave_one_out`` of a fit.

    Returns
    -------
    Dataset, dims (mark)
        ``label``, ``used``, and for each layer ``{layer}_x``, ``{layer}_y``, ``{layer}_source``,
        further ``{layer}_z`` and those of `EXTRAS` that are known. ``attrs["layers"]`` holds
        ``about``.

    Raises
    ------
    MarkError
        If a layer's name cannot be used.
    """
    names = np.array(list(labels), dtype=np.str_)
    stated = np.ones(len(labels)) if used is None else used
    is_used = np.array(stated, dtype=bool)
    variables: Entries = {
        "label": ("mark", names, {"long_name": "Name of the mark"}),
        "used": ("mark", is_used, {"long_name": "Takes part in the fit"}),
    }
    for layer, places in layers.items():
        variables |= _layer_columns(layer, places)
    for name, errors in (results or {}).items():
        variables[name] = _column(errors, "um", RESULTS[name])
    about = about or {}
    layer_facts = {layer: dict(about.get(layer, {})) for layer in layers}
    return xr.Dataset(variables, attrs={"layers": layer_facts})


def _layer_columns(layer: str, places: MarkPlaces) -> Entries:
    """Variables of one layer of marks.

    By their names in the dataset of `make_marks`. MarkError where the layer's name cannot be used.
    """
    if not NAME.fullmatch(layer) or layer == RESIDUAL:
        raise MarkError(
            f"{layer!r} is no name of a layer: use small letters, digits and underscores, such as"
            " map."
        )
    columns: Entries = {}
    where = _TITLES.get(layer, f"in {layer}")
    for axis, values in zip("xyz", places.um.T, strict=False):
        columns[f"{layer}_{axis}"] = _column(values, "um", f"Mark {where}, {axis}")
    for name in filter(places.extras.__contains__, EXTRAS):
        values = places.extras[name]
        units, text = EXTRAS[name]
        if np.isfinite(values).any():
            columns[f"{layer}_{name}"] = _column(values, units, f"{text}, {where}")
    stated = np.array(places.source, dtype=np.str_)
    source = np.broadcast_to(stated, len(places.um)).copy()
    columns[f"{layer}_source"] = ("mark", source, {"long_name": f"Found how, {where}"})
    return columns


def _column(values: Floats, units: str, long_name: str) -> tuple[str, Floats, dict[str, str]]:
    numbers = np.ascontiguousarray(values, dtype=np.float64)
    return "mark", numbers, {"units": units, "long_name": long_name}


def layer_names(marks: xr.Dataset) -> list[str]:
    """Return the names of the layers, in order.

    Also of pairs and of a run's marks, which have no list of layers.
    """
    stems = [str(name)[:-2] for name in marks.variables if str(name).endswith("_x")]
    names = [name for name in stems if f"{name}_y" in marks and name != RESIDUAL]
    listed: Fields = marks.attrs.get("layers", {})
    ordered = dict.fromkeys([*listed, *names])
    return [name for name in ordered if name in names]


def about_layer(marks: xr.Dataset, layer: str) -> Entries:
    """Give what is known of a layer; empty where nothing is.

    Parameters
    ----------
    marks : Dataset, dims (mark)
    layer : str
    """
    return dict(marks.attrs.get("layers", {}).get(layer, {}))


def points_of(marks: xr.Dataset, layer: str) -> Floats:
    """Return positions in one layer, shape (n, 2) or (n, 3), in um.

    NaN where a mark is not in it.
    """
    names = filter(marks.__contains__, [f"{layer}_{axis}" for axis in "xyz"])
    columns = [marks[name].values for name in names]
    return np.stack(columns, axis=1).astype(np.float64)


def places_of(marks: xr.Dataset, layer: str) -> MarkPlaces:
    """Return positions in one layer with all that is known of them."""
    extras = {
        name: marks[f"{layer}_{name}"].values for name in EXTRAS if f"{layer}_{name}" in marks
    }
    source = ["imported"] * marks.sizes["mark"]
    if f"{layer}_source" in marks:
        source = marks[f"{layer}_source"].values.tolist()
    return MarkPlaces(um=points_of(marks, layer), source=source, extras=extras)


def in_layers(marks: xr.Dataset, layers: Sequence[str]) -> Bools:
    """Return which marks have a position in all layers."""
    known_by_layer = [are_known(points_of(marks, layer)) for layer in layers]
    return np.all(known_by_layer, axis=0)


def used_in(marks: xr.Dataset, layers: Sequence[str]) -> Bools:
    """Return which marks are in use and have a position in all layers."""
    return used_of(marks) & in_layers(marks, layers)


def paired(marks: xr.Dataset) -> Bools:
    """Return which marks are in use and lie in both layers."""
    moving = "volume" if "volume_x" in marks else "moving"
    return used_in(marks, [moving, "fixed"])


def labels_of(marks: xr.Dataset) -> list[str]:
    """Return the names of the marks; their numbers where they have none."""
    if "label" in marks:
        return marks["label"].values.astype(np.str_).tolist()
    return [str(k + 1) for k in range(marks.sizes.get("mark", 0))]


def tiles_of(marks: xr.Dataset) -> Bools:
    """Return which marks are tiles of texture in any layer.

    These are no holes and have no diameter.
    """
    are_tiles = np.zeros(marks.sizes.get("mark", 0), bool)
    for layer in layer_names(marks):
        if f"{layer}_source" in marks:
            are_tiles |= marks[f"{layer}_source"].values == "tile"
    return are_tiles


def used_of(marks: xr.Dataset) -> Bools:
    """Return which marks take part in a fit; all where it is not stated."""
    if "used" in marks:
        return marks["used"].values.astype(bool)
    return np.ones(marks.sizes.get("mark", 0), bool)


def marks_of_holes(holes: xr.Dataset, *, layer: str, about: Fields | None = None) -> xr.Dataset:
    """Make marks with one layer of holes.

    The holes are as :func:`planish.marks.find_holes` and `read_holes` give them.

    Parameters
    ----------
    holes : Dataset, dims (mark)
        ``x``, ``y`` in um, and any of `EXTRAS`.
    layer : str
    about : mapping, optional
        As for `make_marks`.
    """
    rows = np.arange(holes.sizes["mark"])
    names = [f"hole {k + 1}" for k in rows]
    places = MarkPlaces.of_holes(holes, rows)
    return make_marks(names, {layer: places}, about={layer: about or {}})


def join_holes(
    moving: xr.Dataset, fixed: xr.Dataset, pairs: Ints | None = None, labels: Sequence[str] = ()
) -> xr.Dataset:
    """Make marks of two layers' holes: first ``pairs``, with labels, then single holes.

    ``pairs`` is (k, 2: rows of moving and fixed); none where None. Single holes are named by their
    side and number.
    """
    rows = np.empty((0, 2), dtype=np.intp) if pairs is None else pairs
    names = [*labels]
    layers = dict[str, MarkPlaces]()
    about = dict[str, Entries]()
    sides = {"moving": moving, "fixed": fixed}
    for k, (side, holes) in enumerate(sides.items()):
        all_rows = np.arange(holes.sizes["mark"])
        single_rows = np.setdiff1d(all_rows, rows[:, k])
        names += [f"{side} {row + 1}" for row in single_rows]
        added_rows = np.full((single_rows.size, 2), -1)
        added_rows[:, k] = single_rows
        rows = np.concatenate([rows, added_rows])
    for (side, holes), side_rows in zip(sides.items(), rows.T, strict=True):
        source = holes.attrs.get("source", "detected")
        layers[side] = MarkPlaces.of_holes(holes, side_rows, source)
        facts = {"title": holes.attrs.get("layer"), "side": holes.attrs.get("seen_from")}
        about[side] = {key: fact for key, fact in facts.items() if fact is not None}
    return make_marks(names, layers, about=about)


def holes_of(marks: xr.Dataset, layer: str) -> xr.Dataset:
    """Return the holes of one layer.

    ``x``, ``y`` (um), ``label`` and what else is known of the marks in it.

    Parameters
    ----------
    marks : Dataset, dims (mark)
    layer : str

    Raises
    ------
    MarkError
        If there is no such layer.
    """
    _check_layer(marks, layer)
    fields = [name for name in ("x", "y", "z", *EXTRAS) if f"{layer}_{name}" in marks]
    names: dict[Hashable, str] = {f"{layer}_{name}": name for name in fields}
    holes = marks[[*names, "label"]].rename(names)
    return holes.isel(mark=in_layers(marks, [layer]))


def with_holes(marks: xr.Dataset, holes: xr.Dataset, layer: str, *, usual_um: float) -> xr.Dataset:
    """Give marks the diameters of the holes they lie in, and add the holes that hold none of them.

    ``holes`` are marks of the layer, with diameters. Those known in ``marks`` stay; without a hole,
    ``usual_um``. Tiles of texture are no holes: they are given none, and nor is a mark that was set
    beside them where no hole is known.
    """
    tiles = tiles_of(marks)
    assumed_um = np.nan if tiles.any() else usual_um
    is_hole = in_layers(holes, [layer]) & ~tiles_of(holes)
    holes = holes.isel(mark=is_hole)
    mark_um = _diameters(marks, layer)
    hole_um = _diameters(holes, layer)
    points = points_of(marks, layer)
    offsets = points[:, None] - points_of(holes, layer)
    distances = np.linalg.norm(offsets, axis=2)
    distances[~(distances < 0.5 * hole_um)] = np.inf
    # The nearest hole; the number after the last one where a mark lies in none.
    none_at = np.full((len(distances), 1), np.finfo(np.float64).max)
    hole_rows = np.argmin(np.hstack([distances, none_at]), axis=1)
    found_um = np.append(hole_um, assumed_um)[hole_rows]
    diameters = np.where(np.isfinite(mark_um), mark_um, found_um)
    diameters[tiles | ~are_known(points)] = np.nan
    layer_columns = [column for column in holes if str(column).startswith(f"{layer}_")]
    unmarked_rows = np.setdiff1d(np.arange(len(hole_um)), hole_rows)
    unmarked = holes[["label", *layer_columns]].isel(mark=unmarked_rows)
    unmarked = unmarked.assign(used=("mark", np.ones(len(unmarked_rows))))
    with_diameters = marks.assign({f"{layer}_diameter": ("mark", diameters, {"units": "um"})})
    joined = xr.concat(
        [with_diameters, unmarked],
        dim="mark",
        data_vars="all",
        join="outer",
        combine_attrs="override",
    )
    joined = joined.assign(used=joined["used"].astype(bool), label=joined["label"].astype(str))
    for column in list(joined):
        if str(column).endswith("_source"):
            joined[column] = joined[column].fillna("imported").astype(str)
    return joined


def _diameters(marks: xr.Dataset, layer: str) -> Floats:
    """Diameters (n,) of the marks in a layer, in um; NaN where they are not known."""
    unknown = np.full(marks.sizes["mark"], np.nan)
    return places_of(marks, layer).extras.get("diameter", unknown)


def used_pairs(
    marks: xr.Dataset,
    *,
    moving: str | None = None,
    fixed: str | None = None,
    least: int = 3,
    name: str = "The file",
) -> xr.Dataset:
    """Return the marks that are used and lie in both layers.

    Parameters
    ----------
    marks : Dataset, dims (mark)
    moving, fixed : str, optional
        Names of the layers; ``moving`` (or ``volume``) and ``fixed`` where they are there,
        otherwise the first two.
    least : int
        Fewer pairs are an error.
    name : str
        What the marks were read from, for messages.

    Returns
    -------
    Dataset, dims (mark)
        ``label``, ``fixed_x, fixed_y`` and ``moving_x, moving_y`` or ``volume_x, volume_y,
        volume_z``, in um.

    Raises
    ------
    MarkError
        If a layer is missing or too few marks are left.
    """
    first, second = pair_of_layers(marks, moving=moving, fixed=fixed, name=name)
    pairs = marks.isel(mark=used_in(marks, (first, second)))
    count = pairs.sizes["mark"]
    if count < least:
        raise MarkError(
            f"{name} holds {marks.sizes['mark']} marks, of which {count} are used and lie in both"
            f" {first} and {second}. At least {least} are needed, far apart: add marks, or use"
            " those that are switched off."
        )
    side = "volume" if f"{first}_z" in marks else "moving"
    variables: Entries = {"label": ("mark", np.array(labels_of(pairs), dtype=np.str_))}
    roles = ((first, side), (second, "fixed"))
    for (layer, role), axis in product(roles, "xyz"):
        if f"{layer}_{axis}" in pairs:
            variables[f"{role}_{axis}"] = pairs[f"{layer}_{axis}"]
    return xr.Dataset(variables)


def pair_of_layers(
    marks: xr.Dataset,
    *,
    moving: str | None = None,
    fixed: str | None = None,
    name: str = "The file",
) -> tuple[str, str]:
    """Return which layers are the moving and the fixed one.

    Parameters
    ----------
    marks, moving, fixed, name
        As for `used_pairs`.

    Raises
    ------
    MarkError
        If a layer is missing, or it is not clear which ones are meant.
    """
    names = layer_names(marks)
    stated = [*filter(None, (moving, fixed))]
    for layer in stated:
        _check_layer(marks, layer)
    usual = sorted({"moving", "volume"}.intersection(names))
    if usual and "fixed" in names and not stated:
        return usual[0], "fixed"
    _check_clear_pair(names, stated, name)
    free_layers = [n for n in names if n not in stated]
    first = moving or free_layers.pop(0)
    return first, fixed or free_layers.pop(0)


def _check_clear_pair(names: Sequence[str], stated: Sequence[str], name: str) -> None:
    """Refuse layers of which it is not clear which two belong together."""
    if len(names) < 2:
        raise MarkError(
            f"{name} holds marks of one layer only ({', '.join(names) or 'none'}); pairs of a"
            " moving and a fixed layer are needed. Give the second file as well: planish marks"
            " convert MOVING FIXED OUT."
        )
    if len(names) > 2 and len(stated) < 2:
        raise MarkError(
            f"{name} holds {len(names)} layers: {', '.join(names)}. Name the two that belong"
            " together moving and fixed."
        )


def _check_layer(marks: xr.Dataset, layer: str) -> None:
    names = layer_names(marks)
    if layer not in names:
        raise MarkError(
            f"The marks have no layer {layer!r}; they have {', '.join(names) or 'none'}."
        )


def check_marks(marks: xr.Dataset, name: str) -> None:
    """Refuse marks that are not unique or lie at no finite position.

    MarkError names all faults: labels that are there twice, a position that is incomplete or
    farther than a kilometre, two used marks at one place. ``name`` is that of the file, for
    messages.
    """
    labels = labels_of(marks)
    used = used_of(marks)
    if not labels:
        raise MarkError(f"{name} holds no mark. Set marks in both layers and save them again.")
    faults = [
        f"the label {label!r} is there {count} times"
        for label, count in Counter(labels).items()
        if count > 1
    ]
    for layer in layer_names(marks):
        points = points_of(marks, layer)
        missing = np.isnan(points)
        # Farther positions are errors of unit or of writing; within, no arithmetic overflows.
        is_far = (np.abs(points) > 1e9).any(axis=1)
        is_incomplete = missing.any(axis=1) & ~missing.all(axis=1)
        faults += [
            f"{labels[k]} has no position within a kilometre in {layer}"
            for k in np.flatnonzero(is_far | is_incomplete)
        ]
        first: dict[tuple[float, ...], int] = {}
        for k in np.flatnonzero(used & are_known(points)).tolist():
            other = first.setdefault(tuple(points[k].tolist()), k)
            if other != k:
                faults.append(f"{labels[other]} and {labels[k]} have the same position in {layer}")
    raise_faults(name, faults, "Give each mark a label and a place of its own.", error=MarkError)


def check_plausible(marks: xr.Dataset, name: str, unit: Unit | None) -> None:
    """Refuse marks that cannot be um in their layer, or may be pixels where nobody said ``unit``.

    Checked where the layer's pixel size and its size in pixels are known.
    """
    source = marks.attrs.get("read_from", {})
    stated = source.get("stated", True)
    assumed = "" if stated or unit is not None else source["unit"]
    for layer in layer_names(marks):
        about = {"origin_um": {"x": 0.0, "y": 0.0}} | about_layer(marks, layer)
        points = points_of(marks, layer)[in_layers(marks, [layer]), :2]
        if len(points) < 3 or not {"pixel_um", "size_px"} <= about.keys():
            continue
        misfit_text = _misfit(points, about, stated, assumed)
        if misfit_text:
            raise MarkError(f"{name}: the marks in {layer} span {misfit_text}")


def _misfit(points: Floats, about: Entries, stated: bool, assumed: str) -> str:
    """Describe why marks (n, 2) cannot be um in their layer; empty where they can.

    ``about`` holds the layer's ``pixel_um``, ``size_px`` and ``origin_um``; ``stated`` says whether
    the file states its unit. In a unit that was ``assumed``, they may be pixels where their numbers
    lie in the layer as such and reach over more than a quarter of it along one side, as marks are
    set far apart. Taken as um they would all lie in its first corner, a quarter of it or less for
    pixels of 2 um or more.
    """
    pixel = _xy(about["pixel_um"])
    count = _xy(about["size_px"])
    origin = _xy(about["origin_um"])
    size = pixel * count
    span = np.ptp(points, axis=0)
    placed = points - origin
    spans = f"{_size(span)}, the layer {_size(size)}"
    if _fill_as_pixels(placed, count, pixel, assumed):
        return (
            f"{spans}. The file states no unit, {assumed} was assumed, and as pixels they spread"
            f" over the layer: they look like pixels. {_remedy('pixel', stated)} If they are"
            f" {assumed}, give `unit={assumed}` there."
        )
    is_inside = _inside(placed, size)
    pixels_fit = bool(_inside(points, count).all())
    if pixels_fit and _look_clicked(points, placed, pixel):
        return (
            f"{spans}, and all positions are whole or half numbers: they look like pixels. "
            f"{_remedy('pixel', stated)} If they are um, write them with decimals."
        )
    if is_inside.all():
        is_dot = span.max() < 0.01 * size.max()
        if is_dot and _inside(points * 1000, size).all():
            return f"{spans}: they look like mm. {_remedy('mm', stated)}"
        return ""
    reason = (
        f"{np.count_nonzero(~is_inside)} of {len(points)} lie outside it. Check the unit, the"
        " pixel size, and that they belong to this image"
    )
    if pixels_fit:
        reason = f"they look like pixels. {_remedy('pixel', stated)}"
    elif _inside(placed[:, ::-1], size).all():
        reason = (
            "they would fit with x and y exchanged. Exchange the columns: x runs to the right, y"
            " down"
        )
    return f"{spans} from ({origin[0]:g}, {origin[1]:g}) um: {reason}"


def _xy(sides: Mapping[str, float]) -> Floats:
    return np.array([sides["x"], sides["y"]], dtype=np.float64)


def _fill_as_pixels(placed: Floats, count: Floats, pixel: Floats, assumed: str) -> bool:
    """Return whether numbers in an ``assumed`` unit reach over a quarter of so many pixels.

    ``placed`` (n, 2) are um from the layer's first pixel, ``count`` its pixels and ``pixel`` their
    size in um, along x and y. Pixels of less than 4 um2 cannot be told from um.
    """
    numbers = placed / 1000 if assumed == "mm" else placed
    span_share = (np.ptp(numbers, axis=0) / count).max()
    is_spread = span_share > 0.25 and _inside(numbers, count).all()
    return bool(assumed and pixel.prod() >= 4 and is_spread)


def _look_clicked(points: Floats, placed: Floats, pixel: Floats) -> bool:
    """Return whether positions are whole or half numbers, as places clicked on pixels are."""
    are_halves = np.all(points * 2 == np.round(points * 2))
    # Places clicked on pixels and then turned into um are multiples of the pixel.
    places_px = placed / pixel
    off_px = np.abs(places_px - np.round(places_px))
    are_pixels = np.all(off_px < 1e-6)
    # Pixels of nearly 1 um cannot be distinguished from um.
    return bool(are_halves and not are_pixels and pixel.max() > 1.5)


def _remedy(unit: str, stated: bool) -> str:
    """Advise what to do with positions in another unit than um."""
    factor = "1000"
    sizes = ""
    if unit == "pixel":
        factor = "the pixel size"
        sizes = ", `moving_pixel_um` and `fixed_pixel_um`"
    if stated:
        return f"The file says um: multiply them by {factor}."
    return f"Convert them by planish marks convert, given `unit={unit}`{sizes}."


def _inside(points: Floats, size: Floats) -> Bools:
    """Return which points lie in a layer, or outside by a twentieth of it.

    Borders are cut in many ways.
    """
    is_within = (points >= -0.05 * size) & (points <= 1.05 * size)
    return np.all(is_within, axis=1)


def _size(um: Floats) -> str:
    unit, factor = ("um", 1) if max(um) < 100 else ("mm", 1000)
    return f"{um[0] / factor:.3g} x {um[1] / factor:.3g} {unit}"
