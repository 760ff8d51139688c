"""What a series of specimens says in numbers.

Frozen models make its ``results.json`` and its page.

Sheets, not fields, are the sample: means, intervals and tests are over means of sheets.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from planish.analyze.agreement import Agreement
from planish.analyze.between_sheets import Equivalence, SetDifference
from planish.analyze.sheets import SheetMean
from planish.core.checks import State
from planish.core.errors import FileError
from planish.core.facts import (
    DescribedModel,
    KnownPair,
    Number,
    Trust,
    Unsaved,
    UnsavedInterval,
    Value,
    is_known,
    optional,
)
from planish.core.older_names import todays_names
from planish.core.tables import naming_faults, read_text
from planish.core.typing import Texts

# ``whole``: linked, no check failed. ``withheld``: linked, and a check failed. ``refused``: its
# input cannot be used. ``damaged``: a fault of the machine or of planish: memory, disk, a process
# that ended. ``open``: not done yet.
MemberState = Literal["whole", "withheld", "refused", "damaged", "open"]

# Factors that planish knows the meaning of; a table may have others, by which it only sorts.
FACTORS = ("paper", "sheet", "field", "treatment", "side")


class Member(DescribedModel):
    """One specimen of a series."""

    name: str
    """Name of the specimen; its run has this name, too."""
    factors: dict[str, str] = Field(default_factory=dict)
    """Factors, such as paper, sheet and treatment."""
    state: MemberState = "open"
    """whole, withheld, refused, damaged or open."""
    message: str = ""
    """Why there is no run, or what a check refuted, and what to do."""
    seconds: float | None = None
    """Time that the link took."""
    run: str | None = None
    """Folder of its run, relative to that of the series."""

    def folder(self, home: Path) -> Path | None:
        """Folder of its run."""
        return None if self.run is None else home / self.run


FORMAT = 2  # version of the schema; planish 0.2.0 wrote 1
What = Literal["mean", "sd", "thin_share", "r"]  # statistics that are compared over specimens

# What a run is: one sheet mapped; a sheet linked to an image; two sheets linked; more layers, or
# two images.
RunKind = Literal["map", "sheet on image", "two volumes", "layers"]


class Quantity(DescribedModel):
    """One figure that every specimen has: a statistic of a map, or r of two maps."""

    layer: str = ""
    """Layer of the map; empty where each specimen has one sheet."""
    map: str
    """Name of the map."""
    what: What
    """mean, sd, thin_share, or r with the other map."""
    other_layer: str = ""
    """Layer of the other map of r; empty as for layer."""
    other_map: str = ""
    """The other map of r."""
    at_um: Number = None
    """Limit of a thin share, or edge of the points of r."""
    unit: str
    """Of its values; 1 for a share and for r."""
    title: str
    """The same in words."""
    map_title: str
    """Title of the map."""


class Cell(DescribedModel):
    """A quantity of one specimen."""

    value: Number = None
    """None where it was not measured, or is withheld."""
    low: Number = None
    """Lower end of its 95 % interval, of r only."""
    high: Number = None
    """Upper end of it."""
    n_eff: Number = None
    """Independent points, of r only."""
    n_eff_interval: Number = None
    """Independent points that would give the interval of r."""
    trust: Trust = "ok"
    """What the checks leave of it."""
    counts: bool = False
    """Whether it takes part in means and comparisons."""
    why_not: str = ""
    """Why it does not; empty where it does."""


class SeriesSpecimen(DescribedModel):
    """One specimen: what it is, what was found, and what its checks say."""

    member: Member
    """Name, factors, state and run."""
    kind: RunKind | None = None
    """None where there is no run."""
    sheet: str = ""
    """Sheet that it counts as a field of, among those of its paper."""
    light: State | None = None
    """Worst state of its checks."""
    spoken: dict[State, Texts] = Field(default_factory=dict)
    """Names of the checks that fail, ask for a look, or could not be answered."""
    marks_used: int | None = None
    """Pairs of marks in use; the fewest of its layers."""
    leave_one_out_um: Number = None
    """Root mean square of the leave-one-out errors; the largest of its layers."""
    expected_error_um: Number = None
    """Median of the expected error of a pixel; the largest of its layers."""
    cells: tuple[Cell, ...] = ()
    """One for each quantity of the series."""

    @property
    def name(self) -> str:
        """Name of the specimen."""
        return self.member.name

    def factor(self, name: str) -> str:
        """Level of a factor; empty where the specimen has none."""
        return self.member.factors.get(name, "")


Specimens = Sequence[SeriesSpecimen]


class _OfGroup(DescribedModel):
    quantity: int
    """Number of the quantity, from 0."""
    group: dict[str, str]
    """Levels of the factors; empty where all specimens are one group."""


class GroupFacts(SheetMean, _OfGroup):
    """One quantity over the sheets of one group."""


class _OfLevels(DescribedModel):
    quantity: int
    """Number of the quantity, from 0."""
    within: dict[str, str]
    """Levels of the other factors that both share."""
    factor: str
    """Factor that is compared."""
    levels: tuple[str, str]
    """Its two levels."""


class DifferenceFacts(SetDifference, _OfLevels):
    """One quantity of two levels of a factor, the second minus the first."""

    smallest_seen: Value = optional("Difference that such a study sees in 80 % of cases.")
    unpaired: Texts = ()
    """Sheets without a partner, where sheets pair."""
    left_out: Texts = ()
    """Specimens of both levels that do not count."""
    reason: str = ""
    """Why there is no interval."""
    equivalence: Equivalence | None = None
    """Where a margin was declared."""

    @property
    def verdict(self) -> Literal["differ", "not after Holm", "not distinguishable", "unknown"]:
        """Whether both levels differ, also among all differences that were looked at."""
        if not is_known(self.interval) or not is_known(self.p_of_table):
            return "unknown"
        low, high = self.interval
        if low <= 0 <= high:
            return "not distinguishable"
        return "differ" if self.p_of_table < 0.05 else "not after Holm"


class _OfTwoLayers(DescribedModel):
    specimen: str
    """Name of the specimen."""
    a: str
    """First layer."""
    b: str
    """Second layer."""
    map: str
    """The map that both show."""
    unit: str
    """Of bias and limits."""


class InstrumentFacts(Agreement, _OfTwoLayers):
    """Two measurements of one sheet, b less a."""

    sd: Unsaved = optional("Standard deviation of b - a.")
    sd_interval: UnsavedInterval = optional("95 % interval of the standard deviation.")
    slopes: KnownPair = None
    """Slope of b over a, and 1 over that of a over b."""
    shared_um: Number = None
    """Both show the same in waves of this length and longer."""
    sentence: str = ""
    """What the rings of waves say, in words."""
    trust: Trust = "ok"
    """What the checks leave of it."""


class SeriesResults(DescribedModel):
    """All numbers of a series of specimens."""

    format: Literal[2] = FORMAT
    """Version of this schema."""
    stored_format: SkipJsonSchema[int] = Field(default=FORMAT, exclude=True)
    """Format of the file that was read; only in Python."""
    planish: str
    """Version of the program."""
    declared: dict[str, object]
    """What was declared: factor, margins, maps, doubtful figures."""
    quantities: tuple[Quantity, ...]
    """What is compared, the leading map first."""
    headline_declared: bool
    """Whether the maps were declared; else they are those of the runs."""
    factors: Texts = ()
    """All factors of the table."""
    grouped_by: Texts = ()
    """Factors that make the groups."""
    compared_by: str | None = None
    """Factor that is compared; None where there is none."""
    sheets_given: bool
    """Whether the table names the sheet of every specimen."""
    specimens: tuple[SeriesSpecimen, ...]
    """In the order of the table."""
    groups: tuple[GroupFacts, ...] = ()
    """By group and quantity."""
    differences: tuple[DifferenceFacts, ...] = ()
    """By quantity and pair of levels."""
    instruments: tuple[InstrumentFacts, ...] = ()
    """Specimens measured by two instruments."""
    cautions: Texts = ()
    """What to be careful about."""

    @model_validator(mode="before")
    @classmethod
    def _with_todays_names(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("format") == 1:  # type: ignore[reportUnknownMemberType]
            return todays_names(data) | {"format": FORMAT, "stored_format": 1}
        return data  # type: ignore[reportUnknownVariableType]

    @property
    def members(self) -> tuple[Member, ...]:
        """What became of each specimen."""
        return tuple(specimen.member for specimen in self.specimens)

    def to_json(self) -> str:
        """The text of ``results.json``."""
        return self.model_dump_json(indent=2) + "\n"

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read ``results.json`` of a series.

        FileError if it cannot be read, or is not of a series.
        """
        remedy = "Give the folder that 'planish study' or 'planish compare --out' made."
        with naming_faults(f"{path} is no results file of a series", remedy, error=FileError):
            return cls.model_validate_json(read_text(path, what="results of a series"))
