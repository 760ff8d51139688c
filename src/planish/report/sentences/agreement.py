"""Two measurements of one quantity: waves in common, bias, and the line between both."""

from collections.abc import Iterator

from planish.analyze.agreement import AgreementFacts
from planish.analyze.correlation_evidence import EvidenceFacts
from planish.core.facts import is_known
from planish.core.numbers import count, fixed, limits_text, number, plain, typeset, unit


def say_agreement(agreement: AgreementFacts, evidence: EvidenceFacts, *_: object) -> Iterator[str]:
    """Down to which wavelength two measurements agree, and how far they differ.

    Where a ratio of the variances of their errors was declared, the line between both, too.
    """
    if agreement.sentence:
        yield typeset(agreement.sentence)
    if is_known(agreement.bias) and is_known(agreement.point_um):
        units = unit(agreement.units)
        text = (
            f"{evidence.b} minus {evidence.a}, over {count(agreement.n)} points of"
            f" {plain(agreement.point_um)}: {fixed(agreement.bias, 2)} {units} on average"
            f" ({limits_text(agreement.bias_interval) or 'no interval'})"
        )
        if sd_text := limits_text(agreement.sd_interval):
            text += f"; standard deviation of a point within {f'{sd_text} {units}'.rstrip()}"
        yield f"{text}."
    if is_known(agreement.error_ratio):
        if not is_known(agreement.error_slope):
            yield (
                "No line is given: the two do not vary together, or too few points are independent."
            )
            return
        yield (
            "Line with errors in both (Deming, variances in a ratio of "
            f"{number(agreement.error_ratio)}, as declared): slope {number(agreement.error_slope)} "
            f"({limits_text(agreement.error_interval) or 'no interval'})."
        )
