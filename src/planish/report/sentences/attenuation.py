"""The attenuation limit: what a perfect relation would show, by misplacement and by noise."""

from collections.abc import Iterator

from planish.analyze.correlation_evidence import EvidenceFacts
from planish.core.facts import is_known
from planish.core.numbers import count, fixed, percent, plain

LEFT_OUT = (
    "What light that spreads in the paper, the blur of the lens and shading take is not in it."
)
"""Of every attenuation limit."""


def say_attenuation(_: object, evidence: EvidenceFacts, *__: object) -> Iterator[str]:
    """What a perfect relation would show."""
    if evidence.attenuation_limit is not None:
        r = f"{evidence.attenuation_limit:.2f}"
        yield (
            f"A perfect relation would show r = {r} here (misplacement leaves {r}). It rests on the"
            " expected error of the registration and the texture of the map; noise lowers it"
            f" further. {LEFT_OUT}"
        )
    yield from say_reliability(evidence)


def say_reliability(evidence: EvidenceFacts) -> Iterator[str]:
    """How far two halves of each measurement agree, or why that is not known.

    Behind the last one: the r that a perfect relation would show with the noise of all of them.
    """
    for k, reliability in enumerate(evidence.reliability):
        map_text = reliability.map.replace("_", " ")
        if len(evidence.reliability) > 1:
            map_text += f" of {reliability.layer}"
        if not is_known(reliability.value):
            yield f"Reliability of {map_text}: not known. {reliability.reason or ''}".strip()
            continue
        # `plain` writes the unit too.
        size_text = f"over {count(reliability.n)} points of {plain(reliability.point_um)}"
        share_text = percent(max(1 - reliability.value, 0.01), 1)
        if reliability.value > 0.99:
            share_text = f"below {share_text}"
        text = (
            f"Odd and even rows of columns are two half measurements of {map_text}: {size_text}"
            f" they correlate with r {_near_one(reliability.halves_r)}, so that noise which differs"
            f" between them is {share_text} of the variance of the map"
        )
        if k == len(evidence.reliability) - 1 and evidence.attenuation_limit_noise is not None:
            limit_both = evidence.attenuation_limit_both
            shift_text = ""
            if limit_both is not None:
                shift_text = f", r {_near_one(limit_both)} with misplacement, too"
            noise_r = _near_one(evidence.attenuation_limit_noise)
            text += f"; with such noise alone a perfect relation would show r {noise_r}{shift_text}"
        yield (
            f"{text}. Errors that neighbouring columns share are not in it, and the standard error"
            f" of a column may be larger: both halves share {reliability.shared}."
        )


def _near_one(value: float) -> str:
    """Write r with its sign of equality.

    More than two nines would claim what halves of one scan cannot show.
    """
    if value > 0.99:
        return "above 0.99"
    return f"= {fixed(value, 2)}"
