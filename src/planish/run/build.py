"""From paths and options to a study: what ``planish link`` and :func:`planish.link` share."""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr
from pydantic import ValidationError

from planish.core.errors import StudyError
from planish.core.options import Params, as_words, params_of, put_options, words_in
from planish.core.parameter_faults import fault_texts
from planish.core.typing import Entries, Fields, Texts
from planish.io import find_place
from planish.io.info import is_image
from planish.io.sections import is_section_folder
from planish.run.array_layers import ArraySource, GivenSource, LayerSource, layer_sources
from planish.run.compute import Compute, Progress, silent
from planish.run.pipeline import run_study
from planish.run.run import Run, is_run
from planish.run.study import ANSWERS, LINK_SECTIONS, MAP_SECTIONS, SECTIONS, Kind, Study

_OF_BOTH = ("override_size", "unusual_size")  # said once, of volumes and images


def map_sheet(
    layer: str | Path | xr.DataArray,
    /,
    *,
    out: str | Path | None = None,
    compute: Compute | None = None,
    progress: Progress = silent,
    **options: Any,
) -> Run:
    """Map the sheet in a volume: flattened maps of all properties.

    Parameters
    ----------
    layer : path or DataArray
        File, folder of slices or sections, or store; or a volume of :func:`planish.volume`, which
        is then written into ``OUT-inputs``.
    out : path, optional
        Run folder to make.
    compute : Compute, optional
        Memory, threads, cluster; or as options, ``memory="4GB"``.
    progress : callable, optional
        Called with the name of a stage and a few words.
    **options
        Words of ``planish map``, ``through="y"`` for ``--through y``; or sections as in the study
        file: ``volume`` (sizes, ``through``, ``top`` ...), ``surface``, ``properties``,
        ``flatten``, ``about``; each a dict or the parameter model.

    Returns
    -------
    Run

    Raises
    ------
    PlanishError
        Any of the tree in :mod:`planish.core.errors`.

    Examples
    --------
    ``run = pl.map_sheet("volume.tif", out="run", voxel_um=3, through="y")``
    """
    sections = ("about", "volume", *MAP_SECTIONS)
    return _make([layer], out, options, sections, compute, progress, "pl.map_sheet")


def link(
    *layers: str | Path | Run | xr.DataArray,
    out: str | Path | None = None,
    chain: bool = False,
    compute: Compute | None = None,
    progress: Progress = silent,
    **options: Any,
) -> Run:
    """Link layers of one specimen to the last of them, the reference.

    Parameters
    ----------
    *layers : path, Run or DataArray
        Volumes, run folders and images; ``"NAME=PATH"`` gives one a name. Volumes of
        :func:`planish.volume` and images of :func:`planish.image` are written into ``OUT-inputs``
        first; without ``out`` into a folder that is removed.
    out : path, optional
        Run folder to make.
    chain : bool
        Register each layer to the next one instead of the reference.
    compute, progress
        As for :func:`planish.map_sheet`.
    **options
        Words of ``planish link``, ``image_side="bottom"`` for ``--image-side bottom``; or sections
        as in the study file: ``volume``, ``image``, ``surface``, ``properties``, ``flatten``,
        ``holes``, ``registration``, ``correlate``, ``about``; each a dict or the parameter model.
        They hold for all layers, and go before what an array says.

    Returns
    -------
    Run
        ``run.linked`` holds all maps on the pixels of the image, where one sheet is linked to one
        image.

    Raises
    ------
    PlanishError
        Any of the tree in :mod:`planish.core.errors`.

    Examples
    --------
    ``run = pl.link("volume.tif", "image.tif", out="run", image_side="bottom", memory="4GB")``
    """
    if len(layers) < 2:
        raise StudyError(
            "Something to link it to is missing: give two layers or more, the reference last."
        )
    return _make(layers, out, options, tuple(SECTIONS), compute, progress, "pl.link", chain=chain)


def _make(
    layers: Sequence[GivenSource],
    out: str | Path | None,
    options: Fields,
    sections: Sequence[str],
    compute: Compute | None,
    progress: Progress,
    call_text: str,
    *,
    chain: bool = False,
) -> Run:
    section_options, compute = sections_of(options, sections, compute, call=call_text)
    more_text = ", ..." if len(layers) > 1 else ""
    with layer_sources(layers, out, f"{call_text}({{}}{more_text})") as sources:
        study = study_of(sources, section_options, chain=chain)
        for source in sources:
            if isinstance(source, ArraySource):
                progress("write", source.path.name)
                source.write(compute or Compute())
        return run_study(study, out, compute=compute, progress=progress)


def study_of(
    layers: Sequence[LayerSource],
    sections: Mapping[str, Fields],
    *,
    chain: bool = False,
) -> Study:
    """Put a study together of paths, or arrays that will have one, and options.

    Parameters
    ----------
    layers : sequence of path or ArraySource
        The reference last; a text may be ``NAME=PATH``.
    sections : mapping of name to mapping
        Options by section, as in a study file.
    chain : bool
        Register each layer to the next one instead of the reference.

    Returns
    -------
    Study

    Raises
    ------
    StudyError
        If an option is unknown, out of range, or means nothing for these layers; all faults are
        named.
    """
    options = {name: dict(values) for name, values in sections.items()}
    unknown = sorted(set(options) - set(SECTIONS))
    if unknown:
        raise StudyError(
            f"There is no group of options called {', '.join(unknown)}; there are"
            f" {', '.join(SECTIONS)}."
        )
    sources = [_source(layer, is_link=len(layers) > 1) for layer in layers]
    if all(source.kind != "volume" for source in sources):
        _refuse_options_of_volumes(options, [source.path for source in sources])
    registration = options.get("registration", {})
    if len(sources) > 2 and registration.get("marks"):
        raise StudyError(
            "`marks` holds pairs of two layers, but more are given. Write them into a study file"
            " (docs/linking.md)."
        )
    names = _all_names(sources)
    tables = [*map(_table, names, sources, repeat(options))]
    link_options = {name: options[name] for name in ("about", *LINK_SECTIONS) if name in options}
    try:
        return Study.model_validate({"layers": tables, "chain": chain, **link_options})
    except ValidationError as error:
        faults = dict.fromkeys(fault_texts(error, Study, as_words(words_of())))
        raise StudyError("; ".join(faults)) from error


def _refuse_options_of_volumes(options: Mapping[str, Fields], files: Sequence[Path]) -> None:
    """Raise StudyError for what is given and means nothing without a volume."""
    names = [name for section in MAP_SECTIONS for name in options.get(section, {})]
    shared_names = (*_OF_BOTH, "md_deg")  # with images, and with runs
    names += [name for name in options.get("volume", {}) if name not in shared_names]
    if names:
        names_text = ", ".join(f"`{name}`" for name in names)
        files_text = ", ".join(file.name for file in files)
        raise StudyError(
            f"{names_text}: for volumes only, and {files_text} is none. A run keeps the options"
            " that it was made with; map the volume again to change them."
        )


class PathSource(NamedTuple):
    """A layer that stands in a file or folder, and its name, if it was given."""

    path: Path
    kind: Kind
    name: str | None


Source = PathSource | ArraySource


def _source(layer: LayerSource, *, is_link: bool) -> Source:
    """Tell a run, an image and a volume; its own reader names its faults.

    A text may be ``NAME=PATH``.
    """
    if isinstance(layer, ArraySource):
        return layer
    name = None
    path = Path(layer)
    prefix, _, path_text = str(layer).partition("=")
    if path_text and not find_place(str(layer)).path.exists():
        if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}", prefix):
            name = prefix
            path = Path(path_text)
        elif find_place(path_text).path.exists():
            raise StudyError(
                f"{prefix!r} is no name of a layer: letters from A to Z, digits, - and _ are"
                " possible, at most 40."
            )
    return PathSource(path, _kind_of(path) if is_link else "volume", name)


def _kind_of(path: Path) -> Kind:
    if is_run(path):
        return "run"
    place = find_place(path)
    return "volume" if is_section_folder(place.path) or not is_image(place) else "image"


def _table(name: str, source: Source, options: Mapping[str, Entries]) -> Entries:
    """The layer of a source as a study has it, with those options that are for its kind."""
    table = {"path": str(source.path.absolute())}
    volume = options.get("volume", {})
    array_options = source.options if isinstance(source, ArraySource) else {}
    if source.kind == "run":
        return {"name": name, "run": table["path"], "md_deg": volume.get("md_deg")}
    if source.kind == "image":
        size_options = {name: volume[name] for name in _OF_BOTH if name in volume}
        image_options = array_options | options.get("image", {})
        return {"name": name, "image": size_options | image_options | table}
    map_options = {k: options[k] for k in MAP_SECTIONS if k in options}
    return {"name": name, "volume": array_options | volume | table, **map_options}


def _all_names(sources: Sequence[Source]) -> list[str]:
    """Names as given.

    Sheet and image where there is one of each; else of the files, with folders where those agree.
    """
    names = ["image" if source.kind == "image" else "sheet" for source in sources]
    if len(set(names)) < len(names):
        places = [find_place(source.path.absolute()) for source in sources]
        names = [_as_name(place.stem) for place in places]
        stems = _as_given(sources, names)
        for k, place in enumerate(places):
            if stems.count(stems[k]) > 1:
                names[k] = f"{_as_name(place.path.parent.name)}-{names[k]}"[:40]
    return _as_given(sources, names)


def _as_given(sources: Sequence[Source], names: Sequence[str]) -> list[str]:
    """The names, but where a source was given one."""
    return [source.name or name for source, name in zip(sources, names, strict=True)]


def _as_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-_")[:40] or "layer"


def sections_of(
    options: Fields, sections: Iterable[str], compute: Compute | None, *, call: str
) -> tuple[dict[str, Entries], Compute | None]:
    """Sort what a call was given into sections of a study, and what may be used.

    An option is a section with a dict or a model, or a word of one of its options; None is not
    given. ``call`` is what the user called. StudyError names all faults.
    """
    word_places = words_of([*sections, "compute"])
    tables: Entries = {}
    if compute is not None:
        tables["compute"] = params_of(Compute, compute, call).model_dump()
    stated = {word: value for word, value in options.items() if value is not None}
    faults: list[str] = []
    for word, value in options.items():
        if word in sections:
            table = _table_in(value)
            if table is None:
                faults.append(
                    f"{word}={value!r}: needed is a dict of options, or one of them by itself."
                )
            else:
                tables[word] = table
        elif word in stated and word not in word_places:
            known_words = [*sections, *word_places, "out", "progress", "chain"]
            faults.append(_unknown(word, known_words))
    given_words = {word: stated[word] for word in stated if word in word_places}
    for word in put_options(tables, word_places, given_words):
        place = word_places[word][0]
        faults.append(f"{word}= is given twice, by itself and in {place}=. Leave one out.")
    if faults:
        raise StudyError(f"{call}: {' '.join(faults)}")
    compute_options = tables.pop("compute", None)
    return tables, None if compute_options is None else params_of(Compute, compute_options, call)


def _table_in(value: Any) -> Entries | None:
    """Options of a section, of a model or a mapping; None where it is neither."""
    if isinstance(value, Params):
        return value.model_dump(exclude_unset=True)
    return deepcopy(Entries(value)) if isinstance(value, Mapping) else None


def words_of(sections: Iterable[str] = SECTIONS) -> dict[str, Texts]:
    """Words of some sections, and where each stands in a study.

    Of the same word in two the first one. What a study asks of its maps has a command of its own,
    and no words here.
    """
    models = {**SECTIONS, "compute": Compute}
    places: dict[str, Texts] = {}
    for section in sections:
        if section not in ANSWERS:
            places = words_in(models[section], section) | places
    return places


def _unknown(word: str, known_words: list[str]) -> str:
    likely = difflib.get_close_matches(word.casefold(), known_words, 1, 0.7)
    if likely:
        return f"{word}= is unknown; did you mean {likely[0]}=?"
    if word in SECTIONS or word in words_of():
        return f"{word}= is for pl.link, which has an image and marks. Leave it out."
    return f"{word}= is unknown. The words are those of the command line: planish link --help."
