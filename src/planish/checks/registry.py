"""The table of all checks of a run.

Also what makes checks of its rows, and what these leave of the figures.
"""

from collections.abc import Iterable, Sequence
from functools import partial
from itertools import repeat
from operator import attrgetter
from typing import Any, TypeVar

import xarray as xr

from planish.checks import files, greys, images, light, registration, sheets, sizes, through_scale
from planish.checks.files import ImageFile
from planish.checks.greys import SheetImage
from planish.checks.registration import (
    DetectedHoles,
    HolesOnSheet,
    JudgedRegistration,
    TextureChecks,
)
from planish.checks.scan import GreyScan, ScannedSheet, read_scan
from planish.checks.sheets import MeasuredSheet
from planish.checks.sizes import SizedLayer
from planish.checks.slices import slice_order
from planish.checks.through_scale import RegisteredSheet
from planish.core.checks import CORRELATION, POSITION, PROPERTIES, Check, CheckRule, trust_of
from planish.core.threads import map_threads
from planish.measure.registry import HEIGHTS
from planish.results import (
    ComparisonRow,
    CorrelationRow,
    EvidenceFacts,
    ExpectedError,
    LagNumbers,
    LayerFacts,
    LinkedArea,
    PropertyFacts,
    Results,
)

Figure = TypeVar("Figure", CorrelationRow, ComparisonRow, PropertyFacts, ExpectedError)
_pair_of = attrgetter("a", "a_map", "b", "b_map")  # maps of two layers
_MAPS = (PROPERTIES,)
_PLACE = (POSITION,)
_R = (CORRELATION,)
_MAPS_AND_PLACE = (PROPERTIES, POSITION)
_PLACE_AND_R = (POSITION, CORRELATION)
_ALL = (PROPERTIES, POSITION, CORRELATION)
_BASE = ("base_thickness", "thickness")
_ABOVE_FORM = (*HEIGHTS, "roughness_top", "roughness_bottom")
_VOIDS = ("porosity", "pore_chord", "pore_diameter")
_THICKNESSES = ("thickness", "coating_top", "coating_bottom", "base_thickness")
_SIDES = ("coating_top", "coating_bottom", *HEIGHTS, "half_thickness_top", "half_thickness_bottom")
_INTERFACES = ("coating_top", "coating_bottom", "base_surface_top", "base_surface_bottom", *_BASE)
CHECKS = (
    # planish map: from the maps of a sheet
    CheckRule("coverage", MeasuredSheet, _MAPS, sheets.coverage),
    CheckRule("missing voxels", MeasuredSheet, _MAPS, sheets.missing_voxels),
    CheckRule("film", MeasuredSheet, _MAPS, sheets.film),
    CheckRule("fold-over", MeasuredSheet, _PLACE, sheets.fold_over),
    CheckRule("alignment", MeasuredSheet, _MAPS_AND_PLACE, sheets.alignment),
    CheckRule("cut-off", MeasuredSheet, _PLACE, sheets.cutoff),
    CheckRule("scale through the sheet", MeasuredSheet, _ALL, through_scale.scale_by_thickness),
    CheckRule("field of the topography", MeasuredSheet, _ABOVE_FORM, sheets.field_of_heights),
    CheckRule("corrections", MeasuredSheet, _MAPS, sheets.corrections),
    # planish map and link: from what a file says of its size
    CheckRule("size by dpi", SizedLayer, _ALL, sizes.size_by_dpi),
    # planish map: from the volume
    CheckRule("hand of the volume", ScannedSheet, _PLACE_AND_R, files.hand_of_volume),
    CheckRule("reading of the volume", ScannedSheet, _ALL, files.reading),
    CheckRule("slices along z", ScannedSheet, _ALL, partial(slice_order, axis="z")),
    CheckRule("slices along y", ScannedSheet, _ALL, partial(slice_order, axis="y")),
    CheckRule("slices along x", ScannedSheet, _ALL, partial(slice_order, axis="x")),
    CheckRule("clipped grey", GreyScan, _INTERFACES, greys.clipped_grey),
    CheckRule("grey of the coating", GreyScan, _INTERFACES, greys.coating_grey),
    CheckRule("porosity", GreyScan, _VOIDS, greys.porosity),
    CheckRule("filler", GreyScan, ("filler", "filler_weight"), greys.filler),
    CheckRule("grey of the slices", GreyScan, _MAPS, greys.steady_grey),
    CheckRule("grey across the sheet", GreyScan, _MAPS, greys.shading),
    CheckRule("one sheet", GreyScan, _MAPS_AND_PLACE, sheets.one_sheet),
    CheckRule("blur of the scan", GreyScan, _MAPS_AND_PLACE, greys.blur),
    CheckRule("voxels through the sheet", ScannedSheet, _THICKNESSES, sheets.voxels_through),
    CheckRule("dust, top", ScannedSheet, ("coating_top", *_BASE), partial(sheets.dust, side="top")),
    CheckRule(
        "dust, bottom",
        ScannedSheet,
        ("coating_bottom", *_BASE),
        partial(sheets.dust, side="bottom"),
    ),
    # planish link: from an image
    CheckRule("hand of the image", ImageFile, _PLACE_AND_R, files.hand_of_image),
    CheckRule("white image", ImageFile, _R, images.white_image),
    CheckRule("linear grey", ImageFile, _R, images.linear_grey),
    # planish link: from a registration
    CheckRule("scale through the sheet", RegisteredSheet, _ALL, through_scale.scale_by_marks),
    CheckRule("marks", JudgedRegistration, _PLACE, registration.marks),
    CheckRule("scale", JudgedRegistration, _MAPS_AND_PLACE, registration.scale),
    CheckRule(
        "strain of the registration",
        JudgedRegistration,
        (POSITION, PROPERTIES),
        registration.strain,
    ),
    CheckRule("tilt of the holes", JudgedRegistration, (POSITION, PROPERTIES), registration.tilt),
    CheckRule("machine direction", JudgedRegistration, _PLACE, registration.machine_direction),
    CheckRule(
        "holes in NAME",
        DetectedHoles,
        (POSITION, PROPERTIES, CORRELATION),
        registration.holes_of_layer,
    ),
    # planish link: from the layers on one grid
    CheckRule("common field", LayerFacts, _R, registration.common_field),
    CheckRule(
        "holes without partner",
        HolesOnSheet,
        _PLACE_AND_R,
        registration.holes_without_partner,
    ),
    CheckRule("clipped image", SheetImage, _R, greys.clipped_image),
    CheckRule(
        "side and specimen",
        TextureChecks,
        (*_SIDES, POSITION, CORRELATION),
        lambda _, textures: textures.side,
    ),
    CheckRule(
        "position by texture",
        TextureChecks,
        _PLACE_AND_R,
        lambda _, textures: textures.position,
    ),
    CheckRule(light.EVEN_LIGHT, EvidenceFacts, _R, light.even_light),
    CheckRule("side light", LagNumbers, _R, light.side_light),
    CheckRule("linked area", LinkedArea, _R, registration.linked_area),
)
"""Rows in the order of the results, each a :class:`planish.core.checks.CheckRule`."""


def run_checks(subject: object, *layers: str) -> list[Check]:
    """Judge a subject by all rows of its class, as checks about ``layers``."""
    rules = [rule for rule in CHECKS if isinstance(subject, rule.stage)]
    checks = map_threads(CheckRule.__call__, rules, repeat(subject))
    return for_layers([check for check in checks if check is not None], *layers)


def for_layers(checks: Iterable[Check], *layers: str) -> list[Check]:
    """Checks with the layers that they are about.

    One layer of a sheet, two of a registration or a comparison.
    """
    return [check.model_copy(update={"layers": layers}) for check in checks]


def check_scan(
    volume: xr.DataArray,
    measured: xr.Dataset,
    *,
    sections: bool = False,
    labels: bool = False,
    threads: int | None = None,
) -> tuple[Check, ...]:
    """Check a volume and the sheet that was measured in it.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um; parts of it are read, in one pass
    measured : Dataset, dims (y, x); surfaces and properties, heights in um
    sections : bool; whether planish joined serial sections to the volume: what it bridged itself is
    no fault
    labels : bool; whether voxels are labels, which have no grey scale
    threads : int, optional; no result depends on it
    """
    scan = read_scan(volume, measured, sections=sections, labels=labels, threads=threads)
    return tuple(run_checks(scan))


def check_holes(holes: xr.Dataset) -> Check:
    """Check how many holes were found and what was rejected; a look where places were not measured.

    Parameters
    ----------
    holes : Dataset, dims (mark)
        Of :func:`planish.marks.find_holes` or :func:`planish.marks.find_sheet_holes`.
    """
    return run_checks(DetectedHoles("", holes))[0].model_copy(update={"name": "holes"})


# --- what checks mean for figures -----------------------------------------------------------------


def apply_checks(results: Results) -> Results:
    """Mark every figure by the checks that concern it.

    What a failed check concerns loses its numbers: rows stay without them, and evidence beside such
    a row goes.
    """
    checks = results.checks
    if all(check.state in ("pass", "unknown") for check in checks):
        return results
    rows = rows_with_trust(results.correlations, checks)
    withheld_pairs = {_pair_of(row) for row in rows if row.trust == "withheld"}
    layers = [_layer_with_trust(layer, checks) for layer in results.layers]
    layer_names = [layer.name for layer in layers]
    comparison = [
        _marked(row, checks, layer_names, row.property, POSITION, CORRELATION)
        for row in results.comparison
    ]
    update = {
        "layers": tuple(layers),
        "correlations": rows,
        "comparison": tuple(comparison),
        "evidence": tuple(e for e in results.evidence if _pair_of(e) not in withheld_pairs),
    }
    return results.model_copy(update=update)


def rows_with_trust(
    rows: Iterable[CorrelationRow], checks: Sequence[Check]
) -> tuple[CorrelationRow, ...]:
    """Mark correlations by the checks that concern them.

    Parameters
    ----------
    rows : iterable of CorrelationRow
    checks : sequence of Check

    Returns
    -------
    tuple of CorrelationRow
        Without numbers where a check that concerns them failed.
    """
    return tuple(
        _marked(row, checks, (row.a, row.b), row.a_map, row.b_map, POSITION, CORRELATION)
        for row in rows
    )


def _layer_with_trust(layer: LayerFacts, checks: Sequence[Check]) -> LayerFacts:
    """A layer whose properties and expected error are marked by the checks that concern them."""
    updates: dict[str, Any] = {}
    layers = (layer.name,)
    if (sheet := layer.sheet) is not None:
        properties = {k: _marked(p, checks, layers, k) for k, p in sheet.properties.items()}
        # The sheet's numbers are made of the maps.
        is_withheld = any(p.trust == "withheld" for p in properties.values())
        numbers = None if is_withheld else sheet.numbers
        sheet_updates = {"properties": properties, "numbers": numbers}
        updates["sheet"] = sheet.model_copy(update=sheet_updates)
    r = layer.registration
    if r is not None and r.expected_error is not None:
        error = _marked(r.expected_error, checks, layers, POSITION)
        updates["registration"] = r.model_copy(update={"expected_error": error})
    return layer.model_copy(update=updates)


def _marked(
    figure: Figure, checks: Sequence[Check], layers: Sequence[str], *figures: str
) -> Figure:
    """Give a figure of some layers its trust, and take its numbers where they are withheld."""
    trust = trust_of(checks, layers, figures)
    blank_fields = dict.fromkeys(figure.WITHHELD) if trust == "withheld" else {}
    return type(figure).model_validate({**dict(figure), **blank_fields, "trust": trust})
