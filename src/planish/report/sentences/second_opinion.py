"""A second interval of r."""

from __future__ import annotations

from collections.abc import Iterator

from planish.analyze.correlation import UNEVEN
from planish.analyze.second_opinion import SecondOpinion
from planish.core.numbers import decimals_of_r, fixed, limits_text, plain


def say_second_opinion(opinion: SecondOpinion, *_: object) -> Iterator[str]:
    """The second interval, where there is one."""
    if interval_text := limits_text(opinion.interval, decimals_of_r(opinion.interval)):
        is_uneven = opinion.ratio > UNEVEN
        caveat = (
            "the maps vary unevenly" if is_uneven else "it is too narrow for maps with a long range"
        )
        yield (
            f"Second opinion, from what single points of {plain(opinion.point_um)} add to r:"
            f" {interval_text} ({fixed(opinion.critical, 2)} standard errors after Conley);"
            f" {caveat}."
        )
