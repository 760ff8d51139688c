"""Checks of an image's grey: what its white image says, and whether grey is linear."""

from collections.abc import Mapping

from planish.checks.files import ImageFile
from planish.core.checks import Check, CheckRule
from planish.core.text import and_join

LOST = 0.01  # share of the pixels without a grey, as of an image that is clipped
TEXTURE = 0.1  # variance of a white's texture over the image's: r would be 5 % weaker
_LOST_IN_WHITE = {
    "white_saturated": "of the white image are saturated",
    "too_dark": "have too little light in the white image",
}
_WHITE_ADVICE = (
    "Take the white image again: a plain white sheet, out of focus or the mean of several places,"
    " light and exposure as for the image, and nothing at the end of the scale."
)
LIGHTEST = 1.2  # no paper reflects more than a white sheet of 85 % by so much


def white_image(rule: CheckRule, file: ImageFile) -> Check | None:
    """Judge whether white and dark image fit the image and left enough of it.

    None where the image was not divided by a white one. Shares are of the image's pixels, the
    median is that of the image over the white sheet, in light as the exposures state it.
    """
    light = file.light
    if light is None:
        return None
    image_texts = _lost_texts(light.shares, {"saturated": "of the image are saturated"})
    white_texts = _lost_texts(light.shares, _LOST_IN_WHITE)
    if light.texture > TEXTURE:
        white_texts.append(
            "the white image has a texture of its own,"
            f" {100 * light.texture**0.5:.0f} % of the contrast of the image"
        )
    if light.exposure is not None and light.median > LIGHTEST:
        white_texts.append(f"the image is {light.median:.3g} times as light as the white sheet")
    texts = image_texts + white_texts
    if not texts:
        return rule.check("pass", f"The white image fits: {light.sentence}.")
    advice = _WHITE_ADVICE
    if not white_texts:
        advice = "Take the image again, at an exposure at which nothing of it is saturated."
    return rule.check("look", f"White and dark image: {and_join(texts)}.", advice=advice)


def _lost_texts(shares: Mapping[str, float], text_of_state: Mapping[str, str]) -> list[str]:
    """Say how many pixels have no grey, for each state of too many of them."""
    return [
        f"{100 * shares[state]:.2g} % of the pixels {text}"
        for state, text in text_of_state.items()
        if shares[state] > LOST
    ]


def linear_grey(rule: CheckRule, file: ImageFile) -> Check | None:
    """Judge whether grey that is taken as linear is coded with a curve, by what the file says.

    ``gamma`` is the curve that the user gave, None without; ``curve`` says in words what the file
    states of its own, and ``is_linear`` that it states a straight one.
    """
    attrs = file.image.attrs
    curve = attrs.get("curve")
    gamma = attrs.get("gamma")
    is_linear = attrs.get("is_linear")
    if is_linear and gamma not in (None, 1):
        sentence = f"Grey was decoded by {gamma}, and the file says that it is linear: {curve}."
        return rule.check("look", sentence, remedy="Leave `gamma` out.")
    if gamma == 1:
        return rule.check("pass", "Grey is linear, as given.")
    if gamma is not None:
        return rule.check("pass", f"Grey was made linear by the curve given, {gamma}.")
    is_camera = attrs.get("camera") and attrs["stored_dtype"] == "uint8"
    if is_linear or not (curve or is_camera):
        return None
    reason = f"it is coded: {curve}" if curve else f"it comes from {attrs['camera']}, in 8 bits"
    return rule.check(
        "look",
        f"The image's grey was taken as linear, and by its file {reason}.",
        advice="Contrast is then too large in dark parts and too small in light ones.",
        remedy="Give `gamma=srgb` for a photograph, or `gamma=1` where its grey is linear.",
    )
