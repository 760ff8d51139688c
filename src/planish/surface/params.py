"""Options of the surface search."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from planish.core.options import Params, option

Label = Annotated[int, Field(ge=0)]
Fringe = Literal["auto", "off"] | Annotated[float, Field(ge=0, le=1)]


def _label(default: int | None, meaning: str) -> tuple[Label, ...]:
    labels: tuple[int, ...] = () if default is None else (default,)
    return option(
        labels,
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
    Hirn et al. (2009) call their centre line a smoothed mean of the faces and give no number; the cut-off of 400 um is
    that of a Gaussian of 75 um. Rims are left out because the laser burns them. A coating's grey is needed only where
    it is nowhere thicker than the blur: grey and thickness of such a layer cannot be told apart.
    """

    sheet_grey: tuple[float, float] | None = option(
        None, metavar="LOW,HIGH", help="Grey range of the sheet, where the volume shows other material beside it."
    )
    seed_um: tuple[float, float, float] | None = option(
        None, metavar="Z,Y,X",
        help="A point inside the sheet, where there are several sheets or layers; with --sheet-grey, the part of that "
        "grey range that holds the point.",
    )  # fmt: skip
    coating_grey: float | None = option(
        None, metavar="GREY", help="Grey of the coating; needed where it is nowhere thicker than half the blur."
    )
    fringe: Fringe = option(
        "auto", metavar="auto|off|SIZE",
        help="Phase-contrast fringe beside every edge: learnt, none, or its size as a share of the edge's step.",
    )  # fmt: skip
    envelope_um: float | None = option(
        None, gt=0, help="Radius of a ball that rolls over both faces (50 to 250): loose fibres do not lift envelopes."
    )
    method: Literal["profile", "paper"] = option(
        "profile", cli="--surface-method",
        help="profile: fit the grey profile of every column; paper: slice by slice as Hirn et al. (2009).",
    )  # fmt: skip
    labels: LabelParams | None = option(
        None, cli="--labels",
        help="The volume holds labels of another program: 0 air, 1 base, 2 coating where not given otherwise.",
    )  # fmt: skip
    corrections: str | None = option(
        None, metavar="FILE", help="Corrections of the faces: JSON with points that they are drawn to."
    )
    cutoff_um: float = option(400.0, gt=0, help="Wavelength of the centre surface that its smoothing passes by half.")
    rim_um: float = option(100.0, ge=0, help="Zone around holes and gaps that is left out of all results.")
