"""The formats of an export: one entry in one table, and the module that writes it.

A module holds the function ``write(content, path, history, params)``. What it gets depends on what is written:

======== ======================================= ==============================================================
Holds    Content                                 From
======== ======================================= ==============================================================
maps     :class:`~planish.writers.content.Maps`  a group of maps on one grid, or of surfaces
volume   ``DataArray (z, y, x)``                 the straightened volume
surface  :class:`~planish.writers.mesh.Surface`  one surface with the maps that it carries
moves    :class:`~planish.writers.field.Moves`   a registration in both directions
marks    --                                      a registration's marks; ``planish.marks.files`` writes them
run      --                                      a run folder
======== ======================================= ==============================================================

``check(content, params)``, where a module has it, refuses before work what the format does not hold. ``path`` is new,
and stays hidden until it is whole. The same content gives the same bytes.
"""

from __future__ import annotations

import importlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from planish.core.errors import FileError, InputError

Holds = Literal["maps", "volume", "surface", "moves", "marks", "run"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """A format of an export.

    Attributes
    ----------
    title : str
        Its name in messages and documents.
    module : str
        Of this package; empty where another package writes it.
    holds : tuple of str
        What it can hold; the first is what is meant where nothing else is asked for.
    suffixes : tuple of str
        Ends of the names of its files, the usual one first. None: it is always a folder.
    stack : bool
        Whether one file holds several maps.
    apart : bool
        Whether a folder gets a file for each map; otherwise one for all of them.
    gives, opens, missing : str
        For the documents: what is written, programs that open it, and how a missing value is written.
    most : int or None
        Largest map in pixels, or surface in nodes, where all of it is held in memory; None: it is written part by part.
    byte_cost : int
        Bytes of memory that a pixel or node of such a map takes.
    needs : str or None
        Library of the extra ``export``.
    options : tuple of str
        Options of :class:`~planish.writers.params.ExportParams` that mean something for it alone.
    note : str
        What has to be known when the files are used.
    """

    title: str
    module: str
    holds: tuple[Holds, ...]
    suffixes: tuple[str, ...]
    stack: bool = False
    apart: bool = True
    gives: str
    opens: str
    missing: str
    most: int | None = None
    byte_cost: int = 0
    needs: str | None = None
    options: tuple[str, ...] = ()
    note: str = ""


_ENDING = re.compile(r"\.[A-Za-z][A-Za-z0-9]{0,4}")  # of a file; a folder may be called run.2

_BOTH = (
    "SOURCE_to_TARGET takes points of SOURCE to TARGET, x and y of planish; programs take the same file to resample an "
    "image of TARGET onto SOURCE."
)

_MESH = ("mesh_um", "as_seen")

FORMATS: dict[str, Format] = {
    "tiff": Format(
        title="TIFF", module="tiff_maps", holds=("maps", "volume"), suffixes=(".tif", ".tiff"), stack=True,
        gives="32-bit maps with pixel size in um; several in one file as channels with names; history under Show Info",
        opens="ImageJ, Fiji", missing="NaN",
    ),
    "ome-tiff": Format(
        title="OME-TIFF", module="tiff_maps", holds=("maps", "volume"), suffixes=(".ome.tif", ".ome.tiff"), stack=True,
        gives="the same with OME metadata: pixel size, place of the first pixel, names of channels",
        opens="Fiji (Bio-Formats), QuPath", missing="NaN",
    ),
    "ome-zarr": Format(
        title="OME-Zarr", module="ome_zarr", holds=("maps", "volume"), suffixes=(".ome.zarr", ".zarr"), stack=True,
        gives="OME-Zarr 0.5 with overviews, each half as fine; size and place in um",
        opens="napari, MoBIE", missing="NaN",
    ),
    "netcdf": Format(
        title="NetCDF", module="netcdf", holds=("maps",), suffixes=(".nc",), stack=True, needs="h5netcdf",
        gives="NetCDF-4 by the CF conventions: maps in their own type, coordinates, units",
        opens="R, Python, MATLAB", missing="NaN as `_FillValue`",
    ),
    "mat": Format(
        title="MATLAB", module="matlab", holds=("maps",), suffixes=(".mat",), stack=True,
        options=("mat_version",),
        gives="a variable for each map, `x_um`, `y_um`, `pixel_um`, `units`, `titles`, `history`; version 5 or 7.3",
        opens="MATLAB, GNU Octave", missing="NaN",
    ),
    "gwy": Format(
        title="Gwyddion", module="gwyddion", holds=("maps",), suffixes=(".gwy",), stack=True, needs="gwyfile",
        gives="a channel for each map, lengths in metres, with its mask; history under Metadata Browser",
        opens="Gwyddion", missing="the mask; below it the mean of the map",
        most=100_000_000, byte_cost=26,
    ),
    "txt": Format(
        title="plain text", module="matrix", holds=("maps",), suffixes=(".txt",),
        gives="one map as a matrix: a line for each row, tabs between; what it is stands in lines with `#`",
        opens="GNU Octave, MATLAB, Origin", missing="`NaN`",
    ),
    "csv": Format(
        title="CSV", module="points", holds=("maps",), suffixes=(".csv",), stack=True, apart=False,
        options=("point_um",),
        gives="a table of points or pixels: place, every map, image, place in the volume, share that is valid",
        opens="GNU Octave, R, Origin, Excel", missing="`NaN`; points that show nothing are left out",
    ),
    "png": Format(
        title="PNG", module="picture", holds=("maps",), suffixes=(".png",),
        gives="a picture with colour bar, axes and scale bar, at most 2000 pixels of the map across",
        opens="anything", missing="grey",
    ),
    "svg": Format(
        title="SVG", module="picture", holds=("maps",), suffixes=(".svg",),
        gives="the same picture to edit: lines and text stay lines and text",
        opens="browsers, Inkscape", missing="grey",
    ),
    "ply": Format(
        title="PLY", module="ply", holds=("surface",), suffixes=(".ply",),
        options=_MESH,
        gives="a surface in um with all maps as properties of its nodes, one as colour",
        opens="MeshLab, CloudCompare, ParaView (colour only)", missing="NaN, coloured grey; holes stay holes",
        most=25_000_000, byte_cost=250,
    ),
    "obj": Format(
        title="OBJ", module="obj", holds=("surface",), suffixes=(".obj",),
        options=_MESH,
        gives="a surface in um as text, one map as colour of its nodes",
        opens="MeshLab, Blender", missing="coloured grey; holes stay holes", most=10_000_000, byte_cost=400,
    ),
    "stl": Format(
        title="STL", module="stl", holds=("surface",), suffixes=(".stl",),
        options=_MESH,
        gives="a surface in um as triangles, one map as their colour (15 bits)",
        opens="MeshLab, CAD, simulation", missing="coloured grey; holes stay holes",
        most=10_000_000, byte_cost=450,
    ),
    "vtk": Format(
        title="VTK", module="vtu", holds=("surface",), suffixes=(".vtu",),
        options=_MESH,
        gives="a surface in um with all maps as point data",
        opens="ParaView", missing="NaN; holes stay holes", most=25_000_000, byte_cost=350,
    ),
    "itk": Format(
        title="ITK", module="itk", holds=("moves",), suffixes=(".tfm",),
        options=("unit",),
        gives="the registration as a transform, in both directions",
        opens="ITK, SimpleITK", missing="–", note=_BOTH,
    ),
    "elastix": Format(
        title="elastix", module="elastix", holds=("moves",), suffixes=(),
        options=("unit",),
        gives="the registration as transform parameters, in both directions",
        opens="elastix, transformix", missing="–",
        note=f"{_BOTH} Start transformix in the folder: it looks for NAME_local.txt where it was started.",
    ),
    "bigwarp": Format(
        title="BigWarp", module="", holds=("marks",), suffixes=(".csv",),
        gives="the marks as landmarks, from the centres of the first pixels",
        opens="BigWarp in Fiji", missing="–",
        note="Moving is the map of the sheet, target the image, in um as Fiji has them. BigWarp's spline passes "
        "through the marks; that of planish leaves the residuals in marks.csv.",
    ),
    "nrrd": Format(
        title="NRRD", module="nrrd_files", holds=("moves", "maps"), suffixes=(".nrrd",),
        options=("unit",),
        gives="the registration as displacement fields; with a group, its maps with size and place",
        opens="ITK, SimpleITK, elastix", missing="NaN",
        note="Of a registration: beside a field other programs take 0, so nothing moves there.",
    ),
    "zarr": Format(
        title="zarr", module="field_zarr", holds=("moves",), suffixes=(".zarr",),
        gives="the registration as displacement fields to read with xarray", opens="Python", missing="–",
    ),
    "crate": Format(
        title="RO-Crate", module="crate", holds=("run",), suffixes=(), needs="rocrate",
        gives="the whole run with `ro-crate-metadata.json`: what was made by which program from which files",
        opens="archives for research data", missing="as in the run",
    ),
}  # fmt: skip
"""In the order of the documents."""


def writer_of(name: str) -> Any:
    """Import the module of a format.

    Raises
    ------
    InputError
        If it needs a library that is not installed.
    """
    form = FORMATS[name]
    if form.needs is not None:
        try:
            importlib.import_module(form.needs)
        except ImportError as error:
            raise InputError(
                f"{form.title} needs the library {form.needs}, which is not installed. Run: pip install "
                '"planish[export]"'
            ) from error
    return importlib.import_module(f"planish.writers.{form.module}")


def is_file(name: str, out: Path) -> bool:
    """Whether a path asks for one file of a format; otherwise it is a folder of such files.

    Raises
    ------
    FileError
        If it ends as files of another format do, or any file.
    """
    form, low = FORMATS[name], out.name.lower()
    known = [(end, other) for other, one in FORMATS.items() for end in one.suffixes if low.endswith(end)]
    longest = max((len(end) for end, _ in known), default=0)
    meant = [other for end, other in known if len(end) == longest]
    if name in meant:
        return True
    if not meant and not _ENDING.fullmatch(out.suffix):
        return False
    ends = f"a name that ends in {' or '.join(form.suffixes)}, or " if form.suffixes else ""
    whose = f"ends as {FORMATS[meant[0]].title} does (--to {meant[0]})" if meant else f"has the ending {out.suffix}"
    raise FileError(f"{out.name} {whose}, and --to says {name}. Give {ends}a folder without an ending.")


def formats_table() -> str:
    """Write the table of ``docs/export.md``."""
    head = ("Format", "PATH ends in", "Gives", "Opens in", "Missing values", "Largest")
    rows: list[tuple[str, ...]] = [head, ("---",) * len(head)]
    for name, form in FORMATS.items():
        ends = " ".join(f"`{end}`" for end in form.suffixes) or "(always a folder)"
        largest = "any" if form.most is None else f"{form.most / 1e6:.0f} million {_counted(form)}"
        rows.append((f"`{name}`", ends, form.gives, form.opens, form.missing, largest))
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _counted(form: Format) -> str:
    return "nodes" if form.holds[0] == "surface" else "pixels"
