"""``planish marks convert``: files of marks of one program into those of another."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import click

from planish.cli.options import Numbers, json_option
from planish.marks.files.formats import FORMATS, TARGETS, target_of

_UNITS = click.Choice(["um", "mm", "pixel"])
_BY_NAME = ", ".join(
    f"{' or '.join(FORMATS[name].suffixes)} {FORMATS[name].title}" for name in TARGETS if FORMATS[name].suffixes
)


class Sizes(click.ParamType[tuple[float, ...]]):
    """One to three numbers: ``2.5``, ``2.5,2.4`` or ``3,2.5,2.5``."""

    name = "sizes"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002
        """Show what is expected in the help."""
        return "SIZE|Y,X|Z,Y,X"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Parse ``"2.5,2.4"``."""
        if isinstance(value, tuple):
            return value  # type: ignore[return-value]
        try:
            numbers = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            numbers = ()
        if not 1 <= len(numbers) <= 3:
            self.fail(f"{value!r} is not SIZE, Y,X or Z,Y,X: write numbers with a decimal point.", param, ctx)
        return numbers


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="IN [IN2] OUT")
@click.option("--to", type=click.Choice(TARGETS), help=f"Format of OUT; where not given, by its name: {_BY_NAME}.")
@click.option("--moving-pixel-um", type=Sizes(), help="Pixel size of the moving layer, where a file counts in pixels.")
@click.option("--fixed-pixel-um", type=Sizes(), help="The same for the fixed layer.")
@click.option(
    "--moving-origin-um",
    type=Numbers(2, metavar="X,Y"),
    help="Place of the moving layer's first pixel, from which other programs count; 0,0 where not given.",
)
@click.option("--fixed-origin-um", type=Numbers(2, metavar="X,Y"), help="The same for the fixed layer.")
@click.option(
    "--unit", type=_UNITS, help="Unit of IN where it states none: BigWarp and ImageJ um, elastix mm if not given."
)
@click.option("--out-unit", type=_UNITS, help="Unit of OUT for BigWarp (um if not given) and elastix (mm).")
@click.option("--swap", is_flag=True, help="The moving image of IN is the fixed one here.")
@click.option("--swap-out", is_flag=True, help="The fixed layer is to be the moving image of OUT.")
@json_option
def convert(
    files: tuple[Path, ...],
    to: str | None,
    unit: Literal["um", "mm", "pixel"] | None,
    out_unit: Literal["um", "mm", "pixel"] | None,
    swap: bool,
    swap_out: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Convert marks from one program's file into another's.

    IN is a file of planish, BigWarp, elastix, 3D Slicer, MATLAB or ImageJ, recognised by its content. Where it
    holds one layer only, IN is the moving and IN2 the fixed one, and marks belong together in their order. For elastix,
    OUT becomes two files, for -mp and -fp.
    """
    from planish.marks.files import LayerPixels, about_layer, layer_names, read_any, write_any

    if not 2 <= len(files) <= 3:
        raise click.UsageError("Give IN and OUT, or IN, IN2 and OUT.")
    *sources, out = files
    kind = to or target_of(out)
    facts = {k: LayerPixels(options[f"{k}_pixel_um"], options[f"{k}_origin_um"]) for k in ("moving", "fixed")}
    marks = read_any(*sources, **facts, unit=unit, swap=swap)
    made = write_any(marks, out, to=kind, **facts, unit=out_unit, swap=swap_out)
    layers, read = layer_names(marks), marks.attrs["read_from"]
    used = int(marks["used"].values.sum())
    if as_json:
        counts = {"read": read, "marks": marks.sizes["mark"], "used": used}
        listed = {"layers": layers, "format": kind, "files": [str(path) for path in made]}
        click.echo(json.dumps(counts | listed, indent=2))
        return
    names = ", ".join(str(path) for path in made)
    click.echo(f"{names}: {marks.sizes['mark']} marks ({used} used) in {', '.join(layers)}")
    if not read["stated"] and unit is None:
        title = FORMATS[read["format"]].title
        click.echo(f"{title} states no unit; the positions were taken as {read['unit']} (--unit).", err=True)
    for layer in layers if FORMATS[kind].unit is not None else ():
        origin = about_layer(marks, layer).get("origin_um", {"x": 0.0, "y": 0.0})
        if any(origin.values()):
            click.echo(
                f"{layer}: positions count from its first pixel, at {origin['x']:g},{origin['y']:g} um; give that as "
                "its origin when they are read again.",
                err=True,
            )
    if kind == "elastix":
        click.echo("elastix: -mp the moving, -fp the fixed points; its transforms take fixed to moving.", err=True)
