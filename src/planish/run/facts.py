"""Results of the stages, put into the models of ``results.json``."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from planish.analyze import LagNumbers
from planish.analyze.compare import is_property
from planish.analyze.image_values import image_facts
from planish.analyze.leading_map import leading_map
from planish.checks.light import EVEN_LIGHT
from planish.core.axial import distribution, summable_of
from planish.core.bands import read_bands, thinned
from planish.core.checks import CORRELATION, POSITION, Check, concerned, trust_of
from planish.core.facts import InputFile, Interval, Side, is_known
from planish.core.grid import Grid, pitch
from planish.core.numbers import capital, with_article
from planish.core.tables import table_text
from planish.core.typing import Bools, Entries, Floats
from planish.io import fingerprint
from planish.measure.registry import has_true_zero
from planish.register import FittedTransform
from planish.results import (
    CorrelationRow,
    EvidenceFacts,
    ExpectedError,
    LayerFacts,
    LinkedArea,
    OrientationFacts,
    PropertyFacts,
    RegistrationFacts,
    Results,
    SectionFacts,
    SheetFacts,
    SurfaceFacts,
)
from planish.run.layers import Link, LinkedLayer, MappedLayer
from planish.run.position_error import error_shares


def input_file(data: xr.DataArray, path: str) -> InputFile:
    """What a file is, as its reader noted it in the attributes of a volume or an image."""
    attrs = data.attrs
    size = "voxel_um" if "voxel_um" in attrs else "pixel_um"
    stored_dtype = attrs.get("stored_dtype", data.dtype)
    return InputFile(
        name=attrs["file_name"],
        shape=data.shape,
        dtype=str(stored_dtype),
        bytes=attrs["file_bytes"],
        sha256=fingerprint(path),
        size_um=tuple(attrs[size]),
        size_source=attrs[f"{size}_source"],
        size_doubt=attrs.get("size_doubt", ""),
    )


def surface_facts(surfaces: xr.Dataset) -> SurfaceFacts:
    """What the surface search learnt and how much of the sheet it measured."""
    status = surfaces["status"]
    shares: dict[str, float] = {}
    for k, name in enumerate(str(status.attrs["flag_meanings"]).split()):
        is_so = status.values == k
        shares[name] = float(is_so.mean())
    facts = {k: surfaces.attrs.get(k) for k in SurfaceFacts.model_fields}
    facts |= {"columns": status.size, "shares": shares}
    for count in ("particles_removed", "half_closed_holes"):
        facts[count] = int(facts[count] or 0)
    return SurfaceFacts.model_validate(facts)


def _known(data: xr.DataArray) -> Floats:
    """The values of a map that are known, one after the other."""
    return data.values[np.isfinite(data.values)].astype(np.float64)


def _error_facts(errors: xr.DataArray, column_um2: float) -> Entries:
    """Error of a column, how many of them are independent, and the error of their mean.

    ``errors`` are standard errors of a map (y, x), ``column_um2`` is the area of a column. The
    attribute ``patch_um2`` is the area that one value speaks for, ``common_um`` the part of the
    error that all columns share, which no mean makes smaller. Without ``patch_um2``, which older
    runs lack, nothing is said of the mean.
    """
    values = _known(errors)
    if not values.size:
        return {}
    facts: Entries = {"standard_error": float(np.median(values))}
    if "patch_um2" in errors.attrs:
        patches_per_column = column_um2 / float(errors.attrs["patch_um2"])
        n_independent = max(1.0, values.size * min(1.0, patches_per_column))
        common_um2 = float(errors.attrs["common_um"]) ** 2
        variance_um2 = np.mean(np.maximum(values**2 - common_um2, 0.0))
        facts["n_independent"] = int(n_independent)
        facts["mean_standard_error"] = float(np.sqrt(variance_um2 / n_independent + common_um2))
    return facts


def property_facts(surfaces: xr.Dataset) -> dict[str, PropertyFacts]:
    """Distribution of each property over the columns (y, x), with its standard errors.

    Those that were measured nowhere are left out. The coefficient of variation is None where a
    property has no zero of its own, as a height.
    """
    facts: dict[str, PropertyFacts] = {}
    for name, data in surfaces.data_vars.items():
        values = _known(data) if is_property(data) else np.empty(0)
        if not values.size:
            continue
        vectors = summable_of(surfaces, name)[np.isfinite(data.values)]
        # Angles of an axis are counted from their mean, so that 179 degrees lie beside 0.
        mean, sd, near_mean = distribution(values, vectors)
        percentiles = np.percentile(near_mean, [5, 50, 95])
        p5, median, p95 = map(float, percentiles)
        has_cov = has_true_zero(str(name)) and mean > 0
        error_facts: Entries = {}
        if f"{name}_se" in surfaces:
            error_facts = _error_facts(surfaces[f"{name}_se"], math.prod(pitch(surfaces)))
        facts[str(name)] = PropertyFacts(
            units=data.attrs["units"],
            n=values.size,
            mean=mean,
            sd=sd,
            coefficient_of_variation=sd / mean if has_cov else None,
            p5=p5,
            median=median,
            p95=p95,
            support_um=data.attrs.get("support_um"),
            period_deg=data.attrs.get("period_deg"),
            **error_facts,
        )
    return facts


def section_facts(sections: xr.Dataset) -> SectionFacts:
    """How serial sections were joined: shifts and gains of those that could be aligned."""
    attrs = sections.attrs
    is_aligned = sections["aligned"].values
    gains = sections["gain"].values[is_aligned]
    row_jitter_um, col_jitter_um = attrs["jitter_left_um"]
    facts = {k: v for k, v in attrs.items() if k in SectionFacts.model_fields}
    facts |= {
        "count": is_aligned.size,
        "not_aligned": int(np.count_nonzero(~is_aligned)),
        "gain_sd": float(np.std(gains)),
        "jitter_left_row_um": float(row_jitter_um),
        "jitter_left_col_um": float(col_jitter_um),
    }
    for axis in ("row", "col"):
        shift_um = sections[f"shift_{axis}"].values[is_aligned]
        facts[f"shift_{axis}_rms_um"] = float(np.sqrt(np.mean(shift_um**2)))
    return SectionFacts.model_validate(facts)


def layer_facts(
    linked: LinkedLayer, *, side: Side, lag: LagNumbers | None, headline: str | None
) -> LayerFacts:
    """What a layer is, how much of the reference it covers, and how it was registered.

    ``side`` is that which shows, ``lag`` how far its texture lies beside that of the reference
    (None where that was not measured), ``headline`` the map of sheets that the study names.
    """
    layer, link, maps = linked.layer, linked.link, linked.maps
    shown = maps["volume_z" if layer.kind == "sheet" else "image"]
    pixels = 0
    for _, (values,) in read_bands(shown):
        pixels += int(np.count_nonzero(np.isfinite(values)))
    image = None
    if layer.params.image is not None:
        image = image_facts(layer.params.image, layer.corrected and layer.corrected.facts)
    registration = None if link is None else _registration_facts(link, maps, lag)
    return LayerFacts(
        name=layer.name,
        kind=layer.kind,
        source=layer.source,
        headline=leading_map(maps, side, headline),
        share_of_reference=pixels / shown.size,
        sheet=layer.facts,
        image=image,
        registration=registration,
    )


def _registration_facts(link: Link, maps: xr.Dataset, lag: LagNumbers | None) -> RegistrationFacts:
    """How a layer was registered to the next one of its path.

    ``maps`` are those of the layer on the reference; their expected error is of the whole path.
    """
    registration = link.registration
    fit = registration.fit
    layer, fixed = link.path[:2]
    _, (errors_um,) = thinned(maps["expected_error"])
    errors_um = errors_um[np.isfinite(errors_um)]
    expected_error = None
    if errors_um.size:
        shares = error_shares(maps, has_shared=fit.shared_um > 0)
        median_um = np.median(errors_um)
        expected_error = ExpectedError(
            median_um=median_um, largest_um=errors_um.max(), shares=shares
        )
    return RegistrationFacts(
        to=fixed.name,
        path=tuple(layer.name for layer in link.path),
        source=registration.source,
        found_moving=registration.count("moving"),
        found_fixed=registration.count("fixed"),
        matched=int(np.count_nonzero(fit.robust_weights)),
        second_best=registration.second_best,
        match_sentence=registration.sentence,
        design=registration.design,
        tilt=registration.tilt,
        model=fit.model,
        model_sentence=fit.sentence,
        warnings=fit.warnings,
        rms_um=fit.rms_um,
        leave_one_out_rms_um=fit.leave_one_out_rms_um,
        scale=fit.transform.scale,
        mirrored=fit.mirrored,
        expected_error=expected_error,
        rotation_deg=np.rad2deg(fit.transform.rotation_rad),
        shift_um=fit.transform.shift_um,
        orientation=_orientation_facts(layer, fixed, fit),
        lag=lag,
        false_probability=registration.false_probability,
    )


def _side_sentence(layer: MappedLayer) -> str:
    name = with_article(layer.name)
    if layer.side_given is not None:
        return f"{capital(name)} shows the {layer.side} side of the sheet, as given."
    if layer.side_found is not None:
        return f"Side of {name} not given; its texture is mirrored, so it shows the bottom side."
    return f"Side of {name} not given; top side assumed."


def _orientation_facts(
    moving: MappedLayer, fixed: MappedLayer, fit: FittedTransform
) -> OrientationFacts:
    """How two registered layers lie on each other: side, hand and machine direction, as given.

    Nothing is guessed. Layers that show opposite sides see each other mirrored; where the marks
    fit mirrored without that, or do not with it, one of them is a mirror image (``is_reversed``).
    """
    is_reversed = fit.mirrored != (moving.side != fixed.side)
    md_fixed_deg = None
    if moving.md_deg is not None:  # an axis, deg clockwise on screen from x: 0 to 180
        angle_rad = np.deg2rad(moving.md_deg)
        direction = (np.cos(angle_rad), np.sin(angle_rad))
        x, y = fit.transform.matrix() @ direction
        md_fixed_deg = float(np.rad2deg(np.arctan2(y, x)) % 180.0)
    sentences = [_side_sentence(layer) for layer in (moving, fixed) if layer.kind == "image"]
    if is_reversed:
        sentences.append(
            f"The marks fit mirrored only: the {moving.name} is numbered against the usual sense."
        )
    hand_texts = [layer.hand_text for layer in (moving, fixed) if layer.hand_text]
    if hand_texts:
        sentences += hand_texts
        fit_text = "mirrored, which agrees with that" if is_reversed else "as they are stored"
        sentences.append(f"The layers fit on each other {fit_text}.")
    sentences.append(_direction_sentence(moving, fixed, md_fixed_deg))
    return OrientationFacts(
        image_side=fixed.side,
        side_given=fixed.side_given is not None or fixed.kind == "sheet",
        mirrored_volume=is_reversed,
        md_deg_moving=moving.md_deg,
        md_deg_fixed=fixed.md_deg,
        md_deg_fixed_from_moving=md_fixed_deg,
        sentence=" ".join(sentences),
    )


def _direction_sentence(moving: MappedLayer, fixed: MappedLayer, md_fixed_deg: float | None) -> str:
    md_text = "The machine direction lies at"
    if md_fixed_deg is not None:
        given_text = "." if fixed.md_deg is None else f"; {_angle(fixed.md_deg)} was given there."
        return (
            f"{md_text} {_angle(moving.md_deg)} in the {moving.name} and so at"
            f" {_angle(md_fixed_deg)} in the {fixed.name}{given_text}"
        )
    if fixed.md_deg is None:
        return "Machine direction not given."
    return (
        f"{md_text} {_angle(fixed.md_deg)} in the {fixed.name}, as given; none was given for the"
        f" {moving.name}."
    )


def _angle(deg: float | None) -> str:
    return f"{(deg or 0.0) % 180.0:.1f}".removesuffix(".0") + "°"


def linked_area(linked: xr.Dataset, mask: Callable[[Grid], Bools]) -> LinkedArea:
    """How much of the reference shows the sheet, and how much of that is valid.

    ``linked`` (y, x) has the flat coordinate ``u``, finite on the sheet, and ``valid``. ``mask``
    tells of pixels whether they lie away from holes and declared regions.
    """
    grid = Grid.of(linked)
    n_on_sheet = n_off_holes = n_valid = 0
    for rows, (u, valid) in read_bands(linked["u"], linked["valid"]):
        is_sheet = np.isfinite(u)
        n_on_sheet += int(is_sheet.sum())
        n_off_holes += int((is_sheet & mask(grid.part(rows))).sum())
        n_valid += int(np.count_nonzero(valid))
    pixels = math.prod(grid.shape)
    return LinkedArea(
        pixels=pixels,
        share_on_sheet=n_on_sheet / pixels,
        share_valid=n_valid / pixels,
        share_valid_of_sheet=n_valid / max(n_on_sheet, 1),
        share_valid_away_from_holes=n_valid / max(n_off_holes, 1),
    )


Rows = Iterator[Sequence[Any]]  # of a table
_LIGHT_OFF = "a quadratic field of light off"  # beside an r in ``figures.csv``


def figures_text(results: Results) -> str:
    """Text of ``figures.csv``: a row for every figure that the page leads with.

    ``trust`` is ``ok``, ``doubtful`` or ``withheld`` (then there is no value), ``checks`` names the
    checks that say so.
    """
    header = (
        "layers",
        "figure",
        "statistic",
        "value",
        "standard_error",
        "units",
        "n",
        "trust",
        "checks",
    )
    return table_text(header, [*_figure_rows(results)])


def _text(figure: float | None) -> float | str:
    return "" if figure is None or not is_known(figure) else figure


def _property_rows(layer: str, sheet: SheetFacts, why: Callable[[str], str]) -> Rows:
    """Give a row for each figure of each property; ``why`` names the checks that concern one.

    A figure is (statistic, value, standard error, units); None is a cell that stays empty.
    """
    for name, p in sheet.properties.items():
        trust_cells = (p.n, p.trust, why(name))
        figures = [("mean", p.mean, p.mean_standard_error, p.units)]
        figures.append(("sd", p.sd, None, p.units))
        if p.coefficient_of_variation is not None:
            figures.append(("coefficient of variation", p.coefficient_of_variation, None, "1"))
        if name in sheet.uncovered_areas and p.trust != "withheld":
            figures.append(("uncovered area ratio", *sheet.uncovered_areas[name], "1"))
        if p.standard_error is not None:
            figures.append(("standard error of a column", p.standard_error, None, p.units))
        for statistic, value, error, units in figures:
            yield layer, name, statistic, _text(value), _text(error), units, *trust_cells


def _figure_rows(results: Results) -> Rows:
    """Rows of ``figures.csv``: properties and position of each layer, then all r."""
    for layer in results.layers:
        why = partial(_why, results.checks, (layer.name,))
        if layer.sheet is not None:
            yield from _property_rows(layer.name, layer.sheet, why)
        r = layer.registration
        if r is not None and r.expected_error is not None:
            e = r.expected_error
            figure_cells = (layer.name, "expected error of the position")
            common_cells = ("", "um", r.matched, e.trust, why(POSITION))
            yield *figure_cells, "median", _text(e.median_um), *common_cells
            yield *figure_cells, "largest", _text(e.largest_um), *common_cells
    for row in results.correlations:
        yield from _r_rows(results, row)
    for evidence in results.evidence:
        yield from _light_rows(results, evidence)


def _r_rows(results: Results, row: CorrelationRow) -> Rows:
    """Give a row for an r, and one for each limit of its interval."""
    figure_name = f"r of {row.a_map} and {row.b_map}"
    if row.negative_control:
        figure_name += ", negative control"
    if results.is_light_off and results.reference.name in (row.a, row.b):
        figure_name += f", {_LIGHT_OFF}"
    layers = (row.a, row.b)
    why = _why(results.checks, layers, row.a_map, row.b_map, POSITION, CORRELATION)
    r_cells = _r_cells(row.point_um, row.r, row.interval, row.n, row.n_eff)
    for cells in r_cells:
        yield " ".join(layers), figure_name, *cells, row.trust, why


def _why(checks: Iterable[Check], layers: Sequence[str], *figures: str) -> str:
    """Names of the checks that make a figure doubtful or withhold it."""
    asked = (check for check in checks if check.state in ("look", "fail"))
    return "; ".join(check.name for check in concerned(asked, layers, figures))


def _r_cells(
    point_um: float, r: float, interval: Interval, n: int, n_eff: float
) -> Iterator[tuple[Any, ...]]:
    """Cells from the statistic to n of an r, and of the limits of its interval."""
    text = f"points of {point_um:g} um"
    yield text, _text(r), "", "1", n
    if is_known(interval):
        for side, limit in zip(("lower", "upper"), interval, strict=True):
            yield f"{text}, {side} 95 % limit", limit, "", "1", round(n_eff)


def _light_rows(results: Results, evidence: EvidenceFacts) -> Rows:
    """Give the r that does not lead: without a smooth field in the image, or with it.

    A check of that field does not doubt it.
    """
    field = evidence.light_field
    if field is None:
        return
    layers = (evidence.a, evidence.b)
    maps = (evidence.a_map, evidence.b_map)
    figures = *maps, POSITION, CORRELATION
    checks = [check for check in results.checks if check.name != EVEN_LIGHT]
    trust_cells = trust_of(checks, layers, figures), _why(checks, layers, *figures)
    n = field.n or 0
    words = _LIGHT_OFF
    r_cells = _r_cells(field.point_um, field.r, field.interval, n, field.n_eff)
    if field.declared:  # then the field is off in the r that leads
        words = "light left in"
        r_cells = _r_cells(field.point_um, field.r_plain, field.interval_plain, n, n)
    figure_cells = " ".join(layers), f"r of {' and '.join(maps)}, {words}"
    for cells in r_cells:
        yield *figure_cells, *cells, *trust_cells
    share_cells = "share of the image's variance that the field holds", _text(field.share)
    yield *figure_cells, *share_cells, "", "1", n, *trust_cells
