"""A pattern of laser holes.

Where they are meant to be, how each is burnt, what lies around them, and its files.

Coordinates are those of the stage, as the laser sees the sheet: x to the right, y up. From the
outside inwards: ``view``, what has to be imaged, with the stage's origin at its lower left;
``frame``, the rectangle on which the holes lie; ``field``, the region whose maps are compared,
which no hole reaches into.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat

from planish.core.errors import MarkError
from planish.core.robust import rms_length
from planish.core.tables import naming_faults, parse_table, read_text, table_text
from planish.core.typing import Floats, Pair, Texts
from planish.design.params import DesignParams, ImagingParams

FORMAT, VERSION = "planish hole pattern", 1
SIDES = ("bottom", "right", "top", "left")
BORDER_DIAMETERS = 1.5  # from the middle of a hole to the end of the view
BURN = ("diameter_um", "rim_um", "pulse_s", "pause_s")
# Of a unit square, counter-clockwise from the lower left, (x, y).
CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
_COLUMNS = ("label", "x_um", "y_um", "diameter_um")


class PatternHole(BaseModel):
    """Number and centre of a hole, and its line: bottom, right, top or left.

    ``own`` where a table gave the holes.
    """

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    label: str
    x_um: float
    y_um: float
    line: str


class Pattern(BaseModel):
    """Holes in the order in which they lie around the field.

    Counter-clockwise from the empty corner.
    """

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    format: Literal["planish hole pattern"] = FORMAT
    version: Literal[1] = VERSION
    name: str
    layout: Literal["coded", "line", "own"]
    axes: str = "stage, as the laser sees the sheet: x to the right, y up"
    field_um: tuple[PositiveFloat, PositiveFloat] = Field(
        description="Region whose maps are compared, (width, height)."
    )
    margin_um: Pair = Field(
        description="From the field's edge to the centres of the holes, (x, y)."
    )
    border_um: float = Field(description="From the centres to the end of the view.")
    origin_um: Pair = Field(
        description=(
            "The view's lower left corner in stage coordinates, (x, y); the stage program ends"
            " there."
        )
    )
    spacing_um: float = Field(description="Least distance of two holes that was asked for.")
    diameter_um: PositiveFloat = Field(description="Nominal diameter of a hole.")
    rim_um: NonNegativeFloat = Field(description="Width of the burnt rim around a hole.")
    pulse_s: PositiveFloat = Field(description="Length of the laser's pulse.")
    pause_s: NonNegativeFloat = Field(description="The rest after a pulse.")
    seed: int
    holes: tuple[PatternHole, ...] = Field(
        default=(), min_length=3, description="Centres in stage coordinates."
    )

    def with_holes(self, points_um: Floats, lines: Sequence[str]) -> Self:
        """Return the pattern with other holes, (n, 2) in stage coordinates, numbered from 1."""
        holes: list[PatternHole] = []
        for (x, y), line in zip(points_um.tolist(), lines, strict=True):
            label = str(len(holes) + 1)
            holes.append(PatternHole(label=label, x_um=x, y_um=y, line=line))
        return self.model_copy(update={"holes": tuple(holes)})

    @property
    def points_um(self) -> Floats:
        """Centres as an array (n, 2), stage coordinates."""
        points = [(hole.x_um, hole.y_um) for hole in self.holes]
        return np.array(points, dtype=np.float64).reshape(-1, 2)

    @property
    def labels(self) -> Texts:
        """Number of each hole, from 1."""
        return tuple(hole.label for hole in self.holes)

    @property
    def burnt_um(self) -> float:
        """Radius of a hole with its burnt rim."""
        return 0.5 * self.diameter_um + self.rim_um

    @property
    def frame_um(self) -> Floats:
        """Width and height of the rectangle on which the holes lie."""
        return 2 * np.array(self.margin_um) + self.field_um

    @property
    def frame_low_um(self) -> Floats:
        """Lower left corner of that rectangle, stage coordinates."""
        return np.array(self.origin_um) + self.border_um

    @property
    def field_low_um(self) -> Floats:
        """Lower left corner of the field, stage coordinates."""
        return self.frame_low_um + self.margin_um

    @property
    def view_um(self) -> Floats:
        """Width and height of what has to be imaged."""
        return self.frame_um + 2 * self.border_um

    @property
    def imaged_um(self) -> Floats:
        """Centres (n, 2) as an image of the laser's side shows them.

        From its upper left corner, y down.
        """
        x, y = (self.points_um - self.origin_um).T
        return np.stack([x, self.view_um[1] - y], axis=1)

    def to_json(self) -> str:
        """Write the pattern as JSON; lengths in um, times in s."""
        return json.dumps(self.model_dump(), indent=2, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Pattern:
        """Read what :meth:`to_json` wrote; further keys are passed over."""
        advice = "Give the pattern.json of 'planish marks design'."
        try:
            content: Any = json.loads(text)
        except ValueError as error:
            raise MarkError(f"This is no JSON: {error}. {advice}") from error
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise MarkError(f"This JSON holds no '{FORMAT}'. {advice}")
        if content.get("version") != VERSION:
            raise MarkError(
                f"The pattern has version {content.get('version')!r}; this planish reads version"
                f" {VERSION}. Design it again, or use the planish that wrote it."
            )
        with naming_faults("The pattern", "Design it again.", error=MarkError):
            return cls.model_validate({"holes": []} | content)


def own_pattern(
    points_um: ArrayLike,
    *,
    name: str = "own",
    field_um: Pair | None = None,
    diameter_um: float | None = None,
) -> Pattern:
    """Make a pattern of holes that somebody else has placed, so that the same rules can be applied.

    Parameters
    ----------
    points_um : (n, 2); centres, in the order given
    field_um : (width, height), optional
        Region whose maps are to be compared, in the middle of the holes; all within them where not
        given.
    diameter_um : float, optional; that of a design where not given

    Raises
    ------
    MarkError
        If there are fewer than three holes, or they lie on one line along an axis.
    """
    burn = {key: DesignParams.model_fields[key].default for key in BURN}
    diameter = diameter_um or burn["diameter_um"]
    burn["diameter_um"] = diameter
    points = np.asarray(points_um, dtype=np.float64).reshape(-1, 2)
    if len(points) < 3:
        raise MarkError(f"{len(points)} holes are no pattern. Give 12 or more, around the field.")
    size = np.ptp(points, axis=0)
    if min(size) <= 0:
        raise MarkError(
            "All holes have the same x or the same y; such a line encloses no field. Place them"
            " around it."
        )
    burnt_um = 0.5 * diameter + burn["rim_um"]
    field = np.array(field_um or np.maximum(size - 2 * burnt_um, 1.0))
    margin = (size - field) / 2
    border = BORDER_DIAMETERS * diameter
    origin = points.min(axis=0) - border
    blank = Pattern(
        name=name,
        layout="own",
        field_um=field.tolist(),
        margin_um=margin.tolist(),
        border_um=border,
        origin_um=origin.tolist(),
        spacing_um=3 * diameter,
        seed=0,
        **burn,
    )
    return blank.with_holes(points, ("own",) * len(points))


def holes_csv(pattern: Pattern, *, imaged: bool = False) -> str:
    """Write ``label,x_um,y_um,diameter_um``, a hole a row.

    Parameters
    ----------
    imaged : bool
        Positions as in an image of the laser's side, from its upper left corner with y down,
        instead of the stage's.
    """
    rows: list[list[str]] = []
    places_um = pattern.imaged_um if imaged else pattern.points_um
    for label, place_um in zip(pattern.labels, places_um, strict=True):
        numbers = [f"{um:.6f}" for um in (*place_um, pattern.diameter_um)]
        rows.append([label, *(number.rstrip("0").rstrip(".") for number in numbers)])
    return table_text(_COLUMNS, rows)


def read_pattern(
    path: str | Path, *, field_um: Pair | None = None, diameter_um: float | None = None
) -> Pattern:
    """Read a pattern: the JSON of a design, or a CSV table of anybody's holes.

    Parameters
    ----------
    path : str or Path
        A table has the columns ``x_um, y_um`` and may have ``diameter_um``, whose median counts,
        and others.
    field_um : (width, height), optional
        Of a table only: the region in the middle of the holes whose maps are to be compared.
    diameter_um : float, optional, of a table only; goes before the column

    Raises
    ------
    FileError
        If the file cannot be read.
    MarkError
        If it is no pattern, or a number is missing or malformed.
    """
    file_path = Path(path)
    text = read_text(file_path, what="pattern")
    if text.lstrip().startswith("{"):
        if field_um is not None or diameter_um is not None:
            raise MarkError(
                f"{file_path.name} states its field and diameter itself; they can be given for a"
                " CSV table only."
            )
        return Pattern.from_json(text)
    table = parse_table(
        text, file_path.name, needed=_COLUMNS[1:3], optional=_COLUMNS[3:], error=MarkError
    )
    has_diameter = _COLUMNS[3] in table.header
    columns = table.numbers(_COLUMNS[1 : 3 + has_diameter])
    table.check()
    if diameter_um is None and has_diameter and len(columns):
        diameter_um = float(np.median(columns[:, 2]))
    if diameter_um is not None and not 10 <= diameter_um <= 2000:
        raise MarkError(
            f"{file_path.name}: a diameter of {diameter_um:g} um; 10 to 2000 um are possible."
        )
    points_um = columns[:, :2]
    return own_pattern(points_um, name=file_path.stem, field_um=field_um, diameter_um=diameter_um)


# Ratio of the error that 95 % stay below to the rms, where both axes err alike and independently.
P95 = float(np.sqrt(-np.log(0.05)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Predicted:
    """Error that a pattern allows.

    At a distance r from the centroid of N holes with the rms radius f, for a similarity: ``TRE**2 =
    FLE**2 / N * (1 + r**2 / f**2)`` (J. M. Fitzpatrick, J. B. West, C. R. Maurer, IEEE Transactions
    on Medical Imaging 17 (1998) 694-702, https://doi.org/10.1109/42.736021; with a free scale the
    second term of two dimensions doubles).
    """

    fle_um: float  #: Error of one hole's position in one map against the other, rms in the plane.
    holes_um: Floats  #: (n, 2), stage coordinates.
    field_um: Floats  #: Middle and corners of the field, (5, 2).

    @property
    def radius_um(self) -> float:
        """Rms distance of the holes from their centroid."""
        return rms_length(self.holes_um - self.holes_um.mean(axis=0))

    @property
    def centre_um(self) -> float:
        """Error of the map, rms, in the middle of the field."""
        return float(self.at(self.field_um[0]))

    @property
    def corner_um(self) -> float:
        """Error of the map, rms, in the field's worst corner."""
        return float(self.at(self.field_um[1:]).max())

    def at(self, points_um: ArrayLike) -> Floats:
        """Predict the rms error, in um, at points (..., 2) in stage coordinates."""
        offsets = np.asarray(points_um) - self.holes_um.mean(axis=0)
        r2 = np.sum(offsets**2, axis=-1)
        mean_um = self.fle_um / np.sqrt(len(self.holes_um))
        growth = np.sqrt(1 + r2 / self.radius_um**2)
        return np.asarray(mean_um * growth)

    def sentence(self) -> str:
        """Write the error in a line."""
        return (
            f"predicted error: {self.centre_um:.2f} um rms in the middle of the field,"
            f" {self.corner_um:.2f} um in its worst corner (95 % below {P95 * self.corner_um:.2f}"
            f" um), from {self.fle_um:.2f} um for a hole"
        )


def size_text(size_um: Iterable[float]) -> str:
    """Write the sides of a field in mm: ``10 x 8``."""
    return " x ".join(f"{side / 1000:g}" for side in size_um)


def hole_error_um(diameter_um: float, imaging: ImagingParams | None = None) -> float:
    """Predict the error of one hole's position in one map against the other.

    Parameters
    ----------
    diameter_um : float
    imaging : ImagingParams, optional; pixels of the two maps, roughness of the rims

    Returns
    -------
    float; rms in the plane, in um

    Notes
    -----
    A rim whose radius varies by ``s`` over a length ``l`` has ``n = pi d / l`` independent arcs; a
    circle through them is off by ``2 s / sqrt(n)``. The pixels add 0.1 pixel along each axis. Both
    count once for each of the two maps: the two instruments do not see the same rim.
    """
    imaging = imaging or ImagingParams()
    arcs = max(np.pi * diameter_um / imaging.rim_length_um, 3.0)  # fewer fix no circle
    rim_um2 = 4 * imaging.roughness_um**2 / arcs
    variances_um2 = [rim_um2 + 2 * (0.1 * pixel) ** 2 for pixel in imaging.pixel_um]
    return float(np.sqrt(sum(variances_um2)))


def predict(pattern: Pattern, imaging: ImagingParams | None = None) -> Predicted:
    """Predict the error of a registration by a similarity over the pattern's field.

    Parameters
    ----------
    pattern : Pattern
    imaging : ImagingParams, optional; as for :func:`hole_error_um`

    Returns
    -------
    Predicted; error in um, at the field's middle, its corners, or any point
    """
    fle_um = hole_error_um(pattern.diameter_um, imaging)
    middle_and_corners = np.vstack([[0.5, 0.5], CORNERS])
    field_points = middle_and_corners * pattern.field_um + pattern.field_low_um
    return Predicted(fle_um=fle_um, holes_um=pattern.points_um, field_um=field_points)
