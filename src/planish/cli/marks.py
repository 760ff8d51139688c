"""``planish marks``: laser holes before they are burnt. Each command of the group is a function of its own."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import click
from pydantic import ValidationError

from planish.cli.marks_convert import convert
from planish.cli.options import Numbers, existing, json_option, out_option
from planish.cli.show import table
from planish.core.options import Params, options_of
from planish.marks.design.params import DesignParams, ImagingParams, StageParams

if TYPE_CHECKING:
    from planish.marks.design import DryRun, Pattern, Rule

P = TypeVar("P", bound=Params)

_POSITIVE = click.FloatRange(min=0, min_open=True)
_PICTURES = ("png", "svg", "pdf")
_SAME_UM = 0.001  # a program states positions to 0.0005 um


def _options(model: type[Params], *names: str) -> Callable[[Any], Any]:
    """Options of the fields of a model, of some names where they are given."""

    def decorate(command: Any) -> Any:
        for name, field, shown in reversed(list(options_of(model))):
            if names and name not in names:
                continue
            parts = [part for part in get_args(field.annotation) if part is not type(None)]
            kind: Any = field.annotation
            if "tuple" in str(kind):
                kind = Numbers(len(parts), repeat=shown.repeat, metavar=shown.metavar or "")
            elif "Literal" in str(kind):
                kind = click.Choice(parts)
            elif parts:
                kind = parts[0]
            value: dict[str, Any] = {"required": True}
            if not field.is_required():
                value = {"default": field.default, "show_default": field.default is not None}
                if isinstance(field.default, tuple):
                    numbers = dict.fromkeys(field.default) if shown.repeat else field.default
                    value["default"] = ",".join(f"{v:g}" for v in numbers)
            command = click.option(*shown.flags, name, type=kind, help=field.description, **value)(command)
        return command

    return decorate


def _checked(model: type[P], options: dict[str, Any]) -> P:
    """Take the model's options out of all, checked."""
    flags = {name: shown.flags[0] for name, _, shown in options_of(model)}
    try:
        return model.model_validate({name: options[name] for name in flags if name in options})
    except ValidationError as error:
        faults = [
            f"{flags[str(e['loc'][0])] + ': ' if e['loc'] else ''}{e['msg'].removeprefix('Value error, ')}"
            for e in error.errors(include_url=False)
        ]
        raise click.UsageError("; ".join(faults)) from error


@click.group()
def marks() -> None:
    """Plan the laser holes that mark a specimen, and convert files of marks."""


marks.add_command(convert)


@marks.command()
@_options(DesignParams)
@click.option("--holes-per-cm2", type=_POSITIVE, help="Number of holes per area of the field.")
@_options(StageParams)
@_options(ImagingParams)
@out_option("Folder to make; it must not exist.")
@json_option
def design(out: Path, as_json: bool, holes_per_cm2: float | None, **options: Any) -> None:
    """Plan laser holes around a field: pattern, drawings, tables, DXF and a program for the stage.

    DIR gets pattern.json, holes.csv (stage, y up), holes_as_imaged.csv (y down), pattern.dxf, program.gcode,
    drawing.pdf with drawing.svg and .png, predicted_error.png and path.png. A pattern that could be taken for itself in
    another position is refused.
    """
    from planish.io.run_folder import new_folder, refuse_existing
    from planish.marks.design import design_pattern, write_design

    if holes_per_cm2 is not None:
        if options["holes"] is not None:
            raise click.UsageError("Give --holes or --holes-per-cm2, not both.")
        width, height = options["field_um"]
        options["holes"] = max(1, round(holes_per_cm2 * width * height / 1e8))
    params, stage = _checked(DesignParams, options), _checked(StageParams, options)
    imaging = _checked(ImagingParams, options)
    refuse_existing(out)
    pattern, rules = design_pattern(params)
    with new_folder(out) as folder:
        written = write_design(pattern, rules, folder, stage=stage, imaging=imaging)
    if as_json:
        predicted = written.predicted
        data = {
            "out": str(out), "files": list(written.files), "holes": len(pattern.holes), **_rules_data(rules),
            "fle_um": predicted.fle_um, "error_centre_um": predicted.centre_um, "error_corner_um": predicted.corner_um,
            "time_s": written.run.time_s, "path_um": written.run.length_um,
        }  # fmt: skip
        click.echo(json.dumps(data, indent=2, allow_nan=False))
        return
    _show(pattern, rules)
    click.echo(written.predicted.sentence())
    click.echo(f"stage: {written.run.sentence()}")
    click.echo(f"{out}: {len(pattern.holes)} holes, {', '.join(written.files)}")


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
        data = {"holes": len(read.holes), **_rules_data(rules), "error_corner_um": predicted.corner_um}
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
@_options(StageParams, "range_um")
@click.option("--pulse-most-s", type=_POSITIVE, default=0.05, show_default=True, help="Longest pulse allowed.")
@click.option("--pattern", type=click.Path(path_type=Path), help="Compare the shots with this pattern.json or table.")
@click.option("--out", "-o", type=click.Path(path_type=Path), help="Picture of the path to make: .png, .svg or .pdf.")
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
    from planish.core.tables import read_text
    from planish.io.run_folder import refuse_existing
    from planish.marks.design import dry_run, read_pattern
    from planish.marks.design.write import path_picture

    checked = _checked(StageParams, {"range_um": range_um})
    if out is not None:
        if out.suffix.lower().lstrip(".") not in _PICTURES:
            raise click.UsageError(f"--out: {out.name} is no .png, .svg or .pdf.")
        refuse_existing(out)
    run = dry_run(read_text(program, what="stage program"), checked, pulse_s=pulse_most_s)
    difference = None if pattern is None else _compared(run, read_pattern(pattern))
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_bytes(path_picture(run, out.suffix.lower().lstrip("."), title=f"Path of the stage: {program.name}"))
    if as_json:
        data = {
            "shots": len(run.fired_um), "pulse_s": sorted(set(run.pulse_s.tolist())), "time_s": run.time_s,
            "path_um": run.length_um, "fired_um": run.fired_um.tolist(), "difference": difference,
        }  # fmt: skip
        click.echo(json.dumps(data, indent=2, allow_nan=False))
    else:
        click.echo(f"{program}: {run.sentence()}" + ("" if out is None else f"; {out}"))
        if pattern is not None and difference is None:
            click.echo(f"the shots are those of {pattern}")
    if difference is not None:
        click.echo(f"planish: {difference}", err=True)
    return 0 if difference is None else 4


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
    title = f"{pattern.name}: {len(pattern.holes)} holes of {pattern.diameter_um:g} um"
    table(title, ("rule", "measured", "limit", ""), rows)


def _rules_data(rules: tuple[Rule, ...]) -> dict[str, list[dict[str, Any]]]:
    names = ("name", "value", "sense", "limit", "unit", "passed", "meaning")
    return {"rules": [{name: getattr(rule, name) for name in names} for rule in rules]}
