"""Whether the relation is straight."""

from collections.abc import Iterator

from planish.analyze.curve import Curvature
from planish.core.numbers import fixed, plain
from planish.report.sentences.wording import Wording


def say_curve(curvature: Curvature, _: object, words: Wording) -> Iterator[str]:
    """Say whether the relation is straight, with r² of a line and of a parabola."""
    r2_text = (
        f"r² is {fixed(curvature.r2_line, 2)} of the line and {fixed(curvature.r2_parabola, 2)} of"
        " the parabola"
    )
    yield f"Over points of {plain(words.point_um)} the relation is {curvature.words} ({r2_text})."
