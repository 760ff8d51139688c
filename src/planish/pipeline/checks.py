"""Checks of a run that need no more than its results, and what all checks mean for its figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
import xarray as xr

from planish.core.checks import CORRELATION, POSITION, PROPERTIES, Check, concerned
from planish.core.facts import HoleTiltFacts, Trust
from planish.core.grid import Grid
from planish.register import FittedTransform
from planish.results import (
    ComparisonRow,
    CorrelationRow,
    ExpectedError,
    LayerFacts,
    LinkedArea,
    PropertyFacts,
    RegistrationFacts,
    Results,
    SheetFacts,
)

Figure = TypeVar("Figure", CorrelationRow, ComparisonRow, PropertyFacts, ExpectedError)

_MD_LIMIT_DEG = 10.0
_LEAST_COVERAGE, _LEAST_AREA, _LEAST_FIELD = 0.5, 0.5, 0.05
_MOST_MISSING, _MOST_ALONE = 0.05, 0.05
_SCALE = 0.03
_STRAIN = 0.01  # paper strains by less between two measurements
_OF_A_HOLE = 0.1  # share of a hole's diameter within which marks that were found well agree
_CORE, _WHOLE = 0.35, 0.7  # of a hole's diameter: its middle, where no sheet is; share measured that says there is one
_TILT_DEG, _SURE = 1.5, 4.0  # of holes burnt from above; and in standard errors
_LEAST_TILTED = 4
_FAR = 5.0  # times the limit from which on marks give no position


def hand_check(volume: xr.DataArray) -> Iterator[Check]:
    """Whether the file says that its slices are a mirror image of the specimen."""
    if hand := volume.attrs.get("hand"):
        yield Check(
            name="hand of the volume", state="look", figures=(POSITION, CORRELATION),
            sentence=f"The axes of the volume make a left-handed system ({hand}): its slices and maps are a mirror "
            "image of the specimen.",
            advice="Flip one axis where you export the volume, and map it again.",
        )  # fmt: skip


def sheet_checks(sheet: SheetFacts) -> Iterator[Check]:
    """Checks of one mapped sheet."""
    s, folded, sections = sheet.surfaces, sheet.flatten.folded_cells, sheet.sections
    # Rims of holes are left out on purpose, and beside a small specimen is air: what counts is the rest.
    air = min(s.empty_share or 0.0, s.shares["no_sheet"])
    share = s.shares["measured"] / max(1.0 - s.shares["rim"] - air, 1e-9)
    yield Check.at_least(
        "coverage", share, look=_LEAST_COVERAGE, units="share", figures=(PROPERTIES,),
        sentence=f"{100 * share:.0f} % of the columns with a sheet, away from rims, are measured.",
        advice="The maps are mostly blank, and what is left may not stand for the sheet. Look at the slices.",
    )  # fmt: skip
    if s.missing_share is not None:
        yield Check.at_most(
            "missing voxels", s.missing_share, look=_MOST_MISSING, units="share", figures=(PROPERTIES,),
            sentence=f"{100 * s.missing_share:.1f} % of the voxels are NaN or infinite.",
            advice="Columns with such voxels near a face are not measured. Export the volume without them.",
        )  # fmt: skip
    yield Check.at_most(
        "fold-over", folded, look=0, figures=(POSITION,), sentence=f"{folded} cells of the flattened mesh are folded.",
        advice="They are marked invalid. Look at the centre surface there: the sheet is folded, or a face was lost.",
    )  # fmt: skip
    if sections is not None:  # those that fit none of their neighbours
        yield Check.at_most(
            "alignment", sections.not_aligned / sections.count, look=_MOST_ALONE, units="share",
            figures=(PROPERTIES, POSITION),
            sentence=f"{sections.count - sections.not_aligned} of {sections.count} sections fit their neighbours.",
            advice="The others are torn, blurred, or not of this sheet, and count as missing. Look at them, and at the "
            "order of the files.",
        )  # fmt: skip


def registration_checks(
    facts: RegistrationFacts, fit: FittedTransform, *, agreement: str, hole_um: float, pixel_um: float, layer: str
) -> Iterator[Check]:  # fmt: skip
    """Checks of one registration.

    ``agreement`` says how many marks agree, and which were left out; ``hole_um`` is the mean diameter of the holes,
    ``pixel_um`` the larger pixel of the two layers: a mark can hardly be placed better than within one.
    """
    limit = max(_OF_A_HOLE * hole_um, pixel_um)
    loo = facts.leave_one_out_rms_um
    # A hole that is badly found is left out now and then; one that lies elsewhere is worth a look.
    left_out = bool((np.hypot(*fit.residuals_um[fit.robust_weights < 1.0].T) > limit).any())
    if loo is None:
        yield Check(
            name="marks", state="unknown", figures=(POSITION,), units="um",
            sentence=f"{facts.matched} marks leave none over to check the registration with. {agreement}",
            advice="Add marks.",
        )  # fmt: skip
    else:
        found = Check.at_most(
            "marks", loo, look=limit, fail=_FAR * limit, units="um", figures=(POSITION,), sentence=agreement,
            advice="That is worse than a tenth of a hole and a pixel. Look at the residual arrows.",
        )  # fmt: skip
        if found.state == "pass" and left_out:
            found = found.model_copy(
                update={"state": "look", "figures": (), "advice": "Look at the marks that were left out."}
            )
        yield found
    yield Check.at_most(
        "scale", abs(facts.scale - 1), look=_SCALE, units="share", figures=(PROPERTIES, POSITION),
        sentence=f"The marks ask for a scale of {facts.scale:.4f}.",
        advice="The calibrations do not agree. Check the voxel and the pixel size.",
    )  # fmt: skip
    strain = fit.strain
    yield Check.at_most(
        "strain of the registration", strain.largest, look=_STRAIN, units="share", figures=(POSITION, PROPERTIES),
        sentence=f"Between the marks, the registration strains the sheet by up to {100 * strain.largest:.2g} %.",
        advice="Paper strains by less than 1 %. Check the marks there, and the order of the slices.",
    )  # fmt: skip
    if facts.tilt is not None and (found := _tilt_check(facts.tilt)) is not None:
        yield found
    o = facts.orientation
    if o.md_deg_fixed is None or o.md_deg_fixed_from_moving is None:
        return
    # The machine direction is given twice: as the marks carry it over, and for the image itself.
    off = abs((o.md_deg_fixed - o.md_deg_fixed_from_moving + 90.0) % 180.0 - 90.0)
    yield Check.at_most(
        "machine direction", off, look=_MD_LIMIT_DEG, units="deg", figures=(POSITION,),
        sentence=f"The machine directions of {layer} and {facts.to} differ by {off:.1f}°.",
        advice="One of them is wrong, or the marks were matched wrongly.",
    )  # fmt: skip


def _tilt_check(tilt: HoleTiltFacts) -> Check | None:
    """Holes run along the normal of the sheet, all together; None where too few were found on both sides."""
    if tilt.tilt_deg is None or tilt.offset_count < _LEAST_TILTED:
        return None
    angle, offset, error = (
        float(np.linalg.norm(np.array(v, dtype=np.float64)))
        for v in (tilt.tilt_deg, tilt.offset_um, tilt.offset_error_um)
    )
    error *= angle / max(offset, 1e-9) / np.sqrt(2)
    limit = max(_TILT_DEG, _SURE * error)
    end = " from its normal, all to one side" if angle > limit else " from its normal on average"
    return Check.at_most(
        "tilt of the holes", angle, look=limit, units="deg",
        figures=(POSITION, PROPERTIES),
        sentence=f"The holes run through the sheet at {angle:.2g} ± {error:.1g}°{end}.",
        advice="Either the laser was not perpendicular to the sheet, or slices drift sideways through the volume, and "
        "then places and thicknesses are wrong. Ask how the holes were burnt.",
    )  # fmt: skip


def alone_check(sheet: xr.Dataset, marks: xr.Dataset, layer: str, reference: str) -> Check:
    """Holes of a reference without a partner: where they lie the sheet has a hole, too, or is not measured.

    ``sheet`` holds its maps on the pixels of the reference, ``marks`` those of its registration.
    """
    grid, seen = Grid.of(sheet), sheet["thickness"]
    alone = marks.isel(mark=np.flatnonzero(np.isfinite(marks["fixed_x"]) & ~np.isfinite(marks["moving_x"])))
    whole: list[str] = []
    for label, x, y, diameter in zip(
        *(alone[k].values for k in ("label", "fixed_x", "fixed_y", "fixed_diameter")), strict=True
    ):  # fmt: skip
        down, across = grid.y_um - y, grid.x_um - x
        rows, cols = (np.flatnonzero(np.abs(away) < _CORE * diameter) for away in (down, across))
        inside = np.hypot(down[rows][:, None], across[cols]) < _CORE * diameter
        if not inside.any():
            continue
        window = seen[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1].values
        if np.isfinite(window)[inside].mean() > _WHOLE:
            whole.append(str(label))
    count = alone.sizes["mark"]
    some = f"{', '.join(whole)} of the {reference} {'lies' if len(whole) == 1 else 'lie'} where the {layer} has no hole"
    return Check.at_most(
        "holes without partner", len(whole), look=0, figures=(POSITION, CORRELATION),
        sentence=f"{some}." if whole else f"Every hole of the {reference} has a partner." if count == 0 else
        f"{count} of the {reference}'s holes have no partner, and none of them lies where the {layer} is whole.",
        advice="Either that is no hole, or the two do not lie on each other there. Look at both, and at the order and "
        "spacing of the slices.",
    )  # fmt: skip


def area_check(k: LinkedArea) -> Check:
    """Enough of what the reference shows of the sheet is valid."""
    return Check.at_least(
        "linked area", k.share_valid_away_from_holes, look=_LEAST_AREA, units="share", figures=(CORRELATION,),
        sentence=f"{100 * k.share_valid_away_from_holes:.0f} % of the sheet that the image shows away from holes is "
        "valid.",
        advice="The linked maps are mostly blank. Look at the slices and the column status.",
    )  # fmt: skip


def field_check(share: float, layer: str, reference: str) -> Check:
    """The layer and the reference have a field in common."""
    return Check.at_least(
        "common field", share, look=_LEAST_FIELD, units="share", figures=(CORRELATION,),
        sentence=f"{100 * share:.1f} % of the {reference} shows the {layer}.",
        advice="Give the part of the reference that shows the specimen.",
    )  # fmt: skip


# --- what checks mean for figures ------------------------------------------------------------------------------------


def about(checks: Iterable[Check], *layers: str) -> list[Check]:
    """Checks with the layers that they are about: one of a sheet, two of a registration or a comparison."""
    return [check.model_copy(update={"layers": layers}) for check in checks]


def with_trust(results: Results) -> Results:
    """Mark every figure by the checks that concern it; what a failed check concerns loses its numbers."""
    if all(check.state in ("pass", "unknown") for check in results.checks):
        return results
    layers = tuple(_layer_with_trust(layer, results.checks) for layer in results.layers)
    rows = rows_with_trust(results.correlations, results.checks)
    both = tuple(layer.name for layer in results.layers)
    comparison = [_marked(row, trust_of_pair(both, (row.property,), results.checks)) for row in results.comparison]
    withheld = {(row.a, row.a_map, row.b, row.b_map) for row in rows if row.trust == "withheld"}
    evidence = tuple(e for e in results.evidence if (e.a, e.a_map, e.b, e.b_map) not in withheld)
    return results.model_copy(
        update={"layers": layers, "correlations": rows, "comparison": tuple(comparison), "evidence": evidence}
    )


def rows_with_trust(rows: Iterable[CorrelationRow], checks: Sequence[Check]) -> tuple[CorrelationRow, ...]:
    """The same correlations, each marked by the checks that concern it."""
    return tuple(_marked(row, trust_of_pair((row.a, row.b), (row.a_map, row.b_map), checks)) for row in rows)


def _layer_with_trust(layer: LayerFacts, checks: Sequence[Check]) -> LayerFacts:
    update: dict[str, Any] = {}
    if layer.sheet is not None:
        trusts: dict[str, Trust] = {name: trust_of(checks, (layer.name,), (name,)) for name in layer.sheet.properties}
        found = {k: _marked(p, trusts[k]) for k, p in layer.sheet.properties.items()}
        numbers = layer.sheet.numbers
        if "withheld" in trusts.values():  # they are made of the maps
            numbers = None
        update["sheet"] = layer.sheet.model_copy(update={"properties": found, "numbers": numbers})
    r = layer.registration
    if r is not None and r.expected_error is not None:
        trust = trust_of(checks, (layer.name,), (POSITION,))
        error = _marked(r.expected_error, trust)
        update["registration"] = r.model_copy(update={"expected_error": error})
    return layer.model_copy(update=update)


def trust_of_pair(layers: tuple[str, ...], maps: tuple[str, ...], checks: Sequence[Check]) -> Trust:
    """Trust in a correlation of maps of some layers."""
    return trust_of(checks, layers, (*maps, POSITION, CORRELATION))


def trust_of(checks: Sequence[Check], layers: Sequence[str], figures: Sequence[str]) -> Trust:
    """Trust in a figure of some layers, by all checks that concern one of ``figures``."""
    states = {check.state for check in concerned(checks, layers, figures)}
    return "withheld" if "fail" in states else "doubtful" if "look" in states else "ok"


def _marked(figure: Figure, trust: Trust) -> Figure:
    """Give a figure its trust, and take its numbers where they are withheld."""
    numbers = dict.fromkeys(figure.WITHHELD) if trust == "withheld" else {}
    return type(figure).model_validate({**dict(figure), **numbers, "trust": trust})
