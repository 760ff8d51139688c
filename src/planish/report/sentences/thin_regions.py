"""The image where the coating is thin."""

from collections.abc import Iterator

from planish.analyze.thin_regions import RegionDifference
from planish.core.facts import is_known
from planish.core.numbers import number, percent, plain
from planish.report.sentences.wording import Wording


def say_thin(regions: tuple[RegionDifference, ...], _: object, words: Wording) -> Iterator[str]:
    """How the image differs where the coating is thin."""
    for region in regions:
        if is_known(region.interval):
            low, high = map(number, region.interval)
            yield (
                f"Where the coating is below {plain(region.thinner_than_um)}"
                f" ({percent(region.share, 2)} of the valid area) the mean {words.image} differs by"
                f" {number(region.difference)} (95 %: {low} to {high})."
            )
