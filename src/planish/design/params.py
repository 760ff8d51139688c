"""Options of a hole pattern, of the stage that moves the sheet, and of the compared maps."""

from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from planish.core.options import Params, option

Side = Annotated[float, Field(ge=500, le=1e6)]


class DesignParams(Params):
    """What a pattern is planned for; the burn as Hirn et al. (2009), section 2.1."""

    field_um: tuple[Side, Side] = option(
        metavar="W,H",
        help="Field whose maps are compared, 500 to 1000000 um a side; no hole reaches into it.",
    )
    layout: Literal["coded", "line"] = option(
        "coded",
        help=(
            "coded: pitches all different, for any field; line: pitches that grow along each line,"
            " for large fields."
        ),
    )
    holes: int | None = option(
        None, ge=1, le=120, help="Number of holes; default: 24, or fewer in a small field."
    )
    diameter_um: float = option(
        175.0, ge=10, le=2000, help="Diameter of a hole, usually 150 to 200 um."
    )
    rim_um: float = option(
        40.0, ge=0, le=2000, cli="--burnt-um", help="Width of the burnt rim around it."
    )
    spacing_um: float | None = option(
        None,
        gt=0,
        le=1e6,
        help="Least distance of two holes; default: the larger of 500 um and 3 diameters.",
    )
    margin_um: float | None = option(
        None,
        gt=0,
        le=1e6,
        help=(
            "From the field to the middle of the holes, widened to whole steps of 50 um; default:"
            " 1.5 diameters, or as much as a small field needs."
        ),
    )
    origin_um: tuple[float, float] = option(
        (0.0, 0.0), metavar="X,Y", help="Where on the stage the lower left corner of the view lies."
    )
    seed: int = option(0, ge=0, help="Another seed gives another pattern.")
    pulse_s: float = option(0.005, ge=1e-6, le=1, help="Length of the laser's pulse.")
    pause_s: float = option(0.1, ge=0, le=60, help="Rest after a pulse.")
    name: str = option("pattern", help="Title of the drawing.")


class StageParams(Params):
    """What the program asks of the stage and the laser."""

    speed_mm_min: float = option(
        1200.0,
        gt=0,
        le=1e6,
        help=(
            "Speed F along the path; controllers that ignore F in G0 move at a speed of their own."
        ),
    )
    pulse_code: Literal["m3", "m64"] = option(
        "m3", help="How the laser is switched: M3 and M5, or the digital output M64 P0 and M65 P0."
    )
    power: float | None = option(
        None, gt=0, le=1e6, help="S word of M3, where the controller needs one."
    )
    range_um: tuple[float, float, float, float] = option(
        (0.0, 0.0, 100_000.0, 100_000.0),
        metavar="X0,Y0,X1,Y1",
        help="Range of the stage; programs that leave it are refused.",
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.power is not None and self.pulse_code != "m3":
            raise ValueError("a power goes with the pulse code m3 only")
        x0, y0, x1, y1 = self.range_um
        if not (x0 < x1 and y0 < y1):
            raise ValueError(
                "the range X0,Y0,X1,Y1 of the stage is empty: X1 and Y1 have to be larger than X0"
                " and Y0"
            )
        return self


class ImagingParams(Params):
    """How well the holes are found, for the predicted error."""

    pixel_um: tuple[PositiveFloat, PositiveFloat] = option(
        (5.0, 5.0),
        metavar="SIZE|A,B",
        repeat=True,
        help="Pixels of the two maps, for the predicted error.",
    )
    roughness_um: float = option(5.0, ge=0, cli=None, help="Standard deviation of a rim's radius.")
    rim_length_um: float = option(
        30.0, gt=0, cli=None, help="Length along the rim over which it varies independently."
    )
