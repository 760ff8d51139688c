"""Where the grid of points begins."""

from collections.abc import Iterator

from planish.core.numbers import decimals_of_r, fixed, plain
from planish.report.sentences.wording import Wording


def say_origins(r_range: tuple[float, float, float], _: object, words: Wording) -> Iterator[str]:
    """How far r depends on where the grid of points begins.

    ``r_range``: the smallest, mean and largest r over all origins.
    """
    decimals = decimals_of_r((r_range[0], r_range[2]))
    least_text, mean_text, largest_text = (fixed(v, decimals) for v in r_range)
    yield (
        f"Where the grid of points of {plain(words.point_um)} begins is arbitrary: over 16 origins"
        f" r is {mean_text} on average, from {least_text} to {largest_text}."
    )
