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


class Labels(click.ParamType[tuple[int, ...]]):
    """Some labels: ``1`` or ``1,4``."""

    name = "labels"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002
        """Show what is expected in the help."""
        return "N[,N...]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        """Parse ``"1,4"``."""
        if isinstance(value, tuple):
            return value  # type: ignore[return-value]
        if not re.fullmatch(r"\s*\d+(\s*,\s*\d+)*\s*", str(value)):
            self.fail(f"{value!r} are no labels: write whole numbers with commas, such as 1,4.", param, ctx)
        return tuple(int(part) for part in str(value).split(","))


class Fringe(click.ParamType[str | float]):
    """``auto``, ``off``, or the size of a fringe."""

    name = "fringe"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002
        """Show what is expected in the help."""
        return "auto|off|SIZE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | float:
        """Parse ``"auto"`` or ``"0.12"``."""
        if value in ("auto", "off"):
            return str(value)
        try:
            size = float(value)
        except ValueError:
            size = -1.0
        if not 0.0 <= size <= 1.0:
            self.fail(
                f"{value!r} is no fringe: write auto, off, or a share of the edge's step, such as 0.12.", param, ctx
            )
        return size


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
        help="End of that axis at which the top side lies. Maps are seen from there.",
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
        "--seed-um",
        type=Numbers(3, metavar="Z,Y,X"),
        help="A point inside the sheet that is meant, where there are several sheets or layers; with --sheet-grey, the "
        "part of that grey that holds it.",
    ),
    click.option(
        "--coating-grey",
        type=float,
        help="Grey of the coating; needed where it is nowhere thicker than half the blur.",
    ),
    click.option(
        "--fringe",
        type=Fringe(),
        default="auto",
        show_default=True,
        help="Phase-contrast fringe beside every edge, as a share of the edge's step: learnt, none, or a size.",
    ),
    click.option(
        "--envelope-um",
        type=click.FloatRange(min=0, min_open=True),
        help="Also find the faces below a ball of this radius (50 to 250): loose fibres do not lift them.",
    ),
    click.option(
        "--surface-method",
        "method",
        type=click.Choice(["profile", "paper"]),
        default="profile",
        show_default=True,
        help="profile: fit the profile of every column; paper: slice by slice as Hirn et al. (2009).",
    ),
    click.option(
        "--labels",
        "is_labels",
        is_flag=True,
        help="The volume holds the labels of another program: 0 air, 1 base, 2 coating where not given otherwise.",
    ),
    *(
        click.option(f"--label-{what}", type=Labels(), help=f"Labels that mean {what}; several with commas.")
        for what in ("air", "base", "coating", "void")
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

_AXIS = click.FloatRange(-180, 180)

direction_option = click.option(
    "--md-deg",
    type=_AXIS,
    metavar="ANGLE",
    help="Machine direction in the flattened map, degrees clockwise from its x axis.",
)

side_options = _stack(
    click.option(
        "--image-side",
        type=click.Choice(["top", "bottom"]),
        help="Side of the sheet that the image shows; where not given, the top is taken and the report says so.",
    ),
    click.option(
        "--image-md-deg",
        type=_AXIS,
        metavar="ANGLE",
        help="Machine direction in the image, likewise; compared with --md-deg, which the marks carry over.",
    ),
)

channel_option = click.option(
    "--volume-channel",
    type=click.Choice(["luminance", "red", "green", "blue"]),
    help="What is taken from slices or sections in colour; luminance where not given.",
)

SURFACE = ("sheet_grey", "seed_um", "coating_grey", "fringe", "envelope_um", "method", "cutoff_um", "rim_um")
"""Options of the surface search that go on as they are."""


def meaning_of(options: dict[str, Any]) -> dict[str, tuple[int, ...]] | None:
    """Return what labels mean, or None where the volume holds grey values."""
    told = {what: options[f"label_{what}"] for what in ("air", "base", "coating", "void")}
    given = {what: labels for what, labels in told.items() if labels is not None}
    if given and not options["is_labels"]:
        raise click.UsageError("--label-air, -base, -coating and -void say what labels mean: give --labels as well.")
    return given if options["is_labels"] else None


section_options = _stack(
    click.option(
        "--fixed-rows",
        type=Strip(),
        help="Serial sections: rows of the photographs with a line along them that lies still, such as the block's "
        "edge. Slow drift is then told from a bend of the sheet.",
    ),
    click.option("--fixed-cols", type=Strip(), help="The same for a line along the columns."),
)

correction_options = _stack(
    click.option(
        "--correct-rings", is_flag=True, help="Micro-CT: take off rings around the axis of rotation that stand out."
    ),
    click.option(
        "--correct-cupping",
        is_flag=True,
        help="Micro-CT: take off the loss of the sheet's grey in the middle, which beam hardening makes.",
    ),
    click.option(
        "--rotation-axis",
        type=click.Choice(["z", "y", "x"]),
        help="Axis of rotation of the scan; z where not given, along which the slices of a file are stacked.",
    ),
    click.option(
        "--rotation-centre-um",
        type=Numbers(2, metavar="A,B"),
        help="Where it stands along the two other axes, in the order z, y, x, in um from the first voxel; the middle "
        "of the field where not given. Needed for a volume that was cropped.",
    ),
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
    click.option(
        "--model",
        type=click.Choice(["rigid", "similarity", "affine", "projective", "tps", "auto"]),
        default="auto",
        show_default=True,
        help="What takes the sheet to the image. auto climbs from rigid to the thin-plate spline (tps) as far as the "
        "marks support it.",
    ),
)

design_option = click.option(
    "--design",
    type=click.Path(path_type=Path),
    help="The pattern that was burnt, pattern.json of 'planish marks design' or a CSV table: every hole is told by its "
    "place in it.",
)

json_option = click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")


def out_option(what: str) -> Command:
    """Where the results go; what stands there already is never overwritten."""
    return click.option("--out", "-o", required=True, type=click.Path(path_type=Path), help=what)


def existing(name: str) -> Command:
    """Take a file or folder that is read; its own reader says what is wrong with it."""
    return click.argument(name, type=click.Path(path_type=Path))
