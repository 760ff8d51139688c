"""Compare layers on one grid with each other.

Correlation, differences of equal quantities, and other registrations.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product, repeat
from typing import ClassVar, NamedTuple

import numpy as np
import xarray as xr
from pydantic import Field

from planish.analyze.agreement import LIMIT
from planish.analyze.correlation import Correlation, PairAtSizes, PairSums
from planish.analyze.differences import holm, paired_difference
from planish.analyze.distributions import around
from planish.analyze.light_field import without_light
from planish.core.area import valid_in_all
from planish.core.axial import is_axial
from planish.core.bands import read_bands
from planish.core.errors import MarkError
from planish.core.facts import NULL, Interval, Trust, Value
from planish.core.grid import Grid, pitch, values_at
from planish.core.tables import grouped
from planish.core.threads import map_threads
from planish.core.typing import Array, Bools, Entries, Pixel, TwoFields
from planish.measure import PROPERTIES
from planish.measure.registry import NEGATIVE_CONTROLS
from planish.register import FittedTransform, fit_transform
from planish.resample import Mesh, resample

CELLS = 2**16
"""Of a map, by which the independent points of a correlation are counted and its scales are
told."""

REGISTRATION_VARIANTS = (
    ("projection, no scale", ("projected_u", "projected_v"), "rigid"),
    ("projection, similarity", ("projected_u", "projected_v"), "similarity"),
    ("flattened, similarity", ("u", "v"), "similarity"),
)
"""Registrations of a sheet to an image that the paper compares: name, coordinates, model."""


class _Judged(Correlation):
    trust: Trust = "ok"
    """What the checks leave of the figures."""


_NUMBERS_OF_R = tuple(
    name for name in Correlation.model_fields if name not in ("point_um", "n", "warnings")
)


class CorrelationRow(_Judged):
    """Correlation of two maps over points of one size.

    ``slope`` and ``intercept`` give b from a.
    """

    WITHHELD: ClassVar = (
        *_NUMBERS_OF_R,
        "p_of_table",
        "difference_mean",
        "difference_sd",
        "limits",
    )

    a: str
    """First layer."""
    a_map: str
    """Its map."""
    b: str
    """Second layer."""
    b_map: str
    """Its map."""
    negative_control: bool = Field(
        default_factory=lambda fields: (
            not {fields.get("a_map"), fields.get("b_map")}.isdisjoint(NEGATIVE_CONTROLS)
        )
    )
    """Whether the map is the pose in the scanner and no property of the paper."""
    p_of_table: Value = NULL
    """p after Holm, corrected for the number of rows at this point size; of a negative control p
    alone, which counts among no properties."""
    same_quantity: bool = False
    """Whether both maps are of one quantity, so that their difference means something."""
    difference_mean: Value = NULL
    """Mean of b less a, for equal quantities."""
    difference_sd: Value = NULL
    """Standard deviation of that difference."""
    limits: Interval = NULL
    """Limits of agreement: where 95 % of the differences lie."""
    units: str | None = None
    """Unit of the difference."""


class ComparisonRow(_Judged):
    """The headline correlation by one registration.

    Registrations are compared as in the paper, all on the same pixels.
    """

    WITHHELD: ClassVar = (*_NUMBERS_OF_R, "difference", "difference_interval")

    registration: str
    """How the map was laid on the image."""
    property: str
    """The map."""
    marks_rms_um: float
    """Root mean square of the residuals of the marks."""
    difference: Value = NULL
    """r of the run's own registration minus this r."""
    difference_interval: Interval = NULL
    """95 % interval of the difference."""


def is_property(data: xr.DataArray) -> bool:
    """Whether a map is a measured property; standard errors, places and masks are none."""
    attrs = data.attrs
    if attrs.get("role") == "property":
        return True
    return "support_um" in attrs and not str(data.name).endswith("_se")


def maps_to_correlate(maps: xr.Dataset) -> list[str]:
    """List the maps of a layer that are correlated.

    Its image, or all properties but angles of an axis and standard errors.
    """
    if "image" in maps and "thickness" not in maps:
        return ["image"]
    names: list[str] = []
    for name, data in maps.data_vars.items():
        if is_property(data) and not is_axial(data):
            names.append(str(name))
    # A store gives its maps in the order of the alphabet: here they stand in one order, wherever
    # they come from.
    order = {name: index for index, name in enumerate(PROPERTIES)}
    return sorted(names, key=lambda name: (order.get(name, len(order)), name))


def correlate_layers(
    a: str,
    b: str,
    maps: dict[str, xr.Dataset],
    point_um: float,
    *,
    light_off: bool = False,
) -> Iterator[CorrelationRow]:
    """Correlate two layers point by point, per pixel and over larger points.

    Parameters
    ----------
    a, b : str; names of the layers: two sheets, or a sheet and an image
    maps : dict of str to Dataset, dims (y, x); layers on one grid, by their names
    point_um : float, in um; edge of the larger points
    light_off : bool; whether a smooth field was taken off the image

    Yields
    ------
    CorrelationRow
        Of two sheets the same properties, with their differences; of a sheet and an image every
        property with the image.
    """
    layers = maps[a], maps[b]
    names_a, names_b = (maps_to_correlate(layer) for layer in layers)
    are_sheets = "image" not in [*names_a, *names_b]
    pairs = [*product(names_a, names_b)]
    if are_sheets:
        pairs = [(name, name) for name in names_a if name in names_b]
    rows: list[CorrelationRow] = []
    all_sums = _sums_of_pairs(layers, pairs, point_um)
    for (a_map, b_map), pair_sums in zip(pairs, all_sums, strict=True):
        correlations = _sizes(pair_sums, light_off=light_off)
        if not correlations[0][0].n:
            continue
        maps_of_row = {"a": a, "a_map": a_map, "b": b, "b_map": b_map}
        units = str(layers[0][a_map].attrs.get("units", "1"))
        for correlation, sums in correlations:
            agreement = _agreement(sums, units) if are_sheets else {}
            rows.append(CorrelationRow.holding(correlation, **maps_of_row, **agreement))
    yield from _with_p_of_table(rows)


def _sums_of_pairs(
    layers: tuple[xr.Dataset, xr.Dataset], pairs: Sequence[tuple[str, str]], point_um: float
) -> list[PairAtSizes]:
    """Sum up pairs of maps of two layers over the pixels valid in both, in one pass.

    A pair names the map of the first layer and that of the second. A map is read once, however many
    pairs it is in: its key is the number of its layer and its name.
    """
    sums = _empty_sums(Grid.of(layers[0]), point_um, len(pairs))
    keys = dict.fromkeys(key for pair in pairs for key in enumerate(pair))
    maps = [layers[k][name] for k, name in keys]
    masks = [layer["valid"] for layer in layers]
    for rows, (valid_a, valid_b, *parts) in read_bands(*masks, *maps):
        is_valid = valid_a & valid_b
        masked = [np.where(is_valid, part, np.nan) for part in parts]
        values = dict(zip(keys, masked, strict=True))
        # Bands of the first and of the second map of each pair.
        x = [values[0, name] for name, _ in pairs]
        y = [values[1, name] for _, name in pairs]
        map_threads(PairAtSizes.add, sums, repeat(rows.start), x, y)
    return sums


def _empty_sums(grid: Grid, point_um: float, count: int) -> list[PairAtSizes]:
    return [
        PairAtSizes(grid.shape, pixel_um=grid.pixel_um, point_um=point_um, most_cells=CELLS)
        for _ in range(count)
    ]


def _agreement(sums: PairSums, units: str) -> Entries:
    """Differences of two maps of one quantity."""
    mean, sd = sums.difference
    return {
        "same_quantity": True,
        "difference_mean": mean,
        "difference_sd": sd,
        "limits": around(mean, LIMIT * sd),
        "units": units,
    }


def _with_p_of_table(rows: Sequence[CorrelationRow]) -> list[CorrelationRow]:
    """Correct p for the number of properties at each point size; negative controls count alone."""
    controls = [row.a_map if row.negative_control else "" for row in rows]
    sizes_um = [row.point_um for row in rows]
    families = grouped(range(len(rows)), lambda k: (sizes_um[k], controls[k]))
    corrected = [*rows]
    for indices in families.values():
        p_of_family = holm([rows[k].p for k in indices])
        for k, p in zip(indices, p_of_family, strict=True):
            corrected[k] = rows[k].model_copy(update={"p_of_table": p})
    return corrected


def _sizes(sums: PairAtSizes, *, light_off: bool) -> list[tuple[Correlation, PairSums]]:
    """The correlations of all sizes with their sums, as sure as a field of light leaves them."""
    (pixel, pixel_sums), (points, point_sums) = sums.sizes()
    if light_off:
        pixel, points = without_light(pixel, points, *sums.points())
    return [(pixel, pixel_sums), (points, point_sums)]


class _Variant(NamedTuple):
    """A registration that is compared.

    Its name, the residual of the marks, and the sheet's mesh laid by it.
    """

    title: str
    rms_um: float
    mesh: Mesh | None  # None: that of the run, whose maps are there

    def bring(self, sheet_map: Array, linked_map: Array, grid_part: Grid) -> Array:
        """Bring a field of the sheet to some pixels of the image.

        There it is ``linked_map`` of the run.
        """
        if self.mesh is None:
            return linked_map
        nodes, places = self.mesh.under(grid_part)
        return resample(sheet_map[nodes], places)


def comparison_rows(
    linked: xr.Dataset,
    sheet: Mapping[str, xr.Dataset],
    fit: FittedTransform,
    *,
    name: str,
    point_um: float,
    away: Callable[[Grid], Bools],
    light_off: bool = False,
) -> Iterator[ComparisonRow]:
    """Yield the headline correlation by the registrations the paper compares and by the run's.

    ``linked`` are the maps on the pixels of the image, ``sheet`` those of the sheet: surfaces, maps
    and flat coordinates; ``name`` is the map that leads. ``away`` gives the pixels of a part of the
    grid that are away from holes. All marks count, as in the paper: misfits show a wrong
    registration.
    """
    grid = Grid.of(linked)
    sheet_map = sheet["surfaces"][name].values
    variant_of_run = _Variant(f"flattened, {fit.model}", fit.rms_um, None)
    variants = [*_variants(sheet, fit), variant_of_run]
    sums = _empty_sums(grid, point_um, len(variants))
    maps = [linked[key] for key in (name, "valid", "image")]
    for rows, (linked_map, is_valid, image) in read_bands(*maps):
        part = grid.part(rows)
        placed = [variant.bring(sheet_map, linked_map, part) for variant in variants]
        # Rows that are compared are of the same pixels.
        valid = valid_in_all(placed, [is_valid, away(part)])
        compared = [np.where(valid, m, np.nan) for m in placed]
        map_threads(PairAtSizes.add, sums, repeat(rows.start), compared, repeat(image))
    of_run = _rows_with_maps(sums[-1], point_um, light_off=light_off)
    for variant, variant_sums in zip(variants, sums, strict=True):
        rows = _rows_with_maps(variant_sums, point_um, light_off=light_off)
        for row, row_of_run in zip(rows, of_run, strict=True):
            change: Entries = {}
            if variant.mesh is not None and row.correlation.n:
                change = _change(row, row_of_run)
            yield ComparisonRow.holding(
                row.correlation,
                registration=variant.title,
                property=name,
                marks_rms_um=variant.rms_um,
                **change,
            )


class _RowWithMaps(NamedTuple):
    """A correlation, with the two maps that stand for it and their pixel."""

    correlation: Correlation
    maps: TwoFields
    pixel_um: Pixel


def _rows_with_maps(sums: PairAtSizes, point_um: float, *, light_off: bool) -> list[_RowWithMaps]:
    """The correlations of all sizes."""
    (pixel, _), (points, _) = _sizes(sums, light_off=light_off)
    (x, y), cell_um = sums.cells()
    of_pixel = _RowWithMaps(pixel, (x, y), cell_um)
    return [of_pixel, _RowWithMaps(points, sums.points(), point_um)]


def _change(row: _RowWithMaps, row_of_run: _RowWithMaps) -> Entries:
    """How much larger r is by the registration of the run, with the interval of that."""
    change_of_r = row_of_run.correlation.r - row.correlation.r
    change = paired_difference(row.maps, row_of_run.maps, pixel_um=row_of_run.pixel_um)
    # The interval is told from cells, which may be larger than the pixels that r is of.
    offset = change_of_r - change.difference
    low, high = change.interval
    return {"difference": change_of_r, "difference_interval": (low + offset, high + offset)}


def _variants(sheet: Mapping[str, xr.Dataset], fit: FittedTransform) -> Iterator[_Variant]:
    """Registrations of the paper but that of the run, each fitted anew to the marks of the run.

    Places of marks are in the flat sheet; those by projection are read off maps of the projected
    coordinates there.
    """
    least_um = min(pitch(sheet["surfaces"]))
    for title, coordinates, model in REGISTRATION_VARIANTS:
        if model == fit.model and coordinates == ("u", "v"):
            continue  # the run's own
        marks = fit.moving
        if coordinates != ("u", "v"):
            marks = values_at(sheet["maps"], coordinates, marks)
        if not np.isfinite(marks).all():
            raise MarkError(
                "A mark lies outside the flattened sheet. Remove it from the table of marks."
            )
        variant_fit = fit_transform(
            marks, fit.fixed, model=model, mirrored=fit.mirrored, robust=False
        )
        nodes = [sheet["flat"][coordinate].values for coordinate in coordinates]
        uv = np.stack(nodes, axis=-1)
        mesh = Mesh.of(variant_fit.transform(uv), least_um=least_um)
        yield _Variant(title, variant_fit.rms_um, mesh)
