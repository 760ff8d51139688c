"""Checks of the light that an image was taken in: even over the field, and from all sides."""

from planish.analyze.correlation_evidence import EvidenceFacts
from planish.analyze.lag import LagNumbers
from planish.core.checks import Check, CheckRule
from planish.core.facts import is_known
from planish.core.numbers import decimals_of_r, fixed, in_ascii, limits_text

EVEN_LIGHT = "even light"
"""Name of the check that doubts r with a smooth field left in, and not r without it."""

# Share of what image and sheet have in common that needs the slopes. On synthetic sheets with less,
# no displacement raises r of 100 um points by 0.005; at 0.56 to 0.71, one of 30 um raises it by
# 0.03 to 0.1: tests/test_side_light.py. A share of 0.25 is stated as 0.23 ± 0.02, since the halves
# of the coating take some of what is the slopes' (benchmarks/even_light.py).
SIDE_LIGHT = 0.23
# Of the width of an interval of 95 %, four standard errors: a bias of one leaves 83 % instead.
_MOVED = 0.25
# Texture alone gives a larger field in 1 of 1000 images in even light; where its range is a twelfth
# to an eighth of the shorter side, in 60 to 130, as waves longer than the field show in no
# covariance (docs/evidence.md). Few of these move r as well.
_BY_CHANCE = 0.001


def even_light(rule: CheckRule, evidence: EvidenceFacts) -> Check | None:
    """Judge whether a smooth field in an image moves r, and is more than the image's texture.

    ``field.r`` is r without that field, ``field.r_plain`` with it; they may differ by a share of
    the width of the interval. None where no field was fitted.
    """
    field = evidence.light_field
    if field is None:
        return None
    text = f"A smooth field holds {100 * field.share:.0f} % of the variance of the image"
    if not (is_known(field.interval) and is_known(field.interval_plain)):
        return rule.check(
            "unknown", f"{text}; too few points are independent to tell what that does to r."
        )
    decimals = decimals_of_r(field.interval)
    r_texts = [
        f"{fixed(r, decimals)} ({limits_text(limits, decimals)})"
        for r, limits in ((field.r, field.interval), (field.r_plain, field.interval_plain))
    ]
    r_text = (
        f"r over points of {field.point_um:g} um is {r_texts[0]}; with it left in, {r_texts[1]}."
    )
    if field.declared:
        sentence = in_ascii(f"{text} and was taken off, as declared: {r_text}")
        return rule.check("pass", sentence, value=field.change)
    if is_known(field.span):
        text += f"; the grey changes by {100 * field.span:.2g} % along it"
    sentence = in_ascii(f"{text}. With it off, {r_text}")
    low, high = field.interval_plain
    limit = _MOVED * (high - low)
    if field.p_even > _BY_CHANCE:
        return rule.check("pass", sentence, value=field.change, limit=limit)
    return rule.at_most(
        field.change,
        look=limit,
        sentence=sentence,
        advice=(
            "Take the image in even light, or divide it by one of a white sheet. Without the field"
            " r lacks the long waves that are the paper's own, too."
        ),
        remedy=(
            "`white` and `dark` take the pictures that divide the light off. `light=quadratic`"
            " leads with r without the field; declare it before you look at r."
        ),
    )


def side_light(rule: CheckRule, lag: LagNumbers) -> Check | None:
    """Judge how much of what image and sheet have in common is slopes of the face."""
    if not is_known(lag.light):
        return None
    return rule.at_most(
        lag.light,
        look=SIDE_LIGHT,
        units="share",
        sentence=(
            f"{100 * lag.light:.0f} % of what image and sheet share follows slopes of the face, as"
            " under light from one side."
        ),
        advice=(
            "A map that is displaced towards the light can have a larger r. Take the image in"
            " diffuse light, and judge the registration by its marks."
        ),
    )
