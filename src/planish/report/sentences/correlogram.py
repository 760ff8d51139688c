"""R at every shift of one map."""

from collections.abc import Iterator

from planish.analyze.correlograms import CorrelogramProfiles
from planish.core.facts import is_known
from planish.core.numbers import fixed, plain


def say_correlogram(profiles: CorrelogramProfiles, *_: object) -> Iterator[str]:
    """Where both maps agree best, and what unrelated maps reach.

    Where there is no peak of r within the lags that were tried, that.
    """
    limit_text = (
        f"|r| above {fixed(profiles.limit_of_any, 2)} is exceeded at any lag by 1 % of unrelated"
        " maps"
    )
    if not is_known(profiles.limit_of_any):
        limit_text = "fewer than 10 independent points: what unrelated maps reach is not known"
    elif not profiles.beyond_chance:
        limit_text += ", and no lag reaches that"
    if not profiles.inner:
        reach_text = plain(round(profiles.reach_um))
        yield (
            f"Shifted against each other, the maps show no peak of r within {reach_text};"
            f" {limit_text}."
        )
        return
    # The lag is (y, x); a tenth of a um is said of short ones alone.
    lag_y_text, lag_x_text = (fixed(v, 0 if abs(v) >= 10 else 1) for v in profiles.lag_um)
    width_text = ""
    if is_known(profiles.widths_um):
        widths_text = " × ".join(fixed(v, 0) for v in profiles.widths_um)
        width_text = f" (width at half height {widths_text} µm)"
    yield (
        f"Shifted against each other, the maps agree best at a lag of {lag_x_text} µm along x and"
        f" {lag_y_text} µm along y, with r = {fixed(profiles.peak_r, 2)}{width_text}; {limit_text}."
    )
