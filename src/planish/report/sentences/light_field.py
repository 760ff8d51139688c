"""R without a smooth field that the map does not explain."""

from collections.abc import Iterator

from planish.analyze.light_field import LightField
from planish.core.facts import is_known
from planish.core.numbers import count, decimals_of_r, fixed, percent, plain
from planish.report.statement import r_sentence


def say_light_field(field: LightField, *_: object) -> Iterator[str]:
    """What a quadratic field holds of the image, and both r, where there is an interval."""
    if not is_known(field.interval):
        return
    r_plain = fixed(field.r_plain, decimals_of_r(field.interval_plain))
    yield (
        f"A quadratic field of x and y, fitted together with the map, holds"
        f" {percent(field.share, 2)} of the image's variance over points of"
        f" {plain(field.point_um)}; texture alone gives {percent(field.share_even, 2)} on average."
        f" With it left in, r = {r_plain}; {off_text(field)},"
        f" {count(round(field.n_eff))} independent points. Uneven light is such a field, and so are"
        " the longest waves of the paper, which are off as well."
    )


def off_text(field: LightField) -> str:
    """Write r without the field, with its interval."""
    return f"with a smooth field of light off, {r_sentence(field)}"
