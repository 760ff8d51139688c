"""How each map varies with distance."""

from collections.abc import Iterator

from planish.analyze.variograms import Variogram
from planish.core.facts import is_known
from planish.core.numbers import in_words, number, percent, plain, unit
from planish.report.sentences.wording import Wording


def say_variograms(curves: tuple[Variogram, ...], _: object, words: Wording) -> Iterator[str]:
    """Nugget, range and direction of each map; ``curves`` are those of ``words.titles``."""
    for curve, title in zip(curves, words.titles, strict=True):
        nugget_share = 1.0
        if curve.sill > 0:
            nugget_share = curve.nugget / curve.sill
        nugget_text = f"nugget {number(curve.nugget, 2)} {squared_unit(curve, title)}"
        if nugget_share > 0.999:
            yield f"{title}: neighbours share nothing ({nugget_text}): noise, no texture."
            continue
        noise_text = "no nugget"
        if nugget_share > 5e-4:
            noise_text = f"{nugget_text}, {percent(nugget_share, 2)} of the sill"
        farthest_text = plain(round(curve.distances_um[-1]))
        direction_text = "no direction, as the machine direction is not given"
        if is_known(curve.md_deg):
            ratio_text = ""
            if is_known(curve.ratio):
                ratio_text = f" ({number(curve.ratio, 2)} times as far)"
            direction_text = (
                f"{_range_text(curve.range_along_um, farthest_text)} along and"
                f" {_range_text(curve.range_across_um, farthest_text)} across the machine"
                f" direction{ratio_text}"
            )
        yield (
            f"{title}: {noise_text}; range {_range_text(curve.range_um, farthest_text)};"
            f" {direction_text}."
        )


def squared_unit(curve: Variogram, title: str) -> str:
    """Unit of a variance; of what has no unit its name."""
    return f"{unit(curve.units) or in_words(title.partition(',')[0])}²"


def _range_text(range_um: float, farthest_text: str) -> str:
    """Write a range; one that is not known is longer than the curve, ``farthest_text``."""
    if not is_known(range_um):
        return f"beyond {farthest_text}"
    decimals = 0 if range_um >= 10 else 1
    return plain(round(range_um, decimals))
