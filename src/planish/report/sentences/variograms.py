"""How each map varies with distance."""

from collections.abc import Iterator

from planish.analyze.correlation_evidence import EvidenceFacts
from planish.analyze.variograms import Variogram
from planish.core.facts import is_known
from planish.core.numbers import in_words, number, percent, plain, unit
from planish.report.sentences.wording import Wording


def say_variograms(
    curves: tuple[Variogram, ...], _: EvidenceFacts, words: Wording
) -> Iterator[str]:
    """Nugget, range and direction of each map."""
    for curve, title in zip(curves, words.titles, strict=True):
        nugget_share = curve.nugget / curve.sill if curve.sill > 0 else 1.0
        nugget_text = f"nugget {number(curve.nugget, 2)} {squared_unit(curve, title)}"
        if nugget_share > 0.999:
            yield f"{title}: neighbours share nothing ({nugget_text}): noise, no texture."
            continue
        noise_text = (
            f"{nugget_text}, {percent(nugget_share, 2)} of the sill"
            if nugget_share > 5e-4
            else "no nugget"
        )
        farthest_text = plain(round(curve.distances_um[-1]))
        if not is_known(curve.md_deg):
            direction_text = "no direction, as the machine direction is not given"
        else:
            ratio_text = (
                f" ({number(curve.ratio, 2)} times as far)" if is_known(curve.ratio) else ""
            )
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
    return (
        plain(round(range_um, 0 if range_um >= 10 else 1))
        if is_known(range_um)
        else f"beyond {farthest_text}"
    )
