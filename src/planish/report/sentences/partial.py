"""R given the maps that stand beside."""

from collections.abc import Iterator

from planish.analyze.correlation_evidence import EvidenceFacts
from planish.analyze.robustness import Partial
from planish.core.facts import is_known
from planish.core.numbers import count, fixed, limits_text, plain


def say_partial(partial_r: Partial, evidence: EvidenceFacts, *_: object) -> Iterator[str]:
    """R given other maps, and the share that the map explains alone."""
    names_text = " and ".join(name.replace("_", " ") for name in partial_r.given)
    over_control_text = say_over_control(partial_r, evidence.a_map)
    if not is_known(partial_r.r):
        text = f"Given {names_text}, there is no r. {partial_r.reason or ''}".strip()
        yield f"{text} {over_control_text}".strip()
        return
    interval_text = f"{limits_text(partial_r.interval)}; ".lstrip("; ")
    unique_share = (evidence.commonality or {}).get(evidence.a_map)
    unique_text = ""
    if unique_share is not None:
        unique_text = f" Alone, the map explains {fixed(unique_share, 2)} of the variance."
    n_eff = round(partial_r.n_eff) if is_known(partial_r.n_eff) else 0
    text = (
        f"Given {names_text}, r = {fixed(partial_r.r, 2)} at points of {plain(partial_r.point_um)}"
        f" ({interval_text}{count(n_eff)} independent points).{unique_text} {over_control_text}"
    )
    yield text.strip()


def say_over_control(partial_r: Partial, map_name: str) -> str:
    """Name the given maps that hold a part of the map, and how r changes; empty without any."""
    clauses: list[str] = []
    controls = zip(partial_r.over_control, partial_r.over_control_parts, strict=False)
    # Of two maps that share parts, one may be a part of the other.
    for name, parts in controls:
        clause = f"{map_name} and {name} both contain {' and '.join(parts)}"
        if parts == (map_name,):
            clause = f"{name} contains {map_name}"
        if parts == (name,):
            clause = f"{map_name} contains {name}"
        clauses.append(clause.replace("_", " "))
    if not clauses:
        return ""
    change_text = ""
    if is_known(partial_r.r_alone):
        end_text = f"becomes {fixed(partial_r.r, 2)}" if is_known(partial_r.r) else "is lost"
        change_text = f" Over the same points, r = {fixed(partial_r.r_alone, 2)} {end_text}."
    return (
        f"Over-control: {'; '.join(clauses)}. What is taken off is in part the map"
        f" itself.{change_text}"
    )
