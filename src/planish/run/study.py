"""The study: every parameter of a run, checked.

What the command line fills in and ``run.toml`` repeats.
"""

import datetime
import os
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import tomli_w
from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from planish.analyze.params import CorrelateParams, ExplainParams, ScalesParams
from planish.core.errors import FileError, InputError, StudyError
from planish.core.files import fault_of_name, write_text
from planish.core.options import Params, option, words_in
from planish.core.parameter_faults import Key, fault_texts, key_lines, toml_tables
from planish.core.parameter_words import flag_of, names_in, with_names
from planish.core.tables import read_text
from planish.core.typing import Entries
from planish.flatten.params import FlattenParams
from planish.io.params import ImageParams, VolumeParams
from planish.marks.params import HoleParams
from planish.measure.params import MeasureParams
from planish.register.params import RegistrationParams
from planish.surface.params import SurfaceParams

Kind = Literal["volume", "image", "run"]
P = TypeVar("P", bound=Params)
RUN_TOML = "run.toml"
"""The study of a run, in its folder."""

EDITS = "edits"
"""Folder of a run for what is changed in the browser."""

EDITS_APPLIED = ("surface.json",)
"""Files in it that a run was made with."""


def _date_text(date: Any) -> Any:
    return str(date) if isinstance(date, datetime.date) else date


class AboutParams(Params):
    """What the page says of the run for those it is handed on to; no number depends on it."""

    model_config = ConfigDict(coerce_numbers_to_str=True)
    title: str | None = option(
        None, min_length=1, max_length=200, help="Title of the page, such as paper and trial."
    )
    author: str | None = option(
        None, min_length=1, max_length=200, help="Who made the run, as named on the page."
    )
    date: Annotated[str | None, BeforeValidator(_date_text)] = option(
        None, min_length=1, max_length=60, help="Date stated on the page, such as 2026-03-31."
    )
    note: str | None = option(
        None, min_length=1, max_length=2000, help="A few words for the page, such as the paper."
    )


SECTIONS: dict[str, type[Params]] = {
    "about": AboutParams,
    "volume": VolumeParams,
    "image": ImageParams,
    "surface": SurfaceParams,
    "properties": MeasureParams,
    "flatten": FlattenParams,
    "holes": HoleParams,
    "registration": RegistrationParams,
    "correlate": CorrelateParams,
    "explain": ExplainParams,
    "scales": ScalesParams,
}
"""Sections of a study with options, and the models of these."""

ANSWERS = ("explain", "scales")
"""Sections that ask something of the maps of a run."""

MAP_SECTIONS = ("surface", "properties", "flatten")
"""Sections of the mapping of a volume."""

LINK_SECTIONS = ("holes", "registration", "correlate", *ANSWERS)
"""Sections of a link."""

_PATHS = {"path", "run", "marks", "design", "regions", "corrections", "white", "dark", "factors"}


class GivenLayer(Params):
    """One layer: a volume that is mapped first, a run that is there, or an image."""

    name: Annotated[
        str,
        Field(
            pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$",
            max_length=40,
            description="Name of the layer; each one once.",
        ),
    ]
    volume: VolumeParams | None = None
    image: ImageParams | None = None
    run: str | None = Field(default=None, description="Folder of a run of one volume.")
    md_deg: float | None = Field(
        default=None, ge=-180, le=180, description="Machine direction in the map of a run."
    )
    marks: str | None = Field(
        default=None,
        description="Marks of this layer (moving) and the one it is registered to (fixed).",
    )
    surface: SurfaceParams = SurfaceParams()
    properties: MeasureParams = MeasureParams()
    flatten: FlattenParams = FlattenParams()

    @model_validator(mode="after")
    def _has_one_source(self) -> Self:
        if (self.volume, self.run, self.image).count(None) != 2:
            raise ValueError("give one of volume, run and image")
        return self

    @property
    def kind(self) -> Kind:
        """What the layer is read from."""
        if self.image is not None:
            return "image"
        return "run" if self.run is not None else "volume"

    @property
    def path(self) -> str:
        """File or folder that it is read from."""
        source = self.image or self.volume
        return source.path if source is not None else str(self.run)


class Study(Params):
    """One run: a sheet that is mapped, or layers that are linked onto the last one, the reference.

    With ``chain`` each layer is registered to the next one and carried on from there, otherwise all
    are registered to the reference.
    """

    layers: tuple[GivenLayer, ...]
    chain: bool = Field(
        default=False,
        description="Register each layer to the next one, and carry it on from there.",
    )
    packages: dict[str, str] = Field(
        default={},
        description=(
            "Packages beside planish whose properties or formats are named here, and their"
            " versions; a run writes them."
        ),
    )
    about: AboutParams = AboutParams()
    holes: HoleParams = HoleParams()
    registration: RegistrationParams = RegistrationParams()
    correlate: CorrelateParams = CorrelateParams()
    explain: ExplainParams = ExplainParams()
    scales: ScalesParams = ScalesParams()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        """The study, if its layers and options fit together; ValueError says what does not."""
        _check_names([layer.name for layer in self.layers])
        if not self.is_link and self.layers[0].kind != "volume":
            raise ValueError(
                "a single layer has to be a volume; a run or an image is linked to something"
            )
        if self.layers[-1].marks is not None:
            raise ValueError(
                "the last layer is the reference: it is registered to nothing and has no marks"
            )
        if not self.is_link and self.correlate.regions is not None:
            raise ValueError(
                "regions are left out of correlations, and a single layer has none; link it to"
                " something"
            )
        if self.registration.refine is not None and len(self.layers) != 2:
            raise ValueError("refine is for two layers; link these two alone")
        return self

    @property
    def is_link(self) -> bool:
        """Whether layers are linked; otherwise one volume is mapped."""
        return len(self.layers) > 1

    @property
    def next_layers(self) -> list[int]:
        """Index of the layer that each one but the last is registered to."""
        last = len(self.layers) - 1
        return [k + 1 if self.chain else last for k in range(last)]

    @property
    def is_sheet_on_image(self) -> bool:
        """Whether one sheet is linked to one image, the usual case."""
        return [layer.kind == "image" for layer in self.layers] == [False, True]


def _check_names(names: Sequence[str]) -> None:
    """Raise ValueError where the layers of a study cannot be told apart, or have no files."""
    if not names:
        raise ValueError("a study needs a layer: a volume to map, or several layers to link")
    # Names of files: on Windows, CT and ct are one.
    small = [name.casefold() for name in names]
    twice = sorted({name for name in names if small.count(name.casefold()) > 1})
    if twice:
        raise ValueError(
            f"every layer needs a name of its own (NAME=PATH); more than one is {', '.join(twice)}"
        )
    for fault in filter(None, map(fault_of_name, names)):
        raise ValueError(f"a layer cannot have one of the names {', '.join(names)}: {fault}")


def read_study(path: Path) -> Study:
    """Read a study file; paths in it are relative to its folder and come back absolute.

    A study of one volume, with or without an image, may leave out the list of layers: tables
    ``[volume]``, ``[image]``, ``[surface]`` ... on the top level then stand for them. So do the
    files of planish 0.1.0.

    Raises
    ------
    FileError
        If it cannot be read as TOML.
    InputError
        If a parameter is unknown, missing or out of range; all faults are named.
    """
    text = read_text(path, what="study")
    tables = toml_tables(path, text)
    tables.pop("planish", None)
    if {"specimens", "watch"} & set(tables):
        raise FileError(
            f"{path} is a series of specimens. Do it with: planish study {path} --out OUT."
        )
    return with_paths(checked_study(path, text, tables), lambda p: _absolute(path.parent / p))


def checked_study(path: Path, text: str, tables: Entries) -> Study:
    """The study in the tables of a file with this text.

    InputError names the lines of all faults, which are looked up by their keys: in the short form
    of one volume, and in files of planish 0.1.0, keys stand elsewhere than in the model.
    """
    try:
        return as_study(tables)
    except ValidationError as error:
        key_line_index = key_lines(text)

        def place(loc: Key) -> tuple[Key, int | None]:
            if loc[:1] == ("layers",) and "layers" not in tables:
                loc = loc[2:]  # of the short form
            old_loc = (*loc[:2], "map", *loc[2:])  # of planish 0.1.0
            return loc, key_line_index.of(old_loc if old_loc[:4] in key_line_index.lines else loc)

        faults = fault_texts(error, Study, place)
        count_text = f"{len(faults)} wrong parameter{'s' if len(faults) > 1 else ''}"
        raise InputError("\n  ".join([f"{path} has {count_text}:", *faults])) from error


def _absolute(path: Path) -> str:
    # On Windows, resolve() makes \\server\share of Z:, to which no relative path leads from a run
    # on Z:.
    return os.path.normpath(path.absolute()) if os.name == "nt" else str(path.resolve())


def as_study(data: Entries) -> Study:
    """Check the content of a study file, in any form that :func:`read_study` takes.

    ValidationError where wrong.
    """
    data = dict(data)
    registration: Any = data.get("registration")
    if isinstance(registration, dict) and "hole_um" in registration:  # as planish 0.1.0 wrote it
        data["registration"] = registration = Entries(registration)
        data["holes"] = {"hole_um": registration.pop("hole_um")}
    if "layers" not in data:  # the short form of one volume
        sheet: Entries = {"name": "sheet"}
        sheet |= {k: data.pop(k) for k in ("volume", *MAP_SECTIONS) if k in data}
        layers = [sheet]
        if "image" in data:
            layers.append({"name": "image", "image": data.pop("image")})
        return Study.model_validate({"layers": layers, **data})
    data.pop("rim_um", None)
    if isinstance(data["layers"], list):
        data["layers"] = list(map(_with_volume, data["layers"]))
    return Study.model_validate(data)


def _with_volume(layer: Any) -> Any:
    """A layer; planish 0.1.0 had the volume one level deeper."""
    tables = layer.get("map") if isinstance(layer, dict) else None
    if not isinstance(tables, dict):
        return layer
    outer = {name: table for name, table in layer.items() if name != "map"}
    return outer | {name: tables[name] for name in ("volume", *MAP_SECTIONS) if name in tables}


def with_values(study: Study, changes: Sequence[str]) -> Study:
    """Change single parameters.

    ``surface.cutoff_um=600`` changes one, ``NAME.surface.cutoff_um=600`` changes it for one layer
    only.

    Parameters
    ----------
    study : Study
    changes : sequence of str
        Values are written as in a study file; text needs no quotes, and nothing behind the sign
        takes a parameter out.

    Returns
    -------
    Study

    Raises
    ------
    StudyError
        If a name means nothing in this study, or a value does not fit; all faults are named.
    """
    data = to_dict(study)
    faults: list[str] = []
    for text in changes:
        key, equals_sign, value = (word.strip() for word in text.partition("="))
        tables, keys = _tables_of(study, data, key.split("."))
        if equals_sign and tables:
            for table in tables:
                _put(table, keys, value)
            continue
        sections = ", ".join((*_LAYER_SECTIONS, *LINK_SECTIONS, "about"))
        faults.append(f"{text!r}: write SECTION.NAME=VALUE with a section of {sections}")
        if equals_sign and keys[0] in _LAYER_SECTIONS:
            faults[-1] += "; no layer of this study has it"
    if faults:
        raise StudyError("; ".join(faults) + ".")
    try:
        return Study.model_validate(data)
    except ValidationError as error:
        raise StudyError("; ".join(fault_texts(error, Study)) + ".") from error


def _put(table: Any, keys: Sequence[str], value: str) -> None:
    """Set a value in a table, or in one within it; take it out where there is none."""
    *table_keys, name = keys
    for key in table_keys:
        table = table.setdefault(key, {}) if isinstance(table, dict) else {}
    table.pop(name, None)
    if value:
        table[name] = _value(value)


_LAYER_SECTIONS = ("volume", "image", *MAP_SECTIONS)


def _tables_of(study: Study, data: Entries, keys: list[str]) -> tuple[list[Entries], list[str]]:
    """The tables of a study that a key is in, and the rest of the key.

    ``keys`` are the words of a key, with the name of a layer in front where it is for that alone;
    ``data`` are the values of the study as `to_dict` gives them, in which the tables lie.
    """
    names = [layer.name for layer in study.layers]
    name = None
    if len(keys) > 2 and keys[0] in names:
        name, *keys = keys
    if keys[0] in _LAYER_SECTIONS:
        kind = "image" if keys[0] == "image" else "volume"
        layers = zip(study.layers, data["layers"], strict=True)
        of_kind = [(layer.name, table) for layer, table in layers if layer.kind == kind]
        return [table for layer, table in of_kind if name in (None, layer)], keys
    is_of_study = name is None and keys[0] in Study.model_fields and keys[0] != "layers"
    tables = [data] if is_of_study else []
    return tables, keys


def in_study_words(text: str) -> str:
    """Name the keys of a study in a text that names parameters.

    It then says surface.rim_um for `rim_um`; what a study has no key for is an option of the
    command line.
    """
    keys: dict[str, str] = {}
    for section, model in reversed(SECTIONS.items()):  # of the same word in two the first one
        keys |= {word: ".".join(path) for word, path in words_in(model, section).items()}
    if "pixel_um" in names_in(text):
        # An image has its own; of a volume they are said in its section.
        keys |= {name: f"image.{name}" for name in ("override_size", "unusual_size")}
    return with_names(text, lambda word: keys.get(word) or flag_of(word))


def _value(text: str) -> Any:
    # As in a study file; numbers with commas stand without their brackets too, which shells treat
    # as their own.
    for written in (text, f"[{text}]"):
        try:
            return tomllib.loads(f"value = {written}")["value"]
        except tomllib.TOMLDecodeError:
            continue
    return text


def write_study(study: Study, folder: Path, *, home: Path, version: str) -> None:
    """Write ``run.toml``.

    Parameters
    ----------
    study : Study
        With absolute paths.
    folder : path
        The file is written into it.
    home : path
        Place where the folder will stand: paths in the file are relative to it.
    version : str
        Of planish.
    """
    study = with_paths(study, lambda path: relative_path(path, home))
    text = tomli_w.dumps({"planish": version} | to_dict(study))
    write_text(folder / RUN_TOML, text)


def relative_path(path: str | Path, base_folder: Path) -> str:
    """Return a path relative to a folder, or as it is where none leads there.

    None leads from one drive to another.
    """
    try:
        return Path(os.path.relpath(path, base_folder)).as_posix()
    except ValueError:
        return Path(path).as_posix()


def to_dict(study: Study) -> Entries:
    """Give the plain values of a study.

    They hold nothing that is not given, and nothing about mapping where nothing is mapped.
    """
    data = study.model_dump(mode="json", exclude_none=True)
    is_given = {
        "about": data["about"],
        "packages": data["packages"],
        "explain": study.explain.is_declared,
        "scales": study.scales.is_declared,
    }
    for name in is_given:
        if not is_given[name]:
            del data[name]
    for layer, values in zip(study.layers, data["layers"], strict=True):
        if layer.kind != "volume":
            for name in MAP_SECTIONS:
                values.pop(name)
    return data


def with_paths(params: P, change: Callable[[str], str | None]) -> P:
    """Change all paths of a study: those of the files that it reads."""
    update: Entries = {}
    for name, value in params:
        if name in _PATHS and isinstance(value, str):
            update[name] = change(value)
        elif isinstance(value, Params):
            update[name] = with_paths(value, change)
        elif isinstance(value, tuple) and value and isinstance(value[0], Params):
            update[name] = tuple(with_paths(part, change) for part in value)
    return params.model_copy(update=update)


def changed(params: P, **values: Any) -> P:
    """The same parameters with some values changed; a dict changes those of a section."""
    for name, part in values.items():
        if isinstance(part, dict):
            values[name] = changed(getattr(params, name), **part)
    return params.model_copy(update=values)


def with_layer(study: Study, name: str, **values: Any) -> Study:
    """The same study with some values of one layer changed, as by :func:`changed`."""
    layers = [*study.layers]
    for k, layer in enumerate(layers):
        if layer.name == name:
            layers[k] = changed(layer, **values)
    return changed(study, layers=tuple(layers))
