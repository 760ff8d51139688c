"""The formats of an export: a row of one table each, and the function that writes it.

A row names its function as ``module:function`` of this package: ``function(content, path, history,
params)``. The content is what the format holds: :class:`~planish.exports.content.Maps`, a volume
(z, y, x), a :class:`~planish.exports.meshes.Surface`, a
:class:`~planish.exports.transforms.DirectedTransform` (where one file holds both directions,
``TransformPair``), marks (mark), or the folder of a run. ``path`` is new, and stays hidden until it
is whole. The same content gives the same bytes.
"""

import importlib
import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from planish.core.errors import FileError, InputError
from planish.core.options import Names, Params, option
from planish.core.plugins import find_plugin, plugins
from planish.core.typing import Pair, Texts

Holds = Literal["maps", "volume", "surface", "registration", "marks", "run"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportFormat:
    """A format of an export."""

    title: str  #: its name in messages and documents
    #: ``module:function`` of this package; of another one the function itself.
    writer: str | Callable[..., None]
    #: the first is what is meant where nothing else is asked for.
    holds: tuple[Holds, ...] = ("maps",)
    #: ends of the names of its files, the usual one first; none: it is always a folder.
    suffixes: Texts
    #: of files of a registration; those after the first only if not affine.
    endings: Texts = ()
    is_folder: bool = False  #: whether what has such a name is a folder
    stack: bool = False  #: whether one file holds several maps
    apart: bool = True  #: whether a folder gets a file for each map, or direction, not one for all
    shows_limits: bool = False  #: whether its file says between which limits a map is shown first
    gives: str  #: for the documents: what is written
    opens: str  #: for the documents: programs that open it
    missing: str = "NaN"  #: for the documents: how a missing value is written
    most: int | None = None  #: most pixels or nodes held in memory; None: written part by part
    byte_cost: int = 0  #: bytes of memory that a pixel or node of such a map takes
    needs: str | None = None  #: library of the extra ``export``
    #: those of :class:`ExportParams` that are for some formats, and for this.
    options: Texts = ()
    note: str = ""  #: what has to be known when the files are used

    @property
    def counts(self) -> str:
        """Word for the parts that its size is counted in: nodes of a surface, or pixels."""
        if "surface" in self.holds:
            return "nodes"
        return "pixels"

    def endings_of(self, *, affine: bool) -> Texts:
        """Ends of the files of one direction of a registration."""
        endings = self.endings or self.suffixes[:1]
        if affine:
            return endings[:1]
        return endings


_BOTH = (
    "SOURCE_to_TARGET takes points of SOURCE to TARGET, x and y of planish; programs take the same"
    " file to resample an image of TARGET onto SOURCE."
)

_MESH = ("mesh_um", "as_seen")
FORMATS: dict[str, ExportFormat] = {
    "tiff": ExportFormat(
        title="TIFF",
        writer="tiff:write_imagej",
        holds=("maps", "volume"),
        suffixes=(".tif", ".tiff"),
        stack=True,
        shows_limits=True,
        gives=(
            "32-bit maps with pixel size in um; several in one file as channels with names; history"
            " under Show Info"
        ),
        opens="ImageJ, Fiji",
    ),
    "ome-tiff": ExportFormat(
        title="OME-TIFF",
        writer="tiff:write_ome",
        holds=("maps", "volume"),
        suffixes=(".ome.tif", ".ome.tiff"),
        stack=True,
        gives="the same with OME metadata: pixel size, place of the first pixel, names of channels",
        opens="Fiji (Bio-Formats), QuPath",
    ),
    "ome-zarr": ExportFormat(
        title="OME-Zarr",
        writer="ome_zarr:write",
        holds=("maps", "volume"),
        suffixes=(".ome.zarr", ".zarr"),
        is_folder=True,
        stack=True,
        gives="OME-Zarr 0.5 with overviews, each half as fine; size and place in um",
        opens="napari, MoBIE",
    ),
    "netcdf": ExportFormat(
        title="NetCDF",
        writer="extras:write_netcdf",
        suffixes=(".nc",),
        stack=True,
        needs="h5netcdf",
        gives="NetCDF-4 by the CF conventions: maps in their own type, coordinates, units",
        opens="R, Python, MATLAB",
        missing="NaN as `_FillValue`",
    ),
    "mat": ExportFormat(
        title="MATLAB",
        writer="matlab:write",
        suffixes=(".mat",),
        stack=True,
        options=("mat_version",),
        gives=(
            "a variable for each map, `x_um`, `y_um`, `pixel_um`, `units`, `titles`, `history`;"
            " version 5 or 7.3"
        ),
        opens="MATLAB, GNU Octave",
    ),
    "gwy": ExportFormat(
        title="Gwyddion",
        writer="extras:write_gwyddion",
        suffixes=(".gwy",),
        stack=True,
        needs="gwyfile",
        gives=(
            "a channel for each map, lengths in metres, with its mask; history under Metadata"
            " Browser"
        ),
        opens="Gwyddion",
        missing="the mask; below it the mean of the map",
        most=100_000_000,
        byte_cost=26,
    ),
    "txt": ExportFormat(
        title="plain text",
        writer="tables:write_matrix",
        suffixes=(".txt",),
        gives=(
            "one map as a matrix: a line for each row, tabs between; what it is stands in lines"
            " with `#`"
        ),
        opens="GNU Octave, MATLAB, Origin",
        missing="`NaN`",
    ),
    "csv": ExportFormat(
        title="CSV",
        writer="tables:write_points",
        suffixes=(".csv",),
        stack=True,
        apart=False,
        options=("point_um",),
        gives=(
            "a table of points or pixels: place, every map, image, place in the volume, share that"
            " is valid"
        ),
        opens="GNU Octave, R, Origin, Excel",
        missing="`NaN`; points that show nothing are left out",
    ),
    "png": ExportFormat(
        title="PNG",
        writer="picture:write",
        suffixes=(".png",),
        shows_limits=True,
        gives=(
            "a picture with colour bar, axes and scale bar, at most 2000 pixels of the map across"
        ),
        opens="anything",
        missing="grey",
    ),
    "svg": ExportFormat(
        title="SVG",
        writer="picture:write",
        suffixes=(".svg",),
        shows_limits=True,
        gives="the same picture to edit: lines and text stay lines and text",
        opens="browsers, Inkscape",
        missing="grey",
    ),
    "ply": ExportFormat(
        title="PLY",
        writer="meshes:write_ply",
        holds=("surface",),
        suffixes=(".ply",),
        options=_MESH,
        gives="a surface in um with all maps as properties of its nodes, one as colour",
        opens="MeshLab, CloudCompare, ParaView (colour only)",
        missing="NaN, coloured grey; holes stay holes",
        most=25_000_000,
        byte_cost=250,
    ),
    "obj": ExportFormat(
        title="OBJ",
        writer="meshes:write_obj",
        holds=("surface",),
        suffixes=(".obj",),
        options=_MESH,
        gives="a surface in um as text, one map as colour of its nodes",
        opens="MeshLab, Blender",
        missing="coloured grey; holes stay holes",
        most=10_000_000,
        byte_cost=400,
    ),
    "stl": ExportFormat(
        title="STL",
        writer="meshes:write_stl",
        holds=("surface",),
        suffixes=(".stl",),
        options=_MESH,
        gives="a surface in um as triangles, one map as their colour (15 bits)",
        opens="MeshLab, CAD, simulation",
        missing="coloured grey; holes stay holes",
        most=10_000_000,
        byte_cost=450,
    ),
    "vtk": ExportFormat(
        title="VTK",
        writer="meshes:write_vtu",
        holds=("surface",),
        suffixes=(".vtu",),
        options=_MESH,
        gives="a surface in um with all maps as point data",
        opens="ParaView",
        missing="NaN; holes stay holes",
        most=25_000_000,
        byte_cost=350,
    ),
    "itk": ExportFormat(
        title="ITK",
        writer="transforms:write_itk",
        holds=("registration",),
        suffixes=(".tfm",),
        options=("unit",),
        gives="the registration as a transform, in both directions",
        opens="ITK, SimpleITK",
        missing="–",
        note=_BOTH,
    ),
    "elastix": ExportFormat(
        title="elastix",
        writer="transforms:write_elastix",
        holds=("registration",),
        suffixes=(),
        endings=(".txt", "_local.txt"),
        options=("unit",),
        gives="the registration as transform parameters, in both directions",
        opens="elastix, transformix",
        missing="–",
        note=(
            f"{_BOTH} Start transformix in the folder: it looks for NAME_local.txt where it was"
            " started."
        ),
    ),
    "bigwarp": ExportFormat(
        title="BigWarp",
        writer="transforms:write_landmarks",
        holds=("marks",),
        suffixes=(".csv",),
        gives="the marks as landmarks, from the centres of the first pixels",
        opens="BigWarp in Fiji",
        missing="–",
        note=(
            "Moving is the map of the sheet, target the image, in um as Fiji has them. BigWarp's"
            " spline passes through the marks; that of planish leaves the residuals in marks.csv."
        ),
    ),
    "nrrd": ExportFormat(
        title="NRRD",
        writer="transforms:write_nrrd",
        holds=("registration", "maps"),
        suffixes=(".nrrd",),
        options=("unit",),
        gives="the registration as displacement fields; with a group, its maps with size and place",
        opens="ITK, SimpleITK, elastix",
        note="Of a registration: beside a field other programs take 0, so nothing moves there.",
    ),
    "zarr": ExportFormat(
        title="zarr",
        writer="transforms:write_zarr",
        holds=("registration",),
        suffixes=(".zarr",),
        is_folder=True,
        apart=False,
        gives="the registration as displacement fields to read with xarray",
        opens="Python",
        missing="–",
    ),
    "crate": ExportFormat(
        title="RO-Crate",
        writer="extras:write_crate",
        holds=("run",),
        suffixes=(),
        is_folder=True,
        needs="rocrate",
        gives=(
            "the whole run with `ro-crate-metadata.json`: what was made by which program from which"
            " files"
        ),
        opens="archives for research data",
        missing="as in the run",
    ),
}
"""In the order of the documents."""


def formats_with(option: str) -> str:
    """Name the formats that an option is for."""
    return ", ".join(name for name, form in FORMATS.items() if option in form.options)


def find_format(name: str) -> ExportFormat:
    """Row of a format; that of another package is added to the table when it is first asked for."""
    if name not in FORMATS and (plugin := find_plugin("export", name)):
        FORMATS[name] = plugin.load(ExportFormat)
    return FORMATS[name]


def writer_of(name: str) -> Callable[..., Any]:
    """Import the function that writes a format.

    InputError where it needs a library that is not installed.
    """
    form = find_format(name)
    if form.needs is not None:
        try:
            importlib.import_module(form.needs)
        except ImportError as error:
            raise InputError(
                f"{form.title} needs the library {form.needs}, which is not installed. Run: pip"
                ' install "planish[export]"'
            ) from error
    if not isinstance(form.writer, str):
        return form.writer
    module, _, function = form.writer.partition(":")
    return getattr(importlib.import_module(f"planish.exports.{module}"), function)


def is_file(name: str, out: Path) -> bool:
    """Tell whether a path asks for one file of a format and no folder.

    FileError where it ends as other files do.
    """
    form = find_format(name)
    low = out.name.lower()
    known_suffixes = chain.from_iterable(row.suffixes for row in FORMATS.values())
    # Of .ome.tif and .tif, both of which such a name ends in, the longer one says what is meant.
    longest = max(filter(low.endswith, known_suffixes), key=len, default="")
    if longest:
        meant = [other for other in FORMATS if longest in FORMATS[other].suffixes]
        if name in meant:
            return True
        whose = f"ends as {FORMATS[meant[0]].title} does (`to={meant[0]}`)"
    # a folder may be called run.2.
    elif not re.fullmatch(r"\.[A-Za-z][A-Za-z0-9]{0,4}", out.suffix):
        return False
    else:
        whose = f"has the ending {out.suffix}"
    ends = ""
    if form.suffixes:
        ends = f"a name that ends in {' or '.join(form.suffixes)}, or "
    raise FileError(
        f"{out.name} {whose}, and `to` says {name}. Give {ends}a folder without an ending."
    )


def formats_table() -> str:
    """Write the table of ``docs/export.md``."""
    head = ("Format", "PATH ends in", "Gives", "Opens in", "Missing values", "Largest")
    rows: list[Texts] = [head, ("---",) * len(head)]
    for name, form in FORMATS.items():
        ends = " ".join(f"`{end}`" for end in form.suffixes) or "(always a folder)"
        largest = "any"
        if form.most is not None:
            largest = f"{form.most / 1e6:.0f} million {form.counts}"
        rows.append((f"`{name}`", ends, form.gives, form.opens, form.missing, largest))
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


if TYPE_CHECKING:
    FormatName = str
else:
    FormatName = Literal[tuple({**FORMATS, **{plugin.name: None for plugin in plugins("export")}})]

Length = Annotated[float, Field(ge=0)]


class ExportParams(Params):
    """Options of an export."""

    to: FormatName = option(help="Format to write (docs/export.md).")
    maps: Names = option(
        (),
        cli="--map",
        metavar="NAME",
        help="Map to write, or a surface, or a map that it carries; repeatable; default: all.",
    )
    group: str | None = option(
        None,
        metavar="GROUP",
        help=(
            "Group of the run: linked, maps, surfaces, layers/NAME, or straightened (the volume"
            " along the normals); for a registration, the name of its layer. Default: linked, or"
            " maps if there is no link."
        ),
    )
    point_um: Length | None = option(
        None,
        metavar="UM",
        help=(
            f"{formats_with('point_um')}: edge of a point in um, 0 for every pixel; that of the"
            " run's correlations where not given."
        ),
    )
    mesh_um: float | None = option(
        None,
        gt=0,
        help=(
            f"{formats_with('mesh_um')}: distance of nodes in um; every measured column where not"
            " given."
        ),
    )
    as_seen: bool = option(
        False,
        help=(
            f"{formats_with('as_seen')}: turn y around, so that programs whose y runs upwards show"
            " the sheet as the maps do and not its mirror image. Otherwise places are those of the"
            " volume."
        ),
    )
    depth_um: Pair | None = option(
        None,
        metavar="LOW,HIGH",
        help=(
            "straightened: range along the normals, in um from the centre surface, up to the top;"
            " default: from below the lowest to above the highest face."
        ),
    )
    unit: Literal["um", "mm"] = option(
        "um", help=f"{formats_with('unit')}: unit of the images as the other program has them."
    )
    mat_version: Literal["5", "7.3"] | None = option(
        None,
        help=(
            f"{formats_with('mat_version')}: 5 holds less than 2 GB, 7.3 has no limit; 5 up to 200"
            " MB where not given."
        ),
    )
