"""R with the coating blurred as far as light spreads."""

from collections.abc import Iterator

from planish.analyze.light_spread import LightSpread
from planish.core.facts import is_known
from planish.core.numbers import count, fixed, limits_text, plain


def say_light_spread(spread: LightSpread, *_: object) -> Iterator[str]:
    """R with the coating blurred, and whether it differs from that of the coating as it is."""
    width_text = (
        f"With the coating blurred by light that spreads over {plain(spread.width_um)} (declared)"
    )
    if not is_known(spread.r):
        yield f"{width_text}, there is no r. {spread.reason or ''}".strip()
        return
    text = f"{width_text}, r = {fixed(spread.r, 2)} at points of {plain(spread.point_um)}"
    if interval_text := limits_text(spread.interval):
        text += f" ({interval_text}; {count(round(spread.n_eff))} independent points)"
    if not is_known(spread.difference_interval):
        yield f"{text}."
        return
    low, high = spread.difference_interval
    verdict = "not distinguishable from" if low <= 0 <= high else "distinguishable from"
    change_text = (
        f"r changes by {fixed(spread.difference, 3)}, {limits_text(spread.difference_interval, 3)}"
    )
    yield f"{text}: {verdict} that of the coating as it is ({change_text})."
