"""Results of a run in one sentence and a few numbers.

What the image-based check of a registration means.
"""

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

from planish.analyze import LagNumbers
from planish.checks.light import EVEN_LIGHT
from planish.core.checks import CORRELATION, POSITION, State, concerned
from planish.core.facts import is_known
from planish.core.numbers import (
    NONE,
    capital,
    count,
    fixed,
    in_words,
    length,
    number,
    percent,
    typeset,
    unit,
    with_article,
)
from planish.core.tables import grouped
from planish.core.text import and_join
from planish.report.relation import largest, written_difference
from planish.report.sentences.light_field import off_text
from planish.report.sentences.partial import say_over_control
from planish.report.statement import (
    point_of,
    r2_interval_text,
    r2_text,
    r_interval_text,
    r_sentence,
    r_text,
)
from planish.report.text import LIGHT_OFF, TwoTexts, as_compared, stated_of
from planish.results import (
    CorrelationRow,
    EvidenceFacts,
    LayerFacts,
    RefinementR,
    RegistrationFacts,
    Results,
)

Titles = Mapping[TwoTexts, str]  # layer and map -> title of the map
PairKey = tuple[str, str, str, str]  # a pair of maps: first layer, its map, second layer, its map
_LOO = "leave-one-out error"


class KeyFigure(NamedTuple):
    """One number large, with what it is."""

    value: str
    unit: str
    label: str
    note: str


class LagVerdict(NamedTuple):
    """Result of the image-based check: its light, its sentence, and what that means."""

    state: Literal["agrees", "amber", "grey"]
    sentence: str
    meaning: str


def summarise(results: Results, titles: Titles) -> tuple[str, list[KeyFigure]]:
    """Return the result of a run in one sentence and a few numbers.

    They go as far as the result does, and no further.
    """
    if not results.is_link:
        return _map_summary(results, titles)
    if len(results.moving) == 1:
        return _pair_summary(results, titles)
    return _layers_summary(results, titles)


def check_summary(results: Results) -> str:
    """State how many checks failed, ask for a look or were not answered, and what follows."""
    fail = len(results.checks_in("fail"))
    look = len(results.checks_in("look"))
    unknown = len(results.checks_in("unknown"))
    total = len(results.checks)
    subjects = {n: "it concerns" if n == 1 else "they concern" for n in (fail, look)}
    clauses: list[str] = []
    if fail:
        clauses.append(f"{fail} failed, and what {subjects[fail]} is withheld")
    if look:
        verb = "asks" if look == 1 else "ask"
        clauses.append(f"{look} {verb} for a look, and what {subjects[look]} is doubtful")
    if unknown:
        clauses.append(f"{unknown} could not be answered")
    if clauses:
        return f"Of {total} checks, {'; '.join(clauses)}."
    if total == 1:
        return "The check passed."
    return f"All {total} checks passed."


def doubt(results: Results, row: CorrelationRow) -> str:
    """Say why the correlation of two maps is kept out of the headline."""
    state: State = "fail" if row.trust == "withheld" else "look"
    figures = row.a_map, row.b_map, POSITION, CORRELATION
    checks = concerned(results.checks_in(state), (row.a, row.b), figures)
    return f"is {row.trust} ({', '.join(dict.fromkeys(check.name for check in checks))})"


def key_of(pair: CorrelationRow | EvidenceFacts) -> PairKey:
    """Return the layers and maps of a pair."""
    return pair.a, pair.a_map, pair.b, pair.b_map


def titles_of(
    pair: CorrelationRow | EvidenceFacts, titles: Titles, *, with_layers: bool = False
) -> TwoTexts:
    """Return the titles of both maps of a pair, their names where they have none.

    On request with their layers.
    """
    first = as_compared(titles.get((pair.a, pair.a_map), pair.a_map), pair.a_map)
    second = as_compared(titles.get((pair.b, pair.b_map), pair.b_map), pair.b_map)
    if with_layers:
        return f"{first}, {pair.a}", f"{second}, {pair.b}"
    return first, second


def names_in_words(pair: CorrelationRow | EvidenceFacts, titles: Titles) -> TwoTexts:
    """Return the titles of both maps of a pair as they stand in a sentence."""
    first_title, second_title = titles_of(pair, titles)
    return in_words(first_title), in_words(second_title)


def by_pair(results: Results) -> list[list[CorrelationRow]]:
    """Group correlations of the same two maps, each group from the pixel to the largest points."""
    groups = grouped(results.correlations, key_of)
    return [sorted(rows, key=lambda row: row.point_um) for rows in groups.values()]


def headline_pair(results: Results, moving: LayerFacts) -> list[CorrelationRow]:
    """Return the correlations of the maps that stand for a layer and for the reference.

    Empty where there are none.
    """
    headlines = {(layer.name, layer.headline) for layer in (moving, results.reference)}
    for group in by_pair(results):
        row = group[0]
        if {(row.a, row.a_map), (row.b, row.b_map)} == headlines:
            return group
    return []


def lead_pair(results: Results) -> list[CorrelationRow]:
    """Return the correlations that the first page shows; empty where there are none.

    Of two layers those of the maps that stand for them, of more those of the pair with the weakest
    correlation: one that correlates well does not vouch for the others.
    """
    if not results.is_link:
        return []
    if len(results.moving) == 1:
        return headline_pair(results, results.moving[0])
    reference = results.reference.name
    groups = [group for group in by_pair(results) if is_known(largest(group).r2)]
    with_reference = [group for group in groups if reference in (group[0].a, group[0].b)]
    return min(with_reference, key=lambda group: largest(group).r2, default=[])


def evidence_of(results: Results, row: CorrelationRow) -> EvidenceFacts | None:
    """Return what stands beside a correlation; None where nothing does."""
    return next((e for e in results.evidence if key_of(e) == key_of(row)), None)


def density_of(results: Results, row: CorrelationRow) -> float | None:
    """Density by which the coating of a correlation is drawn as a weight.

    None where the run knows none.
    """
    evidence = evidence_of(results, row)
    if evidence is None:
        return None
    return evidence.density_g_cm3


def quantities(results: Results) -> list[str]:
    """Say of every image what its values are."""
    images = [(layer.name, layer.image) for layer in results.layers if layer.image is not None]
    texts = [f"{capital(with_article(name))}: {typeset(image.sentence)}." for name, image in images]
    if any(image.quantity == "grey value, uncalibrated" for _, image in images):
        texts.append(
            "A grey value is the brightness that the file holds: larger is lighter, in no"
            " physical unit."
        )
    if results.is_light_off:
        texts.append(
            f"{capital(LIGHT_OFF)}: it was fitted together with the map that leads. Long waves of"
            " the paper that look like it are off as well."
        )
    return texts


def _percent_text(share: float | None) -> str:
    return fixed(None if share is None else 100 * share, 0)


def _map_summary(results: Results, titles: Titles) -> tuple[str, list[KeyFigure]]:
    """The summary of a sheet that is mapped and linked to nothing."""
    layer = results.reference.name
    sheet = results.reference.sheet
    assert sheet is not None
    measured_share = sheet.surfaces.shares.get("measured")
    strain = sheet.flatten.edge_strain_p95
    map_names = [in_words(titles.get((layer, name), name)) for name in sheet.properties]
    sentence = (
        f"The sheet was found in {percent(measured_share, 2)} of the columns and flattened; mapped:"
        f" {', '.join(map_names) or 'no property'}. No image was linked."
    )
    if not {"coating_top", "coating_bottom"} & set(sheet.properties):
        sentence += " No coating was found."
    thickness = sheet.properties.get("thickness")
    mean_um = None
    spread_text = NONE
    if thickness is not None and thickness.trust == "ok":
        mean_um = thickness.mean
        spread_text = f"standard deviation {number(thickness.sd, 2)} µm"
    elif thickness is not None:
        spread_text = f"{thickness.trust}; see the checks"
    columns_text = f"of {count(sheet.surfaces.columns)}"
    measured_text = _percent_text(measured_share)
    move = number(sheet.flatten.largest_move_um)
    return sentence, [
        KeyFigure(number(mean_um), "µm", "mean sheet thickness", spread_text),
        KeyFigure(measured_text, "%", "of the volume's columns are measured", columns_text),
        KeyFigure(number(100 * strain, 2), "%", "edge strain", "95th percentile over the mesh"),
        KeyFigure(move, "µm", "largest displacement", "between projection and flat sheet"),
    ]


def _pair_summary(results: Results, titles: Titles) -> tuple[str, list[KeyFigure]]:
    """The summary of two layers: how they are related, and how well one lies on the other.

    Figures are r of the larger points and of the pixels, and the error of the marks. Where the
    place was fitted to both maps, r of tiles that took no part in that leads.
    """
    marks = results.moving[0].registration
    rows = headline_pair(results, results.moving[0])
    sentence = _relation_sentence(rows, results, titles)
    figure = _r_figure(results, None, "r")
    pixel_figure = _r_figure(results, None, "r at the pixel")
    is_sound = bool(rows) and rows[0].trust == "ok"
    if rows:
        row = largest(rows)
        figure = _r_figure(results, row, f"r, points of {point_of(row)}")
        pixel_figure = _r_figure(results, rows[0], f"r at the pixel, {point_of(rows[0])}")
        if is_sound:
            sentence += _difference_sentence(row, titles)
    if marks is None:
        return sentence, [figure, pixel_figure, KeyFigure(NONE, "µm", _LOO, NONE)]
    if marks.held_out is not None:
        sentence = f"{marks.held_out.sentence} With the place fitted to both: {sentence}"
        if is_sound:
            pixel_figure = figure
            figure = _held_out_figure(marks.held_out)
    loo_um = marks.leave_one_out_rms_um
    if loo_um is None:
        sentence += f" {marks.matched} marks were used."
    else:
        sentence += (
            f" Each of the {marks.matched} marks is predicted by the others to"
            f" {length(loo_um, 2)} (rms)."
        )
    error_figure = KeyFigure(number(loo_um, 2), "µm", _LOO, _marks_text(marks))
    return sentence, [figure, pixel_figure, error_figure]


def _marks_text(marks: RegistrationFacts) -> str:
    """How many marks were used, and the expected error of a pixel."""
    marks_text = f"rms of {marks.matched} marks"
    errors = marks.expected_error
    if errors and errors.trust == "ok" and errors.median_um is not None:
        median = length(errors.median_um, 2)
        largest_error = length(errors.largest_um, 2)
        marks_text += f"; expected error of a pixel {median} (median), {largest_error} at most"
    return marks_text


def _held_out_figure(held_out: RefinementR) -> KeyFigure:
    """R where the place was fitted to both maps: of tiles that took no part, if there are any."""
    note = "beside unrelated maps"
    label = "r after the search"
    low, high = held_out.interval or (None, None)
    if is_known(low):
        label = "r on held-out tiles"
        if is_known(high):
            note = f"95 %: {low:.2f} to {high:.2f}"
    return KeyFigure(number(held_out.r, 2), "", label, f"{note}; without waves above 1 mm")


def _relation_sentence(pair_rows: list[CorrelationRow], results: Results, titles: Titles) -> str:
    """State how two layers are related, in their words, with r and over which points.

    ``pair_rows``: correlations of their maps, from the pixel to the largest points; none where they
    have no pixel in common.
    """
    if not pair_rows or (pair_rows[0].trust == "ok" and not is_known(pair_rows[0].r)):
        n = count(pair_rows[0].n if pair_rows else 0)
        return (
            f"The two layers could not be correlated: {n} pixels are valid in both, or one of the"
            " maps is constant."
        )
    pixel = pair_rows[0]
    row = largest(pair_rows)
    is_image = results.layer(pixel.b).kind == "image"
    are_images = is_image and results.layer(pixel.a).kind == "image"
    a, b = names_in_words(pixel, titles)
    if are_images:
        a = with_article(pixel.a)
        b = with_article(pixel.b)
    if pixel.trust != "ok":
        why = doubt(results, pixel)
        return f"The correlation of {a} and {b} {why}.{_light_text(results, row)}"
    if not is_image:
        a = f"{a} of {pixel.a}"
        b = f"{b} of {pixel.b}"
    elif not are_images:
        b = "the image"
    return _stated_relation(row, a, b, results, titles)


def _stated_relation(row: CorrelationRow, a: str, b: str, results: Results, titles: Titles) -> str:
    """State r of the larger points of two maps that are called ``a`` and ``b``.

    Without an interval nothing is stated; where it holds 0, that the relation is not certain.
    """
    is_image = results.layer(row.b).kind == "image"
    are_images = is_image and results.layer(row.a).kind == "image"
    points_text = f"{count(row.n)} points of {point_of(row)}"
    if is_known(row.n_eff):
        points_text += f", {count(round(row.n_eff))} of them independent"
    if not is_known(row.interval):
        return f"No statement on {a} and {b} is possible: {points_text} ({stated_of(results)})."
    interval = f"a 95 % interval of {r_interval_text(row)}"
    limits_text = f"r = {r_text(row)} with {interval}, over {points_text} ({stated_of(results)})."
    if not row.direction:  # neither 1 nor -1: the interval holds 0
        return f"It is not certain that {b} is related to {a}: {limits_text}"
    comparative = "larger" if row.direction > 0 else "smaller"
    if is_image:
        comparative = "lighter" if row.direction > 0 else "darker"
        title = titles.get((row.b, row.b_map))
        if title:
            comparative += f" ({title[:1].lower()}{title[1:]})"
    larger = "lighter" if are_images else "larger"
    return f"{capital(b)} is {comparative} where {a} is {larger}: {limits_text}"


def _light_text(results: Results, row: CorrelationRow) -> str:
    """Both r where uneven light makes one doubtful; empty elsewhere, and where r is withheld."""
    evidence = evidence_of(results, row)
    is_asked = any(check.name == EVEN_LIGHT for check in results.checks_in("look"))
    if evidence is None or row.trust != "doubtful" or not is_asked:
        return ""
    field = evidence.light_field
    if field is None:
        return ""
    return (
        f" As the image is, {r_sentence(row)}; {off_text(field)}. Which one holds"
        " depends on the light."
    )


def cautions(results: Results) -> list[str]:
    """What to be careful about in the correlation that leads."""
    rows = lead_pair(results)
    if not rows or largest(rows).trust == "withheld":
        return []
    warnings = [*largest(rows).warnings]
    evidence = evidence_of(results, rows[0])
    if evidence is not None and evidence.partial is not None:
        warnings += filter(None, [say_over_control(evidence.partial, evidence.a_map)])
    return warnings


def declared(results: Results) -> str:
    """Say whether the map that leads was named before r was looked at.

    Empty where nothing leads.
    """
    if not results.evidence or all(layer.headline == "image" for layer in results.layers):
        return ""
    if results.evidence[0].declared:
        return "The map that leads was declared in the study, before r was looked at."
    return (
        "The map that leads is the usual one, the coating that is seen or else the thickness; the"
        " study declared none. No map was chosen by its r."
    )


def _difference_sentence(row: CorrelationRow, titles: Titles) -> str:
    """State the difference of two maps of the same quantity; empty where it is not known."""
    if not row.same_quantity or not is_known(row.limits):
        return ""
    units = unit(row.units or "")
    mean, _, low, high = written_difference(row)
    return (
        f" Over points of {point_of(row)}, {names_in_words(row, titles)[0]} of {row.b} minus that"
        f" of {row.a} is {mean} {units} on average, with 95 % limits of {low} to {high} {units}."
    )


def _layers_summary(results: Results, titles: Titles) -> tuple[str, list[KeyFigure]]:
    """The summary of several layers: how well the worst lies, and the weakest relation.

    Where two maps of one quantity differ by a known amount, the first such difference, too.
    """
    reference = results.reference.name
    sentence = (
        f"The layers {and_join(layer.name for layer in results.moving)} were brought onto the"
        f" pixels of {reference}."
    )
    median_um, max_um = _worst_errors(results)
    median_text = f"median {number(median_um, 2)} µm in the worst layer"
    if median_um is not None:
        median = f"{length(median_um, 2)} (rms, median over the worst layer)"
        sentence += f" The expected error is {median}, at most {length(max_um, 2)}."
    rows = [largest(group) for group in by_pair(results)]
    differences = [_difference_sentence(row, titles) for row in rows if row.trust == "ok"]
    sentence += next(filter(None, differences), "")
    r_figure = _r_figure(results, None, "r")
    lead = lead_pair(results)
    if lead:
        weakest = largest(lead)
        figure = _r_figure(results, weakest, f"weakest r, points of {point_of(weakest)}")
        r_figure = figure._replace(note=f"{weakest.a} and {weakest.b}: {figure.note}")
    shares = [layer.share_of_reference for layer in results.moving]
    known_shares = [share for share in shares if share is not None]
    covered = _percent_text(min(known_shares, default=None))
    n_layers = count(len(results.layers))
    figures = [
        KeyFigure(n_layers, "", "layers on one grid", f"{reference} is the reference"),
        KeyFigure(number(max_um, 2), "µm", "largest expected error", median_text),
        KeyFigure(covered, "%", "of the reference is covered", "by the layer that covers least"),
    ]
    return sentence, [*figures, r_figure]


def _worst_errors(results: Results) -> tuple[float | None, float | None]:
    """Largest of the medians, and of the largest expected errors, of the layers in um.

    None where none can be trusted, or a layer is not registered.
    """
    medians_um: list[float] = []
    largest_um: list[float] = []
    for layer in results.moving:
        if layer.registration is None:
            return None, None
        error = layer.registration.expected_error
        if error is not None and error.trust == "ok":
            if error.median_um is not None:
                medians_um.append(error.median_um)
            if error.largest_um is not None:
                largest_um.append(error.largest_um)
    return max(medians_um, default=None), max(largest_um, default=None)


def _r_figure(results: Results, row: CorrelationRow | None, label: str) -> KeyFigure:
    """R of a row with all that its interval rests on; no number where there is none to trust."""
    if row is None or row.trust != "ok":
        return KeyFigure(NONE, "", label, f"{row.trust}; see the checks" if row else NONE)
    note_text = "no interval"
    r2_limits_text = ""
    if is_known(row.interval):
        note_text = f"95 %: {r_interval_text(row)}"
        r2_limits_text = f" ({r2_interval_text(row)})"
    if is_known(row.r2):
        note_text += f"; r² {r2_text(row)}{r2_limits_text}"
    if is_known(row.n_eff):
        note_text += f"; {count(round(row.n_eff))} independent points of {count(row.n)}"
    return KeyFigure(r_text(row), "", label, f"{note_text}; {stated_of(results)}")


def lag_verdict(lag: LagNumbers | None, map_texts: TwoTexts) -> LagVerdict | None:
    """Return what the lag of two maps, named in words, means; None where none was looked for.

    Grey: inconclusive; amber: they do not coincide.
    """
    if lag is None:
        return None
    se_um = math.hypot(*lag.se_um)  # of the lag, from its standard errors along y and x
    state = "agrees"
    if lag.agrees is None:  # no lag is certain, or there is no expected error
        state = "grey"
        end_text = (
            "The result is inconclusive: it speaks neither for nor against the registration,"
            " whose error is known from the marks alone."
        )
        if is_known(lag.length_um):
            end_text = "The marks give no expected error to compare the result with."
    elif not lag.agrees:
        state = "amber"
        end_text = (
            "They do not coincide within the expected error. Until the cause is known, a position"
            f" is known to about {length(lag.length_um, 2)} and no better."
        )
    elif se_um > lag.expected_um > 0:
        end_text = (
            "They coincide, but locate the maps less precisely than the marks do: an error of up"
            f" to about {length(2 * se_um, 2)} would not be noticed."
        )
    else:
        end_text = "They coincide within the error expected from the marks."
    textures = f"The fine textures of {map_texts[0]} and {map_texts[1]}"
    meaning = f"{textures} were aligned without using the marks. {end_text}"
    return LagVerdict(state, capital(typeset(lag.sentence)).removesuffix(".") + ".", meaning)
