"""From paths and options to a study: what ``planish link`` and :func:`planish.link` share."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr
from pydantic import ValidationError

from planish.compute import Compute, Progress, silent
from planish.core.errors import StudyError
from planish.core.mistakes import mistakes
from planish.io import find_place
from planish.io.info import is_image
from planish.io.sections import is_section_folder
from planish.pipeline.array_layers import ArrayLayer, Given, layer_sources
from planish.pipeline.run import Run, is_run
from planish.pipeline.save import run_study
from planish.pipeline.words import flag_of, sections_of
from planish.study import SECTIONS, Kind, Study

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}")
_OF_BOTH = ("override_size", "unusual_size")  # said once, of volumes and images
_OF_A_VOLUME = ("surface", "properties", "flatten")
_OF_THE_LINK = ("holes", "registration", "correlate")


def map_sheet(
    layer: str | Path | xr.DataArray, /, *, out: str | Path | None = None, compute: Compute | None = None,
    progress: Progress = silent, **options: Any,
) -> Run:  # fmt: skip
    """Map the sheet in a volume: flattened maps of all properties.

    Parameters
    ----------
    layer : path or DataArray
        File, folder of slices or sections, or store; or a volume of :func:`planish.volume`, which is then written into
        ``OUT-inputs``.
    out : path, optional
        Run folder to make.
    compute : Compute, optional
        Memory, threads, cluster; or as options, ``memory="4GB"``.
    progress : callable, optional
        Called with the name of a stage and a few words.
    **options
        Words of ``planish map``, ``through="y"`` for ``--through y``; or sections as in the study file: ``volume``
        (sizes, ``through``, ``top`` ...), ``surface``, ``properties``, ``flatten``; each a dict or the parameter model.

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
    return _made([layer], out, options, ("volume", *_OF_A_VOLUME), compute, progress, "pl.map_sheet")


def link(
    *layers: str | Path | Run | xr.DataArray, out: str | Path | None = None, chain: bool = False,
    compute: Compute | None = None, progress: Progress = silent, **options: Any,
) -> Run:  # fmt: skip
    """Link layers of one specimen to the last of them, the reference.

    Parameters
    ----------
    *layers : path, Run or DataArray
        Volumes, run folders and images; ``"NAME=PATH"`` gives one a name. Volumes of :func:`planish.volume` and images
        of :func:`planish.image` are written into ``OUT-inputs`` first; without ``out`` into a folder that is removed.
    out : path, optional
        Run folder to make.
    chain : bool
        Register each layer to the next one instead of the reference.
    compute, progress
        As for :func:`planish.map_sheet`.
    **options
        Words of ``planish link``, ``image_side="bottom"`` for ``--image-side bottom``; or sections as in the study
        file: ``volume``, ``image``, ``surface``, ``properties``, ``flatten``, ``holes``, ``registration``,
        ``correlate``; each a dict or the parameter model. They hold for all layers, and go before what an array says.

    Returns
    -------
    Run
        ``run.linked`` holds all maps on the pixels of the image, where one sheet is linked to one image.

    Raises
    ------
    PlanishError
        Any of the tree in :mod:`planish.core.errors`.

    Examples
    --------
    ``run = pl.link("volume.tif", "image.tif", out="run", image_side="bottom", memory="4GB")``
    """
    if len(layers) < 2:
        raise StudyError("Something to link it to is missing: give two layers or more, the reference last.")
    return _made(layers, out, options, tuple(SECTIONS), compute, progress, "pl.link", chain=chain)


def _made(
    layers: Sequence[Given], out: str | Path | None, options: Mapping[str, Any], sections: Sequence[str],
    compute: Compute | None, progress: Progress, call: str, *, chain: bool = False,
) -> Run:  # fmt: skip
    """Make a run of paths and arrays."""
    chosen, compute = sections_of(options, sections, compute, call=call)
    with layer_sources(layers, out, f"{call}({{}}{', ...' if len(layers) > 1 else ''})") as sources:
        study = study_of(sources, chosen, chain=chain)
        for source in sources:
            if isinstance(source, ArrayLayer):
                progress("write", source.path.name)
                source.write(compute or Compute())
        return run_study(study, out, compute=compute, progress=progress)


def study_of(
    layers: Sequence[str | Path | ArrayLayer], sections: Mapping[str, Mapping[str, Any]], *, chain: bool = False
) -> Study:
    """Put a study together of paths, or arrays that will have one, and options.

    Raises
    ------
    StudyError
        If an option is unknown, out of range, or means nothing for these layers; all faults are named.
    """
    options = {name: dict(values) for name, values in sections.items()}
    if unknown := sorted(set(options) - set(SECTIONS)):
        raise StudyError(f"There is no group of options called {', '.join(unknown)}; there are {', '.join(SECTIONS)}.")
    parts = [(None, layer.path) if isinstance(layer, ArrayLayer) else _named(str(layer)) for layer in layers]
    kinds: list[Kind] = [
        layer.kind if isinstance(layer, ArrayLayer) else _kind_of(path) if len(parts) > 1 else "volume"
        for layer, (_, path) in zip(layers, parts, strict=True)
    ]
    stated = [layer.options() if isinstance(layer, ArrayLayer) else {} for layer in layers]
    names = _all_names(parts, kinds)
    # What is given and means nothing without a volume.
    unused = [name for group in _OF_A_VOLUME for name in options.get(group, {})]
    unused += [name for name in options.get("volume", {}) if name not in (*_OF_BOTH, "md_deg")]
    if "volume" not in kinds and unused:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in unused)
        raise StudyError(
            f"{flags}: for volumes only, and {', '.join(p.name for _, p in parts)} is none. A run keeps "
            "the options that it was made with; map the volume again to change them."
        )
    if len(kinds) > 2 and options.get("registration", {}).get("marks"):
        raise StudyError(
            "--marks holds pairs of two layers, but more are given. Write them into a study file (docs/linking.md)."
        )
    try:
        made = [
            _layer(name, kind, path, options, of_array)
            for name, kind, (_, path), of_array in zip(names, kinds, parts, stated, strict=True)
        ]
        more = {k: options[k] for k in _OF_THE_LINK if k in options}
        return Study.model_validate({"layers": made, "chain": chain, **more})
    except ValidationError as error:
        faults = dict.fromkeys(mistakes(error, Study, lambda loc: (flag_of(loc), None)))
        raise StudyError("; ".join(faults)) from error


def _layer(
    name: str, kind: Kind, path: Path, options: Mapping[str, dict[str, Any]], of_array: Mapping[str, Any]
) -> dict[str, Any]:
    place = str(path.absolute())
    volume = options.get("volume", {})
    if kind == "run":
        return {"name": name, "run": place, "md_deg": volume.get("md_deg")}
    if kind == "image":
        both = {name: volume[name] for name in _OF_BOTH if name in volume}
        return {"name": name, "image": both | {**of_array} | options.get("image", {}) | {"path": place}}
    mapping = {k: options[k] for k in _OF_A_VOLUME if k in options}
    return {"name": name, "volume": {**of_array} | volume | {"path": place}, **mapping}


def _kind_of(path: Path) -> Kind:
    """Whether a path is a run, an image or a volume; its own reader names its faults."""
    if is_run(path):
        return "run"
    place = find_place(path)
    return "image" if not is_section_folder(place.path) and is_image(place) else "volume"


def _named(text: str) -> tuple[str | None, Path]:
    """Part ``NAME=PATH``."""
    name, sign, rest = text.partition("=")
    if not sign or not rest or find_place(text).path.exists():
        return None, Path(text)
    if _NAME.fullmatch(name):
        return name, Path(rest)
    if find_place(rest).path.exists():
        raise StudyError(
            f"{name!r} is no name of a layer: letters from A to Z, digits, - and _ are possible, at most 40."
        )
    return None, Path(text)


def _all_names(parts: Sequence[tuple[str | None, Path]], kinds: Sequence[Kind]) -> list[str]:
    """Names of all layers: as given; sheet and image where there is one of each; else those of the files.

    Files of the same name are told apart by their folders.
    """
    usual = ["image" if kind == "image" else "sheet" for kind in kinds]
    if len(set(usual)) == len(usual):
        return [name or word for (name, _), word in zip(parts, usual, strict=True)]
    places = [find_place(path.absolute()) for _, path in parts]
    stems = [name or _as_name(place.stem) for (name, _), place in zip(parts, places, strict=True)]
    return [
        name or (f"{_as_name(place.path.parent.name)}-{stem}"[:40] if stems.count(stem) > 1 else stem)
        for (name, _), place, stem in zip(parts, places, stems, strict=True)
    ]


def _as_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-_")[:40] or "layer"
