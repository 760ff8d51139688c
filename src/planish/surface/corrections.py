"""Corrections of the faces as data: stretches of points that a person set, as a file of JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from planish.core.errors import FileError
from planish.core.options import Params
from planish.core.tables import read_text

Face = Literal["top", "bottom"]
FACES: tuple[Face, Face] = ("top", "bottom")

REACH_UM = 60.0
"""Where none is stated."""
_REMEDY = "docs/how-to/correct-faces.md shows an example."


class Point(Params):
    """A place of a face, in um of the volume."""

    z: float
    y: float
    x: float
    face: Face


class Stretch(Params):
    """A stretch of the faces that is drawn to points.

    Columns farther than ``reach_um`` from the line through the points of a face, in their order and seen along the axis
    through the sheet, keep that face.
    """

    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=40)]
    points: Annotated[tuple[Point, ...], Field(min_length=1, max_length=10_000)]
    reach_um: Annotated[float, Field(gt=0, le=5000)] = REACH_UM
    note: Annotated[str, Field(max_length=1000)] = ""

    def of(self, face: Face) -> tuple[Point, ...]:
        """Its points of one face."""
        return tuple(point for point in self.points if point.face == face)


class Corrections(Params):
    """All stretches of one sheet, in the order in which they are drawn."""

    format: Literal["planish surface corrections"] = "planish surface corrections"
    version: Literal[1] = 1
    units: Literal["um"] = "um"
    stretches: Annotated[tuple[Stretch, ...], Field(max_length=1000)] = ()

    @model_validator(mode="after")
    def _ids_are_unique(self) -> Corrections:
        names = [stretch.id for stretch in self.stretches]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"more than one stretch has the id {', '.join(twice)}")
        return self

    def to_json(self) -> str:
        """The text of its file; the same for the same corrections."""
        return json.dumps(self.model_dump(mode="json"), indent=1, ensure_ascii=False) + "\n"


def read_corrections(path: str | Path) -> Corrections:
    """Read the corrections of a file.

    Raises
    ------
    FileError
        If it cannot be read, or holds something else; all faults are named.
    """
    name = Path(path).name
    text = read_text(Path(path), what="file of corrections")
    try:
        content: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileError(f"{name} is no JSON: {error}. {_REMEDY}") from error
    try:
        return Corrections.model_validate(content)
    except ValidationError as error:
        faults = [f"{'.'.join(map(str, e['loc']))}: {e['msg'].removeprefix('Value error, ')}" for e in error.errors()]
        more = f" and {len(faults) - 8} more" if len(faults) > 8 else ""
        raise FileError(f"{name} holds no corrections of surfaces: {'; '.join(faults[:8])}{more}. {_REMEDY}") from error
