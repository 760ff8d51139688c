"""What came out, in one sentence and four numbers, as far as it goes and no further."""

from __future__ import annotations

from dataclasses import dataclass

from planish.report.promise import registered
from planish.report.tables import Row, is_link
from planish.report.text import NONE, count, fixed, in_words, length, number, percent, plain

_FAINT = 0.02  # r2 below which no direction is named in words


@dataclass(frozen=True, slots=True, kw_only=True)
class Tile:
    """One number large, with what it is."""

    value: str
    label: str
    note: str
    unit: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What came out, in one sentence and a few numbers."""

    sentence: str
    tiles: tuple[Tile, ...]
    passed: bool
    summary: str


def give_verdict(results: Row, names: dict[str, str]) -> Verdict:
    """Say what came out, as far as it goes and no further."""
    gates = results["quality"]
    failed = [gate for gate in gates if not gate["passed"]]
    sentence, tiles = _link_verdict(results, names) if is_link(results) else _map_verdict(results, names)
    return Verdict(sentence=sentence, tiles=tiles, passed=not failed, summary=summarise(gates))


def summarise(gates: list[Row]) -> str:
    """Say how many quality gates were passed."""
    failed = [gate for gate in gates if not gate["passed"]]
    if not failed:
        return "The quality gate is passed." if len(gates) == 1 else f"All {len(gates)} quality gates are passed."
    return (
        f"{len(failed)} of {len(gates)} quality gates {'is' if len(failed) == 1 else 'are'} not passed; "
        "read them before using a number of this page."
    )


def _link_verdict(results: Row, names: dict[str, str]) -> tuple[str, tuple[Tile, ...]]:
    headline = str(results["headline"])
    title = names.get(headline, headline)
    pixel, point = _pair(results["correlation"], headline)
    marks, linked = results["marks"], results["linked"]
    loo = marks["leave_one_out_rms_um"]
    what, how = in_words(title), registered(results)
    if pixel.get("r2") is None:
        sentence = (
            f"{title} and the image could not be correlated: {count(pixel.get('n', 0))} pixels are valid in both, or "
            "one of the two is constant."
        )
    else:
        way = "higher" if pixel["r"] > 0 else "lower"
        start = f"Where {what} is larger, the image's value tends to be {way}"
        if pixel["r2"] < _FAINT:
            start = f"The image's value hardly goes along with {what}"
        sentence = (
            f"{start}: a straight line on it accounts for {percent(pixel['r2'], 2)} of the variance over "
            f"{count(pixel['n'])} pixels"
        )
        if point.get("r2") is not None:
            sentence += f", and for {percent(point['r2'], 2)} over points of {plain(point['point_um'])}"
        sentence += f" ({how})."
    if loo is None:
        sentence += f" {marks['matched']} marks were used."
    else:
        sentence += f" The {marks['matched']} marks agree to {length(loo, 2)} when each is predicted from the others."
    return sentence, (
        Tile(value=fixed(pixel.get("r2"), 3), label="r² at the pixel", note=_tile_note(pixel, how)),
        Tile(value=fixed(point.get("r2"), 3), label=f"r² at {plain(_point_um(results))}", note=_tile_note(point, how)),
        Tile(
            value=number(loo, 2),
            unit="µm",
            label="agreement of the marks",
            note=f"leave-one-out rms of {marks['matched']}; fit {number(marks['rms_um'], 2)} µm",
        ),
        Tile(
            value=fixed(100 * linked["share_valid_of_sheet"], 0),
            unit="%",
            label="of the shown sheet is valid",
            note=f"{percent(results['surfaces']['share_measured'], 2)} of the columns are measured",
        ),
    )


def _map_verdict(results: Row, names: dict[str, str]) -> tuple[str, tuple[Tile, ...]]:
    thickness, flat, surfaces = results["properties"].get("thickness"), results["flatten"], results["surfaces"]
    there = [in_words(names.get(str(k), str(k))) for k, v in results["properties"].items() if v]
    coated = any(results["properties"].get(k) for k in ("coating_top", "coating_bottom"))
    sentence = (
        f"The sheet was found in {percent(surfaces['share_measured'], 2)} of the columns and flattened; "
        f"mapped are {', '.join(there) if there else 'no properties'}. No image was linked."
    )
    if not coated:
        sentence += " No coating was found."
    return sentence, (
        Tile(
            value=number(thickness["mean_um"] if thickness else None),
            unit="µm",
            label="mean sheet thickness",
            note=f"standard deviation {number(thickness['sd_um'], 2)} µm" if thickness else NONE,
        ),
        Tile(
            value=fixed(100 * surfaces["share_measured"], 0),
            unit="%",
            label="of the columns are measured",
            note=f"of {count(surfaces['columns'])}",
        ),
        Tile(
            value=number(100 * flat["edge_strain_p95"], 2),
            unit="%",
            label="edge strain",
            note="95th percentile of the mesh's edges",
        ),
        Tile(
            value=number(flat["largest_move_um"]),
            unit="µm",
            label="largest displacement",
            note="between projection and flat sheet",
        ),
    )


def _tile_note(row: Row, how: str) -> str:
    return f"r = {number(row.get('r'))}, n = {count(row.get('n'))}; {how}"


def _point_um(results: Row) -> float:
    return float(results["parameters"].get("correlate", {}).get("point_um", 100.0))


def _pair(rows: list[Row], name: str) -> tuple[Row, Row]:
    """Return the rows of one property: at the pixel, and at the larger points."""
    found = [row for row in rows if row["property"] == name]
    return (found[0] if found else {}), (found[1] if len(found) > 1 else {})
