"""A study to be filled in.

It holds what the files say, every option with its default, and what only the user knows.
"""

import textwrap
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin

import tomli_w
from pydantic.fields import FieldInfo

from planish.core.annotations import kinds_of, models_in, words_in
from planish.core.errors import StudyError
from planish.core.options import Params, Shown, options_of, unit_of
from planish.core.typing import Entries, Texts
from planish.io.info import describe
from planish.run.run import is_run
from planish.run.study import LINK_SECTIONS, MAP_SECTIONS, SECTIONS, in_study_words, relative_path

_TITLES = {
    "about": "What the page says of the run",
    "surface": "How the faces of the sheet are found",
    "properties": "What is measured",
    "flatten": "How the sheet is flattened",
    "holes": "The laser holes",
    "registration": "How image and sheet are registered",
    "correlate": "How image and maps are compared",
    "explain": "Which maps explain another one, declared before the run",
    "scales": "Which maps are described by octaves of wavelength",
}
_NOT_IN_FILES = {
    "volume": {
        "top": "which end of the axis is the top side",
        "md_deg": "the machine direction in the map",
    },
    "image": {
        "side": "the side of the sheet that the image shows",
        "md_deg": "the machine direction in the image",
    },
}
"""Options that no file states, with what they are."""


class Missing(NamedTuple):
    """Something that has to be filled in before a study can be run, or that only the user knows."""

    line: int
    key: str  # with its table, as volume.voxel_um
    why: str
    needed: bool  # whether the study cannot be run without it


class Draft(NamedTuple):
    """Text of a study, and what is missing in it."""

    text: str
    missing: tuple[Missing, ...]


def draft_study(
    volume: str | Path, image: str | Path | None = None, *, home: str | Path = ".", name: str = ""
) -> Draft:
    """Write a study of a volume, with or without an image.

    It holds what was read from them, and all options as comments.

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
        ``text`` is a study that :func:`planish.run.study.read_study` reads. Lines that begin with
        ``#`` and a key hold defaults; where an option has none, what is needed stands in capitals.

    Raises
    ------
    FileError, VolumeError, ResourceError
        As the reading functions.
    StudyError
        If one of them is of another kind: a run, or an image in place of a volume.
    """
    lines: list[str] = []
    missing: list[Missing] = []
    _input(lines, missing, "volume", Path(volume), Path(home))
    if image is not None:
        _input(lines, missing, "image", Path(image), Path(home))
    for section in ("about", *MAP_SECTIONS, *(() if image is None else LINK_SECTIONS)):
        lines += ["", "", f"# {_TITLES[section]}", "", f"[{section}]"]
        for key, field, shown in _options(SECTIONS[section]):
            lines += _option(key, field, shown, section)
    n_head_lines = len(_head(name, missing))
    missing = [unset._replace(line=unset.line + n_head_lines) for unset in missing]
    text = "\n".join([*_head(name, missing), *lines, ""])
    return Draft(text=text, missing=tuple(missing))


def _options(model: type[Params]) -> list[tuple[str, FieldInfo, Shown]]:
    """Give all options of a model, those last that are tables of their own.

    A key behind a table would belong to it.
    """
    flags = {name: shown for name, _, shown in options_of(model)}
    no_flag = Shown(flags=())
    options: list[tuple[str, FieldInfo, Shown]] = []
    tables: list[tuple[str, FieldInfo, Shown]] = []
    for name, field in model.model_fields.items():
        if name != "path":
            kind = tables if models_in(field.annotation) else options
            kind.append((name, field, flags.get(name, no_flag)))
    return options + tables


def _head(name: str, missing: list[Missing]) -> list[str]:
    lines = [
        f"# A study of planish. Fill it in, then: planish run {name or 'STUDY.toml'}",
        "#",
        (
            "# A key behind a # is an option with its default: take the # away to change it. Where"
            " an option has no"
        ),
        (
            "# default, what is needed stands in capitals. Paths are relative to this file and"
            " stand in single quotes."
        ),
    ]
    titles = {True: "To fill in:", False: "Stated in no file; is the default right?"}
    for is_needed, title in titles.items():
        items = [m for m in missing if m.needed is is_needed]
        if items:
            lines += ["#", f"# {title}"]
        lines += [f"#   line {m.line}: {m.key}: {m.why}" for m in items]
    return lines


def _input(
    lines: list[str],
    missing: list[Missing],
    section: Literal["volume", "image"],
    path: Path,
    home: Path,
) -> None:
    """Add the options of an input with what its file says, and note what no file states.

    ``lines`` of the study and what is ``missing`` in them grow; paths are relative to ``home``.
    """
    if is_run(path):
        raise StudyError(
            f"{path} is a run, which was mapped already. Link it: planish link {path} IMAGE --out"
            " RUN. For a study give the volume."
        )
    facts = describe(path)
    is_image = facts["kind"] == "image"
    if is_image is not (section == "image"):
        kind_text = "an image" if is_image else "a volume"
        raise StudyError(
            f"{path} is {kind_text}. Give the volume first, then the image: planish new STUDY.toml"
            " VOLUME IMAGE."
        )
    # A path stands in single quotes, which Windows' paths need; as any text where it holds one.
    relative = relative_path(path.absolute(), home.absolute())
    is_plain = "'" not in relative and relative.isprintable()
    lines += ["", "", *_comment(_description(facts, section)), "", f"[{section}]"]
    lines.append(f"path = '{relative}'" if is_plain else f"path = {_value(relative)}")
    for key, field, shown in _options(SECTIONS[section]):
        *texts, last_line = _option(key, field, shown, section)
        stated_line, reason = _stated(key, facts)
        lines += [*texts, stated_line or last_line]
        if key in _SIZES and reason:
            lines[-1] += "; fill in"
        reason = reason or _NOT_IN_FILES[section].get(key)
        if reason is not None:
            missing.append(Missing(len(lines), f"{section}.{key}", reason, key in _SIZES))


_SIZES = ("voxel_um", "pixel_um")


def _stated(key: str, facts: Entries) -> tuple[str | None, str | None]:
    """Line of an option that a file states, or why it has to be filled in; None for others.

    ``facts`` are those of `describe`.
    """
    if key in _SIZES:
        if not facts["size_um"]:
            return None, in_study_words(str(facts["size_problem"])).partition(". ")[0]
        stated_size = _value(tuple(float(f"{um:.9g}") for um in facts["size_um"]))
        return f"#{key} = {stated_size}  # um; as stated", None
    if key == "through":
        if not facts.get("through"):
            return None, "the axis through the sheet, which the grey does not tell"
        return f'through = "{facts["through"]}"  # along which the grey changes most', None
    return None, None


def _description(facts: Entries, section: str) -> list[str]:
    """What the file of an input holds, in sentences."""
    elements, axes = ("voxels", "z, y, x") if section == "volume" else ("pixels", "y, x")
    format_name = facts.get("format") or facts["kind"]
    shape_text = " x ".join(map(str, facts["shape"]))
    file_text = (
        f"{facts['file_name']}: {format_name}, {shape_text} {elements} ({axes}), {facts['dtype']}"
    )
    sentences = [f"{file_text}, {facts['bytes'] / 1e6:.1f} MB."]
    if facts["size_um"]:
        size_text = " x ".join(f"{um:.6g}" for um in facts["size_um"])
        extent_text = " x ".join(f"{um:.6g}" for um in facts["extent_um"])
        sentences.append(
            f"{elements.capitalize()} of {size_text} um ({axes}), from {facts['size_source']};"
            f" extent {extent_text} um."
        )
    else:
        sentences.append(f"No {elements[:-1]} size is stated in it.")
    if facts["min"] is not None:
        levels = ", ".join(f"{level:.5g} ({k} %)" for k, level in facts["percentiles"].items())
        sentences.append(f"Grey {facts['min']:.5g} to {facts['max']:.5g}; percentiles {levels}.")
    return sentences + [
        in_study_words(f"Look: {warning}")
        for warning in facts["warnings"]
        if warning != facts["size_problem"]
    ]


def _option(key: str, field: FieldInfo, shown: Shown, section: str) -> list[str]:
    """Lines of an option: a blank one, what it is, and its default behind a #."""
    nested_models = models_in(field.annotation)
    lines = ["", *_comment([in_study_words(str(field.description))])]
    if nested_models:
        lines.append(f"#[{section}.{key}]")
        for name, nested_field, nested_shown in _options(nested_models[0]):  # pyright: ignore[reportArgumentType]
            lines += _option(name, nested_field, nested_shown, f"{section}.{key}")[1:]
        return lines
    kinds = kinds_of(field.annotation)
    words = words_in(kinds)
    default = field.get_default()
    value = _placeholder(kinds, shown) if default is None else _value(default)
    if default is None and words:
        default = words[0]
        if len(kinds) == 1:
            value = _value(default)
    notes = [unit_of(key)]
    if kinds == [Texts]:
        notes = ["names in quotes, with commas between them"]
    choices = [_value(word) for word in words if word != str(default)]
    if choices and float in kinds:
        choices.append("a number")
    if choices:
        notes.append(f"or {' or '.join(choices)}")
    note_text = "; ".join(filter(None, notes))
    return [*lines, f"#{key} = {value}  # {note_text}".removesuffix("  # ")]


def _placeholder(kinds: list[Any], shown: Shown) -> str:
    """Say what is needed where an option has no default, in capitals.

    This is no value, so that the study cannot be run by mistake.
    """
    word = shown.metavar or ""
    for kind in kinds:
        if get_origin(kind) is tuple:
            count = len(get_args(kind))
            words = word.rpartition("|")[2].split(",")
            return f"[{', '.join(words if len(words) == count else ['NUMBER'] * count)}]"
    if str in kinds:
        return f"'{word or 'TEXT'}'"
    return word if word.isalpha() and word.isupper() else "NUMBER"


def _comment(sentences: list[str]) -> list[str]:
    wrapper = textwrap.TextWrapper(
        100,
        initial_indent="# ",
        subsequent_indent="# ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line for sentence in sentences for line in wrapper.wrap(sentence)]


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_value, value))}]"  # pyright: ignore[reportUnknownVariableType]
    return tomli_w.dumps({"k": value}).removeprefix("k = ").strip()
