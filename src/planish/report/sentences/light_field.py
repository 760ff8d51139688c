"""R without a smooth field that the map does not explain."""

from __future__ import annotations

from collections.abc import Iterator

from planish.analyze.light_field import LightField
from planish.core.facts import is_known
from planish.core.numbers import count, decimals_of_r, fixed, limits_text, percent, plain


def say_light_field(field: LightField, *_: object) -> Iterator[str]:
    """What a quadratic field holds of the image, and both r, where there is an interval."""
    if not is_known(field.interval):
        return
    yield (
        f"A quadratic field of x and y, fitted together with the map, holds"
        f" {percent(field.share, 2)} of the image's variance over points of"
        f" {plain(field.point_um)}; texture alone gives {percent(field.share_even, 2)} on average."
        f" With it left in, r = {fixed(field.r_plain, 2)}; {off_text(field)},"
        f" {count(round(field.n_eff))} independent points. Uneven light is such a field, and so are"
        " the longest waves of the paper, which are off as well."
    )


def off_text(field: LightField) -> str:
    """Write r without the field, with its interval."""
    decimals = decimals_of_r(field.interval)
    limits = limits_text(field.interval, decimals) or "no interval"
    return f"with a smooth field of light off, r = {fixed(field.r, decimals)} ({limits})"
