"""RO-Crate: a run folder as it is, with a description of its files, inputs and program; written by rocrate."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rocrate.model.contextentity import ContextEntity
from rocrate.rocrate import ROCrate

from planish.core.errors import InputError
from planish.exports.content import ExportHistory
from planish.exports.params import ExportParams

_VERSION = "1.1"
_DESCRIPTIONS: dict[str, tuple[str, str]] = {
    "run.toml": ("Every parameter of the run; planish run repeats it", "application/toml"),
    "results.json": ("Every number of the run", "application/json"),
    "figures.csv": ("Every figure with its error", "text/csv"),
    "report.html": ("The report, to read", "text/html"),
    "regions.geojson": ("Regions that were declared artefacts", "application/geo+json"),
    "maps.zarr": ("All maps, zarr version 3; xarray.open_datatree opens it", ""),
    "figures": ("The figures of the report as SVG and CSV", ""),
    "layers": ("Whole runs of volumes that were mapped on the way", ""),
}


def write(run: Path, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Copy a run folder into a crate, a new folder.

    Its date is the day on which ``results.json`` was last changed (UTC), the only one that a run has. The inputs are
    described with their hashes and not copied.

    Raises
    ------
    InputError
        The run folder holds a crate's description already.
    """
    if (run / "ro-crate-metadata.json").exists():
        raise InputError(f"{run} is an RO-Crate already.")
    crate: Any = ROCrate(version=_VERSION)
    crate.name = f"{run.absolute().name}: a run of planish"
    crate.description = "Maps of a sheet from a volume, and their link to other layers, made by planish."
    crate.root_dataset["datePublished"] = (
        f"{datetime.fromtimestamp((run / 'results.json').stat().st_mtime, UTC):%Y-%m-%d}"
    )
    parts = [_add(crate, entry) for entry in sorted(run.iterdir()) if not entry.name.startswith(".")]
    program = _entity(
        crate, "#planish", "SoftwareApplication", name="planish", softwareVersion=history.planish,
        description="Links the 3D structure of a paper sheet to a 2D image of it.",
    )  # fmt: skip
    inputs = [
        _entity(crate, f"#input-{layer['layer']}", "CreativeWork", name=layer["name"], sha256=layer["sha256"])
        for layer in history.inputs
    ]
    action = _entity(crate, "#run", "CreateAction", name="planish run", instrument=program, object=inputs, result=parts)
    crate.root_dataset["mentions"] = [action]
    crate.write(str(path))


def _add(crate: Any, entry: Path) -> Any:
    """Add a file with its size and hash, or a folder."""
    words, kind = _DESCRIPTIONS.get(
        entry.name, ("Marks and registration" if entry.name.startswith("marks") else entry.name, "")
    )
    if entry.is_dir():
        return crate.add_dataset(str(entry), f"{entry.name}/", properties={"name": entry.name, "description": words})
    kinds = {".json": "application/json", ".csv": "text/csv"}
    with entry.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return crate.add_file(
        str(entry), entry.name,
        properties={
            "name": entry.name, "description": words, "contentSize": str(entry.stat().st_size), "sha256": sha256,
            "encodingFormat": kind or kinds.get(entry.suffix, "application/octet-stream"),
        },
    )  # fmt: skip


def _entity(crate: Any, identifier: str, kind: str, **properties: Any) -> Any:
    return crate.add(ContextEntity(crate, identifier, properties={"@type": kind} | properties))
