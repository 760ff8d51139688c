"""Sentences on octaves of wavelength: how much a map varies in each, what it shows of another."""

from collections.abc import Iterator, Sequence

from planish.analyze.scales import MapScales, ScaleBand, Scales
from planish.core.facts import is_known
from planish.core.numbers import (
    capital,
    fixed,
    in_words,
    interval_text,
    percent,
    plain,
    to_spread,
    with_unit,
)
from planish.core.tables import grouped
from planish.core.text import and_join
from planish.core.typing import Pair

_MOST = 2  # maps that the answer is about
_WIDE = 0.15  # half of an interval over its standard deviation: from there, a larger field
_LOUD = 0.5  # share of the variance of an octave


def say_answer(octaves: Scales) -> str:
    """The answer: where the first maps vary most, or what they show of the other map.

    Where no octave of a map can be measured, why; where the formation of a map is known, that too.
    """
    sentences: list[str] = []
    for name in leading(octaves):
        facts = octaves.maps[name]
        bands = octaves.bands[name]
        if not bands:
            sentences.append(f"{_title(facts)}: {facts.reason}")
        elif octaves.against is None:
            sentences.append(_say_spread(facts, bands))
        else:
            sentences.append(_say_relation(octaves, facts, bands))
        if facts.formation is not None:
            sentences.append(_say_formation(facts))
    return " ".join(sentences)


def leading(octaves: Scales) -> list[str]:
    """Names of the maps that the answer is about."""
    return list(octaves.maps)[:_MOST]


def leading_band(octaves: Scales, bands: Sequence[ScaleBand]) -> ScaleBand:
    """The octave that the answer names: of the largest coherence, or standard deviation."""
    related = _related(bands)
    if octaves.against is None or not related:
        return max(bands, key=lambda band: band.sd)
    return max(related, key=lambda band: band.coherence)


def _related(bands: Sequence[ScaleBand]) -> list[ScaleBand]:
    return [band for band in bands if is_known(band.coherence) and is_known(band.gain)]


def _levels(octaves: Scales, facts: MapScales) -> bool:
    """Whether a coating is compared with the surface of its base."""
    return facts.map.startswith("coating_") and "base_surface" in str(octaves.against)


def waves(band: ScaleBand) -> str:
    """The wavelengths of an octave."""
    low = plain(band.low_um)
    high = plain(band.high_um)
    if low[-2:] == high[-2:]:
        low = low[:-3]
    return f"{low} to {high}"


def _title(facts: MapScales) -> str:
    return capital(in_words(facts.title))


def _say_spread(facts: MapScales, bands: Sequence[ScaleBand]) -> str:
    """Where a map varies most, and by how much; of an image that is its mottle."""
    largest = max(bands, key=lambda band: band.sd)
    interval = _ends(largest.interval, largest.sd)
    noise_text = ", without noise" if facts.shared is not None else ""
    sd_text = with_unit_of(to_spread(largest.sd, _half(largest.interval)), facts.units)
    if facts.map == "image" and is_known(largest.cov):
        size_text = f"{percent(largest.cov)} of its mean"
        return (
            f"The mottle of {in_words(facts.title)} is largest in waves of {waves(largest)}:"
            f" {size_text} (standard deviation {sd_text}; 95 %: {interval})."
        )
    cov_text = ""
    if is_known(largest.cov):
        cov_text = f"; {percent(largest.cov)} of its mean"
    return (
        f"{_title(facts)} varies most in waves of {waves(largest)}: its standard deviation there is"
        f" {sd_text} (95 %: {interval}{cov_text}){noise_text}."
    )


def _say_relation(octaves: Scales, facts: MapScales, bands: Sequence[ScaleBand]) -> str:
    """In which waves a map follows the other one most, and by how much.

    Of a coating over the surface of its base: how much of the height it levels. Also in which waves
    it does not follow.
    """
    other = in_words(octaves.against_title)
    related = _related(bands)
    if not related:
        return f"Whether {in_words(facts.title)} follows {other} cannot be said in any octave."
    best = leading_band(octaves, bands)
    if not best.coherence_interval[0] > 0:
        return f"{_title(facts)} follows {other} in no octave beyond chance."
    follows, rises = "mirrors", "falls"
    if best.gain > 0:
        follows, rises = "follows", "rises"
    low, high = sorted(map(abs, best.gain_interval))
    # Hundredths of a change are the most that anyone reads.
    size = to_spread(abs(best.gain), max(_half(best.gain_interval), 0.1 * abs(best.gain)))
    digits = _decimals(size)
    title = in_words(facts.title)
    text = (
        f"{_title(facts)} {follows} {other} most in waves of {waves(best)} (squared coherence"
        f" {fixed(best.coherence, 2)}; 95 %: {interval_text(best.coherence_interval)}): where"
        f" {other} rises by {with_unit(1.0, octaves.against_units)}, {title} {rises} by"
        f" {with_unit_of(size, facts.units)} (95 %:"
        f" {interval_text((low, high), digits)})."
    )
    if _levels(octaves, facts) and best.gain_interval[1] >= -1 and best.gain < 0:
        share_text = percent(min(-best.gain, 1.0), 2)
        text += f" The coating levels {share_text} of the height of these waves."
    silent = [waves(band) for band in related if not band.coherence_interval[0] > 0]
    if silent:
        text += f" In waves of {and_join(silent)} it does not follow beyond chance."
    return text


def _say_formation(facts: MapScales) -> str:
    formation = facts.formation
    assert formation is not None
    low, high = formation.interval
    verdict = "as uneven as"
    if low > 1:
        verdict = "more uneven than"
    elif high < 1:
        verdict = "more even than"
    return (
        f"Its formation number over cells of {plain(formation.cell_um)} is"
        f" {fixed(formation.number, 2)} (95 %: {interval_text(formation.interval)}): {verdict} a"
        " random sheet of the stated fibres."
    )


def say_surer(octaves: Scales) -> list[str]:
    """What would make octaves more certain; at most three sentences."""
    sentences: list[str] = []
    doubtful = [in_words(facts.title) for facts in octaves.maps.values() if facts.trust != "ok"]
    if doubtful:
        sentences.append(
            f"Checks of the run leave {and_join(doubtful)} doubtful: look at them before anything"
            " else."
        )
    names = [name for name in leading(octaves) if octaves.bands[name]]
    if any(_wants_larger_field(octaves.bands[name]) for name in names):
        longest_um = octaves.bands[names[0]][0].high_um  # octaves stand from the longest waves on
        sentences.append(
            "A larger field: four times the area halves the interval of each octave, and adds the"
            f" octave above {plain(longest_um)}. Waves count where five of them fit along the"
            " shorter side of the field."
        )
    sentences += _say_noise(octaves, names)
    if names:
        sentences.append("Other fields and sheets: the interval is that of one field.")
    return sentences[:3]


def _say_noise(octaves: Scales, names: Sequence[str]) -> Iterator[str]:
    """In which waves noise is most of the variance of maps, and of which it is not known."""
    unknown: list[str] = []
    for name in names:
        title = in_words(octaves.maps[name].title)
        loud = [band for band in octaves.bands[name] if _is_loud(band)]
        if loud:
            yield (
                f"A scan with less noise: in waves of {waves(loud[-1])} most of the variance of"
                f" {title} is noise."
            )
        if octaves.maps[name].shared is None:
            unknown.append(title)
    if unknown:
        yield (
            f"A second measurement of {and_join(unknown)}: without one its noise is not known, and"
            " counts in every octave."
        )


def _wants_larger_field(bands: Sequence[ScaleBand]) -> bool:
    """Whether the longest waves vary most, or their interval is wide."""
    longest = bands[0]  # octaves stand from the longest waves on
    is_largest = longest.sd >= max(band.sd for band in bands)
    return is_largest or _half(longest.interval) > _WIDE * longest.sd


def _is_loud(band: ScaleBand) -> bool:
    return is_known(band.noise) and band.noise**2 > _LOUD * (band.sd**2 + band.noise**2)


def say_reading(octaves: Scales) -> list[str]:
    """How to read octaves, and what they do not say."""
    sentences = [
        "Each octave holds the waves between a length and its double, as if all others were taken"
        " off; their variances add up. Octaves are the same for every map, of paper and of print."
    ]
    if any(facts.shared is not None for facts in octaves.maps.values()):
        sentences.append(
            "Noise is what neighbouring rows of the scan do not share; it is taken off. What they"
            " share stays."
        )
    if octaves.against is not None:
        sentences.append(
            "Gain is the change of the map for a change of the other one in these waves alone, and"
            " squared coherence the share of its variance there that goes with it. It names no"
            " cause."
        )
    if any(_levels(octaves, facts) for facts in octaves.maps.values()):
        sentences.append(
            "Coating and base meet at one interface: where it was found too high or too low, the"
            " gain is -1 as well. Only the noise of it is taken off. A gain beyond -1 is no"
            " levelling: the face is high over valleys of the base, as where thick coating was"
            " pressed into it."
        )
    if "image" in (facts.map for facts in octaves.maps.values()):
        sentences.append(
            "Of an image the coefficient of variation of an octave is its mottle there, after the"
            " idea of ISO/IEC 24790, without its procedure."
        )
    if any(facts.formation for facts in octaves.maps.values()):
        sentences.append(
            "A formation number of 1 is that of fibres laid at random; flocs raise it."
        )
    return sentences


def say_notes(octaves: Scales) -> list[str]:
    """What else stands beside the octaves.

    Maps without any, noise that both halves of the rows share, heights above a form, and that the
    study declared other maps.
    """
    notes = [
        f"{_title(facts)}: {facts.reason}"
        for facts in octaves.maps.values()
        if facts.reason is not None
    ]
    for cause, maps in grouped(octaves.maps.values(), lambda facts: facts.shared).items():
        if cause is not None:
            titles = and_join(in_words(facts.title) for facts in maps)
            notes.append(f"All rows share {cause}: it stays in {titles}.")
    notes += _say_forms(octaves)
    if octaves.declared is False:
        notes.append("The study declared other maps: these were chosen later.")
    return notes


def _say_forms(octaves: Scales) -> Iterator[str]:
    """Which octaves the form of a height takes in part."""
    forms = {facts.title: facts.form_um for facts in octaves.maps.values()}
    forms[octaves.against_title] = octaves.against_form_um
    bands = next(iter(octaves.bands.values()), ())
    for title, form_um in forms.items():
        cut = [waves(band) for band in bands if band.high_um > form_um]  # none where it is NaN
        if cut:
            yield (
                f"{capital(in_words(title))} is a height above its form, which takes half of waves"
                f" of {plain(form_um)}, and longer ones: in waves of {and_join(cut)} it varies less"
                " than the face itself, and a gain for it is too large."
            )


def with_unit_of(text: str, units: str) -> str:
    """Write a number that is typeset already with a unit."""
    return f"{text}{with_unit(0.0, units).removeprefix('0')}"


def _half(interval: Pair) -> float:
    return 0.5 * (interval[1] - interval[0]) if is_known(interval) else 0.0


def _ends(interval: Pair, value: float) -> str:
    return interval_text(interval, _decimals(to_spread(value, _half(interval))))


def _decimals(text: str) -> int:
    return len(text.partition(".")[2])
