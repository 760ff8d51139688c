"""A second interval of r."""

from collections.abc import Iterator

from planish.analyze.conley_interval import ConleyInterval
from planish.analyze.correlation import UNEVEN
from planish.core.numbers import decimals_of_r, fixed, limits_text, plain


def say_conley_interval(conley: ConleyInterval, *_: object) -> Iterator[str]:
    """The second interval, where there is one."""
    if interval_text := limits_text(conley.interval, decimals_of_r(conley.interval)):
        caveat = "it is too narrow for maps with a long range"
        if conley.ratio > UNEVEN:
            caveat = "the maps vary unevenly"
        yield (
            f"Conley interval, from what single points of {plain(conley.point_um)} add to r:"
            f" {interval_text} ({fixed(conley.critical, 2)} standard errors);"
            f" {caveat}."
        )
