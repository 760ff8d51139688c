"""Commands that do one stage: read files, call one function, write files and a line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import numpy as np

from planish.cli.options import (
    SURFACE,
    design_option,
    existing,
    hole_option,
    image_options,
    json_option,
    match_options,
    meaning_of,
    out_option,
    surface_options,
    volume_options,
)

if TYPE_CHECKING:
    import xarray as xr

Method = Literal["multigrid", "relaxation"]
Rest = Literal["arc", "chord"]

_STORE = "Zarr store to make; it must not exist."


def _write(out: Path, groups: dict[str, xr.Dataset], summary: str) -> None:
    from planish.io.run_folder import new_folder, write_tree

    with new_folder(out) as folder:
        write_tree(folder, groups)
    click.echo(f"{out}: {summary}")


def _read(path: Path, group: str) -> xr.Dataset:
    """Read one group of a store, or of the maps.zarr in a run folder."""
    from planish.core.errors import FileError
    from planish.io.run_folder import read_tree

    groups = read_tree(path / "maps.zarr" if (path / "maps.zarr").is_dir() else path)
    if group not in groups:
        raise FileError(
            f"{path} has no group '{group}'; it holds {', '.join(sorted(groups))}. Give what the stage before wrote."
        )
    return groups[group]


def corrected_for_import(
    data: xr.DataArray, out: Path, options: dict[str, Any], *, memory_bytes: int, tell: Callable[[str, str], None]
) -> tuple[xr.DataArray, Callable[[], None]]:
    """Correct a volume on its way into a store as the options say, and say what was done.

    Returns
    -------
    volume : DataArray
        The same one where nothing is asked for.
    write_record : callable
        To be called when the store is whole: writes the record and the figure beside it.
    """
    from planish.core.errors import FileError
    from planish.correct.params import CorrectParams
    from planish.io.run_folder import refuse_existing

    params = CorrectParams(
        rings=options["correct_rings"], cupping=options["correct_cupping"],
        axis=options["rotation_axis"] or "z", centre_um=options["rotation_centre_um"],
    )  # fmt: skip
    if not params.asked:
        if options["rotation_axis"] or options["rotation_centre_um"]:
            raise click.UsageError("--rotation-axis and -centre-um belong to --correct-rings and --correct-cupping.")
        return data, lambda: None
    from planish.correct import correct_volume, write_picture

    record, picture = (out.with_name(f"{out.stem}.corrections.{kind}") for kind in ("json", "png"))
    for path in (record, picture):
        refuse_existing(path)
    found = correct_volume(
        data,
        params=params,
        memory_bytes=memory_bytes,
        tell=lambda what, how_far: tell("correct", f"{what}, {how_far}"),
    )
    for sentence in found.record.sentences:
        click.echo(sentence)
    if found.record.clipped:
        click.echo(f"{100 * found.record.clipped:.2g} % of the voxels left the range of {data.dtype} and were clipped.")

    def write_record() -> None:
        try:
            record.write_text(json.dumps(found.record.to_json(), indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise FileError(f"{record} cannot be written: {error.strerror}. The store itself is whole.") from error
        if found.before is not None:
            write_picture(found, data, picture)

    return found.volume, write_record


@click.command()
@existing("volume")
@out_option(_STORE)
@volume_options
@surface_options
def surface(volume: Path, out: Path, **options: Any) -> None:
    """Find the faces, interfaces and centre surface of the sheet in VOLUME."""
    from planish.core.frame import Frame
    from planish.io import read_volume
    from planish.io.run_folder import refuse_existing
    from planish.surface import SurfaceParams, find_surfaces

    refuse_existing(out)
    data = read_volume(volume, voxel_um=options["voxel_um"], override_size=options["override_size"])
    params = SurfaceParams.model_validate({k: options[k] for k in SURFACE} | {"labels": meaning_of(options)})
    found = find_surfaces(data, frame=Frame(through=options["through"], top=options["top"]), params=params)
    share = float((found["status"].values == 0).mean())
    _write(
        out,
        {"surfaces": found},
        f"sheet of {found.attrs['thickness_um']:.2f} um, {100 * share:.0f} % of the columns measured",
    )


@click.command()
@existing("surfaces")
@out_option(_STORE)
def measure(surfaces: Path, out: Path) -> None:
    """Measure thicknesses and topographies along the normals of SURFACES."""
    from planish.measure import measure_properties

    found = measure_properties(_read(surfaces, "surfaces"))
    thickness = float(np.nanmean(found["thickness"].values))
    _write(out, {"properties": found}, f"mean thickness {thickness:.2f} um along the normals")


@click.command()
@existing("surfaces")
@out_option(_STORE)
@click.option(
    "--mesh-um",
    type=click.FloatRange(min=0, min_open=True),
    help="Pitch of the spring mesh; four columns or more where not given.",
)
@click.option(
    "--method",
    type=click.Choice(["multigrid", "relaxation"]),
    default="multigrid",
    show_default=True,
    help="multigrid: straight to the least spring energy; relaxation: the damped motion of Hirn et al. (2009).",
)
@click.option(
    "--rest",
    type=click.Choice(["arc", "chord"]),
    default="arc",
    show_default=True,
    help="Rest lengths of the springs: along the curved surface, or straight through space as in Hirn et al. (2009).",
)
def flatten(surfaces: Path, out: Path, mesh_um: float | None, method: Method, rest: Rest) -> int:
    """Develop the centre surface of SURFACES into the plane."""
    from planish.flatten import FlattenParams, flatten_sheet

    found = flatten_sheet(_read(surfaces, "surfaces"), params=FlattenParams(mesh_um=mesh_um, method=method, rest=rest))
    summary = (
        f"{found.outcome.value} Edge strain {100 * found.edge_strain_p95:.3f} % (p95), "
        f"{found.folded_cells} folded cells"
    )
    _write(out, {"flat": found.flat, "strain": found.strain}, summary)
    return 4 if found.folded_cells else 0


@click.command()
@existing("properties")
@existing("flat")
@out_option(_STORE)
@click.option(
    "--map-um",
    type=click.FloatRange(min=0, min_open=True),
    help="Pixel of the map; the volume's columns where not given.",
)
def resample(properties: Path, flat: Path, out: Path, map_um: float | None) -> None:
    """Bring PROPERTIES onto a regular grid of the FLAT sheet."""
    from planish.core.checks import check_same_grid
    from planish.core.grid import pitch
    from planish.resample import covering_grid, find_places, resample_dataset

    data, coordinates = _read(properties, "properties"), _read(flat, "flat")
    check_same_grid(data, coordinates)
    rows, cols = pitch(data)
    step = map_um or float(np.sqrt(rows * cols))
    uv = np.stack([coordinates["u"].values, coordinates["v"].values], axis=-1)
    grid = covering_grid(uv, step)
    places = find_places(uv, grid, least_um=min(rows, cols))
    maps = resample_dataset(data, places, dims=("v", "u"), coords={"v": grid.y_um, "u": grid.x_um})
    _write(out, {"maps": maps}, f"{grid.shape[1]} x {grid.shape[0]} pixels of {step:g} um")


@click.command()
@existing("image")
@out_option("CSV table to make; it must not exist.")
@image_options
@hole_option
def holes(
    image: Path, out: Path, pixel_um: tuple[float, float] | None, channel: str, hole_um: tuple[float, float]
) -> None:
    """Find the laser holes in IMAGE: a picture, or a run whose flattened sheet is searched."""
    from planish.core.grid import pitch
    from planish.io import read_image
    from planish.io.run_folder import refuse_existing
    from planish.marks import find_holes, write_holes

    refuse_existing(out)
    if image.is_dir():
        maps = _read(image, "maps")
        u, v = maps["u"].values, maps["v"].values
        found = find_holes(maps["presence"].values, pixel_um=pitch(maps)[1], diameter_um=hole_um, polarity="dark")
        found = found.assign(x=found["x"] + u[0], y=found["y"] + v[0])
    else:
        picture = read_image(image, pixel_um=pixel_um, channel=channel)
        rows, cols = picture.attrs["pixel_um"]
        found = find_holes(picture.values, pixel_um=(rows, cols), diameter_um=hole_um)
    write_holes(found, out)
    click.echo(f"{out}: {found.sizes['mark']} holes")


@click.command()
@existing("moving")
@existing("fixed")
@out_option("CSV table of pairs to make; it must not exist.")
@match_options
@design_option
def register(
    moving: Path, fixed: Path, out: Path, mirror: bool, tolerance_um: float, model: str, design: Path | None
) -> None:
    """Match the holes in MOVING and FIXED, two tables of 'planish holes', and fit what takes one to the other."""
    from planish.io.run_folder import refuse_existing
    from planish.marks import read_holes, write_marks
    from planish.marks.design import read_pattern
    from planish.register import fit_transform, match_by_design, match_marks
    from planish.results import marks_table

    refuse_existing(out)
    a, b = (np.stack([h["x"].values, h["y"].values], axis=1) for h in (read_holes(moving), read_holes(fixed)))
    if design is None:
        matched = match_marks(a, b, tolerance_um=tolerance_um, mirror=mirror)
        labels = [f"hole {k + 1}" for k in range(len(matched.pairs))]
    else:
        pattern = read_pattern(design)
        matched = match_by_design(
            a, b, pattern.seen_um, labels=pattern.labels, tolerance_um=tolerance_um, mirror=mirror
        )  # fmt: skip
        labels = list(matched.labels)
    a, b = a[matched.pairs[:, 0]], b[matched.pairs[:, 1]]
    fit = fit_transform(a, b, model=model, mirrored=matched.mirrored, lowest="similarity")
    write_marks(marks_table(labels, fit), out)
    click.echo(matched.sentence)
    click.echo(fit.sentence)
    click.echo(f"{out}: {len(a)} pairs, residual {fit.rms_um:.2f} um rms, scale {fit.transform.scale:.4f}")


@click.command()
@existing("linked")
@click.option(
    "--property", "name", default="coating_top", show_default=True, help="Map that the image is compared with."
)
@click.option(
    "--point-um",
    type=click.FloatRange(min=0, min_open=True),
    default=100.0,
    show_default=True,
    help="Edge of the larger points.",
)
@json_option
def correlate(linked: Path, name: str, point_um: float, as_json: bool) -> None:
    """Correlate the image with one property, point by point, in the LINKED maps of a run."""
    from planish.analyze import correlate as at_pixel
    from planish.analyze import correlate_at
    from planish.cli.show import number, table
    from planish.core.errors import InputError
    from planish.core.grid import pitch

    data = _read(linked, "linked")
    if name not in data:
        raise InputError(f"{linked} has no map '{name}'; it holds {', '.join(map(str, data.data_vars))}.")
    pixel = pitch(data)
    values = np.where(data["valid"].values, data[name].values.astype(np.float64), np.nan)
    image = data["image"].values.astype(np.float64)
    pairs = (
        at_pixel(values, image, point_um=float(np.sqrt(pixel[0] * pixel[1]))),
        correlate_at(values, image, pixel_um=pixel, point_um=point_um)[0],
    )
    if as_json:
        click.echo(json.dumps([p.to_dict() for p in pairs], indent=2))
        return
    rows = [(name, f"{p.point_um:g}", str(p.n), number(p.r), number(p.r2), number(p.slope, 4)) for p in pairs]
    table("Image against property", ("", "point um", "n", "r", "r2", "slope"), rows)


@click.command()
@existing("run")
@out_option("HTML file to make; it must not exist.")
def report(run: Path, out: Path) -> None:
    """Make the report of a RUN folder again."""
    from planish.core.errors import FileError
    from planish.io.run_folder import read_tree, refuse_existing
    from planish.report import write_layers_report, write_report

    refuse_existing(out)
    groups = read_tree(run / "maps.zarr")
    try:
        results = json.loads((run / "results.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(f"{run / 'results.json'} cannot be read: {error}. Give a whole run folder.") from error
    if "layers" in results:
        pairs = {name.removeprefix("marks/"): groups.pop(name) for name in list(groups) if name.startswith("marks/")}
        write_layers_report(out, groups=groups, marks=pairs, results=results)
    else:
        marks = groups.pop("marks", None)
        write_report(out, groups=groups, marks=marks, results=results)
    click.echo(str(out))
