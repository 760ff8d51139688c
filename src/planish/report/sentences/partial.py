"""R given the maps that stand beside."""

from __future__ import annotations

from collections.abc import Iterator

from planish.analyze.correlation_evidence import EvidenceFacts
from planish.analyze.robustness import Partial
from planish.core.facts import is_known
from planish.core.numbers import count, fixed, limits_text, plain
from planish.report.sentences.wording import Wording


def say_partial(partial_r: Partial, evidence: EvidenceFacts, _: Wording) -> Iterator[str]:
    """R given other maps, and the share that the map explains alone."""
    names_text = " and ".join(name.replace("_", " ") for name in partial_r.given)
    if not is_known(partial_r.r):
        yield f"Given {names_text}, there is no r. {partial_r.reason or ''}".strip()
        return
    interval_text = f"{limits_text(partial_r.interval)}; ".lstrip("; ")
    unique_share = (evidence.commonality or {}).get(evidence.a_map)
    unique_text = (
        ""
        if unique_share is None
        else f" Alone, the map explains {fixed(unique_share, 2)} of the variance."
    )
    yield (
        f"Given {names_text}, r = {fixed(partial_r.r, 2)} at points of {plain(partial_r.point_um)}"
        f" ({interval_text}{count(round(partial_r.n_eff) if is_known(partial_r.n_eff) else 0)}"
        f" independent points).{unique_text}"
    )
