"""What a model of several maps says: its answer, what would make it surer, how to read it."""

from collections.abc import Iterator
from typing import Any

from planish.analyze.explain import COLLINEAR, Coefficient, Explained, strongest
from planish.analyze.explain_sheets import ExplainedSeries
from planish.core.facts import is_known
from planish.core.numbers import (
    capital,
    count,
    fixed,
    in_words,
    interval_text,
    number,
    percent,
    plain,
)
from planish.core.text import and_join
from planish.core.typing import Fields
from planish.report.series_words import sheets_text

AnyModel = Explained | ExplainedSeries

_SURFACES = {
    "top": "the top face",
    "bottom": "the bottom face",
    "interface_top": "the interface of base and coating of the top side",
    "interface_bottom": "the interface of base and coating of the bottom side",
}


def say_answer(model: AnyModel) -> str:
    """The answer: what is explained, by which map most, and whether that is certain.

    Maps come from the largest standardised coefficient on.
    """
    sentences = [_say_share(model)]
    coefficients: Fields = model.coefficients
    order = strongest(model.coefficients)
    texts = [say_coefficient(coefficients[name]) for name in order]
    title = capital(in_words(coefficients[order[0]].title))
    verb = "matters most, with" if len(order) > 1 else "has"
    sentences.append(f"{title} {verb} a standardised coefficient of {texts[0]}.")
    if len(order) > 1:
        clauses = [
            f"{in_words(coefficients[name].title)} has {text}"
            for name, text in zip(order[1:], texts[1:], strict=True)
        ]
        sentences.append(f"{capital('; '.join(clauses))}.")
        sentences.append(_say_lead(model, order))
    sentences.append(_say_cells(model))
    return " ".join(sentences)


def say_coefficient(coefficient: Any) -> str:
    """A standardised coefficient with its interval, and whether it differs from 0."""
    if not is_known(coefficient.interval):
        return f"{fixed(coefficient.standardised, 2)}, without an interval"
    text = f"{fixed(coefficient.standardised, 2)} (95 %: {interval_text(coefficient.interval)})"
    if coefficient.direction:
        return text
    return f"{text}, not distinguishable from 0"


def _say_share(model: AnyModel) -> str:
    """Say how much of the variance the maps explain, and how much out of sample."""
    titles = [in_words(coefficient.title) for coefficient in model.coefficients.values()]
    verb = "explains" if len(titles) == 1 else "together explain"
    out_text = ""
    if is_known(model.r2_out):
        out_text = f" ({percent(model.r2_out, 2)} of places that the model was not fitted to)"
    corrected_text = ", with the stated errors of the maps taken off," if model.corrected else ""
    return capital(
        f"{and_join(titles)}{corrected_text} {verb} {percent(model.r2, 2)} of the variance of"
        f" {in_words(model.title)} over cells of {plain(model.cell_um)}{out_text}."
    )


def _say_lead(model: AnyModel, order: list[str]) -> str:
    """Say whether the largest coefficient is larger than the second one beyond chance."""
    first, second = (in_words(model.coefficients[name].title) for name in order[:2])
    if not is_known(model.lead_interval):
        return f"Whether {first} matters more than {second} is not known."
    low, high = model.lead_interval
    lead_text = f"{fixed(model.lead, 2)} (95 %: {interval_text((low, high))})"
    if low > 0:
        return f"{capital(first)} matters more than {second} beyond chance: by {lead_text}."
    return f"Whether {first} matters more than {second} is not certain: by {lead_text}."


def _say_cells(model: AnyModel) -> str:
    cells_text = f"{count(model.n)} cells count as {independent_cells(model)} independent ones"
    if isinstance(model, ExplainedSeries):
        fields_text = f"Means of {count(model.fields)} fields over {sheets_text(model.sheets)}"
        return f"{fields_text}; {cells_text}."
    return f"{cells_text} (n_eff)."


def independent_cells(model: AnyModel) -> str:
    """How many cells count as independent: of the map with the fewest to that with the most."""
    numbers = [model.n_eff]
    if isinstance(model, Explained):
        numbers = [coefficient.n_eff for coefficient in model.coefficients.values()]
    ends = [count(round(end)) for end in (min(numbers), max(numbers))]
    return " to ".join(dict.fromkeys(ends))


def say_surer(model: AnyModel) -> list[str]:
    """What would make a model more certain; at most three sentences.

    Of a series, more sheets; of one field doubts of the checks first, and then a larger field.
    """
    sentences: list[str] = []
    if isinstance(model, ExplainedSeries):
        if model.left_out:
            left_out = [f"{name} ({reason})" for name, reason in model.left_out.items()]
            sentences.append(f"Left out: {'; '.join(left_out[:3])}")
        return [
            *sentences,
            *_undeclared(model),
            "More sheets: the interval is that of the mean of such sheets, and narrows with the"
            " root of their number.",
        ]
    if model.trust != "ok":
        sentences.append(
            f"The checks of the run leave this model {model.trust}: look at them before anything"
            " else."
        )
    sentences += [*_collinear(model), *_undeclared(model)]
    is_uncertain = any(not c.direction for c in model.coefficients.values())
    is_uncertain |= is_known(model.lead_interval) and model.lead_interval[0] <= 0
    if is_uncertain:
        sentences.append("A field of four times the area would halve the intervals.")
    several_text = "Several sheets would show whether it holds beyond this one."
    sentences.append(model.reason or several_text)
    return sentences[:3]


def _undeclared(model: AnyModel) -> Iterator[str]:
    if not model.declared:
        yield (
            "Declare the model in the study ([explain]) before you look at the next specimen: of"
            " several models that were tried, one looks good by chance."
        )


def _collinear(model: Explained) -> Iterator[str]:
    for coefficient in model.coefficients.values():
        if coefficient.vif >= COLLINEAR:
            yield (
                f"{capital(in_words(coefficient.title))} is collinear with the others (variance"
                f" inflation {fixed(coefficient.vif, 0)}): leave one of them out."
            )


def say_reading(model: AnyModel) -> list[str]:
    """How to read a model, and what it does not say."""
    sentences = [
        "A coefficient says by how many standard deviations the response changes where a map is"
        " larger by one of its own and the others are the same. It compares maps of any unit, and"
        " names no cause."
    ]
    if isinstance(model, ExplainedSeries):
        count_text = "Sheets, not fields, are the sample: each sheet counts once."
        return [*sentences, _say_declared(model), count_text]
    sentences.append(_say_declared(model))
    hiding_text = " (below 0: one hides what another does)" if model.shared < -0.005 else ""
    sentences.append(
        "Neighbouring cells resemble each other: intervals and p rest on the independent cells, not"
        f" on n. What only one map explains of the variance is {_say_unique(model)}. They share"
        f" {fixed(100 * model.shared, 1)} %{hiding_text}: which of them explains that is unknown."
    )
    return sentences


def say_notes(model: AnyModel) -> list[str]:
    """What else stands beside a model: other cells, shared errors and parts, ranks and weights."""
    columns_text = (
        "Standardised: standard deviations of the response per standard deviation of the map, the"
        " others held. Plain: units of the response per unit of the map. p is after Holm over all"
        " maps of the model"
    )
    if isinstance(model, ExplainedSeries):
        return [f"{columns_text}, and rests on the spread between sheets."]
    return [
        f"{columns_text}, and rests on independent cells (n_eff), as the intervals do. VIF:"
        " variance inflation, by how much the other maps widen the square of the interval. Each map"
        " has its own n_eff; the answer names the smallest and the largest. Explains alone: share"
        " of the variance that no other map explains. Over ranks: the standardised coefficient of"
        " ranks. GLS: with the covariance of the residuals as weights.",
        *_say_sizes(model),
        *_say_sharing(model),
        *_say_parts(model),
        *_say_ranks(model),
    ]


def _say_declared(model: AnyModel) -> str:
    if model.declared:
        return "The study declared this model before it was run."
    if model.declared is None:
        return (
            "No study declared this model, its maps or its cells: if it was chosen after a look at"
            " others, its p says less than it seems to."
        )
    return (
        "This is not the model that the study declared: it was tried after looking, and its p says"
        " less than it seems to."
    )


def _say_unique(model: Explained) -> str:
    shares = [
        f"{fixed(100 * c.unique, 1)} % for {in_words(c.title)}" for c in model.coefficients.values()
    ]
    return and_join(shares)


def _say_sizes(model: Explained) -> Iterator[str]:
    rows = [row for row in model.sizes if row.standardised]
    if len(rows) < 2:
        return
    name = strongest(model.coefficients)[0]
    first = rows[0]
    last = rows[-1]
    yield (
        f"Over other cells the model is another one: {in_words(model.coefficients[name].title)} has"
        f" {fixed(first.standardised[name], 2)} over cells of {plain(first.cell_um)} and"
        f" {fixed(last.standardised[name], 2)} over {plain(last.cell_um)}."
    )


def _say_sharing(model: Explained) -> Iterator[str]:
    """Say which maps share an error of one surface, and what that does to their coefficients.

    A corrected model tells how far coefficients were moved before, others how far they are now.
    """
    for surface, surface_text in _SURFACES.items():
        pairs = [(e.a, e.b) for e in model.shared_errors if e.surface == surface]
        names = dict.fromkeys(name for pair in pairs for name in pair)
        if names:
            titles = and_join(in_words(model.coefficients[name].title) for name in names)
            yield (
                f"{capital(titles)} meet at {surface_text}: where it was found too high or too low,"
                " their errors go together."
            )
    moves: list[str] = []
    for c in model.coefficients.values():
        if not is_known(c.by_errors):  # by how much the errors move the plain coefficient
            continue
        move = f"{in_words(c.title)} by {number(c.by_errors, 2)}"
        if not model.corrected:
            move += f" of {number(c.plain)}"
        moves.append(move)
    if moves and model.corrected:
        yield (
            "The stated errors moved the plain coefficients before they were taken off:"
            f" {and_join(moves)}."
        )
    elif moves:
        yield (
            "The stated errors of the maps move the plain coefficients, that of"
            f" {and_join(moves)}; the corrected model takes that off."
        )


def _say_parts(model: Explained) -> Iterator[str]:
    for shared in model.shared_parts:
        parts = and_join(part.replace("_", " ") for part in shared.parts)
        a, b = (name.replace("_", " ") for name in (shared.a, shared.b))
        yield (
            f"{capital(a)} and {b} both contain {parts}: with one held, the other is no longer what"
            " its name says."
        )
    for name in model.controls:
        yield (
            f"{capital(name.replace('_', ' '))} is the pose in the scanner, no property of the"
            " paper: a negative control."
        )


def _say_ranks(model: Explained) -> Iterator[str]:
    far = [c for c in model.coefficients.values() if _is_beyond(c.rank, c)]
    if far:
        yield (
            f"Over ranks {and_join(f'{in_words(c.title)} has {fixed(c.rank, 2)}' for c in far)},"
            " beyond the interval: single values or a bent relation count much."
        )
    far = [c for c in model.coefficients.values() if _is_beyond(c.weighed, c)]
    if far:
        yield (
            "With the covariance of the residuals as weights (generalised least squares)"
            f" {and_join(f'{in_words(c.title)} has {fixed(c.weighed, 2)}' for c in far)}, beyond"
            " the interval: short waves, which count more then, show another relation than long"
            " ones."
        )


def _is_beyond(value: float, coefficient: Coefficient) -> bool:
    low, high = coefficient.interval
    return is_known(value) and is_known(coefficient.interval) and not low <= value <= high
