"""A pattern of laser holes: where they are meant to be, how each is burnt, and what lies around them.

Coordinates are those of the stage, as the laser sees the sheet: x to the right, y up. From the outside inwards::

    view    what has to be imaged: the frame and a border around it; its lower left corner is the stage's origin
    frame   the rectangle on which the holes lie
    field   the region whose maps are compared: no hole reaches into it
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from planish.core.errors import MarkError
from planish.core.tables import raise_faults

Array = NDArray[np.float64]
Layout = Literal["coded", "line", "own"]

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]

FORMAT = "planish hole pattern"
VERSION = 1
SIDES = ("bottom", "right", "top", "left")
_BORDER_DIAMETERS = 1.5  # from the middle of a hole to the end of the view


@dataclass(frozen=True, slots=True, kw_only=True)
class Burn:
    """How a hole is burnt, and what it leaves; defaults as Hirn et al. (2009), section 2.1.

    Attributes
    ----------
    diameter_um : float
        Nominal diameter, 150 to 200 depending on the grammage.
    rim_um : float
        Width of the burnt rim around it.
    pulse_s, pause_s : float
        Length of the laser's pulse, and the rest after it.
    """

    diameter_um: float = 175.0
    rim_um: float = 40.0
    pulse_s: float = 0.005
    pause_s: float = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Pattern:
    """Holes in the order in which they lie around the field, counter-clockwise from the empty corner.

    Attributes
    ----------
    positions_um : tuple of (x, y)
        Centres in stage coordinates.
    lines : tuple of str
        The line of each hole: bottom, right, top or left; ``own`` where a table gave the holes.
    field_um : (width, height)
        Region whose maps are compared.
    margin_um : (x, y)
        From the field's edge to the centres of the holes.
    border_um : float
        From the centres to the end of the view.
    origin_um : (x, y)
        The view's lower left corner in stage coordinates; the stage program ends there.
    spacing_um : float
        Least distance of two holes that was asked for.
    """

    name: str = "pattern"
    layout: Layout = "own"
    positions_um: tuple[tuple[float, float], ...]
    lines: tuple[str, ...]
    field_um: tuple[float, float]
    margin_um: tuple[float, float]
    border_um: float
    origin_um: tuple[float, float] = (0.0, 0.0)
    spacing_um: float = 525.0
    burn: Burn = Burn()
    seed: int = 0

    @property
    def points_um(self) -> Array:
        """Centres as an array (n, 2), stage coordinates."""
        return np.array(self.positions_um, dtype=np.float64).reshape(-1, 2)

    @property
    def labels(self) -> tuple[str, ...]:
        """Number of each hole, from 1."""
        return tuple(str(k + 1) for k in range(len(self.positions_um)))

    @property
    def frame_um(self) -> tuple[float, float]:
        """Width and height of the rectangle on which the holes lie."""
        return self.field_um[0] + 2 * self.margin_um[0], self.field_um[1] + 2 * self.margin_um[1]

    @property
    def frame_low_um(self) -> tuple[float, float]:
        """Lower left corner of that rectangle, stage coordinates."""
        return self.origin_um[0] + self.border_um, self.origin_um[1] + self.border_um

    @property
    def field_low_um(self) -> tuple[float, float]:
        """Lower left corner of the field, stage coordinates."""
        low = self.frame_low_um
        return low[0] + self.margin_um[0], low[1] + self.margin_um[1]

    @property
    def view_um(self) -> tuple[float, float]:
        """Width and height of what has to be imaged."""
        return self.frame_um[0] + 2 * self.border_um, self.frame_um[1] + 2 * self.border_um

    @property
    def imaged_um(self) -> Array:
        """Centres (n, 2) as an image of the laser's side shows them: from its upper left corner, y down."""
        points = self.points_um - self.origin_um
        return np.stack([points[:, 0], self.view_um[1] - points[:, 1]], axis=1)

    def to_json(self) -> str:
        """Write the pattern as JSON; lengths in um, times in s."""
        holes = [
            {"label": label, "x_um": x, "y_um": y, "line": line}
            for label, (x, y), line in zip(self.labels, self.positions_um, self.lines, strict=True)
        ]
        data = {
            "format": FORMAT,
            "version": VERSION,
            "name": self.name,
            "layout": self.layout,
            "axes": "stage, as the laser sees the sheet: x to the right, y up",
            "field_um": list(self.field_um),
            "margin_um": list(self.margin_um),
            "border_um": self.border_um,
            "origin_um": list(self.origin_um),
            "spacing_um": self.spacing_um,
            **asdict(self.burn),
            "seed": self.seed,
            "holes": holes,
        }
        return json.dumps(data, indent=2, allow_nan=False) + "\n"

    @staticmethod
    def from_json(text: str) -> Pattern:
        """Read what :meth:`to_json` wrote."""
        try:
            data: Any = json.loads(text)
        except ValueError as error:
            raise MarkError(f"This is no JSON: {error}. Give the pattern.json of 'planish marks design'.") from error
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise MarkError(f"This JSON holds no '{FORMAT}'. Give the pattern.json of 'planish marks design'.")
        if data.get("version") != VERSION:
            raise MarkError(
                f"The pattern has version {data.get('version')!r}; this planish reads version {VERSION}. Design it "
                "again, or use the planish that wrote it."
            )
        try:
            held = _File.model_validate(data)
        except ValidationError as error:
            faults = [f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors(include_url=False)]
            raise_faults("The pattern", faults, "Design it again.", error=MarkError)
            raise
        own = {name: getattr(held, name) for name in _File.model_fields if name in Pattern.__dataclass_fields__}
        return Pattern(
            positions_um=tuple((hole.x_um, hole.y_um) for hole in held.holes),
            lines=tuple(hole.line for hole in held.holes),
            burn=Burn(**{name: getattr(held, name) for name in asdict(Burn())}),
            **own,
        )


class _Hole(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    x_um: float
    y_um: float
    line: str


class _File(BaseModel):
    """What pattern.json has to hold; further keys are passed over."""

    model_config = ConfigDict(allow_inf_nan=False)

    name: str
    layout: Layout
    field_um: tuple[Positive, Positive]
    margin_um: tuple[float, float]
    border_um: float
    origin_um: tuple[float, float]
    spacing_um: float
    diameter_um: Positive
    rim_um: NotNegative
    pulse_s: Positive
    pause_s: NotNegative
    seed: int
    holes: Annotated[list[_Hole], Field(min_length=3)]


def own_pattern(
    points_um: ArrayLike,
    *,
    name: str = "own",
    field_um: tuple[float, float] | None = None,
    burn: Burn | None = None,
) -> Pattern:
    """Make a pattern of holes that somebody else has placed, so that the same rules can be applied.

    Parameters
    ----------
    points_um : (n, 2)
        Centres, in the order given.
    field_um : (width, height), optional
        Region whose maps are to be compared, in the middle of the holes; where it is not given, all that lies within
        the holes.

    Raises
    ------
    MarkError
        If there are fewer than three holes, or they lie on one line along an axis.
    """
    burn = burn or Burn()
    points = np.asarray(points_um, dtype=np.float64).reshape(-1, 2)
    if len(points) < 3:
        raise MarkError(f"{len(points)} holes are no pattern. Give 12 or more, around the field.")
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    if size.min() <= 0:
        raise MarkError("All holes have the same x or the same y; such a line encloses no field. Place them around it.")
    inwards = 0.5 * burn.diameter_um + burn.rim_um
    field = field_um or (max(float(size[0]) - 2 * inwards, 1.0), max(float(size[1]) - 2 * inwards, 1.0))
    border = _BORDER_DIAMETERS * burn.diameter_um
    return Pattern(
        name=name,
        layout="own",
        positions_um=tuple((float(x), float(y)) for x, y in points),
        lines=("own",) * len(points),
        field_um=field,
        margin_um=((float(size[0]) - field[0]) / 2, (float(size[1]) - field[1]) / 2),
        border_um=border,
        origin_um=(float(low[0]) - border, float(low[1]) - border),
        spacing_um=3 * burn.diameter_um,
        burn=burn,
    )


def border_of(burn: Burn) -> float:
    """Distance from the centres of the holes to the end of the view, in um."""
    return _BORDER_DIAMETERS * burn.diameter_um
