"""``planish marks``: laser holes before they are burnt, and conversion of files of marks.

Files of marks of one program are turned into those of another.
"""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click
from pydantic import Field

from planish.cli.console import print_json, table, warn
from planish.cli.options import (
    PATH,
    Option,
    Value,
    Verb,
    build_params,
    existing,
    json_option,
    options,
    out_option,
)
from planish.core.files import write_whole
from planish.core.typing import Array, Entries, Pair, Texts
from planish.design.params import DesignParams, ImagingParams, StageParams
from planish.marks.exchange.formats import FORMATS, TARGETS, Unit, target_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import xarray as xr

    from planish.design import Pattern, Rule

_POSITIVE = click.FloatRange(min=0, min_open=True)
_UNITS = click.Choice(["um", "mm", "pixel"])
_PAIR = Pair
_SIZES = Value(Annotated[tuple[float, ...], Field(min_length=1, max_length=3)], "SIZE|Y,X|Z,Y,X")
_ORIGIN = Value(_PAIR, "X,Y")
_BY_NAME = ", ".join(
    f"{' or '.join(FORMATS[name].suffixes)} {FORMATS[name].title}"
    for name in TARGETS
    if FORMATS[name].suffixes
)


@click.group()
def marks() -> None:
    """Plan the laser holes that mark a specimen, and convert files of marks."""


@marks.command(cls=Verb)
@options(DesignParams, "Pattern")
@click.option(
    "--holes-per-cm2",
    type=_POSITIVE,
    cls=Option,
    group="Pattern",
    help="Number of holes per area of the field.",
)
@options(StageParams, "Stage program")
@options(ImagingParams, "Predicted error")
@out_option("Folder to make; it must not exist.")
@json_option
def design(out: Path, as_json: bool, holes_per_cm2: float | None, **values: Any) -> None:
    """Plan laser holes around a field: pattern, drawings, tables, DXF and a program for the stage.

    DIR gets pattern.json, holes.csv (stage, y up), holes_as_imaged.csv (y down), pattern.dxf,
    program.gcode, drawing.pdf with drawing.svg and .png, predicted_error.png and path.png. A
    pattern that could be taken for itself in another position is refused.
    """
    from planish.design import design_pattern, write_design
    from planish.io.run_folder import new_folder

    if holes_per_cm2 is not None:
        if values["holes"] is not None:
            raise click.UsageError("Give --holes or --holes-per-cm2, not both.")
        width, height = values["field_um"]
        values["holes"] = max(1, round(holes_per_cm2 * width * height / 1e8))
    params = build_params(DesignParams, values)
    stage = build_params(StageParams, values)
    imaging = build_params(ImagingParams, values)
    pattern, rules = design_pattern(params)
    with new_folder(out) as folder:
        files, program, error = write_design(pattern, rules, folder, stage=stage, imaging=imaging)
    if as_json:
        facts = {
            "out": str(out),
            "files": list(files),
            "holes": len(pattern.holes),
            **_rule_facts(rules),
            "fle_um": error.fle_um,
            "error_centre_um": error.centre_um,
            "error_corner_um": error.corner_um,
            "time_s": program.time_s,
            "path_um": program.length_um,
        }
        print_json(facts)
        return
    _show(pattern, rules)
    click.echo(error.sentence())
    click.echo(f"stage: {program.sentence()}")
    click.echo(f"{out}: {len(pattern.holes)} holes, {', '.join(files)}")


@marks.command()
@existing("pattern")
@click.option(
    "--field-um", type=Value(_PAIR, "W,H"), help="Field in the middle of a table's holes."
)
@click.option("--diameter-um", type=_POSITIVE, help="Diameter of a table's holes.")
@json_option
def check(pattern: Path, field_um: Pair | None, diameter_um: float | None, as_json: bool) -> int:
    """Check a PATTERN by the rules of the design: a pattern.json, or a table with x_um and y_um.

    Ends with 4 when a rule is broken.
    """
    from planish.design import check_pattern, predict, read_pattern

    if field_um is not None and min(field_um) <= 0:
        raise click.UsageError("--field-um: width and height have to be positive.")
    hole_pattern = read_pattern(pattern, field_um=field_um, diameter_um=diameter_um)
    rules = check_pattern(hole_pattern)
    error = predict(hole_pattern)
    if as_json:
        facts = {
            "holes": len(hole_pattern.holes),
            **_rule_facts(rules),
            "error_corner_um": error.corner_um,
        }
        print_json(facts)
    else:
        _show(hole_pattern, rules)
        click.echo(error.sentence())
    for rule in rules:
        if not rule.passed:
            warn(f"{rule.sentence()}: {rule.remedy}.")
    if all(rule.passed for rule in rules):
        return 0
    return 4


@marks.command()
@existing("program")
@options(StageParams, "Options", only=("range_um",))
@click.option(
    "--pulse-most-s", type=_POSITIVE, default=0.05, show_default=True, help="Longest pulse allowed."
)
@click.option("--pattern", type=PATH, help="Compare the shots with this pattern.json or table.")
@out_option("Picture of the path to make: .png, .svg or .pdf.", required=False)
@json_option
def simulate(
    program: Path,
    pulse_most_s: float,
    pattern: Path | None,
    out: Path | None,
    as_json: bool,
    **values: Any,
) -> int:
    """Run a stage PROGRAM dry: what it fires and how long it takes; refuse what is not safe.

    Ends with 4 when the shots are not those of --pattern.
    """
    from planish.core.tables import read_text
    from planish.design import dry_run, read_pattern
    from planish.design.draw import encode, house_style, path_page
    from planish.io.run_folder import refuse_existing

    stage = build_params(StageParams, values)
    if out is not None:
        if out.suffix.lower() not in (".png", ".svg", ".pdf"):
            raise click.UsageError(f"--out: {out.name} is no .png, .svg or .pdf.")
        refuse_existing(out)
    run = dry_run(read_text(program, what="stage program"), stage, pulse_s=pulse_most_s)
    shots_um = run.fired_um
    difference = None
    if pattern is not None:
        difference = _difference(shots_um, read_pattern(pattern).points_um)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        title = f"Path of the stage: {program.name}"
        with house_style():
            picture = encode([path_page(run, title=title)], out.suffix.lower().lstrip("."), title)
        write_whole(out, picture)
    if as_json:
        facts = {
            "shots": len(shots_um),
            "pulse_s": sorted(set(run.pulse_s.tolist())),
            "time_s": run.time_s,
            "path_um": run.length_um,
            "fired_um": shots_um.tolist(),
            "difference": difference,
        }
        print_json(facts)
    else:
        click.echo(f"{program}: {run.sentence()}" + ("" if out is None else f"; {out}"))
        if pattern is not None and difference is None:
            click.echo(f"the shots are those of {pattern}")
    if difference is None:
        return 0
    warn(difference)
    return 4


def _difference(shots_um: Array, holes_um: Array) -> str | None:
    """How the shots of a program differ from the holes of a pattern; None where they do not.

    Both (n, 2), in um on the stage, in any order.
    """
    import numpy as np

    if len(holes_um) != len(shots_um):
        return f"the program fires {len(shots_um)} shots, the pattern has {len(holes_um)} holes."
    # Of each shot from each hole; the worst hole or shot is farthest from its nearest partner.
    offsets_um = shots_um[:, None] - holes_um[None]
    distance_um = np.hypot(offsets_um[..., 0], offsets_um[..., 1])
    worst_um = max(float(distance_um.min(axis=axis).max()) for axis in (0, 1))
    if worst_um <= 0.001:  # um: a program states positions to 0.0005
        return None
    return (
        f"a hole of the pattern is {worst_um:.3f} um from the nearest shot; write the"
        " program again."
    )


def _show(pattern: Pattern, rules: tuple[Rule, ...]) -> None:
    rows: list[Texts] = []
    for rule in rules:
        measured = f"{rule.value:.4g} {rule.unit}".strip()
        outcome = "kept" if rule.passed else "BROKEN"
        rows.append((rule.name, measured, f"{rule.sense} {rule.limit:g}", outcome))
    title = f"{pattern.name}: {len(pattern.holes)} holes of {pattern.diameter_um:g} um"
    table(title, ("rule", "measured", "limit", ""), rows)


def _rule_facts(rules: tuple[Rule, ...]) -> dict[str, list[Entries]]:
    names = ("name", "value", "sense", "limit", "unit", "passed", "meaning")
    facts_of = attrgetter(*names)
    return {"rules": [dict(zip(names, facts_of(rule), strict=True)) for rule in rules]}


@marks.command()
@click.argument("files", nargs=-1, required=True, type=PATH, metavar="IN [IN2] OUT")
@click.option(
    "--to",
    type=click.Choice(TARGETS),
    help=f"Format of OUT; where not given, by its name: {_BY_NAME}.",
)
@click.option(
    "--moving-pixel-um",
    type=_SIZES,
    help="Pixel size of the moving layer, where a file counts in pixels.",
)
@click.option("--fixed-pixel-um", type=_SIZES, help="The same for the fixed layer.")
@click.option(
    "--moving-origin-um",
    type=_ORIGIN,
    help="Place of the moving layer's first pixel, from which other programs count; default: 0,0.",
)
@click.option("--fixed-origin-um", type=_ORIGIN, help="The same for the fixed layer.")
@click.option(
    "--unit",
    type=_UNITS,
    help=(
        "Unit of IN if it states none; default: um for BigWarp and ImageJ results, mm for elastix."
    ),
)
@click.option(
    "--out-unit", type=_UNITS, help="Unit of OUT for BigWarp (default: um) and elastix (mm)."
)
@click.option("--swap", is_flag=True, help="The moving image of IN is the fixed one here.")
@click.option("--swap-out", is_flag=True, help="The fixed layer is to be the moving image of OUT.")
@json_option
def convert(
    files: tuple[Path, ...],
    to: str | None,
    unit: Unit | None,
    out_unit: Unit | None,
    swap: bool,
    swap_out: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Convert marks from one program's file into another's.

    IN is a file of planish, BigWarp, elastix, 3D Slicer, MATLAB or ImageJ, or a table of another
    program, recognised by its content. Where it holds one layer only, IN is the moving and IN2 the
    fixed one, and marks belong together in their order. For elastix, OUT becomes two files, for -mp
    and -fp.
    """
    from planish.marks.exchange import LayerPixels, layer_names, read_any, write_any

    if not 2 <= len(files) <= 3:
        raise click.UsageError("Give IN and OUT, or IN, IN2 and OUT.")
    *sources, out = files
    out_format = to or target_of(out)
    layer_pixels = {
        layer: LayerPixels(options[f"{layer}_pixel_um"], options[f"{layer}_origin_um"])
        for layer in ("moving", "fixed")
    }
    marks = read_any(*sources, **layer_pixels, unit=unit, swap=swap)
    out_files = write_any(marks, out, to=out_format, **layer_pixels, unit=out_unit, swap=swap_out)
    layers = layer_names(marks)
    source = marks.attrs["read_from"]
    n_used = int(marks["used"].values.sum())
    out_names = [str(path) for path in out_files]
    if as_json:
        counts = {"marks": marks.sizes["mark"], "used": n_used}
        print_json(
            {"read": source, **counts, "layers": layers, "format": out_format, "files": out_names}
        )
        return
    click.echo(
        f"{', '.join(out_names)}: {marks.sizes['mark']} marks ({n_used} used) in"
        f" {', '.join(layers)}"
    )
    if not source["stated"] and unit is None:
        title = FORMATS[source["format"]].title
        click.echo(
            f"{title} states no unit; the positions were taken as {source['unit']} (--unit). Where"
            " the images had no scale in that program, they are pixels: give --unit pixel.",
            err=True,
        )
    has_unit = FORMATS[out_format].unit is not None
    for note in _origin_notes(marks, layers, has_unit=has_unit):
        click.echo(note, err=True)
    if out_format == "elastix":
        click.echo(
            "elastix: -mp the moving, -fp the fixed points; its transforms take fixed to moving.",
            err=True,
        )


def _origin_notes(marks: xr.Dataset, layers: Sequence[str], *, has_unit: bool) -> Iterator[str]:
    """From where positions count, of files with a unit and of those that were read."""
    from planish.marks.exchange import about_layer

    is_counted = "moving" in marks.attrs["from_first_pixel"]
    is_shifted = "moving" in layers and is_counted != has_unit
    if is_shifted and "origin_um" not in about_layer(marks, "moving"):
        yield (
            "moving: its first pixel was taken to lie at 0,0 um, as that of an image does. That of"
            " a flat map lies elsewhere: give --moving-origin-um, in Python"
            " pl.open_run(RUN).maps.u[0] and .v[0]."
        )
    for layer in layers:
        origin = about_layer(marks, layer).get("origin_um", {"x": 0.0, "y": 0.0})
        if has_unit and any(origin.values()):
            yield (
                f"{layer}: positions count from its first pixel, at {origin['x']:g},{origin['y']:g}"
                " um; give that as its origin when they are read again."
            )
