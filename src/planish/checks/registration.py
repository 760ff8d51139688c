"""Checks of layers that are registered and linked.

Their marks, holes and directions, and the field they share.
"""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from planish.core.checks import Check, CheckRule
from planish.core.grid import Grid
from planish.core.numbers import with_article
from planish.marks.find import REASONS
from planish.register import FittedTransform
from planish.results import LayerFacts, LinkedArea, RegistrationFacts


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedRegistration:
    """A layer with its registration.

    A mark can hardly be placed better than within the larger pixel of the two layers.
    """

    layer: str
    facts: RegistrationFacts
    fit: FittedTransform
    agreement: str  # how many marks agree, and which were left out
    hole_um: float  # mean diameter of the holes
    pixel_um: float


@dataclass(frozen=True, slots=True)
class DetectedHoles:
    """The holes that were found in a layer: Dataset (mark) of :func:`planish.find_holes`."""

    layer: str
    holes: xr.Dataset


@dataclass(frozen=True, slots=True, kw_only=True)
class HolesOnSheet:
    """A sheet's maps on the pixels of a reference, and the marks of its registration to it."""

    sheet: xr.Dataset
    marks: xr.Dataset
    layer: str
    reference: str


@dataclass(frozen=True, slots=True)
class TextureChecks:
    """What the textures of two layers say of side, specimen and position.

    :mod:`planish.analyze` judges them.
    """

    side: Check
    position: Check | None = None


# --- of a registration ----------------------------------------------------------------------------


def marks(rule: CheckRule, registered: JudgedRegistration) -> Check:
    """Judge the leave-one-out error of the marks, and whether omitted marks lie far off.

    That error is None where each mark is needed for the fit; then nothing can be said. Omitted are
    marks of a weight below 1.
    """
    # Marks that were found well agree within that.
    limit_um = max(0.1 * registered.hole_um, registered.pixel_um)
    loo_um = registered.facts.leave_one_out_rms_um
    fit = registered.fit
    if loo_um is None:
        return rule.check(
            "unknown",
            units="um",
            advice="Add marks.",
            sentence=(
                f"With {registered.facts.matched} marks, none is left to check the registration. "
                f"{registered.agreement}"
            ),
        )
    check = rule.at_most(
        loo_um,
        look=limit_um,
        fail=5.0 * limit_um,
        units="um",
        sentence=registered.agreement,
        advice="That is worse than a tenth of a hole and a pixel. Look at the residual arrows.",
    )
    # A hole that is badly found is left out now and then; one that lies elsewhere is worth a look.
    omitted_um = np.hypot(*fit.residuals_um[fit.robust_weights < 1.0].T)
    if check.state == "pass" and (omitted_um > limit_um).any():
        advice = "Look at the marks that were left out."
        return check.model_copy(update={"state": "look", "figures": (), "advice": advice})
    return check


def scale(rule: CheckRule, registered: JudgedRegistration) -> Check:
    """Judge whether the calibrations of both layers agree."""
    return rule.at_most(
        abs(registered.facts.scale - 1),
        look=0.03,
        units="share",
        sentence=f"The marks imply a scale of {registered.facts.scale:.4f}.",
        advice="The calibrations do not agree. Check the voxel and the pixel size.",
    )


def strain(rule: CheckRule, registered: JudgedRegistration) -> Check:
    """Judge the strain of the registration between the marks."""
    largest = registered.fit.strain.largest
    return rule.at_most(
        largest,
        look=0.01,
        units="share",
        sentence=(
            f"Between the marks, the registration strains the sheet by up to {100 * largest:.2g} %."
        ),
        advice=(
            "Paper strains by less than 1 %. Check the marks there, and the order of the slices."
        ),
    )


def tilt(rule: CheckRule, registered: JudgedRegistration) -> Check | None:
    """Judge whether all holes run along the normal of the sheet.

    None where fewer than 4 were found on both sides. Tilt, offset between the faces, and its error
    are vectors (u, v); their lengths are compared.
    """
    hole_tilt = registered.facts.tilt
    if hole_tilt is None or hole_tilt.tilt_deg is None or hole_tilt.offset_count < 4:
        return None
    vectors = (hole_tilt.tilt_deg, hole_tilt.offset_um, hole_tilt.offset_error_um)
    lengths = (float(np.linalg.norm(np.array(v, dtype=np.float64))) for v in vectors)
    angle_deg, offset_um, offset_error_um = lengths
    # The angle goes with the offset; that of its error along one direction.
    error_deg = offset_error_um * (angle_deg / max(offset_um, 1e-9) / np.sqrt(2))
    limit_deg = max(1.5, 4.0 * error_deg)  # of holes burnt from above
    end_text = ", all to one side" if angle_deg > limit_deg else " on average"
    return rule.at_most(
        angle_deg,
        look=limit_deg,
        units="deg",
        sentence=(
            f"The holes run through the sheet at {angle_deg:.2g} ± {error_deg:.1g}° from its normal"
            f"{end_text}."
        ),
        advice=(
            "Either the laser was not perpendicular to the sheet, or slices drift sideways through"
            " the volume, and then places and thicknesses are wrong. Ask how the holes were burnt."
        ),
    )


def machine_direction(rule: CheckRule, registered: JudgedRegistration) -> Check | None:
    """Judge the machine direction that is given twice.

    Once as the marks carry it over, and once for the image itself.
    """
    orientation = registered.facts.orientation
    stated_deg, carried_deg = orientation.md_deg_fixed, orientation.md_deg_fixed_from_moving
    if stated_deg is None or carried_deg is None:
        return None
    difference_deg = abs((stated_deg - carried_deg + 90.0) % 180.0 - 90.0)
    return rule.at_most(
        difference_deg,
        look=10.0,
        units="deg",
        sentence=(
            f"The machine directions of {registered.layer} and {registered.facts.to} differ by "
            f"{difference_deg:.1f}°."
        ),
        advice="One of them is wrong, or the marks were matched wrongly.",
    )


def holes_of_layer(rule: CheckRule, detected: DetectedHoles) -> Check:
    """Judge how many holes were found and what was rejected.

    A look where places were not measured. The search left in the attributes how many places it did
    not take, by the reason (``not_taken``), and how many openings as large as a hole are not round.
    """
    attrs = detected.holes.attrs
    hole_count = detected.holes.sizes["mark"]
    rejected: dict[str, int] = attrs.get("not_taken", {})
    rejected_texts: list[str] = []
    for name, reason_text in REASONS.items():
        if rejected.get(name):
            rejected_texts.append(f"{rejected[name]} {reason_text}")
    noun = "hole" if hole_count == 1 else "holes"
    sentence = f"{hole_count} {noun} found"
    if rejected_texts:
        sentence += f"; seen and not taken: {', '.join(rejected_texts)}"
    sentence += "."
    n_not_measured = rejected.get("not_measured", 0)
    n_openings = int(attrs.get("openings", 0))
    # So many that are not round are no single holes that are half closed.
    n_usual = max(1, 0.25 * (hole_count + n_openings))
    n_doubtful = n_openings if n_openings > n_usual else 0
    if n_openings == 1:
        sentence += " 1 opening as large as a hole is not round enough to be one."
    elif n_openings:
        sentence += f" {n_openings} openings as large as holes are not round enough to be one."
    figures = rule.figures[:1]
    advice = "More places look like holes than fit into the area."
    remedy = "Give a closer range of diameters (`hole_um`)."
    if n_doubtful:
        figures = rule.figures
        advice = (
            "Look at the maps there: a stretched or torn hole says that slices or voxel sizes are"
            " wrong."
        )
        remedy = ""
    check = rule.at_most(
        n_not_measured + n_doubtful,
        look=0,
        sentence=sentence,
        figures=figures,
        advice=advice,
        remedy=remedy,
    )
    return check.model_copy(update={"name": rule.name.replace("NAME", detected.layer)})


# --- of linked layers -----------------------------------------------------------------------------


def common_field(rule: CheckRule, layer: LayerFacts) -> Check | None:
    """Judge whether a layer and the reference have a field in common."""
    if layer.registration is None:
        return None
    share = layer.share_of_reference or 0.0
    reference = with_article(layer.registration.path[-1])
    return rule.at_least(
        share,
        look=0.05,
        units="share",
        sentence=f"{100 * share:.1f} % of {reference} shows {with_article(layer.name)}.",
        advice="Give the part of the reference that shows the specimen.",
    )


def holes_without_partner(rule: CheckRule, linked: HolesOnSheet) -> Check:
    """Judge the holes of a reference without a partner.

    Either the sheet has a hole there, too, or it is not measured. Looked at is the middle of such
    a hole, a circle of 0.35 of its diameter: the sheet is intact where more than 0.7 of its pixels
    have a thickness.
    """
    grid = Grid.of(linked.sheet)
    thickness = linked.sheet["thickness"]
    marks = linked.marks
    is_unpaired = np.isfinite(marks["fixed_x"]) & ~np.isfinite(marks["moving_x"])
    unpaired = marks.isel(mark=np.flatnonzero(is_unpaired))
    whole_labels: list[str] = []
    columns = ("label", "fixed_x", "fixed_y", "fixed_diameter")
    circles = zip(*(unpaired[column].values for column in columns), strict=True)
    for label, x, y, diameter in circles:
        dy = grid.y_um - y
        dx = grid.x_um - x
        core_um = 0.35 * diameter
        rows = np.flatnonzero(np.abs(dy) < core_um)
        cols = np.flatnonzero(np.abs(dx) < core_um)
        is_inside = np.hypot(dy[rows][:, None], dx[cols]) < core_um
        if not is_inside.any():
            continue
        core_thickness = thickness.isel(y=rows, x=cols).values
        if np.isfinite(core_thickness)[is_inside].mean() > 0.7:
            whole_labels.append(str(label))
    n_unpaired = unpaired.sizes["mark"]
    layer = with_article(linked.layer)
    reference = with_article(linked.reference)
    text = (
        f"{n_unpaired} holes of {reference} have no partner, and none of them lies where {layer} is"
        " intact."
    )
    if whole_labels:
        verb = "lies" if len(whole_labels) == 1 else "lie"
        text = f"{', '.join(whole_labels)} of {reference} {verb} where {layer} has no hole."
    elif n_unpaired == 0:
        text = f"Every hole of {reference} has a partner."
    return rule.at_most(
        len(whole_labels),
        look=0,
        sentence=text,
        advice=(
            "Either that is not a hole, or the two are not aligned there. Look at both, and at the"
            " order and spacing of the slices."
        ),
    )


def linked_area(rule: CheckRule, area: LinkedArea) -> Check:
    """Judge whether enough of what the reference shows of the sheet is valid."""
    share = area.share_valid_away_from_holes
    return rule.at_least(
        share,
        look=0.5,
        units="share",
        sentence=f"{100 * share:.0f} % of the sheet that the image shows away from holes is valid.",
        advice="The linked maps are mostly blank. Look at the slices and the column status.",
    )
