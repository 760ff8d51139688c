"""A study to be filled in: what the files say, every option with its default, and what only the user knows."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import tomli_w
from pydantic.fields import FieldInfo

from planish.analyze.params import CorrelateParams
from planish.core.errors import StudyError
from planish.core.mistakes import models_in
from planish.core.options import Params, Shown, kinds_of, options_of, unit_of
from planish.flatten.params import FlattenParams
from planish.io.info import describe
from planish.io.params import ImageParams, VolumeParams
from planish.marks.params import HoleParams
from planish.measure.params import MeasureParams
from planish.pipeline.run import is_run
from planish.register.params import RegistrationParams
from planish.study import in_study_words
from planish.surface.params import SurfaceParams

_WIDTH = 100
_OF_A_SHEET: tuple[tuple[str, type[Params], str], ...] = (
    ("surface", SurfaceParams, "How the faces of the sheet are found"),
    ("properties", MeasureParams, "What is measured"),
    ("flatten", FlattenParams, "How the sheet is flattened"),
)
_OF_A_LINK: tuple[tuple[str, type[Params], str], ...] = (
    ("holes", HoleParams, "The laser holes"),
    ("registration", RegistrationParams, "How image and sheet are registered"),
    ("correlate", CorrelateParams, "How image and maps are compared"),
)
_NOT_IN_FILES = {
    "volume": {"top": "which end of the axis is the top side", "md_deg": "the machine direction in the map"},
    "image": {"side": "the side of the sheet that the image shows", "md_deg": "the machine direction in the image"},
}
"""Options that no file states, with what they are."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Missing:
    """Something that has to be filled in before a study can be run, or that only the user knows."""

    line: int
    key: str  # with its table, as volume.voxel_um
    why: str
    needed: bool  # whether the study cannot be run without it


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """Text of a study, and what is missing in it."""

    text: str
    missing: tuple[Missing, ...]


def draft_study(
    volume: str | Path, image: str | Path | None = None, *, home: str | Path = ".", name: str = ""
) -> Draft:
    """Write a study of a volume, with or without an image: what was read from them, and all options as comments.

    Parameters
    ----------
    volume, image : path
        Files or folders; as :func:`planish.read_volume` and :func:`planish.read_image` take them.
    home : path
        Folder in which the study will stand: paths in it are relative to that.
    name : str
        Name of the file, for its first line.

    Returns
    -------
    Draft
        ``text`` is a study that :func:`planish.study.read_study` reads. Lines that begin with ``#`` and a key hold
        defaults; where an option has none, what is needed stands in capitals.

    Raises
    ------
    FileError, VolumeError, ResourceError
        As the reading functions.
    StudyError
        If one of them is of another kind: a run, or an image in place of a volume.
    """
    lines: list[str] = []
    missing: list[Missing] = []
    _input(lines, missing, "volume", VolumeParams, Path(volume), Path(home))
    if image is not None:
        _input(lines, missing, "image", ImageParams, Path(image), Path(home))
    for section, model, title in (*_OF_A_SHEET, *(_OF_A_LINK if image is not None else ())):
        lines += ["", "", f"# {title}", "", f"[{section}]"]
        for key, field, shown in _options(model):
            lines += _option(key, field, shown, section)
    below = len(_head(name, missing))
    missing = [replace(one, line=one.line + below) for one in missing]
    return Draft(text="\n".join([*_head(name, missing), *lines]) + "\n", missing=tuple(missing))


def _options(model: type[Params]) -> list[tuple[str, FieldInfo, Shown]]:
    """All options of a model, those last that are tables of their own: a key behind a table would belong to it."""
    flags = {name: shown for name, _, shown in options_of(model)}
    found = [(name, field, flags.get(name, Shown(flags=()))) for name, field in model.model_fields.items()]
    return sorted((one for one in found if one[0] != "path"), key=lambda one: bool(models_in(one[1].annotation)))


def _head(name: str, missing: list[Missing]) -> list[str]:
    """First lines: what the file is, and what is to be filled in."""
    said = f"planish run {name or 'STUDY.toml'}"
    lines = [
        f"# A study of planish. Fill it in, then: {said}",
        "#",
        "# A key behind a # is an option with its default: take the # away to change it. Where an option has no",
        "# default, what is needed stands in capitals. Paths are relative to this file and stand in single quotes.",
    ]
    for needed, title in ((True, "To fill in:"), (False, "Stated in no file; is the default right?")):
        listed = [m for m in missing if m.needed is needed]
        if listed:
            lines += ["#", f"# {title}"]
            lines += [f"#   line {m.line}: {m.key}: {m.why}" for m in listed]
    return lines


def _input(
    lines: list[str], missing: list[Missing], section: Literal["volume", "image"], model: type[Params], path: Path,
    home: Path,
) -> None:  # fmt: skip
    """Write the table of a file: what it says, and its options."""
    if is_run(path):
        raise StudyError(
            f"{path} is a run, which was mapped already. Link it: planish link {path} IMAGE --out RUN. For a study "
            "give the volume."
        )
    facts = describe(path)
    if (facts["kind"] == "image") is not (section == "image"):
        other = "an image" if facts["kind"] == "image" else "a volume"
        raise StudyError(
            f"{path} is {other}. Give the volume first, then the image: planish new STUDY.toml VOLUME IMAGE."
        )
    known, stated = _known(facts, section)
    lines += ["", "", *_comment(known)]
    lines += ["", f"[{section}]", f"path = {_quoted(_relative(path, home))}"]
    size_key = "voxel_um" if section == "volume" else "pixel_um"
    for key, field, shown in _options(model):
        own = _option(key, field, shown, section)
        why = _NOT_IN_FILES[section].get(key)
        if key == size_key and stated is not None:
            own[-1] = f"#{key} = {_value(stated)}  # um; as stated"
        elif key == size_key:
            why = in_study_words(str(facts["size_problem"])).partition(". ")[0]
            own[-1] += "; fill in"
        elif key == "through" and facts.get("through"):
            own = [*own[:-1], f'through = "{facts["through"]}"  # along which the grey changes most']
        elif key == "through":
            why = "the axis through the sheet, which the grey does not tell"
        lines += own
        if why is not None:
            missing.append(Missing(line=len(lines), key=f"{section}.{key}", why=why, needed=key == size_key))


def _known(facts: dict[str, Any], section: str) -> tuple[list[str], tuple[float, ...] | None]:
    """Sentences about a file, and the size that it states."""
    what, axes = ("voxels", "z, y, x") if section == "volume" else ("pixels", "y, x")
    kind = facts.get("format") or facts["kind"]
    shape = " x ".join(map(str, facts["shape"]))
    found = [f"{facts['file_name']}: {kind}, {shape} {what} ({axes}), {facts['dtype']}, {facts['bytes'] / 1e6:.1f} MB."]
    stated: tuple[float, ...] | None = None
    if facts["size_um"]:
        stated = tuple(float(f"{value:.9g}") for value in facts["size_um"])
        size, extent = (" x ".join(f"{v:.6g}" for v in facts[k]) for k in ("size_um", "extent_um"))
        found.append(f"{what.capitalize()} of {size} um ({axes}), from {facts['size_source']}; extent {extent} um.")
    else:
        found.append(f"No {what[:-1]} size is stated in it.")
    if facts["min"] is not None:
        levels = facts["percentiles"]
        found.append(
            f"Grey {facts['min']:.5g} to {facts['max']:.5g}; percentiles "
            + ", ".join(f"{levels[k]:.5g} ({k} %)" for k in levels) + "."
        )  # fmt: skip
    found += [f"Look: {warning}" for warning in facts["warnings"] if warning != facts["size_problem"]]
    return found, stated


def _option(key: str, field: FieldInfo, shown: Shown, section: str) -> list[str]:
    """Lines of one option: what it is, and its default behind a sign."""
    inner = models_in(field.annotation)
    lines = ["", *_comment([in_study_words(str(field.description))])]
    if inner:
        lines.append(f"#[{section}.{key}]")
        for name, part, how in _options(inner[0]):  # pyright: ignore[reportArgumentType]
            lines += _option(name, part, how, f"{section}.{key}")[1:]
        return lines
    kinds = kinds_of(field.annotation)
    words = [str(word) for kind in kinds if get_origin(kind) is Literal for word in get_args(kind)]
    default = field.get_default()
    note = unit_of(key) or ""
    if default is not None:
        value = _value(default)
    elif words and len(kinds) == 1:
        value = _value(words[0])
    else:
        value = _placeholder(kinds, shown)
    others = [word for word in words if word != str(default if default is not None else words[0])]
    if kinds == [tuple[str, ...]]:
        note = "names in quotes, with commas between them"
    if others:
        more = " or ".join(map(_value, others)) + (" or a number" if float in kinds else "")
        note = f"{f'{note}; ' if note else ''}or {more}"
    lines.append(f"#{key} = {value}" + (f"  # {note}" if note else ""))
    return lines


def _placeholder(kinds: list[Any], shown: Shown) -> str:
    """What is needed where an option has no default, in capitals: no value, so that it cannot be run by mistake."""
    count = next((len(get_args(kind)) for kind in kinds if get_origin(kind) is tuple), 0)
    if count:
        words = (shown.metavar or "").rpartition("|")[2].split(",")
        return f"[{', '.join(words if len(words) == count else ['NUMBER'] * count)}]"
    if str in kinds:
        return f"'{shown.metavar or 'TEXT'}'"
    word = shown.metavar or ""
    return word if word.isalpha() and word.isupper() else "NUMBER"


def _comment(sentences: list[str]) -> Iterator[str]:
    for sentence in sentences:
        yield from textwrap.wrap(
            sentence,
            _WIDTH,
            initial_indent="# ",
            subsequent_indent="# ",
            break_long_words=False,
            break_on_hyphens=False,
        )


def _value(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_value, value))}]"  # pyright: ignore[reportUnknownVariableType]
    return tomli_w.dumps({"k": value}).removeprefix("k = ").strip()


def _quoted(path: str) -> str:
    """A path in single quotes, which Windows' paths need; as any text where it holds one."""
    return f"'{path}'" if "'" not in path and path.isprintable() else _value(path)


def _relative(path: Path, home: Path) -> str:
    try:
        return Path(os.path.relpath(path.absolute(), home.absolute())).as_posix()
    except ValueError:  # on another drive
        return path.absolute().as_posix()
