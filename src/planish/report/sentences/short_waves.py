"""R of short waves alone."""

from collections.abc import Iterator

from planish.analyze.correlation_evidence import EvidenceFacts
from planish.analyze.curve_of_sizes import SizeRow
from planish.core.facts import is_known
from planish.core.numbers import count, decimals_of_r, fixed, limits_text, plain


def say_short_waves(short_waves: SizeRow, evidence: EvidenceFacts, *_: object) -> Iterator[str]:
    """R of short waves, where it has an interval."""
    if is_known(short_waves.interval) and evidence.short_waves_um:
        decimals = decimals_of_r(short_waves.interval)
        yield (
            f"Waves below {plain(round(evidence.short_waves_um, -1))} alone: r ="
            f" {fixed(short_waves.r, decimals)} ({limits_text(short_waves.interval, decimals)};"
            f" {count(round(short_waves.n_eff))} independent points). This says nothing of longer"
            " waves."
        )
