"""Options of an export."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from planish.core.options import Params, option
from planish.exports.formats import FORMATS, formats_with

if TYPE_CHECKING:
    FormatName = str
else:
    FormatName = Literal[tuple(FORMATS)]

Length = Annotated[float, Field(ge=0)]


class ExportParams(Params):
    """Options of an export."""

    to: FormatName = option(help="Format to write (docs/export.md).")
    maps: tuple[str, ...] = option(
        (), cli="--map", metavar="NAME",
        help="Map to write; may be given again; all where not given. Of surfaces: a surface, or a map that it carries.",
    )  # fmt: skip
    group: str | None = option(
        None, metavar="GROUP",
        help="What of the run: linked, maps, surfaces, layers/NAME, or straightened, the volume along the normals. "
        "Linked maps where there are any, otherwise maps; for a registration the name of its layer.",
    )  # fmt: skip
    point_um: Length | None = option(
        None, metavar="UM",
        help=f"{formats_with('point_um')}: edge of a point in um, 0 for every pixel; that of the run's correlations "
        "where not given.",
    )  # fmt: skip
    mesh_um: float | None = option(
        None, gt=0, help=f"{formats_with('mesh_um')}: distance of nodes in um; every measured column where not given."
    )
    as_seen: bool = option(
        False,
        help=f"{formats_with('as_seen')}: turn y around, so that programs whose y runs upwards show the sheet as "
        "the maps do and not its mirror image. Otherwise places are those of the volume.",
    )  # fmt: skip
    depth_um: tuple[float, float] | None = option(
        None, metavar="LOW,HIGH",
        help="straightened: from where to where along the normals, in um from the centre surface, up to the top; from "
        "below the lowest to above the highest face where not given.",
    )  # fmt: skip
    unit: Literal["um", "mm"] = option(
        "um", help=f"{formats_with('unit')}: unit of the images as the other program has them."
    )
    mat_version: Literal["5", "7.3"] | None = option(
        None,
        help=f"{formats_with('mat_version')}: 5 holds less than 2 GB, 7.3 has no limit; 5 up to 200 MB where not "
        "given.",
    )
