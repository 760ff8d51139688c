"""Options of a call in the words of the command line, ``through="y"`` for ``--through y``, beside whole sections."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from typing import Any

from planish.compute import Compute
from planish.core.errors import StudyError
from planish.core.mistakes import Key, models_in
from planish.core.options import Params, options_of, params_of
from planish.study import SECTIONS

_ALIKE = 0.7  # of difflib
_ARGUMENTS = ("out", "progress", "chain")
_ALL = {**SECTIONS, "compute": Compute}


def sections_of(
    given: Mapping[str, Any], sections: Iterable[str], compute: Compute | None, *, call: str
) -> tuple[dict[str, dict[str, Any]], Compute | None]:
    """Sort what a call was given into sections of a study, and what may be used.

    Raises
    ------
    InputError
        If a word is unknown, or given twice; all faults are named.
    """
    places = words_of([*sections, "compute"])
    options: dict[str, Any] = {} if compute is None else {"compute": params_of(Compute, compute, call).model_dump()}
    faults: list[str] = []
    for section in (name for name in given if name in sections):
        value = given[section]
        if isinstance(value, Mapping | Params):
            plain = value.model_dump(exclude_unset=True) if isinstance(value, Params) else value
            options[section] = deepcopy(dict(plain))
        else:
            faults.append(f"{section}={value!r}: needed is a dict of options, or one of them by itself.")
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
        elif table.get(name) is not None:
            faults.append(f"{word}= is given twice, by itself and in {outer[0]}=. Leave one out.")
        else:
            table[name] = value
    if faults:
        raise StudyError(f"{call}: {' '.join(faults)}")
    limits = options.pop("compute", None)
    return options, None if limits is None else params_of(Compute, limits, call)


def flag_of(loc: Key) -> Key:
    """The option of the command line for a place in a study, as a message names it; the place where there is none."""
    names = tuple(part for part in loc if isinstance(part, str) and part != "layers")
    flags = {place: f"--{word.replace('_', '-')}" for word, place in words_of(SECTIONS).items()}
    # A message about a whole section is one of options that do not fit together, which it names.
    if len(names) == 1 and names[0] in SECTIONS:
        return ()
    return (flags[names],) if names in flags else names


def words_of(sections: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Words of some sections, and where each stands in a study; of the same word in two the first one."""
    places = [pair for section in sections for pair in _words(_ALL[section], section)]
    return dict(reversed(places))


def _words(model: type[Params], *outer: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    for name, field, shown in options_of(model):
        yield from ((flag[2:].replace("-", "_"), (*outer, name)) for flag in shown.flags if flag.startswith("--"))
        for inner in models_in(field.annotation):
            if issubclass(inner, Params):
                yield from _words(inner, *outer, name)


def _unknown(word: str, possible: list[str]) -> str:
    if likely := difflib.get_close_matches(word.casefold(), possible, 1, _ALIKE):
        return f"{word}= is unknown; did you mean {likely[0]}=?"
    if word in SECTIONS or word in words_of(SECTIONS):
        return f"{word}= is for pl.link, which has an image and marks. Leave it out."
    return f"{word}= is unknown. The words are those of the command line: planish link --help."
