"""How to read the r that leads.

What it explains, how high errors would let it be, and which checks bear on it.
"""

import math
from collections.abc import Iterator

from planish.analyze import LagNumbers
from planish.analyze.correlograms import CorrelogramProfiles
from planish.checks.light import SIDE_LIGHT
from planish.core.facts import is_known
from planish.core.numbers import fixed, length, percent, plain
from planish.flatten import FlatteningQuality
from planish.report.relation import largest
from planish.report.sentences.attenuation import LEFT_OUT
from planish.report.statement import point_of, r2_limits
from planish.report.summary import evidence_of, lead_pair
from planish.results import CorrelationRow, EvidenceFacts, LayerFacts, Results

_ABOVE_ERROR = 3.0  # times the expected error: a lag beyond that is more than the marks allow


def reading(results: Results) -> list[str]:
    """Say how strong the r that leads is, and which checks bear on it.

    Nothing where no r leads or it is withheld.
    """
    rows = lead_pair(results)
    if not rows:
        return []
    row = largest(rows)
    if row.trust == "withheld" or not is_known(row.r2):
        return []
    limits = r2_limits(row)
    limits_text = ""
    if limits is not None:
        limits_text = f" (95 %: {100 * limits[0]:.0f} to {100 * limits[1]:.0f} %)"
    strength = (
        f"A straight line explains r² = {100 * row.r2:.0f} % of the variance{limits_text} over"
        f" points of {point_of(row)}; the rest has other causes."
    )
    evidence = evidence_of(results, row)
    moving = next(layer for layer in results.moving if layer.name in (row.a, row.b))
    texts = (_limit_text(evidence), _short_waves_text(row, evidence))
    return [strength, *filter(None, texts), *_bearing_texts(evidence, moving)]


def _limit_text(evidence: EvidenceFacts | None) -> str:
    """Say how high r could be; empty where no attenuation limit is known."""
    if evidence is None or evidence.attenuation_limit is None:
        return ""
    highest = evidence.attenuation_limit_both
    causes = "misplacement and noise"
    if highest is None:
        highest = evidence.attenuation_limit
        causes = "misplacement"
    text = f"an r of {fixed(highest, 2)} here; the rest is lost to {causes}"
    if highest > 0.99:
        text = f"an r above 0.99 here: little is lost to {causes}"
    return f"A perfect relation would show {text}. {LEFT_OUT}"


def _short_waves_text(row: CorrelationRow, evidence: EvidenceFacts | None) -> str:
    """Say that long waves change r, where that is certain; elsewhere empty."""
    if evidence is None or evidence.short_waves is None or not evidence.short_waves_um:
        return ""
    short_waves = evidence.short_waves
    if not is_known(short_waves.interval):
        return ""
    low, high = short_waves.interval
    if low <= row.r <= high:
        return ""
    change = "lower" if abs(short_waves.r) > abs(row.r) else "raise"
    return (
        f"Waves below {plain(round(evidence.short_waves_um, -1))} alone have r ="
        f" {fixed(short_waves.r, 2)}: longer ones, of the sheet or of its light, {change} it."
    )


def _bearing_texts(evidence: EvidenceFacts | None, moving: LayerFacts) -> Iterator[str]:
    """Reconcile side light, the lag of the largest r and that with slopes allowed for.

    Then the strain. ``moving``: the layer that was brought onto the other.
    """
    lag = None
    if moving.registration is not None:
        lag = moving.registration.lag
    if lag is not None and is_known(lag.light):
        weight = "side light affects r" if lag.light >= SIDE_LIGHT else "too little to affect r"
        yield (
            f"{100 * lag.light:.0f} % of what image and sheet share follows slopes of the face, as"
            f" under light from one side: {weight}."
        )
    if lag is not None and evidence is not None:
        profiles = evidence.correlogram
        if profiles is not None and profiles.inner:
            yield _lag_text(lag, profiles)
    if moving.sheet is not None:
        yield from _strain_text(moving.sheet.flatten)


def _strain_text(flatten: FlatteningQuality) -> Iterator[str]:
    """Compare the strain of flattening with what paper withstands."""
    strain = flatten.edge_strain_p95
    limit = flatten.curvature.limit
    if is_known(strain):
        yield (
            f"Flattening strains the sheet by {percent(strain, 2)} (95 % of its edges),"
            f" {'less' if strain < limit else 'more'} than the {percent(limit, 1)} that paper"
            " withstands."
        )


def _lag_text(lag: LagNumbers, profiles: CorrelogramProfiles) -> str:
    """Say why the largest r may lie at a lag that the marks exclude.

    ``lag``: that of the fine textures, with slopes allowed for; ``profiles``: r at all lags.
    """
    lag_um = math.hypot(*profiles.lag_um)
    peak = (
        f"r would be largest, {fixed(profiles.peak_r, 2)}, with one map shifted by"
        f" {length(lag_um, 2)}."
    )
    if not is_known(lag.length_um):
        return (
            f"{peak} The fine texture does not tell whether that is an error of the registration."
        )
    expected_text = length(lag.expected_um, 2)
    light_text = ""
    if is_known(lag.light):
        light_text = ", slopes allowed for"
    texture = f"The fine texture lies {length(lag.length_um, 2)} apart{light_text}"
    if not lag.agrees:
        return f"{peak} {texture}, where {expected_text} are expected: see Registration."
    if lag_um <= _ABOVE_ERROR * max(lag.expected_um, lag.length_se_um):
        return f"{peak} That is about the error of the registration."
    cause = "the light moves the peak" if lag.light >= SIDE_LIGHT else "the peak is broad"
    return f"{peak} {texture} ({expected_text} expected): {cause}, and the registration stands."
