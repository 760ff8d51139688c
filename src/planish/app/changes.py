"""What a person can change in a session.

Immutable states, and one function that takes a state to the next.
"""

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, Field, TypeAdapter

from planish.core.errors import InputError
from planish.core.tables import naming_faults
from planish.core.text import printable
from planish.core.typing import Entries, Pair
from planish.marks.exchange.json_marks import Label, Source
from planish.marks.exchange.lists import MOST_MARKS, Part
from planish.marks.regions.model import LONGEST_TEXT
from planish.register.params import ModelChoice
from planish.run.study import Study
from planish.surface import Corrections, read_corrections

FARTHEST_UM = 1e9
"""Positions beyond a kilometre are errors, as in files of marks."""
MOST_POINTS = 10_000
"""Of one polygon or one correction."""

Um = Annotated[float, Field(ge=-FARTHEST_UM, le=FARTHEST_UM)]
Id = Annotated[str, Field(pattern=r"^[a-z][0-9]{1,9}(-[0-9]{1,6})?$")]
Text = Annotated[str, Field(max_length=LONGEST_TEXT)]
Layer = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=40)]


class ChangeError(InputError):
    """A change that cannot be made: it is malformed, or what it names is not there."""


class End(Part):
    """One end of a mark, in um of its plane, with what is known of it.

    The fields are those of files of marks.
    """

    x: Um
    y: Um
    source: Source = "clicked"
    cov_xx: float | None = None
    cov_xy: float | None = None
    cov_yy: float | None = None
    diameter: float | None = None
    axis_ratio: float | None = None
    arc_coverage: float | None = None

    @property
    def xy(self) -> Pair:
        """The place, in um."""
        return self.x, self.y


def _as_end(end: Any) -> Any:
    is_place = isinstance(end, list | tuple) and len(end) == 2  # pyright: ignore
    if is_place:
        return dict(zip("xy", end, strict=True))
    return end


OneEnd = Annotated[End, BeforeValidator(_as_end)]


class Mark(Part):
    """A mark of one registration; an end that is not known yet is None."""

    id: Id
    label: Label
    used: bool = True
    moving: OneEnd | None = None
    fixed: OneEnd | None = None

    @property
    def is_tile(self) -> bool:
        """Whether it is a tile of texture, no hole.

        Also where one of its ends was moved by hand.
        """
        sources = [end.source for end in (self.moving, self.fixed) if end is not None]
        return "tile" in sources


Marks = tuple[Mark, ...]


class CorrectedPoint(Part):
    """A place of a face in the volume, in um."""

    z: Um
    y: Um
    x: Um
    face: Literal["top", "bottom"]


Points = Annotated[tuple[CorrectedPoint, ...], Field(min_length=1, max_length=MOST_POINTS)]
Polygon = Annotated[tuple[tuple[Um, Um], ...], Field(min_length=3, max_length=MOST_POINTS)]


class DrawnRegion(Part):
    """A polygon of the reference, ``(x, y)`` in um, that is declared an artefact."""

    id: Id
    name: Label
    author: Text = ""
    reason: Text = ""
    polygon: Polygon
    holes: Annotated[tuple[Polygon, ...], Field(max_length=1000)] = ()


FREE = "m0"
"""Id of what the journal has not numbered yet."""


class _Change(Part):
    layer: Layer | None = None


class Add(_Change):
    """A new mark, with one end or both."""

    do: Literal["add"] = "add"
    id: Id = FREE
    label: Label | None = None
    moving: OneEnd | None = None
    fixed: OneEnd | None = None


class Move(_Change):
    """New places for one end of a mark, or both."""

    do: Literal["move"] = "move"
    id: Id
    moving: OneEnd | None = None
    fixed: OneEnd | None = None


class Use(_Change):
    """Whether a mark takes part in the fit."""

    do: Literal["use"] = "use"
    id: Id
    used: bool


class Relabel(_Change):
    """Another label."""

    do: Literal["label"] = "label"
    id: Id
    label: Label


class Remove(_Change):
    """A mark, a correction or a region less."""

    do: Literal["delete", "uncorrect", "unregion"]
    id: Id


class Import(_Change):
    """Other marks in place of all that are there."""

    do: Literal["import"] = "import"
    marks: Annotated[Marks, Field(max_length=MOST_MARKS)]


class ChooseModel(_Change):
    """The transformation that is fitted."""

    do: Literal["model"] = "model"
    model: ModelChoice


class Correct(_Change):
    """A correction of a face: a stretch found to be wrong, and the points it runs through."""

    do: Literal["correct"] = "correct"
    id: Id = FREE
    points: Points
    reach_um: Annotated[float, Field(gt=0, le=5000)] | None = None
    note: Text = ""


class DeclareRegion(_Change):
    """A region that is an artefact."""

    do: Literal["region"] = "region"
    id: Id = FREE
    name: Label
    author: Text = ""
    reason: Text = ""
    polygon: Polygon


Change = Annotated[
    Add | Move | Use | Relabel | Remove | Import | ChooseModel | Correct | DeclareRegion,
    Field(discriminator="do"),
]
_CHANGE: TypeAdapter[Change] = TypeAdapter(Change)


def change_of(data: bytes | str) -> Change:
    """Read a change from JSON, as the page sends it or the journal holds it.

    ChangeError names every fault.
    """
    with naming_faults("This is no change", error=ChangeError):
        return _CHANGE.validate_json(data)


def numbered(change: Change, line_number: int) -> Change:
    """Return the change with the ids of what it makes.

    They are those of its line in the journal, so that no id ever returns.
    """
    if isinstance(change, Import):
        marks = (
            mark.model_copy(update={"id": f"m{line_number}-{k}"})
            for k, mark in enumerate(change.marks, 1)
        )
        return change.model_copy(update={"marks": tuple(marks)})
    letter = {"add": "m", "correct": "c", "region": "r"}.get(change.do)
    if letter is None:
        return change
    return change.model_copy(update={"id": f"{letter}{line_number}"})


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """What stands after some changes."""

    marks: Mapping[str, Marks]  # by the name of the moving layer, newest last
    model: str = "auto"  # transformation that is fitted
    corrections: tuple[Correct, ...] = ()
    regions: tuple[DrawnRegion, ...] = ()
    first_layer: str = ""  # the one of changes that name none

    def of(self, layer: str | None) -> Marks:
        """Marks of one registration, of the first where none is named.

        ChangeError for another name.
        """
        name = layer or self.first_layer
        if name not in self.marks:
            raise ChangeError(
                f"There is no registration {name!r}; there is {', '.join(self.marks) or 'none'}."
            )
        return self.marks[name]

    def mark(self, layer: str | None, mark_id: str) -> Mark:
        """The mark of an id; ChangeError where it is not there."""
        return _element_of_id(self.of(layer), mark_id)


def applied(state: State, change: Change) -> State:
    """The state after a change.

    ChangeError where it names what is not there, or leaves a mark without a place.
    """
    match change:
        case ChooseModel():
            return replace(state, model=change.model)
        case Correct():
            return replace(state, corrections=(*state.corrections, change))
        case Remove(do="uncorrect"):
            return replace(state, corrections=_without(state.corrections, change.id))
        case DeclareRegion():
            region = DrawnRegion.model_validate(change.model_dump(exclude={"do", "layer"}))
            return replace(state, regions=(*state.regions, region))
        case Remove(do="unregion"):
            return replace(state, regions=_without(state.regions, change.id))
        case _:
            marks = _marks_after(state.of(change.layer), change)
            return replace(state, marks={**state.marks, change.layer or state.first_layer: marks})


def _marks_after(marks: Marks, change: Add | Move | Use | Relabel | Remove | Import) -> Marks:
    """Marks of a registration after a change of one of them, or of all."""
    match change:
        case Add():
            ends = _ends_of(change, "A new mark has no place.")
            if len(marks) >= MOST_MARKS:
                raise ChangeError(f"There are {len(marks)} marks; {MOST_MARKS} are the most.")
            used_labels = {mark.label for mark in marks}
            label = change.label or next(free_names("mark", used_labels))
            label = _free_label(marks, label, change.id)
            return *marks, Mark(id=change.id, label=label, **ends)
        case Move():
            ends = _ends_of(change, "A move gives no new place.")
            return _with_fields(marks, change.id, **ends)
        case Use():
            return _with_fields(marks, change.id, used=change.used)
        case Relabel():
            label = _free_label(marks, change.label, change.id)
            return _with_fields(marks, change.id, label=label)
        case Remove():
            return _without(marks, change.id)
        case Import():
            return change.marks


def _ends_of(change: Add | Move, fault: str) -> Entries:
    """Ends of a mark that a change gives; ChangeError where there is none."""
    ends = {"moving": change.moving, "fixed": change.fixed}
    ends = {side: end for side, end in ends.items() if end is not None}
    if not ends:
        raise ChangeError(f"{fault} Give moving or fixed.")
    return ends


def _free_label(marks: Marks, label: str, mark_id: str) -> str:
    """A label that can stand in a table, and that no other mark has."""
    if any(mark.label == label and mark.id != mark_id for mark in marks):
        raise ChangeError(f"Another mark is called {label!r}. Choose another label.")
    return checked_label(label)


def free_names(word: str, used_names: Collection[str]) -> Iterator[str]:
    """Names of a word and a number, from 1, that are not used."""
    for k in itertools.count(1):
        if f"{word} {k}" not in used_names:
            yield f"{word} {k}"


def checked_label(label: str) -> str:
    """A label that can stand in a table.

    ChangeError for one with line ends, or with nothing to see.
    """
    if not label.strip() or printable(label) != label or {*label} & {*"\n\t"}:
        raise ChangeError(
            f"The label {label!r} cannot be read. Give letters, digits, signs and blanks."
        )
    return label


T = TypeVar("T", Mark, Correct, DrawnRegion)


def _with_fields(marks: Marks, mark_id: str, **fields: Any) -> Marks:
    changed_mark = _element_of_id(marks, mark_id)
    return tuple(mark.model_copy(update=fields) if mark is changed_mark else mark for mark in marks)


def _without(elements: tuple[T, ...], element_id: str) -> tuple[T, ...]:
    removed = _element_of_id(elements, element_id)
    return tuple(element for element in elements if element is not removed)


def _element_of_id(elements: tuple[T, ...], element_id: str) -> T:
    element = next((element for element in elements if element.id == element_id), None)
    if element is None:
        raise ChangeError(f"{element_id} no longer exists. The page shows the current state.")
    return element


def corrections_of(study: Study) -> tuple[Correct, ...]:
    """The corrections that a run has, as a session begins with them."""
    corrections: list[Correct] = []
    for layer in study.layers:
        if layer.volume is None or layer.surface.corrections is None:
            continue
        for stretch in read_corrections(layer.surface.corrections).stretches:
            identity = {"id": f"c0-{len(corrections) + 1}", "layer": layer.name}
            corrections.append(Correct.model_validate(stretch.model_dump() | identity))
    return tuple(corrections)


def stretches_of(corrections: Sequence[Correct], layer: str, first_sheet: str) -> Corrections:
    """The corrections of one layer as its file has them.

    Those that name none are of the ``first_sheet``.
    """
    of_layer = [c for c in corrections if (c.layer or first_sheet) == layer]
    stretches = [c.model_dump(exclude={"do", "layer"}, exclude_none=True) for c in of_layer]
    return Corrections.model_validate({"stretches": stretches})


def changed_corrections(
    study: Study, old: Sequence[Correct], new: Sequence[Correct]
) -> Mapping[str, Corrections]:
    """The corrections of each layer that has others than before."""
    sheet_names = [layer.name for layer in study.layers if layer.volume is not None]
    corrections: dict[str, Corrections] = {}
    for name in sheet_names:
        after = stretches_of(new, name, sheet_names[0])
        if after != stretches_of(old, name, sheet_names[0]):
            corrections[name] = after
    return corrections
