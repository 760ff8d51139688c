"""Options that several commands share, and how their text becomes numbers."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import click

Command = Callable[..., Any]


class Numbers(click.ParamType[tuple[float, ...]]):
    """Some numbers, separated by commas; one stands for all where ``repeat`` is set."""

    name = "numbers"

    def __init__(self, count: int, *, repeat: bool = False, metavar: str = "NUMBERS") -> None:
        self.count, self.repeat, self.metavar = count, repeat, metavar

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002
        """Show what is expected in the help."""
        return self.metavar

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Parse ``"3"`` or ``"3,1.5,1.5"``."""
        if isinstance(value, tuple):
            return value  # type: ignore[return-value]
        try:
            numbers = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(
                f"{value!r} is not {self.metavar}: write numbers with a decimal point, commas between them.", param, ctx
            )
        if len(numbers) == 1 and self.repeat:
            return numbers * self.count
        if len(numbers) != self.count:
            self.fail(f"{value!r} holds {len(numbers)} numbers; {self.metavar} is needed.", param, ctx)
        return numbers


class Strip(click.ParamType[tuple[int, int]]):
    """First and last pixel of a strip: ``10,60``."""

    name = "strip"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002
        """Show what is expected in the help."""
        return "FIRST,LAST"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Parse ``"10,60"``."""
        if isinstance(value, tuple):
            return value  # type: ignore[return-value]
        found = re.fullmatch(r"\s*(\d+)\s*,\s*(\d+)\s*", str(value))
        if not found:
            self.fail(f"{value!r} is no strip: write the first and the last pixel, such as 10,60.", param, ctx)
        return int(found[1]), int(found[2])


class Memory(click.ParamType[int]):
    """An amount of memory: ``4GB``, ``500 MB``, or a number of bytes."""

    name = "memory"
    units: ClassVar[dict[str, int]] = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002
        """Show what is expected in the help."""
        return "SIZE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Parse ``"4GB"``."""
        if isinstance(value, int):
            return value
        found = re.fullmatch(r"\s*([0-9.]+)\s*([A-Za-z]*)\s*", str(value))
        unit = self.units.get(found[2].upper().replace("IB", "B")) if found else None
        try:
            amount = int(float(found[1]) * unit) if found and unit else 0
        except ValueError:
            amount = 0
        if amount < 2**20:
            self.fail(f"{value!r} is no amount of memory: write 4GB or 500MB.", param, ctx)
        return amount


_POSITIVE = click.FloatRange(min=0, min_open=True)


def _stack(*options: Command) -> Command:
    def decorate(function: Command) -> Command:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


volume_options = _stack(
    click.option(
        "--voxel-um",
        type=Numbers(3, repeat=True, metavar="SIZE|Z,Y,X"),
        help="Voxel size in um, where the file does not state it.",
    ),
    click.option(
        "--through",
        type=click.Choice(["z", "y", "x"]),
        default="z",
        show_default=True,
        help="Axis that runs through the sheet.",
    ),
    click.option(
        "--top",
        type=click.Choice(["high", "low"]),
        default="high",
        show_default=True,
        help="End of that axis at which the top side lies: the side that the image shows.",
    ),
    click.option("--override-size", is_flag=True, help="Take the sizes given here where a file states others."),
)

surface_options = _stack(
    click.option(
        "--sheet-grey",
        type=Numbers(2, metavar="LOW,HIGH"),
        help="Grey range of the sheet, to tell it from other material in the volume.",
    ),
    click.option(
        "--cutoff-um",
        type=click.FloatRange(min=0, min_open=True),
        default=400.0,
        show_default=True,
        help="Wavelength of the centre surface that its smoothing passes by half.",
    ),
    click.option(
        "--rim-um",
        type=click.FloatRange(min=0),
        default=100.0,
        show_default=True,
        help="Zone around holes and gaps that is left out of all results.",
    ),
)

channel_option = click.option(
    "--volume-channel",
    type=click.Choice(["luminance", "red", "green", "blue"]),
    help="What is taken from slices or sections in colour; luminance where not given.",
)

section_options = _stack(
    click.option(
        "--fixed-rows",
        type=Strip(),
        help="Serial sections: rows of the photographs with a line along them that lies still, such as the block's "
        "edge. Slow drift is then told from a bend of the sheet.",
    ),
    click.option("--fixed-cols", type=Strip(), help="The same for a line along the columns."),
)

column_option = click.option(
    "--column-um",
    type=click.FloatRange(min=0, min_open=True),
    help="Width of the measured columns in um; single voxels where not given, or as the memory demands.",
)

compute_options = _stack(
    click.option(
        "--memory", "memory_bytes", type=Memory(), help="Most memory to use, such as 4GB; half of what is free."
    ),
    click.option("--threads", type=click.IntRange(min=1), help="Local threads; one a core, eight at most."),
    click.option("--scheduler", metavar="tcp://HOST:PORT", help="Work on a dask cluster instead of local threads."),
)

property_options = _stack(
    click.option(
        "--property",
        "maps",
        multiple=True,
        metavar="NAME",
        help="A further map, such as porosity or fibre_angle; may be given again. 'planish properties' lists them.",
    ),
    click.option(
        "--rays",
        type=click.Choice(["normal", "vertical"]),
        default="normal",
        show_default=True,
        help="Direction along which further maps are measured.",
    ),
    click.option("--coating-density", "coating_g_cm3", type=_POSITIVE, metavar="G/CM3", help="For coat weight."),
    click.option("--base-density", "base_g_cm3", type=_POSITIVE, metavar="G/CM3", help="For grammage."),
    click.option("--grammage", "grammage_g_m2", type=_POSITIVE, metavar="G/M2", help="Weighed mass of the sheet."),
    click.option("--coat-weight-top", "coat_weight_top_g_m2", type=_POSITIVE, metavar="G/M2", help="Weighed coating."),
    click.option("--coat-weight-bottom", "coat_weight_bottom_g_m2", type=_POSITIVE, metavar="G/M2", help="The same."),
    click.option("--solid-grey", type=float, help="Grey of fibre wall without voids: for the porosity."),
    click.option("--ink-grey", type=Numbers(2, metavar="LOW,HIGH"), help="Grey range of ink: for its depth."),
)

image_options = _stack(
    click.option(
        "--pixel-um",
        type=Numbers(2, repeat=True, metavar="SIZE|Y,X"),
        help="Pixel size in um, where the image does not state it.",
    ),
    click.option(
        "--channel",
        default="luminance",
        show_default=True,
        help="Channel of a colour image: luminance, red, green, blue or a number from 0.",
    ),
)

hole_option = click.option(
    "--hole-um",
    type=Numbers(2, metavar="LEAST,MOST"),
    default="100,300",
    show_default=True,
    help="Range of hole diameters in um.",
)

match_options = _stack(
    click.option(
        "--mirror",
        is_flag=True,
        help="Also try mirror images: for a volume whose slices are numbered against the usual sense.",
    ),
    click.option(
        "--tolerance-um",
        type=click.FloatRange(min=0, min_open=True),
        default=25.0,
        show_default=True,
        help="How far apart two marks may be to belong together.",
    ),
)

json_option = click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")


def out_option(what: str) -> Command:
    """Where the results go; what stands there already is never overwritten."""
    return click.option("--out", "-o", required=True, type=click.Path(path_type=Path), help=what)


def existing(name: str) -> Command:
    """Take a file or folder that is read; its own reader says what is wrong with it."""
    return click.argument(name, type=click.Path(path_type=Path))
