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
Point = tuple[float, float, float]

_FORMAT = "planish surface corrections"
_REMEDY = "docs/how-to/correct-faces.md shows an example."


class Stretch(Params):
    """A stretch of one face that is drawn to points, in um of the volume.

    ``reach_um``: columns farther than this from the line through the points, seen along the axis through the sheet,
    keep their faces.
    """

    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=40)]
    face: Face
    points: Annotated[tuple[Point, ...], Field(min_length=1, max_length=500, description="Points as (z, y, x).")]
    reach_um: Annotated[float, Field(gt=0, le=2000)] = 60.0
    author: Annotated[str, Field(max_length=200)] = ""
    reason: Annotated[str, Field(max_length=1000)] = ""


class Corrections(Params):
    """All stretches of one sheet, in the order in which they are applied."""

    format: Literal["planish surface corrections"] = _FORMAT
    version: Literal[1] = 1
    units: Literal["um"] = "um"
    stretches: Annotated[tuple[Stretch, ...], Field(max_length=1000)] = ()

    @model_validator(mode="after")
    def _told_apart(self) -> Corrections:
        names = [one.id for one in self.stretches]
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
