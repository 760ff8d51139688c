"""Quality gates: what a result has to meet to be used without a second look."""

from __future__ import annotations

import math
from collections.abc import Iterator

from planish.core.results import Gate, LinkedArea, RegistrationFacts, SheetFacts

_MD_LIMIT_DEG = 10.0
_LEAST_LIKE, _MOST_CROSSWISE = 0.3, 0.2  # r


def _at_least(name: str, value: float, limit: float, *, good: str, bad: str) -> Gate:
    passed = bool(value >= limit)
    return Gate(name=name, value=float(value), limit=limit, passed=passed, sentence=good if passed else bad)


def _at_most(name: str, value: float, limit: float, *, good: str, bad: str) -> Gate:
    passed = bool(value <= limit)
    return Gate(name=name, value=float(value), limit=limit, passed=passed, sentence=good if passed else bad)


def sheet_gates(sheet: SheetFacts) -> Iterator[Gate]:
    """Gates of one mapped sheet."""
    s, folded, sections = sheet.surfaces, sheet.flatten.folded_cells, sheet.sections
    # Rims of holes are left out on purpose; what counts is how much of the rest was measured.
    share = s.shares["measured"] / max(1.0 - s.shares["rim"], 1e-9)
    text = f"{100 * share:.0f} % of the columns away from rims are measured"
    yield _at_least(
        "coverage", share, 0.5,
        good=f"{text}.", bad=f"Only {text}: the maps are mostly blank. Look at the slices in the report.",
    )  # fmt: skip
    if s.saturated_share is not None:  # a volume of labels has no grey scale
        text = f"{100 * s.saturated_share:.1f} % of the sheet's voxels are saturated"
        yield _at_most(
            "saturation", s.saturated_share, 0.05,
            good=f"{text}.",
            bad=f"{text} (at the end of the grey scale): the faces may be displaced. Export the volume with a wider "
            "grey window.",
        )  # fmt: skip
    if s.missing_share is not None:
        text = f"{100 * s.missing_share:.1f} % of the voxels are"
        yield _at_most(
            "missing voxels", s.missing_share, 0.05,
            good=f"{text} NaN.",
            bad=f"{text} NaN or infinite; columns with such voxels near a face are not measured.",
        )  # fmt: skip
    yield _at_most(
        "fold-over", folded, 0,
        good="No cell of the flattened mesh is folded.",
        bad=f"{folded} cells of the flattened mesh are folded; they are marked invalid.",
    )  # fmt: skip
    if sections is not None:  # those that fit none of their neighbours
        yield _at_most(
            "alignment", sections.not_aligned / sections.count, 0.05,
            good=f"{sections.count - sections.not_aligned} of {sections.count} sections fit their neighbours.",
            bad=f"{sections.not_aligned} of {sections.count} sections fit none of their neighbours: torn, blurred, or "
            "not of this sheet. They count as missing. Look at them, and at the order of the files.",
        )  # fmt: skip


def registration_gates(registration: RegistrationFacts, layer: str) -> Iterator[Gate]:
    """Gates of one registration."""
    m = registration
    loo = math.inf if m.leave_one_out_rms_um is None else m.leave_one_out_rms_um
    yield _at_most(
        "marks", loo, 20.0,
        good=f"{m.matched} marks agree to {loo:.1f} um (leave-one-out, rms).",
        bad=f"{m.matched} marks agree to {loo:.1f} um only (leave-one-out, rms): worse than the 10-20 um "
        "that the paper reached by hand. Look at the residual arrows in the report.",
    )  # fmt: skip
    yield _at_most(
        "scale", abs(m.scale - 1), 0.03,
        good=f"The marks ask for a scale of {m.scale:.4f}.",
        bad=f"The marks ask for a scale of {m.scale:.4f}: the calibrations do not agree.",
    )  # fmt: skip
    o = m.orientation
    if o.md_deg_fixed is None or o.md_deg_fixed_from_moving is None:
        return
    # The machine direction is given twice: as the marks carry it over, and for the image itself.
    off = abs((o.md_deg_fixed - o.md_deg_fixed_from_moving + 90.0) % 180.0 - 90.0)
    text = f"The machine directions of {layer} and {m.to} differ by {off:.1f}°"
    yield _at_most(
        "machine direction", off, _MD_LIMIT_DEG,
        good=f"{text}.",
        bad=f"{text}: one of them is wrong, or the marks were matched wrongly.",
    )  # fmt: skip


def area_gate(k: LinkedArea) -> Gate:
    """Enough of what the reference shows of the sheet is valid."""
    area = f"{100 * k.share_valid_away_from_holes:.0f} % of the sheet that the image shows away from holes"
    return _at_least(
        "linked area", k.share_valid_away_from_holes, 0.5,
        good=f"{area} is valid.", bad=f"Only {area} is valid: the linked maps are mostly blank.",
    )  # fmt: skip


def field_gate(share: float, layer: str, reference: str) -> Gate:
    """The layer and the reference have a field in common."""
    return _at_least(
        "common field", share, 0.05,
        good=f"{100 * share:.0f} % of the {reference} shows the {layer}.",
        bad=f"Only {100 * share:.1f} % of the {reference} shows the {layer}.",
    )  # fmt: skip


def same_sheet_gates(a: str, b: str, likeness: dict[str, float] | None) -> Iterator[Gate]:
    """Two sheets are one specimen, seen from the same side."""
    if likeness is None or not math.isfinite(likeness["thickness"]):
        return
    r = likeness["thickness"]
    yield _at_least(
        f"{a} and {b}: one sheet", r, _LEAST_LIKE,
        good=f"The thicknesses of {a} and {b} go together (r = {r:.2f}).",
        bad=f"The thicknesses of {a} and {b} do not go together (r = {r:.2f}): either they are not the same piece of "
        "paper, or they do not lie on each other, or one of them is measured badly.",
    )  # fmt: skip
    same, cross = likeness["same_sides"], likeness["crosswise"]
    if math.isfinite(same) and math.isfinite(cross):
        yield _at_most(
            f"{a} and {b}: sides", cross - same, _MOST_CROSSWISE,
            good=f"The coatings of {a} and {b} go together side by side (r = {same:.2f}), not crosswise ({cross:.2f}).",
            bad=f"The coatings of {a} and {b} go together crosswise (r = {cross:.2f}), not side by side ({same:.2f}): "
            "top and bottom of one of the two are exchanged. Check --top, and whether its slices are numbered against "
            "the usual sense.",
        )  # fmt: skip
