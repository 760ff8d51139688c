"""Maps that outlive a refused link.

They are a run beside its place, taken up again where the same is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from planish.core.errors import CannotRegister, MarkError, PlanishError
from planish.core.files import write_text
from planish.core.text import quoted
from planish.run.array_layers import inputs_folder
from planish.run.compute import Compute, run_key
from planish.run.layers import Layers, MappedLayer
from planish.run.packages import with_packages
from planish.run.run import is_run, open_results, open_sheet
from planish.run.sheet import asked_corrections, made_corrections
from planish.run.study import RUN_TOML, GivenLayer, Study, changed, read_study, to_dict

# File of such a run: what was asked for, as a hash, and the study of the link.
_REQUEST = ".request"


class CachedMaps(NamedTuple):
    """Where the maps of a layer stand, or will stand.

    The place is ``OUT-map``, or ``OUT-map-2`` where that is another's.
    """

    path: Path
    key: str

    @classmethod
    def of_link(
        cls, study: Study, hashes: Sequence[str], out: Path, compute: Compute
    ) -> dict[str, CachedMaps]:
        """Give the cached maps of all volumes of a link to ``out``, by layer.

        Their names are ``OUT-NAME-map`` where there are several.

        Each is the folder with the maps of the volume as the link asks for them, or a name that is
        free.
        """
        caches: dict[str, CachedMaps] = {}
        if not study.is_link:
            return caches
        pairs = zip(study.layers, hashes, strict=True)
        volumes = [pair for pair in pairs if pair[0].kind == "volume"]
        for layer, sha256 in volumes:
            name = out.name if len(volumes) == 1 else f"{out.name}-{layer.name}"
            uncorrected = changed(layer, marks=None, surface={"corrections": None})
            mapping = Study(layers=(uncorrected,))
            # The memory decides how wide the columns are.
            input_hashes = [sha256, str(compute.memory_bytes)]
            corrections = asked_corrections(layer)
            if corrections:
                input_hashes.append(corrections)
            request_key = run_key(to_dict(with_packages(mapping)), input_hashes)
            path = out.with_name(f"{name}-map")
            k = 1
            while path.exists() and _request(path)[:1] != [request_key]:
                k += 1
                path = out.with_name(f"{name}-map-{k}")
            caches[layer.name] = cls(path, request_key)
        return caches

    def read(self) -> MappedLayer | None:
        """The sheet, where it was mapped before and is whole."""
        try:
            return open_sheet(self.path) if is_run(self.path) else None
        except PlanishError:
            return None

    def note(self, folder: Path, study: Study) -> None:
        """Mark the folder that will stand there with the request and the link that was refused."""
        write_text(folder / _REQUEST, f"{self.key}\n{study.model_dump_json()}\n")


def sheets_of(old: Path, study: Study, hashes: Sequence[str]) -> tuple[Layers, Layers]:
    """Give the sheets of a run that a study asks for, of the same files and by this planish code.

    The first have the same parameters; the second the same surface, and other properties,
    flattening, or corrections.
    """
    ready_sheets: Layers = {}
    similar_sheets: Layers = {}
    try:
        results = open_results(old)
        old_study = read_study(old / RUN_TOML)
    except PlanishError:
        return ready_sheets, similar_sheets
    if old_study.packages != study.packages or not results.is_of_this_code:
        return ready_sheets, similar_sheets
    pairs = zip(old_study.layers, results.layers, strict=True)
    old_layers = {(layer.name, facts.source.sha256): layer for layer, facts in pairs}
    kinds = [layer.kind for layer in results.layers]
    is_own_map = len(kinds) == 1 or kinds == ["sheet", "image"]
    for layer, sha256 in zip(study.layers, hashes, strict=True):
        old_layer = old_layers.get((layer.name, sha256))
        if layer.kind != "volume" or old_layer is None or not _has_same_surface(layer, old_layer):
            continue
        is_same = changed(old_layer, marks=layer.marks, surface=layer.surface) == layer
        with suppress(PlanishError):  # damaged: it is mapped again
            sheet = open_sheet(old if is_own_map else old / "layers" / layer.name)
            is_same &= made_corrections(sheet.groups["surfaces"]) == asked_corrections(layer)
            (ready_sheets if is_same else similar_sheets)[layer.name] = sheet
    return ready_sheets, similar_sheets


def _has_same_surface(layer: GivenLayer, old_layer: GivenLayer) -> bool:
    """Whether volume and search are those of an old layer, whatever was corrected by hand."""
    surface = changed(layer.surface, corrections=None)
    old_surface = changed(old_layer.surface, corrections=None)
    return layer.volume == old_layer.volume and surface == old_surface


def next_step(
    error: PlanishError, caches: Mapping[str, CachedMaps], study: Study, out: Path
) -> str:
    """Say where maps are kept of a link that was refused with an error, and how to go on.

    Where none are, how to get them without the image; empty where that does not help. Layers that
    were arrays have no file to name.
    """
    inputs = inputs_folder(out.absolute())
    # The files of arrays are removed when this is read.
    has_arrays = any(Path(layer.path).parent == inputs for layer in study.layers)
    reference = quoted(study.layers[-1].path)
    places = [cache.path for cache in caches.values()]
    paths = [str(place) for place in places if place.exists()]
    if paths:
        text = (
            f"The maps of the volume are kept in {' and '.join(paths)}; the same command goes"
            " on from there."
        )
        if not isinstance(error, CannotRegister | MarkError) or not study.is_sheet_on_image:
            return text
        if has_arrays:
            return f"{text} To set the marks by hand, write the arrays to files and link those."
        return f"{text} To set the marks by hand: planish view {quoted(paths[0])} {reference}"
    volume = next((layer for layer in study.layers if layer.kind == "volume"), None)
    if volume is None or has_arrays or not isinstance(error, CannotRegister):
        return ""
    map_folder = quoted(str(caches[volume.name].path))
    command = f"planish map {quoted(volume.path)} --out {map_folder}"
    text = f"To map the volume without it, with the same options: {command}"
    if study.is_sheet_on_image:
        text += f"; then, to set the marks by hand: planish view {map_folder} {reference}"
    return text


def noted_study(path: Path) -> Study | None:
    """The link that was refused after it had made these maps.

    None where they are of no such link.
    """
    try:
        return Study.model_validate_json(_request(path)[1])
    except (IndexError, ValueError):
        return None


def _request(path: Path) -> list[str]:
    """Lines of the file that says what maps were asked for; none where there is no such file."""
    try:
        return (path / _REQUEST).read_text(encoding="utf-8").splitlines() if is_run(path) else []
    except (OSError, UnicodeDecodeError):
        return []
