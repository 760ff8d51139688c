"""The gates that a result must pass to be used without a second look."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """One condition that a result must meet to be used without a second look."""

    name: str
    value: float
    limit: float
    passed: bool
    sentence: str


def _gate(name: str, value: float, limit: float, *, least: bool, good: str, bad: str) -> Gate:
    passed = value >= limit if least else value <= limit
    return Gate(name=name, value=float(value), limit=limit, passed=bool(passed), sentence=good if passed else bad)


def map_gates(results: dict[str, Any]) -> tuple[Gate, ...]:
    """Gates of a map."""
    s, f = results["surfaces"], results["flatten"]
    # Rims of holes are left out on purpose; what counts is how much of the rest was measured.
    share = s["share_measured"] / max(1.0 - s["share_rim"], 1e-9)
    text = f"{100 * share:.0f} % of the columns away from rims are measured"
    return (
        _gate(
            "coverage", share, 0.5, least=True,
            good=f"{text}.",
            bad=f"Only {text}: the maps are mostly blank. Look at the slices in the report.",
        ),
        _gate(
            "fold-over", f["folded_cells"], 0, least=False,
            good="No cell of the flattened mesh is folded.",
            bad=f"{f['folded_cells']} cells of the flattened mesh are folded; they are marked invalid.",
        ),
        *_grey_gates(s),
        *_section_gates(results.get("sections")),
    )  # fmt: skip


def _grey_gates(s: dict[str, Any]) -> tuple[Gate, ...]:
    """Gates of grey values; labels have none."""
    saturated, missing = s["saturated_share"], s["missing_share"]
    if saturated is None or missing is None:
        return ()
    return (
        _gate(
            "saturation", saturated, 0.05, least=False,
            good=f"{100 * saturated:.1f} % of the sheet's voxels are saturated.",
            bad=f"{100 * saturated:.1f} % of the sheet's voxels are saturated (at the end of the grey scale): the "
            "faces may be displaced. Export the volume with a wider grey window.",
        ),
        _gate(
            "missing voxels", missing, 0.05, least=False,
            good=f"{100 * missing:.1f} % of the voxels are NaN.",
            bad=f"{100 * missing:.1f} % of the voxels are NaN or infinite; columns with such voxels near a face are "
            "not measured.",
        ),
    )  # fmt: skip


def _section_gates(told: dict[str, Any] | None) -> tuple[Gate, ...]:
    """Gate of serial sections: too many that fit to none of their neighbours."""
    if told is None:
        return ()
    bad = told["not_aligned"]
    return (
        _gate(
            "alignment", bad / told["count"], 0.05, least=False,
            good=f"{told['count'] - bad} of {told['count']} sections fit to their neighbours.",
            bad=f"{bad} of {told['count']} sections fit to none of their neighbours: torn, blurred, or not of this "
            "sheet. They count as missing. Look at them, and at the order of the files.",
        ),
    )  # fmt: skip


_MD_LIMIT_DEG = 10.0
_LEAST_LIKE, _MOST_CROSSWISE = 0.3, 0.2  # r


def direction_gates(told: dict[str, Any] | None) -> tuple[Gate, ...]:
    """Gate of the machine direction, where it is given twice: as the marks carry it, and for the image itself."""
    if told is None or told["md_deg_image"] is None or told["md_deg_image_from_map"] is None:
        return ()
    off = abs((told["md_deg_image"] - told["md_deg_image_from_map"] + 90.0) % 180.0 - 90.0)
    between = " and ".join(told.get("between", ("volume", "image")))
    return (
        _gate(
            "machine direction", off, _MD_LIMIT_DEG, least=False,
            good=f"The machine directions of {between} differ by {off:.1f}°.",
            bad=f"The machine directions of {between} differ by {off:.1f}°: one was given wrongly, or the marks "
            "were matched wrongly.",
        ),
    )  # fmt: skip


def link_gates(results: dict[str, Any]) -> tuple[Gate, ...]:
    """Further gates of a link."""
    m, k = results["marks"], results["linked"]
    return (*mark_gates(m), *direction_gates(results.get("orientation")), *_area_gates(k))


def mark_gates(m: dict[str, Any]) -> tuple[Gate, ...]:
    """Gates of one registration."""
    loo = m["leave_one_out_rms_um"] if m["leave_one_out_rms_um"] is not None else float("inf")
    return (
        _gate(
            "marks", loo, 20.0, least=False,
            good=f"{m['matched']} marks agree to {loo:.1f} um (leave-one-out, rms).",
            bad=f"{m['matched']} marks agree to {loo:.1f} um only (leave-one-out, rms): worse than the 10-20 um "
            "that the paper reached by hand. Look at the residual arrows in the report.",
        ),
        _gate(
            "scale", abs(m["scale"] - 1), 0.03, least=False,
            good=f"The marks ask for a scale of {m['scale']:.4f}.",
            bad=f"The marks ask for a scale of {m['scale']:.4f}: the calibrations do not agree.",
        ),
    )  # fmt: skip


def _area_gates(k: dict[str, Any]) -> tuple[Gate, ...]:
    area = f"{100 * k['share_valid_away_from_holes']:.0f} % of the sheet that the image shows away from holes"
    return (
        _gate(
            "linked area", k["share_valid_away_from_holes"], 0.5, least=True,
            good=f"{area} is valid.",
            bad=f"Only {area} is valid: the linked maps are mostly blank.",
        ),
        field_gate(k["share_on_sheet"], "the image", "the scanned sheet"),
    )  # fmt: skip


def field_gate(share: float, reference: str, layer: str) -> Gate:
    """Gate of the field that a layer and the reference have in common."""
    return _gate(
        "common field", share, 0.05, least=True,
        good=f"{100 * share:.0f} % of {reference} shows {layer}.",
        bad=f"Only {100 * share:.1f} % of {reference} shows {layer}.",
    )  # fmt: skip


def sheet_gates(a: str, b: str, like: dict[str, float] | None) -> tuple[Gate, ...]:
    """Gates of two sheets: they are one specimen, seen from the same side."""
    if like is None or not math.isfinite(like["thickness"]):
        return ()
    found = [
        _gate(
            f"{a} and {b}: one sheet", like["thickness"], _LEAST_LIKE, least=True,
            good=f"The thicknesses of {a} and {b} go together (r = {like['thickness']:.2f}).",
            bad=f"The thicknesses of {a} and {b} do not go together (r = {like['thickness']:.2f}): either they are not "
            "the same piece of paper, or they do not lie on each other, or one of them is measured badly.",
        )
    ]  # fmt: skip
    if math.isfinite(like["same_sides"]) and math.isfinite(like["crosswise"]):
        found.append(
            _gate(
                f"{a} and {b}: sides", like["crosswise"] - like["same_sides"], _MOST_CROSSWISE, least=False,
                good=f"The coatings of {a} and {b} go together side by side (r = {like['same_sides']:.2f}), not "
                f"crosswise ({like['crosswise']:.2f}).",
                bad=f"The coatings of {a} and {b} go together crosswise (r = {like['crosswise']:.2f}), not side by "
                f"side ({like['same_sides']:.2f}): top and bottom of one of the two are exchanged. Check --top, and "
                "whether its slices are numbered against the usual sense.",
            )
        )  # fmt: skip
    return tuple(found)
