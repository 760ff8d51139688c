"""Commands of one stage each, from files to files.

One after the other they give the bytes of ``planish link``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planish.analyze.params import CorrelateParams
from planish.cli.console import shown
from planish.cli.options import (
    PATH,
    Option,
    build_params,
    existing,
    figures_option,
    json_option,
    options,
    out_option,
    verb,
)
from planish.cli.runs import (
    compute_options,
    hole_options,
    image_options,
    image_params,
    image_size_options,
    property_options,
    surface_options,
    volume_options,
)
from planish.core.typing import Entries, Texts
from planish.flatten.params import FlattenParams
from planish.io.params import ImageParams, VolumeParams
from planish.marks.params import HoleParams
from planish.measure.params import MeasureParams
from planish.register.params import RegistrationParams
from planish.run.compute import Compute, silent
from planish.surface.params import SurfaceParams

if TYPE_CHECKING:
    import xarray as xr

_VOLUME = "volume"
"""Attribute of a store of surfaces: the volume that they were found in."""

_STORE = "Zarr store to make; it must not exist."
_ONE_FILE: Entries = {"type": PATH, "cls": Option}


def _write(out: Path, groups: dict[str, xr.Dataset], summary: str) -> None:
    from planish.io.map_groups import write_tree
    from planish.io.run_folder import new_folder

    with new_folder(out) as folder:
        write_tree(folder, groups)
    click.echo(f"{out}: {summary}")


def _read(path: Path, group: str, command: str) -> xr.Dataset:
    """Read one group of a store, or of the maps.zarr in a run folder."""
    from planish.core.errors import FileError
    from planish.io.map_groups import open_tree

    groups = open_tree(path / "maps.zarr" if (path / "maps.zarr").is_dir() else path)
    if group not in groups:
        raise FileError(
            f"{path} has no {group}; it holds {', '.join(sorted(groups))}. Give what {command}"
            " wrote."
        )
    return groups[group]


def _volume(
    path: Path, values: Entries, **store_params: Any
) -> tuple[xr.DataArray, VolumeParams, Compute]:
    """A volume of any kind, how it lies, and what may be used.

    ``store_params`` is what a store says of it.
    """
    from planish.run.volume import read_sheet_volume

    params = build_params(VolumeParams, values, **store_params | {"path": str(path.absolute())})
    compute = build_params(Compute, values)
    return read_sheet_volume(params, compute, silent)[0], params, compute


def _image(
    path: Path, values: Entries, *, is_compared: bool = False
) -> tuple[xr.DataArray, ImageParams]:
    from planish.io.light import read_corrected
    from planish.io.sizes import PIXEL, with_advice

    params = image_params(path, values)
    image, corrected = read_corrected(params)
    if "size_doubt" in image.attrs:
        doubt_text = with_advice(image.attrs["size_doubt"], PIXEL)
        click.echo(f"look: {shown(doubt_text)}", err=True)
    if is_compared and corrected is not None:
        image = corrected.valid
    return image, params


def _maps_or_image(path: Path, values: Entries) -> xr.Dataset | xr.DataArray:
    if path.is_dir():
        return _read(path, "maps", "'planish resample'")
    return _image(path, values)[0]


@verb(
    "planish surface volume.tif -o surfaces.zarr",
    "planish surface scan/ -o s.zarr --through y --voxel-um 1.37",
)
@existing("volume")
@out_option(_STORE)
@volume_options
@surface_options
@compute_options
def surface(volume: Path, out: Path, **values: Any) -> None:
    """Find the faces, interfaces and centre surface of the sheet in VOLUME."""
    from planish.run.sheet import search_sheet
    from planish.run.study import GivenLayer

    data, params, compute = _volume(volume, values)
    layer = GivenLayer(name="sheet", volume=params, surface=build_params(SurfaceParams, values))
    surfaces = search_sheet(data, layer, compute=compute)
    share = float((surfaces["status"].values == 0).mean())
    summary = (
        f"sheet of {surfaces.attrs['thickness_um']:.2f} um, {100 * share:.0f} % of the columns"
        " measured"
    )
    # 'planish measure' finds the grey values again.
    surfaces = surfaces.assign_attrs({_VOLUME: params.model_dump_json(exclude_none=True)})
    _write(out, {"surfaces": surfaces}, summary)


@verb(
    "planish measure surfaces.zarr -o measured.zarr",
    "planish measure surfaces.zarr -o measured.zarr --property porosity --solid-grey 180",
)
@existing("surfaces")
@out_option(_STORE)
@click.option("--volume", "path", help="Volume of the surfaces, if it was moved.", **_ONE_FILE)
@volume_options
@property_options
@compute_options
def measure(surfaces: Path, out: Path, path: Path | None, **values: Any) -> None:
    """Measure all properties along the normals of SURFACES."""
    from planish.core.errors import FileError
    from planish.io import find_place
    from planish.measure import measure_properties

    data = _read(surfaces, "surfaces", "'planish surface'")
    store_params = json.loads(data.attrs.pop(_VOLUME, "{}"))
    if path is None and store_params:
        path = Path(store_params.pop("path"))
        if not find_place(path).path.exists():
            raise FileError(
                f"The volume of {surfaces}, {path}, is not there any more. Give its place with"
                " --volume."
            )
    volume = None
    if path is not None:
        volume = _volume(path, values, **store_params)[0]
    measured = measure_properties(data, volume=volume, params=build_params(MeasureParams, values))
    mean = float(measured["thickness"].mean())
    _write(out, {"surfaces": measured}, f"mean thickness {mean:.2f} um along the normals")


@verb(
    "planish flatten surfaces.zarr -o flat.zarr",
    "planish flatten surfaces.zarr -o flat.zarr --method relaxation",
)
@existing("surfaces")
@out_option(_STORE)
@options(FlattenParams, "Flattening", without=("map_um",))
def flatten(surfaces: Path, out: Path, **values: Any) -> int:
    """Develop the centre surface of SURFACES into the plane."""
    from planish.flatten import flatten_sheet

    flattened = flatten_sheet(
        _read(surfaces, "surfaces", "'planish surface'"), params=build_params(FlattenParams, values)
    )
    q = flattened.quality
    summary = (
        f"{q.sentence} Edge strain {100 * (q.edge_strain_p95 or 0):.3f} % (p95), {q.folded_cells}"
        " folded cells"
    )
    _write(out, {"flat": flattened.flat, "strain": flattened.strain}, summary)
    return 4 if q.folded_cells else 0


@verb(
    "planish resample measured.zarr flat.zarr -o maps.zarr",
    "planish resample measured.zarr flat.zarr -o linked.zarr --onto image.tif --registration"
    " marks.json",
)
@existing("measured")
@existing("flat")
@out_option(_STORE)
@options(FlattenParams, "Flattening", only=("map_um",))
@click.option(
    "--onto",
    "reference",
    help="Image whose pixels the maps are brought onto; needs --registration.",
    **_ONE_FILE,
)
@click.option("--registration", help="marks.json of 'planish register' or of a run.", **_ONE_FILE)
@image_options
@image_size_options
def resample(
    measured: Path,
    flat: Path,
    out: Path,
    reference: Path | None,
    registration: Path | None,
    **values: Any,
) -> None:
    """Bring MEASURED properties onto a regular grid of the FLAT sheet or the pixels of an image."""
    from planish.analyze.image_values import compared_image
    from planish.run import Registration, resample_maps

    if (reference is None) != (registration is None):
        raise click.UsageError(
            "--onto and --registration belong together: give both, or neither for flat maps."
        )
    data = _read(measured, "surfaces", "'planish measure'")
    coordinates = _read(flat, "flat", "'planish flatten'")
    map_um = build_params(FlattenParams, values).map_um
    if reference is None or registration is None:
        maps = resample_maps(data, coordinates, map_um=map_um)
        _write(out, {"maps": maps}, f"{maps.sizes['u']} x {maps.sizes['v']} pixels")
        return
    image = compared_image(*_image(reference, values, is_compared=True))
    linked = resample_maps(
        data, coordinates, onto=image, registration=Registration.read(registration)
    )
    share_text = f"{100 * float(linked['valid'].values.mean()):.0f} % valid"
    summary = f"{linked.sizes['x']} x {linked.sizes['y']} pixels, {share_text}"
    _write(out, {"linked": linked}, summary)


@verb(
    "planish holes image.tif -o image-holes.json",
    "planish holes maps.zarr -o sheet-holes.json --image-side bottom",
)
@existing("image")
@out_option("JSON file to make; a table for reading, .csv, is made beside it.")
@options(ImageParams, "Image", without=("dark_grey", "white_grey", "screen_um"))
@image_size_options
@hole_options
def holes(image: Path, out: Path, **values: Any) -> None:
    """Find the laser holes in IMAGE: a picture, or the flat maps of a sheet."""
    from planish.checks import check_holes
    from planish.io.run_folder import refuse_existing
    from planish.marks import write_holes
    from planish.run import find_holes

    files = (out,)
    if out.suffix.lower() != ".csv":
        files = (out, out.with_suffix(".csv"))
    refuse_existing(*files)
    side = build_params(ImageParams, values, path=str(image)).side or "top"
    picture = _maps_or_image(image, values)
    detected = find_holes(picture, params=build_params(HoleParams, values), side=side)
    for path in files:
        write_holes(detected, path)
    click.echo(f"{out}: {check_holes(detected).sentence}")


@verb(
    "planish register sheet-holes.json image-holes.json -o marks.json",
    "planish register sheet-holes.json image-holes.json -o marks.json --model affine",
    "planish register maps.zarr image.tif -o marks.json --by texture",
)
@existing("moving")
@existing("fixed")
@out_option("JSON file to make; a table of the pairs, .csv, is made beside it.")
@options(RegistrationParams, "Marks and registration", without=("marks", "refine"))
@options(ImageParams, "Image", without=("dark_grey", "white_grey", "screen_um"))
@image_size_options
def register(moving: Path, fixed: Path, out: Path, **values: Any) -> None:
    """Match the holes in MOVING and FIXED and fit the transformation.

    MOVING and FIXED are two files of 'planish holes'.

    With --by texture they are flat maps or images, and no hole is needed.
    """
    from planish.io.run_folder import refuse_existing
    from planish.marks import read_holes, write_marks
    from planish.run import register_marks, register_texture

    table = out.with_suffix(".csv")
    if out == table:
        raise click.UsageError(
            f"{out} is the name of the table, which is made beside the registration: give -o"
            f" {out.with_suffix('.json')}."
        )
    params = build_params(RegistrationParams, values)
    refuse_existing(table)
    if params.by == "both":
        raise click.UsageError(
            "--by both needs maps and holes in one: use planish link. Give --by holes or texture"
            " here."
        )
    if params.by == "texture":
        layers = [_maps_or_image(path, values) for path in (moving, fixed)]
        side = build_params(ImageParams, values, path=str(fixed)).side
        # Of a sheet and an image whose side is not given, both hands are tried.
        is_of_sheet = moving.is_dir() != fixed.is_dir()
        is_mirrored = None if is_of_sheet and side is None else side == "bottom"
        registration = register_texture(layers[0], layers[1], params=params, mirrored=is_mirrored)
    else:  # holes, and auto: files of holes show no texture
        registration = register_marks(read_holes(moving), read_holes(fixed), params=params)
    registration.save(out)
    write_marks(registration.pairs(), table)
    fit = registration.fit
    sentences = (registration.sentence, registration.design, fit.sentence)
    for sentence in filter(None, (*sentences, registration.agreement(), *fit.warnings)):
        click.echo(shown(sentence))
    click.echo(
        f"{out}: {len(fit.moving)} pairs, residual {fit.rms_um:.2f} um rms, scale"
        f" {fit.transform.scale:.4f}"
    )


@verb("planish correlate linked.zarr", "planish correlate run --property base_thickness --json")
@existing("linked")
@click.option(
    "--property",
    "names",
    multiple=True,
    metavar="NAME",
    help="Maps to compare; default: all.",
)
@options(CorrelateParams, "Correlation", only=("point_um", "regions"))
@json_option
def correlate(linked: Path, names: Texts, as_json: bool, **values: Any) -> int:
    """Correlate the image with the properties, point by point, in LINKED maps.

    Of a run, rows that a check makes doubtful are marked, and those that a failed check concerns
    are withheld.
    """
    from planish.checks import rows_with_trust
    from planish.cli.show import correlations, exit_code
    from planish.core.errors import InputError
    from planish.run import correlate_maps
    from planish.run.run import is_run, open_results

    data = _read(linked, "linked", "'planish resample --onto' or 'planish link'")
    for name in names:
        if name not in data:
            maps = ", ".join(map(str, data.data_vars))
            raise InputError(f"{linked} has no map {name!r}; it holds {maps}.")
    correlated = correlate_maps(data, params=build_params(CorrelateParams, values))
    code = 0
    if is_run(linked):
        results = open_results(linked)
        correlated = rows_with_trust(correlated, results.checks)
        code = exit_code(results)
    rows = [row for row in correlated if not names or row.a_map in names]
    if as_json:
        click.echo(json.dumps([row.model_dump() for row in rows], indent=2))
        return code
    correlations("Image against properties", [(row.a_map, row) for row in rows])
    return code


@verb("planish report run --out page.html", "planish report run --out pages/page.html --figures")
@existing("run")
@out_option("HTML file to make; it must not exist.")
@figures_option
def report(run: Path, out: Path, figures: bool) -> None:
    """Write the report of a RUN folder anew."""
    from planish.report import FIGURES, write_report
    from planish.run import open_run

    figures_folder = out.absolute().with_name(FIGURES) if figures else None
    write_report(out, open_run(run), figures=figures_folder)
    click.echo(str(out))
