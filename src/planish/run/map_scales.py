"""``pl.scales``: octaves of the maps of a run, or of a Dataset, and the noise in each."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from planish import __version__
from planish.analyze.formation import RandomSheet, formation_number
from planish.analyze.params import FIBRES, ScalesParams
from planish.analyze.scales import (
    HalfDifferences,
    MapScales,
    ScaleBand,
    ScaledMap,
    Scales,
    octaves_of_map,
    with_formation,
)
from planish.analyze.sheet_columns import SheetColumns
from planish.analyze.split_half import row_difference
from planish.core.arrays import check_path
from planish.core.axial import is_axial
from planish.core.errors import CannotMeasure, InputError, PlanishError
from planish.core.grid import Grid, pitch
from planish.core.options import params_of
from planish.core.transform import Similarity
from planish.core.typing import Array, Entries, Pair
from planish.measure.registry import HEIGHTS, LENGTHS, NEGATIVE_CONTROLS, has_true_zero
from planish.report.scales import scales_page, tables_of
from planish.report.sentences.scales import leading
from planish.run.answers import write_answer
from planish.run.named_maps import (
    OCTAVES,
    NamedMap,
    NamedMaps,
    choices,
    is_declared,
    maps_of,
    maps_of_dataset,
    named,
    trust_of_maps,
    with_answer,
)
from planish.run.run import Run, open_run
from planish.texture.octave_spectra import OctaveField, OctaveFields

ROWS = "rows"
"""The halves of a map whose odd and even rows are two measurements."""

Halves = Mapping[str, tuple[str, str] | str]
Read = Callable[[Sequence[str]], "Reading"]

_UNEVEN = ("thickness", "base_thickness")
"""Maps of a run in um whose unevenness is that of the fibres' mass."""


def scales(
    data: Run | xr.Dataset | str | Path,
    of: Sequence[str] = (),
    against: str | None = None,
    *,
    halves: Halves | None = None,
    fibre_length_mm: float | None = None,
    fibre_width_um: float | None = None,
    coarseness_mg_m: float | None = None,
    mean_grammage_g_m2: float | None = None,
    formation_cell_um: float = 1000.0,
) -> Scales:
    """State how much maps vary in each octave of wavelength, and what they show of another map.

    Parameters
    ----------
    data : Run, Dataset or path
        A run or its folder; or maps on one grid with coordinates in um: missing is NaN, and
        ``valid`` says which pixels count if it is there.
    of : sequence of str
        Maps; all of them where none is named. ``LAYER.MAP`` where several layers have one.
    against : str, optional
        Map that each is compared with: gain of the map for a change of this one, coherence, phase.
    halves : mapping of str to (str, str) or "rows", optional
        Of maps of a Dataset: the names of two half measurements of each, of which the map is the
        mean, or "rows" where its rows have errors of their own. Their noise is taken off. A run
        has the odd and the even rows of its columns.
    fibre_length_mm, fibre_width_um, coarseness_mg_m, mean_grammage_g_m2 : float, optional
        Mean fibre, and the mass of the sheet, for the formation number; all or none of them.
    formation_cell_um : float
        Edge of the cells that the formation number is of.

    Returns
    -------
    Scales
        ``bands[name]``: rows with ``low_um``, ``high_um``, ``sd``, ``interval`` (95 %), ``cov``,
        and with ``against`` also ``gain``, ``coherence``, ``phase_deg``; ``maps[name]``: what they
        are of, and the formation number.

    Raises
    ------
    InputError
        If a map is missing or holds angles of an axis.

    Examples
    --------
    >>> found = planish.scales("run", of=["coating_top"], against="image")  # doctest: +SKIP
    >>> [(band.low_um, band.gain) for band in found.bands["coating_top"]]  # doctest: +SKIP
    """
    options = {
        "map": tuple(of),
        "against": against,
        "fibre_length_mm": fibre_length_mm,
        "fibre_width_um": fibre_width_um,
        "coarseness_mg_m": coarseness_mg_m,
        "mean_grammage_g_m2": mean_grammage_g_m2,
        "formation_cell_um": formation_cell_um,
    }
    params = params_of(ScalesParams, options, "pl.scales")
    if isinstance(data, xr.Dataset):
        return scales_of_dataset(data, params, halves or {})
    if not isinstance(data, Run):
        folder = check_path(data, "a run", "pl.scales({})", 'pl.scales("run")')
        data = open_run(folder)
    return scales_of_run(data, params)


def scales_of_dataset(data: xr.Dataset, params: ScalesParams, halves: Halves) -> Scales:
    """Octaves of maps of a Dataset; errors as of :func:`scales`.

    Maps that are halves of others are none of the choices.
    """
    maps = maps_of_dataset(data, "scales")
    of_halves = {name for pair in halves.values() if pair != ROWS for name in pair}
    all_names = [name for name in choices(maps) if name not in of_halves]

    def read(names: Sequence[str]) -> Reading:
        sources = [named(maps, name) for name in names]
        scaled: list[ScaledMap] = []
        of_rows: dict[int, Array] = {}
        of_pairs: dict[int, Array] = {}
        for number, (name, source) in enumerate(zip(names, sources, strict=True)):
            values = _counted(source)
            facts = _facts(source, name)
            scaled.append(ScaledMap(facts=facts, values=values, has_zero=True, is_mass=True))
            pair = halves.get(name)
            if pair == ROWS:
                of_rows[number] = row_difference(values.astype(np.float64))
            elif pair is not None:
                first, second = (_counted(named(maps, half)) for half in pair)
                of_pairs[number] = 0.5 * (first - second)
        pixel_um = Grid.of(sources[0].values).pixel_um
        by_rows = HalfDifferences(of_maps=of_rows, pixel_um=pixel_um, of_rows=True)
        by_pairs = HalfDifferences(of_maps=of_pairs, pixel_um=pixel_um, of_rows=False)
        differences = [halves for halves in (by_rows, by_pairs) if halves.of_maps]
        return Reading(scaled, pixel_um, differences)

    return _scales(params, maps, all_names, read)


def with_declared_scales(run: Run) -> Run:
    """The same run with the octaves that its study declares, and their bands as maps.

    Where there can be none the run stands, and its results say why.
    """
    params = run.study.scales
    if not params.is_declared:
        return run
    try:
        octaves = scales_of_run(run, params)
    except PlanishError as fault:
        return with_answer(run, scales_reason=fault.text)
    maps = maps_of(run)
    bands: dict[str, xr.DataArray] = {}
    for name in leading(octaves):
        if octaves.bands[name]:
            bands |= _band_maps(named(maps, name), name)
    return with_answer(run, {OCTAVES: xr.Dataset(bands)} if bands else None, scales=octaves)


def _band_maps(source: NamedMap, name: str) -> dict[str, xr.DataArray]:
    """A map by octaves on its pixels, by names that state their waves."""
    like = source.values
    values = _counted(source)
    field = OctaveField(np.isfinite(values), Grid.of(like).pixel_um)
    facts = _facts(source, name)
    coords = {dim: like[dim] for dim in like.dims}
    bands: dict[str, xr.DataArray] = {}
    octaves = zip(field.octaves, field.band_maps(values), strict=True)
    for (low_um, high_um), band in octaves:
        waves = f"{facts.title}, waves of {low_um:g} to {high_um:g} um"
        attrs = {"units": facts.units, "long_name": waves}
        bands[f"{name}_{low_um:g}_{high_um:g}_um"] = xr.DataArray(band, coords, attrs=attrs)
    return bands


def scales_of_run(run: Run, params: ScalesParams) -> Scales:
    """Octaves of maps of a run; errors as of :func:`scales`.

    Maps of one sheet are taken on its columns, where their noise is known, unless regions are
    declared; an image, and what is compared with one, on the pixels of the reference.
    """
    maps = maps_of(run)

    def read(names: Sequence[str]) -> Reading:
        sources = [named(maps, name) for name in names]
        columns = [_columns_of(run, source) for source in sources]
        facts = [_facts(source, name) for name, source in zip(names, sources, strict=True)]
        is_one_sheet = len({source.layer for source in sources}) == 1
        if is_one_sheet and columns[0] is not None and run.regions is None:
            return _read_columns(columns[0], facts)
        scaled: list[ScaledMap] = []
        halves: list[HalfDifferences] = []
        for number, (source, fact, of_sheet) in enumerate(
            zip(sources, facts, columns, strict=True)
        ):
            scaled.append(_scaled(fact, _counted(source)))
            if of_sheet is not None:
                halves.append(_halves_of(of_sheet, {number: fact.map}))
        return Reading(scaled, Grid.of(sources[0].values).pixel_um, halves)

    octaves = _scales(params, maps, _shown_maps(run, maps), read)
    references = [] if params.against is None else [params.against]
    facts = dict(octaves.maps)
    bands = dict(octaves.bands)
    for name, fact in octaves.maps.items():
        sources = [named(maps, other) for other in (name, *references)]
        trust = trust_of_maps(run, sources)
        update: Entries = {"trust": trust}
        if trust == "withheld":
            reason = "A check of the run failed, and withholds it."
            update |= {"reason": reason, "formation": None}
            bands[name] = ()
        facts[name] = fact.model_copy(update=update)
    declared = is_declared(run.study.scales, params)
    return octaves.model_copy(update={"maps": facts, "bands": bands, "declared": declared})


@dataclass(frozen=True, slots=True)
class Reading:
    """One or two maps on one grid, its pixel, and the differences of their halves."""

    maps: Sequence[ScaledMap]
    pixel_um: Pair
    halves: Sequence[HalfDifferences]


def _scales(params: ScalesParams, maps: NamedMaps, all_names: Sequence[str], read: Read) -> Scales:
    """Octaves of the chosen maps, and of each with the map that is named ``against``.

    ``read`` gives a map, and the other one, by their names on one grid. Without a choice, all of
    ``all_names`` are taken. InputError where a map holds angles of an axis.
    """
    against = params.against
    chosen = params.of or [name for name in all_names if name != against]
    references = [] if against is None else [against]
    for name in [*chosen, *references]:
        if is_axial(named(maps, name).values):
            raise InputError(
                f"{name} holds angles of an axis, which have no standard deviation by octaves."
                " Name other maps."
            )
    fields = OctaveFields()
    sheet = _random_sheet(params)
    bands: dict[str, tuple[ScaleBand, ...]] = {}
    facts: dict[str, MapScales] = {}
    for name in chosen:
        reading = read([name, *references])
        fact, rows = octaves_of_map(reading.maps, reading.pixel_um, reading.halves, fields=fields)
        if sheet is not None and reading.maps[0].is_mass:
            rows = with_formation(rows, sheet)
            fact = fact.model_copy(update=_formation(reading, sheet, params.formation_cell_um))
        facts[name], bands[name] = fact, rows
    octaves = Scales(bands=bands, maps=facts, against=against)
    if against is None:
        return octaves
    other = _facts(named(maps, against), against)
    of_other = {
        "against_title": other.title,
        "against_units": other.units,
        "against_form_um": other.form_um,
    }
    return octaves.model_copy(update=of_other)


def _formation(reading: Reading, sheet: RandomSheet, cell_um: float) -> Entries:
    """The formation number of the first map, or the reason why there is none.

    Half the difference of its half measurements takes its noise off, where they have its pixels.
    """
    values = reading.maps[0].values
    difference = None
    for half in reading.halves:
        if 0 in half.of_maps and half.of_maps[0].shape == values.shape:
            difference = half.of_maps[0]
    try:
        formation = formation_number(
            values,
            pixel_um=reading.pixel_um,
            sheet=sheet,
            cell_um=cell_um,
            half_difference=difference,
        )
    except CannotMeasure as fault:
        return {"reason": fault.text}
    return {"formation": formation}


def _random_sheet(params: ScalesParams) -> RandomSheet | None:
    """The random sheet of the fibres that are stated; None where they are not."""
    stated = [getattr(params, name) for name in FIBRES]
    if None in stated:
        return None
    names = ("length_mm", "width_um", "coarseness_mg_m", "grammage_g_m2")
    return RandomSheet(**dict(zip(names, stated, strict=True)))


def _facts(source: NamedMap, name: str) -> MapScales:
    """What a map is, before it is looked at; ``form_um`` is NaN where no form was taken off."""
    attrs = source.values.attrs
    return MapScales(
        map=str(source.values.name),
        layer=source.layer,
        title=str(attrs.get("long_name", name)),
        units=str(attrs.get("units", "1")),
        form_um=attrs.get("form_um", math.nan),
    )


def _scaled(facts: MapScales, values: Array) -> ScaledMap:
    """A map of a run; an image and a property with a zero of its own have a cov."""
    name = facts.map
    return ScaledMap(
        facts=facts,
        values=values,
        has_zero=name == "image" or has_true_zero(name),
        is_mass=name in _UNEVEN or facts.units == "g/m2",
    )


def _counted(source: NamedMap) -> Array:
    """Values of a map, NaN where its pixels do not count."""
    values = source.values.values.astype(np.float32)
    if "valid" not in source.group or source.values.name == "valid":
        return values
    is_valid = source.group["valid"].values.astype(bool)
    return np.where(is_valid, values, np.float32(np.nan))


def _columns_of(run: Run, source: NamedMap) -> SheetColumns | None:
    """The columns of the sheet that a map is of; None of an image, and where they are elsewhere."""
    surfaces = run.groups.get("surfaces")
    if surfaces is None or source.values.name not in surfaces:
        return None
    return SheetColumns(measured=surfaces, flat=run.groups["flat"], similarity=Similarity())


def _read_columns(columns: SheetColumns, facts: Sequence[MapScales]) -> Reading:
    """Maps of one sheet on its columns, with the differences of odd and even rows."""
    scaled: list[ScaledMap] = []
    for fact in facts:
        shared = columns.shared(alone=fact.map in LENGTHS or fact.map in HEIGHTS)
        facts_shared = fact.model_copy(update={"shared": shared})
        scaled.append(_scaled(facts_shared, columns.measured[fact.map].values))
    halves = _halves_of(columns, {number: fact.map for number, fact in enumerate(facts)})
    return Reading(scaled, halves.pixel_um, [halves])


def _halves_of(columns: SheetColumns, names: Mapping[int, str]) -> HalfDifferences:
    """Half the differences of odd and even rows of some maps of a sheet, by their numbers."""
    of_maps = {number: row_difference(columns.faces(name)) for number, name in names.items()}
    return HalfDifferences(of_maps=of_maps, pixel_um=pitch(columns.measured), of_rows=True)


def _shown_maps(run: Run, maps: NamedMaps) -> list[str]:
    """All maps of a run but angles, the pose in the scanner, and those under two names.

    Those that lead are the first.
    """
    headlines = [layer.headline for layer in run.results.layers]
    names: list[str] = []
    seen_ids: set[int] = set()
    for name in choices(maps):
        source = maps[name]
        is_left_out = is_axial(source.values) or source.values.name in NEGATIVE_CONTROLS
        if source.values.ndim == 2 and not is_left_out and id(source) not in seen_ids:
            seen_ids.add(id(source))
            names.append(name)
    return sorted(names, key=lambda name: name not in headlines)


def write_scales(octaves: Scales, out: Path, *, source: str) -> None:
    """Write the page of octaves, ``scales.json`` and the octaves as a table into a new folder.

    ``source``: name of the run.
    """
    page = scales_page(octaves, source=source, version=__version__)
    write_answer(out, "scales", page=page, facts=octaves, tables=tables_of(octaves))
