"""The command that links: a volume or its run to an image, two volumes, two images, or more layers to one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from planish.cli.line import OUT, checked, properties_section, run_and_show, surface_section, validated, volume_section
from planish.cli.options import (
    channel_option,
    column_option,
    compute_options,
    design_option,
    direction_option,
    hole_option,
    image_options,
    json_option,
    match_options,
    out_option,
    property_options,
    section_options,
    side_options,
    surface_options,
    volume_options,
)

_OF_A_LINK = {
    "layers", "out", "pixel_um", "channel", "override_size", "image_side", "md_deg", "image_md_deg", "marks", "design",
    "chain", "mirror", "tolerance_um", "model", "refine", "hole_um", "point_um", "memory_bytes", "threads",
    "scheduler", "as_json",
}  # fmt: skip
"""Options that mean something without a volume."""


@click.command()
@click.argument("layers", nargs=-1, required=True, metavar="LAYER... REFERENCE")
@out_option(OUT)
@volume_options
@direction_option
@channel_option
@section_options
@column_option
@image_options
@side_options
@click.option(
    "--marks",
    type=click.Path(path_type=Path),
    help="Pairs of points from planish or another program (docs/marks-files.md), instead of finding the holes.",
)
@design_option
@click.option(
    "--refine",
    type=click.Choice(["affine", "bspline"]),
    help="Also refine the marks' registration by the maps themselves (one image only; needs planish[refine]). The maps "
    "go into the group 'refined'; r is cross-fitted, or stands beside a searched null.",
)
@click.option("--chain", is_flag=True, help="Register each layer to the next one, and carry it on from there.")
@match_options
@hole_option
@click.option(
    "--point-um",
    type=click.FloatRange(min=0, min_open=True),
    default=100.0,
    show_default=True,
    help="Edge of the larger points that are correlated.",
)
@surface_options
@property_options
@compute_options
@json_option
@click.pass_context
def link(
    ctx: click.Context, layers: tuple[str, ...], out: Path, marks: Path | None, as_json: bool, **options: Any
) -> int:
    """Link layers of one specimen to the last of them: all maps on its pixels, correlation, report.

    A layer is a volume (TIFF stack, folder of slices or sections, store), the folder of a run that planish made of one,
    or an image (TIFF, PNG, JPEG); NAME=PATH gives it a name. All show the same specimen, marked with laser holes.

    'planish link VOLUME IMAGE --out RUN' is the usual case: all 3D properties on the image's own pixels. RUN gets
    maps.zarr, marks.csv, results.json, report.html and run.toml. With two volumes, two images or more than two layers,
    the flattened maps and images are laid onto the last layer (docs/linking.md). Options of volumes hold for all of
    them; where two need different ones, map each first with 'planish map' and give the runs.
    """
    if len(layers) < 2:
        raise click.UsageError("Something to link it to is missing: give two layers or more, the reference last.")
    named = _all_named(layers)
    kinds = [_kind(path) for _, path in named]
    if "volume" not in kinds:
        _refuse_options(ctx, [path for _, path in named])
    registration = {k: options[k] for k in ("mirror", "tolerance_um", "hole_um", "model", "refine")}
    registration["design"] = str(options["design"].absolute()) if options["design"] else None
    correlate = {"point_um": options["point_um"]}
    given = str(marks.absolute()) if marks else None
    if len(layers) == 2 and kinds[1] == "image" and kinds[0] != "image" and not options["chain"]:
        parts = {
            "image": _image(named[1][1], options), "registration": registration | {"marks": given},
            "correlate": correlate,
        }  # fmt: skip
        if kinds[0] == "volume":
            study = checked(_sheet(named[0][1], options) | parts)
            return run_and_show(study, out, as_json=as_json, options=options)
        from planish.pipeline import read_run

        sheet = read_run(named[0][1])
        told = sheet.study.model_dump()
        if options["md_deg"] is not None:
            told["volume"]["md_deg"] = options["md_deg"]
        study = checked(told | parts)
        return run_and_show(study, out, as_json=as_json, options=options, sheet=sheet)
    if options["refine"]:
        raise click.UsageError("--refine is for one volume or run and one image. Link these two alone to refine them.")
    if given and len(layers) > 2:
        raise click.UsageError(
            "--marks holds pairs of two layers, but more are given. Write them into a study file (docs/linking.md)."
        )
    from planish.study import LayersStudy

    sections = [
        {"name": name, "marks": given if k == 0 else None, **_layer(kind, path, options)}
        for k, ((name, path), kind) in enumerate(zip(named, kinds, strict=True))
    ]
    several = validated(
        LayersStudy,
        {"layers": sections, "chain": options["chain"], "registration": registration, "correlate": correlate},
    )
    return run_and_show(several, out, as_json=as_json, options=options)


def _all_named(texts: tuple[str, ...]) -> list[tuple[str, Path]]:
    """Part NAME=PATH; names that are not given are made of the paths, with their folders' where files are alike."""
    given = [_named(text) for text in texts]
    stems = [name or _as_name(path.absolute().stem) for name, path in given]
    return [
        (name or (f"{_as_name(path.absolute().parent.name)}-{stem}"[:40] if stems.count(stem) > 1 else stem), path)
        for (name, path), stem in zip(given, stems, strict=True)
    ]


def _named(text: str) -> tuple[str | None, Path]:
    name, sign, rest = text.partition("=")
    if not sign or not rest or Path(text).exists():
        return None, Path(text)
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}", name):
        return name, Path(rest)
    if Path(rest).exists():
        raise click.UsageError(
            f"{name!r} is no name of a layer: letters from A to Z, digits, - and _ are possible, at most 40."
        )
    return None, Path(text)


def _as_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-_")[:40] or "layer"


def _kind(path: Path) -> str:
    """Whether a path is a run, an image or a volume; what is wrong with it is said by its own reader."""
    from planish.io import find_place
    from planish.io.info import is_image
    from planish.io.sections import is_section_folder
    from planish.pipeline import is_run

    if is_run(path):
        return "run"
    place = find_place(path)
    return "image" if not is_section_folder(place.path) and is_image(place) else "volume"


def _sheet(path: Path, options: dict[str, Any]) -> dict[str, Any]:
    return {
        "volume": volume_section(path, options),
        "surface": surface_section(options),
        "properties": properties_section(options),
    }


def _image(path: Path, options: dict[str, Any]) -> dict[str, Any]:
    return {
        "path": str(path.absolute()),
        "pixel_um": options["pixel_um"],
        "channel": options["channel"],
        "override_size": options["override_size"],
        "side": options["image_side"],
        "md_deg": options["image_md_deg"],
    }


def _layer(kind: str, path: Path, options: dict[str, Any]) -> dict[str, Any]:
    """One layer as the study wants it."""
    if kind == "run":
        return {"run": str(path.absolute()), "md_deg": options["md_deg"]}
    return {"image": _image(path, options)} if kind == "image" else {"map": _sheet(path, options)}


def _refuse_options(ctx: click.Context, paths: list[Path]) -> None:
    """Refuse options that say how a volume is mapped where none is: they would do nothing."""
    given = [
        option.opts[0]
        for option in ctx.command.params
        if option.name not in _OF_A_LINK
        and ctx.get_parameter_source(option.name or "") == click.core.ParameterSource.COMMANDLINE
    ]
    if given:
        raise click.UsageError(
            f"{', '.join(given)}: for volumes only, and {', '.join(p.name for p in paths)} is none. A run keeps the "
            "options that it was made with; map the volume again to change them."
        )
