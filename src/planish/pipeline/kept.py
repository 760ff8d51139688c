"""Maps that outlive a refused link: a run beside its place, taken up again where the same is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from planish.compute import Compute, run_key
from planish.core.errors import PlanishError
from planish.pipeline.corrections import asked_corrections, made_corrections, uncorrected_params
from planish.pipeline.layers import Layer
from planish.pipeline.run import is_run, open_results, open_sheet
from planish.study import LayerParams, Study, read_study, to_dict

_REQUEST = ".request"  # file of such a run: what was asked for, as a hash, and the study of the link


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptMaps:
    """Where the maps of a layer stand, or will: ``OUT-map``, or ``OUT-map-2`` where that is another's."""

    path: Path
    key: str

    @classmethod
    def of(cls, layer: LayerParams, sha256: str, out: Path, compute: Compute) -> KeptMaps:
        """Find the folder with the maps of a volume as a link to ``out`` asks for them, or a name that is free."""
        bare = layer.model_copy(update={"marks": None, "surface": uncorrected_params(layer.surface)})
        # The memory decides how wide the columns are.
        found = [sha256, str(compute.memory_bytes), *filter(None, [asked_corrections(layer)])]
        key = run_key(to_dict(Study(layers=(bare,))), found)
        path, k = out.with_name(f"{out.name}-map"), 1
        while path.exists() and _noted(path) != key:
            k += 1
            path = out.with_name(f"{out.name}-map-{k}")
        return cls(path=path, key=key)

    def read(self) -> Layer | None:
        """The sheet, where it was mapped before and is whole."""
        try:
            return open_sheet(self.path) if is_run(self.path) else None
        except PlanishError:
            return None

    def note(self, folder: Path, study: Study) -> None:
        """Mark the folder that will stand there with what was asked for, and the link that was refused."""
        (folder / _REQUEST).write_text(f"{self.key}\n{study.model_dump_json()}\n", encoding="utf-8", newline="\n")


def sheets_of(old: Path, study: Study, hashes: Sequence[str]) -> tuple[dict[str, Layer], dict[str, Layer]]:
    """Sheets of a run that a study asks for, of the same files and by this code of planish.

    First those whose parameters are the same, then those of the same surface with other properties, flattening, or
    corrections.
    """
    try:
        results, asked = open_results(old), {layer.name: layer for layer in read_study(old / "run.toml").layers}
    except PlanishError:
        return {}, {}
    sources = {layer.name: layer.source.sha256 for layer in results.layers}
    whole = len(results.layers) == 1 or [layer.kind for layer in results.layers] == ["sheet", "image"]
    found: tuple[dict[str, Layer], dict[str, Layer]] = ({}, {})
    for layer, sha256 in zip(study.layers, hashes, strict=True):
        before = asked.get(layer.name)
        if layer.kind != "volume" or before is None or not results.is_of_this_code:
            continue
        place = old if whole else old / "layers" / layer.name
        bare = uncorrected_params(layer.surface)
        near = (before.volume, uncorrected_params(before.surface)) == (layer.volume, bare)
        if not (near and sources.get(layer.name) == sha256 and is_run(place)):
            continue
        same = before.model_copy(update={"marks": layer.marks, "surface": layer.surface}) == layer
        with suppress(PlanishError):  # damaged: it is mapped again
            sheet = open_sheet(place)
            same &= made_corrections(sheet.groups["surfaces"]) == asked_corrections(layer)
            found[0 if same else 1][layer.name] = sheet
    return found


def noted_study(path: Path) -> Study | None:
    """The link that was refused after it had made these maps; None where they are of no such link."""
    try:
        return Study.model_validate_json(_lines(path)[1])
    except (IndexError, ValueError):
        return None


def _noted(path: Path) -> str:
    return next(iter(_lines(path)), "")


def _lines(path: Path) -> list[str]:
    try:
        return (path / _REQUEST).read_text(encoding="utf-8").splitlines() if is_run(path) else []
    except (OSError, UnicodeDecodeError):
        return []
