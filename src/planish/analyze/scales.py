"""How much a map varies in each octave of wavelength, and what it shows there of another one.

The noise of a measurement adds to every octave: two half measurements give it, and it is taken off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planish.analyze.distributions import around, t_95, variance_interval
from planish.analyze.formation import Formation, RandomSheet
from planish.core.area import valid_in_all
from planish.core.facts import NULL, DescribedModel, Interval, Trust, Value
from planish.core.typing import Array, Complexes, Entries, Floats, Pair, pair_of
from planish.texture.octave_spectra import OctaveFields, OctavePower

_LEAST_SIGNAL = 0.1  # share of the power that is no noise: below, the rest says nothing of the map
_LEAST_MODES = 4.0  # independent waves that an interval needs
_LEAST_DEGREES = 2.0  # of freedom: less has what holds next to nothing but leaks of other waves


class ScaleBand(DescribedModel):
    """One octave of wavelength of a map."""

    low_um: float
    """Shortest wave."""
    high_um: float
    """Longest wave."""
    sd: Value
    """Standard deviation in the octave, without noise."""
    interval: Interval = NULL
    """Its 95 % interval, of the sheet by this field."""
    cov: Value = NULL
    """sd over the mean, a share; None of what has no zero of its own."""
    noise: Value = NULL
    """Standard deviation of the noise that was taken off."""
    modes: Value = NULL
    """Independent waves."""
    formation: Value = NULL
    """cov over that of a random sheet of the stated fibres."""
    gain: Value = NULL
    """Change of this map for a change of the other one, with its sign, without noise."""
    gain_interval: Interval = NULL
    """Its 95 % interval."""
    coherence: Value = NULL
    """Squared, corrected for chance and without noise."""
    coherence_interval: Interval = NULL
    """Its 95 % interval."""
    phase_deg: Value = NULL
    """Of this map against the other one, in waves towards larger x: 0, or 180, where one simply
    follows the other."""
    phase_interval: Interval = NULL
    """Its 95 % interval."""


class MapScales(DescribedModel):
    """What the octaves are of."""

    map: str
    """Name of the map."""
    layer: str = ""
    """Name of the layer."""
    title: str
    """Title of the map."""
    units: str = "1"
    """Of the map."""
    mean: Value = NULL
    """Over the pixels that count."""
    n: int | None = None
    """Pixels that count."""
    pixel_um: Pair | None = None
    """Size of a pixel along y and x."""
    field_um: Pair | None = None
    """Size of the field along y and x."""
    known_share: Value = NULL
    """Share of the pixels of the grid that count."""
    form_um: Value = NULL
    """Nesting index of the form that a surface is above."""
    shared: str | None = None
    """What two half measurements share; None where there are none."""
    formation: Formation | None = None
    """Where the fibres are stated."""
    trust: Trust = "ok"
    """What the checks leave of the figures."""
    reason: str | None = None
    """Why there are no octaves."""


class Scales(DescribedModel):
    """Octaves of several maps, and what these are."""

    bands: dict[str, tuple[ScaleBand, ...]]
    """By map, from the longest waves to the shortest."""
    maps: dict[str, MapScales]
    """By map, too."""
    against: str | None = None
    """Map that each one is compared with."""
    against_title: str = ""
    """Its title."""
    against_units: str = "1"
    """Its unit."""
    against_form_um: Value = NULL
    """Nesting index of the form that it is above."""
    declared: bool | None = None
    """Whether the study declared it; None where it declares none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaledMap:
    """A map (rows, cols) as its octaves are taken, NaN where it does not count."""

    facts: MapScales
    values: Array
    has_zero: bool = False  # so that it has a coefficient of variation
    is_mass: bool = False  # so that it has a formation number


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HalfDifferences:
    """Half the difference of two half measurements (rows, cols) of some maps, by their numbers.

    ``of_rows``: the halves are odd and even rows. The pixels may be others than those of the maps.
    """

    of_maps: dict[int, Array]
    pixel_um: Pair
    of_rows: bool = False


def octaves_of_map(
    maps: Sequence[ScaledMap],
    pixel_um: Pair,
    halves: Sequence[HalfDifferences] = (),
    *,
    fields: OctaveFields,
) -> tuple[MapScales, tuple[ScaleBand, ...]]:
    """What the first map is, and its octaves; with a second map what the first shows of it.

    Parameters
    ----------
    maps : sequence of ScaledMap
        One or two, on one grid; the pixels count that are known in both.
    pixel_um : (float, float), along y and x
    halves : sequence of HalfDifferences
        Those of maps 0 and 1 from one scan stand together: they may share their noise.
    fields : OctaveFields
        The same for maps that are described one after the other.

    Returns
    -------
    MapScales, tuple of ScaleBand
        From the longest waves to the shortest: octaves of 1 mm, from a fifth of the shorter side of
        the field down to 4 pixels; none where the field holds no octave, and then a reason.

    Notes
    -----
    The interval is that of a Gaussian texture, by Satterthwaite's degrees of freedom; where noise
    is taken off, that of a difference of variances (Zou and Donner 2008). Gain and phase have the
    random errors of Bendat and Piersol (2010), section 9.2.

    References
    ----------
    Zou and Donner (2008), Stat. Med. 27, 1693, doi:10.1002/sim.3095. Bendat and Piersol (2010),
    Random Data, 4th ed., doi:10.1002/9781118032428.
    """
    arrays = [m.values for m in maps]
    is_valid = valid_in_all(arrays)
    facts = _facts_on(maps[0].facts, arrays[0], is_valid, pixel_um)
    field = fields.on(is_valid, pixel_um)
    if not field.octaves:
        reason = (
            "The field holds no octave: waves count where five of them fit along its shorter side"
            " and each is 4 pixels long or more. Give a larger field, or smaller pixels."
        )
        return facts.model_copy(update={"reason": reason}), ()
    count = len(maps)
    noise = _noise_of(halves, count, fields)
    mean = math.nan
    if maps[0].has_zero and facts.mean > 0:
        mean = facts.mean
    bands: list[ScaleBand] = []
    # Of each octave the powers of the maps with each other, without what other waves leak.
    for power in field.powers(arrays):
        octave_noise = noise.get(power.low_um, _Noise.none(count))
        values = _spread(power, octave_noise, mean)
        if count > 1:
            values |= _relation(power, octave_noise)
        band = ScaleBand(low_um=power.low_um, high_um=power.high_um, **values)
        bands.append(band)
    return facts, tuple(bands)


def _facts_on(facts: MapScales, values: Array, is_valid: Array, pixel_um: Pair) -> MapScales:
    """What a map is, with its mean and the extent of what counts of it."""
    known_values = values[is_valid]
    n = known_values.size
    mean = math.nan
    if n:
        mean = float(known_values.mean(dtype=np.float64))
    field_um = pair_of(np.multiply(is_valid.shape, pixel_um))
    update: Entries = {"n": n, "mean": mean, "pixel_um": pixel_um, "field_um": field_um}
    update["known_share"] = n / is_valid.size
    return facts.model_copy(update=update)


@dataclass(frozen=True, slots=True, eq=False)
class _Noise:
    """Power of the noise of maps in an octave, with each other, and its degrees of freedom."""

    power: Complexes  # (maps, maps); 0 where nothing is known
    degrees: Floats  # (maps,); infinite there

    @classmethod
    def none(cls, count: int) -> _Noise:
        """Of maps of whose noise nothing is known."""
        power = np.zeros((count, count), dtype=np.complex128)
        return cls(power, np.full(count, math.inf))


def _noise_of(
    halves: Sequence[HalfDifferences], count: int, fields: OctaveFields
) -> dict[float, _Noise]:
    """Noise of so many maps by the shortest wave of each octave, in um.

    Maps of which no two halves are given have none.
    """
    noise: dict[float, _Noise] = {}
    for half in halves:
        numbers = list(half.of_maps)
        differences = list(half.of_maps.values())
        field = fields.on(valid_in_all(differences), half.pixel_um)
        are_of_rows = [half.of_rows] * len(differences)
        for power in field.powers(differences, rows=are_of_rows):
            octave_noise = noise.setdefault(power.low_um, _Noise.none(count))
            octave_noise.power[np.ix_(numbers, numbers)] = power.power
            octave_noise.degrees[numbers] = power.degrees
    return noise


def _spread(power: OctavePower, noise: _Noise, mean: float) -> Entries:
    """Standard deviation of the first map in an octave, with its interval, as fields of a band.

    ``mean`` is that of the map, NaN where it has no coefficient of variation. No interval where the
    octave has too few independent waves.
    """
    total = power.power[0, 0].real
    noise_power = noise.power[0, 0].real
    rest = total - noise_power
    sd = math.sqrt(max(rest, 0.0))
    fields: Entries = {"sd": sd, "modes": power.modes, "cov": sd / mean}
    if noise_power > 0:
        fields["noise"] = math.sqrt(noise_power)
    if power.modes < _LEAST_MODES or power.degrees[0] < _LEAST_DEGREES:
        return fields
    low, high = variance_interval(total, power.degrees[0])
    noise_low, noise_high = variance_interval(noise_power, noise.degrees[0])
    below = math.hypot(total - low, noise_high - noise_power)
    above = math.hypot(high - total, noise_power - noise_low)
    limits = np.maximum([rest - below, rest + above], 0.0)
    fields["interval"] = pair_of(np.sqrt(limits))
    return fields


def _relation(power: OctavePower, noise: _Noise) -> Entries:
    """Gain, coherence and phase of the first map against the second, as fields of a band.

    Nothing where the octave has too few independent waves, or one of the maps is nearly all noise.
    """
    totals = np.diag(power.power).real
    noise_powers = np.diag(noise.power).real
    # Of each map's power, what is no noise.
    shares = 1.0 - noise_powers / np.maximum(totals, 1e-300)
    modes = 0.5 * min(power.degrees[1], 2.0 * power.modes)
    raw_coherence = power.coherence[1, 0]
    has_signal = shares.min() > _LEAST_SIGNAL
    if modes < _LEAST_MODES or not has_signal or math.isnan(raw_coherence):
        return {}
    cross = complex(power.power[1, 0])
    cross_rest = cross - complex(noise.power[1, 0])
    raw = min(abs(cross) ** 2 / totals.prod(), 1.0)
    own_power = totals[1] * shares[1]
    t = t_95(2 * modes - 2)
    # Of noise in the cross power and, where noise was taken off the second map, in its power.
    error = math.inf
    if raw > 0:
        error = math.sqrt((1 - raw) / (2 * modes * raw))
    noise_share = 1 - shares[1]
    error_of_noise = math.sqrt(2 / noise.degrees[1]) * noise_share / shares[1]
    relative = t * math.hypot(error, error_of_noise)
    sign = math.copysign(1.0, cross_rest.real)
    gain = sign * abs(cross_rest) / own_power
    phase_deg = math.degrees(math.atan2(cross_rest.imag, cross_rest.real))
    fields: Entries = {"gain": gain, "phase_deg": phase_deg}
    fields["gain_interval"] = around(gain, abs(gain) * relative)
    if t * error < 1:
        width_deg = math.degrees(math.asin(t * error))
        fields["phase_interval"] = around(phase_deg, width_deg)
    factor = 1.0
    if abs(cross) > 0:
        factor = abs(cross_rest / cross) ** 2 / shares.prod()
    by_chance = 1 / power.modes
    fields["coherence"] = factor * (raw_coherence - by_chance) / (1 - by_chance)
    raw_r = min(math.sqrt(raw_coherence), 1 - 1e-12)
    width = 1.96 / math.sqrt(2 * power.modes - 2)
    ends = np.maximum(around(math.atanh(raw_r), width), 0.0)
    limits = factor * np.tanh(ends) ** 2
    fields["coherence_interval"] = pair_of(np.minimum(limits, 1.0))
    return fields


def with_formation(bands: Sequence[ScaleBand], sheet: RandomSheet) -> tuple[ScaleBand, ...]:
    """The same octaves, each with the formation number of its waves."""
    numbers = [band.cov / sheet.cov_of(band.low_um, band.high_um) for band in bands]
    with_numbers = zip(bands, numbers, strict=True)
    return tuple(band.model_copy(update={"formation": number}) for band, number in with_numbers)
