"""``planish marks``: laser holes before they are burnt. Each command of the group is a function of its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from planish.cli.marks_convert import convert
from planish.cli.options import Numbers, existing, json_option, out_option
from planish.cli.show import table

if TYPE_CHECKING:
    from planish.marks.design import DryRun, Pattern, Rule

_POSITIVE = click.FloatRange(min=0, min_open=True)
_PICTURES = ("png", "svg", "pdf")
_SAME_UM = 0.001  # a program states positions to 0.0005 um

_range_option = click.option(
    "--range-um", type=Numbers(4, metavar="X0,Y0,X1,Y1"), default="0,0,100000,100000", show_default=True,
    help="Range of the stage; a program that leaves it is refused.",
)  # fmt: skip


@click.group()
def marks() -> None:
    """Plan the laser holes that mark a specimen, and convert files of marks."""


marks.add_command(convert)


@marks.command()
@click.option("--field-um", required=True, type=Numbers(2, metavar="W,H"), help="Field whose maps are compared.")
@click.option(
    "--layout", type=click.Choice(["coded", "line"]), default="coded", show_default=True,
    help="coded: pitches all different, for any field; line: pitches that grow along each line, for large fields.",
)  # fmt: skip
@click.option("--holes", type=click.IntRange(min=1), help="Number of holes; 24 or what the field takes.")
@click.option("--holes-per-cm2", type=_POSITIVE, help="The same as a number per area of the field.")
@click.option("--diameter-um", type=_POSITIVE, default=175.0, show_default=True, help="Diameter of a hole.")
@click.option("--burnt-um", type=click.FloatRange(min=0), default=40.0, show_default=True, help="Its burnt rim.")
@click.option("--spacing-um", type=_POSITIVE, help="Least distance of two holes; 500 um or 3 diameters.")
@click.option("--margin-um", type=_POSITIVE, help="From the field to the middle of the holes; 1.5 diameters.")
@click.option("--origin-um", type=Numbers(2, metavar="X,Y"), default="0,0", show_default=True,
              help="Where on the stage the lower left corner lies.")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Another one, another pattern.")
@click.option("--pulse-s", type=_POSITIVE, default=0.005, show_default=True, help="Length of the laser's pulse.")
@click.option("--pause-s", type=click.FloatRange(min=0), default=0.1, show_default=True, help="Rest after a pulse.")
@click.option("--speed-mm-min", type=_POSITIVE, default=1200.0, show_default=True, help="Speed of the stage, F.")
@click.option("--pulse-code", type=click.Choice(["m3", "m64"]), default="m3", show_default=True,
              help="How the laser is switched: M3 and M5, or the digital output M64 P0 and M65 P0.")  # fmt: skip
@click.option("--power", type=_POSITIVE, help="S word of M3, where the controller needs one.")
@_range_option
@click.option("--pixel-um", type=Numbers(2, repeat=True, metavar="SIZE|A,B"), default="5", show_default=True,
              help="Pixels of the two maps, for the predicted error.")  # fmt: skip
@click.option("--name", default="pattern", show_default=True, help="Title of the drawing.")
@out_option("Folder to make; it must not exist.")
@json_option
def design(field_um: tuple[float, float], out: Path, as_json: bool, **options: Any) -> None:
    """Plan laser holes around a field: pattern, drawings, tables, DXF and a program for the stage.

    DIR gets pattern.json, holes.csv (stage, y up), holes_as_imaged.csv (y down), pattern.dxf, program.gcode,
    drawing.pdf with drawing.svg and .png, predicted_error.png and way.png. A pattern that could be taken for itself in
    another position is refused.
    """
    from planish.io.run_folder import new_folder, refuse_existing
    from planish.marks.design import Burn, Imaging, Limits, Stage, design_pattern
    from planish.marks.design.write import write_design

    holes = _count(field_um, options)
    refuse_existing(out)
    low_x, low_y, high_x, high_y = _range(options["range_um"])
    pattern, rules = design_pattern(
        field_um=field_um,
        layout=options["layout"],
        holes=holes,
        burn=Burn(
            diameter_um=options["diameter_um"], rim_um=options["burnt_um"], pulse_s=options["pulse_s"],
            pause_s=options["pause_s"],
        ),
        spacing_um=options["spacing_um"], margin_um=options["margin_um"], origin_um=options["origin_um"],
        seed=options["seed"], name=options["name"],
    )  # fmt: skip
    with new_folder(out) as folder:
        written = write_design(
            pattern, rules, folder,
            stage=Stage(
                speed_mm_min=options["speed_mm_min"], pulse_code=options["pulse_code"], power=options["power"]
            ),
            # What is asked for here is meant; a program from elsewhere is held to the usual length.
            limits=Limits(low_um=(low_x, low_y), high_um=(high_x, high_y), pulse_s=max(0.05, options["pulse_s"])),
            imaging=Imaging(pixel_um=options["pixel_um"]),
        )  # fmt: skip
    if as_json:
        predicted = written.predicted
        data = {
            "out": str(out), "files": list(written.files), "holes": len(pattern.positions_um), **_rules_data(rules),
            "fle_um": predicted.fle_um, "error_centre_um": predicted.centre_um, "error_corner_um": predicted.corner_um,
            "time_s": written.run.time_s, "way_um": written.run.way_um,
        }  # fmt: skip
        click.echo(json.dumps(data, indent=2, allow_nan=False))
        return
    _show(pattern, rules)
    click.echo(written.predicted.sentence())
    click.echo(f"stage: {written.run.sentence()}")
    click.echo(f"{out}: {len(pattern.positions_um)} holes, {', '.join(written.files)}")


@marks.command()
@existing("pattern")
@click.option("--field-um", type=Numbers(2, metavar="W,H"), help="Field in the middle of a table's holes.")
@click.option("--diameter-um", type=_POSITIVE, help="Diameter of a table's holes.")
@json_option
def check(pattern: Path, field_um: tuple[float, float] | None, diameter_um: float | None, as_json: bool) -> int:
    """Check a PATTERN by the rules of the design: a pattern.json, or a table with x_um and y_um.

    Ends with 4 when a rule is broken.
    """
    from planish.marks.design import check_pattern, predict, read_pattern

    if field_um is not None and min(field_um) <= 0:
        raise click.UsageError("--field-um: width and height have to be positive.")
    read = read_pattern(pattern, field_um=field_um, diameter_um=diameter_um)
    rules, predicted = check_pattern(read), predict(read)
    if as_json:
        data = {"holes": len(read.positions_um), **_rules_data(rules), "error_corner_um": predicted.corner_um}
        click.echo(json.dumps(data, indent=2, allow_nan=False))
    else:
        _show(read, rules)
        click.echo(predicted.sentence())
    for rule in rules:
        if not rule.passed:
            click.echo(f"planish: {rule.sentence()}: {rule.remedy}.", err=True)
    return 0 if all(rule.passed for rule in rules) else 4


@marks.command()
@existing("program")
@_range_option
@click.option("--pulse-most-s", type=_POSITIVE, default=0.05, show_default=True, help="Longest pulse allowed.")
@click.option("--pattern", type=click.Path(path_type=Path), help="Compare the shots with this pattern.json or table.")
@click.option("--out", "-o", type=click.Path(path_type=Path), help="Picture of the way to make: .png, .svg or .pdf.")
@json_option
def simulate(
    program: Path,
    range_um: tuple[float, float, float, float],
    pulse_most_s: float,
    pattern: Path | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Run a stage PROGRAM dry: what it fires and how long it takes; refuse what is not safe.

    Ends with 4 when the shots are not those of --pattern.
    """
    from planish.io.run_folder import refuse_existing
    from planish.marks.design import Limits, dry_run, read_pattern, read_text
    from planish.marks.design.write import way_picture

    low_x, low_y, high_x, high_y = _range(range_um)
    if out is not None:
        if out.suffix.lower().lstrip(".") not in _PICTURES:
            raise click.UsageError(f"--out: {out.name} is no .png, .svg or .pdf.")
        refuse_existing(out)
    limits = Limits(low_um=(low_x, low_y), high_um=(high_x, high_y), pulse_s=pulse_most_s)
    run = dry_run(read_text(program, "stage program"), limits)
    difference = None if pattern is None else _compared(run, read_pattern(pattern))
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_bytes(way_picture(run, out.suffix.lower().lstrip("."), title=f"Way of the stage: {program.name}"))
    if as_json:
        data = {
            "shots": len(run.fired_um), "pulse_s": sorted(set(run.pulse_s.tolist())), "time_s": run.time_s,
            "way_um": run.way_um, "fired_um": run.fired_um.tolist(), "difference": difference,
        }  # fmt: skip
        click.echo(json.dumps(data, indent=2, allow_nan=False))
    else:
        click.echo(f"{program}: {run.sentence()}" + ("" if out is None else f"; {out}"))
        if pattern is not None and difference is None:
            click.echo(f"the shots are those of {pattern}")
    if difference is not None:
        click.echo(f"planish: {difference}", err=True)
    return 0 if difference is None else 4


def _count(field_um: tuple[float, float], options: dict[str, Any]) -> int | None:
    """Return the number of holes that was asked for, in either way."""
    if min(field_um) <= 0:
        raise click.UsageError("--field-um: width and height have to be positive.")
    if min(options["pixel_um"]) <= 0:
        raise click.UsageError("--pixel-um: both have to be positive.")
    if options["power"] is not None and options["pulse_code"] != "m3":
        raise click.UsageError("--power goes with --pulse-code m3 only.")
    if options["holes_per_cm2"] is None:
        return options["holes"]
    if options["holes"] is not None:
        raise click.UsageError("Give --holes or --holes-per-cm2, not both.")
    return max(1, round(options["holes_per_cm2"] * field_um[0] * field_um[1] / 1e8))


def _range(range_um: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    if not (range_um[0] < range_um[2] and range_um[1] < range_um[3]):
        raise click.UsageError("--range-um: X1 and Y1 have to be larger than X0 and Y0.")
    return range_um


def _compared(run: DryRun, pattern: Pattern) -> str | None:
    """Say how the shots differ from a pattern; None where they do not."""
    import numpy as np

    points = pattern.points_um
    if len(points) != len(run.fired_um):
        return f"the program fires {len(run.fired_um)} shots, the pattern has {len(points)} holes."
    apart = np.hypot(*(run.fired_um[:, None] - points[None]).transpose(2, 0, 1))
    worst = max(float(apart.min(axis=0).max()), float(apart.min(axis=1).max()))
    if worst <= _SAME_UM:
        return None
    return f"a hole of the pattern is {worst:.3f} um from the nearest shot; write the program again."


def _show(pattern: Pattern, rules: tuple[Rule, ...]) -> None:
    rows = [
        (
            rule.name,
            f"{rule.value:.4g}{' ' + rule.unit if rule.unit else ''}",
            f"{rule.sense} {rule.limit:g}",
            "kept" if rule.passed else "BROKEN",
        )
        for rule in rules
    ]
    title = f"{pattern.name}: {len(pattern.positions_um)} holes of {pattern.burn.diameter_um:g} um"
    table(title, ("rule", "measured", "limit", ""), rows)


def _rules_data(rules: tuple[Rule, ...]) -> dict[Literal["rules"], list[dict[str, Any]]]:
    return {
        "rules": [
            {
                "name": r.name, "value": r.value, "sense": r.sense, "limit": r.limit, "unit": r.unit,
                "passed": r.passed, "meaning": r.meaning,
            }
            for r in rules
        ]
    }  # fmt: skip
