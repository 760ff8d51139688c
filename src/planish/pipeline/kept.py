"""Maps that outlive a refused link: a run beside its place, taken up again where the same is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from planish.compute import Compute, run_key
from planish.core.errors import PlanishError
from planish.pipeline.layers import Layer
from planish.pipeline.run import is_run, open_run
from planish.study import LayerParams, Study, to_dict

_REQUEST = ".request"  # file of such a run: what was asked for, as a hash


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptMaps:
    """Where the maps of a layer stand, or will: ``OUT-map``, or ``OUT-map-2`` where that is another's."""

    path: Path
    key: str

    @classmethod
    def of(cls, layer: LayerParams, sha256: str, out: Path, compute: Compute) -> KeptMaps:
        """Find the folder with the maps of a volume as a link to ``out`` asks for them, or a name that is free."""
        asked = to_dict(Study(layers=(layer.model_copy(update={"marks": None}),)))
        key = run_key(asked, [sha256, str(compute.memory_bytes)])  # the memory decides how wide the columns are
        path, k = out.with_name(f"{out.name}-map"), 1
        while path.exists() and _noted(path) != key:
            k += 1
            path = out.with_name(f"{out.name}-map-{k}")
        return cls(path=path, key=key)

    def read(self) -> Layer | None:
        """The sheet, where it was mapped before and is whole."""
        try:
            return open_run(self.path).sheet() if is_run(self.path) else None
        except PlanishError:
            return None

    def note(self, folder: Path) -> None:
        """Mark the folder that will stand there with what was asked for."""
        (folder / _REQUEST).write_text(self.key, encoding="utf-8")


def _noted(path: Path) -> str:
    try:
        return (path / _REQUEST).read_text(encoding="utf-8") if is_run(path) else ""
    except (OSError, UnicodeDecodeError):
        return ""
