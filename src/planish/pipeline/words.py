"""Options of a call in the words of the command line, ``through="y"`` for ``--through y``, beside whole sections."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

from pydantic import ValidationError

from planish.compute import Compute
from planish.core.errors import StudyError
from planish.core.mistakes import mistakes, models_in
from planish.core.options import Params, options_of, params_of
from planish.core.toml_lines import Key
from planish.study import SECTIONS

_ALIKE = 0.7  # of difflib
_ARGUMENTS = ("out", "compute", "progress", "chain")


def sections_of(
    given: Mapping[str, Any], sections: Sequence[str], compute: Compute | None, *, call: str
) -> tuple[dict[str, dict[str, Any]], Compute | None]:
    """Sort what a call was given into sections of a study, and what may be used.

    Raises
    ------
    StudyError
        If a word is unknown, or said twice; all faults are named.
    """
    places = _places(sections) | {word: ("compute", *rest) for word, (_, *rest) in _words("compute", Compute).items()}
    options: dict[str, Any] = {}
    faults: list[str] = []
    for section in (name for name in given if name in sections):
        value = given[section]
        if isinstance(value, Params):
            options[section] = value.model_dump(exclude_unset=True)
        elif isinstance(value, Mapping):
            options[section] = deepcopy(dict(value))
        else:
            word = next(word for word, place in places.items() if place[0] == section)
            faults.append(f"{section}={value!r}: needed is a dict of options; or write one of them, such as {word}=...")
    for word, value in given.items():
        if word in sections or value is None:
            continue
        if word not in places:
            faults.append(_unknown(word, [*sections, *places, *_ARGUMENTS]))
            continue
        *outer, name = places[word]
        table = options
        for part in outer:
            table = table.setdefault(part, {})
        if value is True and any(place[:-1] == places[word] for place in places.values()):
            table.setdefault(name, {})  # options of their own, which this word switches on
        elif name in table or (outer == ["compute"] and compute is not None):
            faults.append(f"{word}= is given twice, by itself and in {outer[0]}=. Leave one out.")
        else:
            table[name] = value
    if faults:
        raise StudyError(f"{call}: {' '.join(faults)}")
    limits = options.pop("compute", None)
    compute = None if compute is None else params_of(Compute, compute, call)
    try:
        return options, compute if limits is None else Compute.model_validate(limits)
    except ValidationError as error:
        raise StudyError(
            f"{'; '.join(mistakes(error, Compute, lambda loc: (flag_of(('compute', *loc)), None)))}."
        ) from error


def flag_of(loc: Key) -> Key:
    """The option of the command line for a place in a study, as a message names it; the place where there is none."""
    names = [part for part in loc if isinstance(part, str) and part != "layers"]
    words = _places(SECTIONS) | _words("compute", Compute)
    flags = {place: f"--{word.replace('_', '-')}" for word, place in words.items()}
    if len(names) == 1 and names[0] in SECTIONS:  # of options that do not fit together: the message names them
        return ()
    return (flags[tuple(names)],) if tuple(names) in flags else tuple(names)


def _places(sections: Sequence[str] | Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """Words of some sections, and where each stands in a study."""
    found: dict[str, tuple[str, ...]] = {}
    for section in sections:
        found = _words(section, SECTIONS[section]) | found
    return found


def _words(section: str, model: type[Params], *outer: str) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for name, field, shown in options_of(model):
        words = [flag[2:].replace("-", "_") for flag in shown.flags if flag.startswith("--")]
        found |= dict.fromkeys(words, (section, *outer, name))
        for inner in models_in(field.annotation):
            if issubclass(inner, Params):
                found |= _words(section, inner, *outer, name)
    return found


def _unknown(word: str, possible: Sequence[str]) -> str:
    likely = difflib.get_close_matches(word.casefold(), possible, 1, _ALIKE)
    if likely:
        return f"{word}= is unknown; did you mean {likely[0]}=?"
    if word in SECTIONS or word in _places(SECTIONS):
        return f"{word}= is for pl.link, which has an image and marks. Leave it out."
    return f"{word}= is unknown. The words are those of the command line: planish link --help."
