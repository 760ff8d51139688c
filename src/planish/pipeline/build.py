"""From paths and options to a study: what ``planish link`` and :func:`planish.link` share."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from planish.compute import Compute, Progress, silent
from planish.core.errors import StudyError
from planish.core.options import Params
from planish.io import find_place
from planish.io.info import is_image
from planish.io.sections import is_section_folder
from planish.pipeline.run import Run, is_run
from planish.pipeline.save import run_study
from planish.study import Kind, LayerParams, Study

Section = Mapping[str, Any] | Params
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}")
_OF_BOTH = ("override_size", "unusual_size")  # said once, of volumes and images
_OF_A_VOLUME = ("surface", "properties", "flatten")
_NO_OPTION = ("layers", "volume", "image")
_OF_THE_LINK = ("holes", "registration", "correlate")


def map_sheet(
    path: str | Path, /, *, out: str | Path | None = None, compute: Compute | None = None, progress: Progress = silent,
    **sections: Section,
) -> Run:  # fmt: skip
    """Map the sheet in a volume: flattened maps of all properties.

    Parameters
    ----------
    path : path
        File, folder of slices or sections, or store.
    out : path, optional
        Run folder to make.
    compute : Compute, optional
        Memory, threads, cluster.
    progress : callable, optional
        Called with the name of a stage and a few words.
    **sections
        Options as in the study file: ``volume`` (sizes, ``through``, ``top`` ...), ``surface``, ``properties``,
        ``flatten``; each a dict or the parameter model.

    Returns
    -------
    Run

    Raises
    ------
    PlanishError
        Any of the tree in :mod:`planish.core.errors`.

    Examples
    --------
    ``run = pl.map_sheet("volume.tif", out="run", volume={"voxel_um": (3, 3, 3)})``
    """
    return run_study(study_of([path], sections), out, compute=compute, progress=progress)


def link(
    *layers: str | Path, out: str | Path | None = None, chain: bool = False, compute: Compute | None = None,
    progress: Progress = silent, **sections: Section,
) -> Run:  # fmt: skip
    """Link layers of one specimen to the last of them, the reference.

    Parameters
    ----------
    *layers : path
        Volumes, run folders and images; ``"NAME=PATH"`` gives one a name.
    out : path, optional
        Run folder to make.
    chain : bool
        Register each layer to the next one instead of the reference.
    compute, progress
        As for :func:`planish.map_sheet`.
    **sections
        Options as in the study file: ``volume``, ``image``, ``surface``, ``properties``, ``flatten``, ``holes``,
        ``registration``, ``correlate``; each a dict or the parameter model. They hold for all layers.

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
    ``run = pl.link("volume.tif", "image.tif", out="run", image={"side": "bottom"})``
    """
    if len(layers) < 2:
        raise StudyError("Something to link it to is missing: give two layers or more, the reference last.")
    return run_study(study_of(layers, sections, chain=chain), out, compute=compute, progress=progress)


def study_of(layers: Sequence[str | Path], sections: Mapping[str, Section], *, chain: bool = False) -> Study:
    """Put a study together of paths and options.

    Raises
    ------
    StudyError
        If an option is unknown, out of range, or means nothing for these layers; all faults are named.
    """
    options = {k: v.model_dump() if isinstance(v, Params) else dict(v) for k, v in sections.items()}
    known = ("volume", "image", *_OF_A_VOLUME, *_OF_THE_LINK)
    if unknown := sorted(set(options) - set(known)):
        raise StudyError(f"There is no group of options called {', '.join(unknown)}; there are {', '.join(known)}.")
    parts = [_named(str(text)) for text in layers]
    kinds: list[Kind] = [_kind_of(path) if len(parts) > 1 else "volume" for _, path in parts]
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
        found = [_layer(n, k, p, options) for n, k, (_, p) in zip(names, kinds, parts, strict=True)]
        more = {k: options[k] for k in _OF_THE_LINK if k in options}
        return Study.model_validate({"layers": found, "chain": chain, **more})
    except ValidationError as error:
        faults: list[str] = []
        for fault in error.errors():
            words = [str(part) for part in fault["loc"] if not isinstance(part, int)]
            flag = f"--{words[-1].replace('_', '-')}: " if words and words[-1] not in _NO_OPTION else ""
            faults.append(flag + fault["msg"].removeprefix("Value error, "))
        raise StudyError("; ".join(faults)) from error


def _layer(name: str, kind: Kind, path: Path, options: Mapping[str, dict[str, Any]]) -> LayerParams:
    place = str(path.absolute())
    volume = options.get("volume", {})
    if kind == "run":
        return LayerParams.model_validate({"name": name, "run": place, "md_deg": volume.get("md_deg")})
    if kind == "image":
        own = {name: volume[name] for name in _OF_BOTH if name in volume}
        return LayerParams.model_validate({"name": name, "image": own | options.get("image", {}) | {"path": place}})
    mapping = {k: options[k] for k in _OF_A_VOLUME if k in options}
    return LayerParams.model_validate({"name": name, "volume": volume | {"path": place}, **mapping})


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
