"""Options of the surface search, and corrections of the faces.

Corrections are stretches of points that a person set, as JSON.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from planish.core.errors import FileError
from planish.core.facts import Side
from planish.core.options import Params, option
from planish.core.tables import naming_faults, read_text

Label = Annotated[int, Field(ge=0)]
Fringe = Literal["auto", "off"] | Annotated[float, Field(ge=0, le=1)]


def _label(default: int | None, meaning: str) -> tuple[Label, ...]:
    return option(
        () if default is None else (default,),
        cli=f"--label-{meaning.split()[0]}",
        metavar="N[,N...]",
        help=f"Labels that mean {meaning}; several with commas, none for no such label.",
    )


class LabelParams(Params):
    """Meaning of the labels of a volume that another program has segmented."""

    air: tuple[Label, ...] = _label(0, "air")
    base: tuple[Label, ...] = _label(1, "base")
    coating: tuple[Label, ...] = _label(2, "coating")
    void: tuple[Label, ...] = _label(None, "void (pores of the sheet)")


class SurfaceParams(Params):
    """Options of the surface search; lengths in um.

    Notes
    -----
    Hirn et al. (2009) call their centre line a smoothed mean of the faces and give no number; the
    cut-off of 400 um is that of a Gaussian of 75 um. Rims are left out because the laser burns
    them. A coating's grey is needed only where it is nowhere thicker than the blur: grey and
    thickness of such a layer cannot be told apart.
    """

    sheet_grey: tuple[float, float] | None = option(
        None,
        metavar="LOW,HIGH",
        help="Grey range of the sheet, if the volume shows other material.",
    )
    seed_um: tuple[float, float, float] | None = option(
        None,
        metavar="Z,Y,X",
        help=(
            "A point inside the sheet, if there are several sheets or layers; with `sheet_grey`,"
            " the connected part of that grey range around the point."
        ),
    )
    coating_grey: float | None = option(
        None,
        metavar="GREY",
        help="Grey of the coating; needed if it is nowhere thicker than half the blur.",
    )
    fringe: Fringe = option(
        "auto",
        metavar="auto|off|SIZE",
        help=(
            "Phase-contrast fringe beside every edge: learnt, none, or its size as a share of the"
            " edge's step."
        ),
    )
    envelope_um: float | None = option(
        None,
        gt=0,
        help=(
            "Radius of a ball that rolls over both faces (50 to 250): loose fibres do not lift"
            " envelopes."
        ),
    )
    method: Literal["profile", "paper"] = option(
        "profile",
        cli="--surface-method",
        help=(
            "profile: fit the grey profile of every column; paper: slice by slice as Hirn et al."
            " (2009)."
        ),
    )
    labels: LabelParams | None = option(
        None,
        cli="--labels",
        help="The volume holds labels of another program; default: 0 air, 1 base, 2 coating.",
    )
    corrections: str | None = option(
        None,
        metavar="FILE",
        help="Corrections of the faces: JSON with points on the true faces.",
    )
    cutoff_um: float = option(
        400.0, gt=0, help="Wavelength that the smoothing of the centre surface halves."
    )
    rim_um: float = option(
        100.0, ge=0, help="Zone around holes and gaps that is left out of all results."
    )


REACH_UM = 60.0
"""Where none is stated."""
_REMEDY = "docs/how-to/correct-faces.md shows an example."


class Point(Params):
    """A place of a face, in um of the volume."""

    z: float
    y: float
    x: float
    face: Side


class Stretch(Params):
    """A stretch of the faces that is drawn to points.

    Columns farther than ``reach_um`` from the line through the points of a face, in their order and
    seen along the axis through the sheet, keep that face.
    """

    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=40)]
    points: Annotated[tuple[Point, ...], Field(min_length=1, max_length=10_000)]
    reach_um: Annotated[float, Field(gt=0, le=5000)] = REACH_UM
    note: Annotated[str, Field(max_length=1000)] = ""

    def of(self, face: Side) -> tuple[Point, ...]:
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
        ids = [stretch.id for stretch in self.stretches]
        if duplicate_ids := sorted({stretch_id for stretch_id in ids if ids.count(stretch_id) > 1}):
            raise ValueError(f"more than one stretch has the id {', '.join(duplicate_ids)}")
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
    text = read_text(path, what="file of corrections")
    with naming_faults(
        f"{Path(path).name} holds no corrections of surfaces", _REMEDY, error=FileError
    ):
        return Corrections.model_validate_json(text)
