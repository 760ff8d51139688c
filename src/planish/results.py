"""What a run says in numbers.

Frozen models make ``results.json``, its JSON schema and the page.

NaN and infinity have no place in JSON: such numbers are None. Lengths are in um where the name says
so.
"""

import json
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from planish.analyze.compare import ComparisonRow, CorrelationRow
from planish.analyze.correlation_evidence import EvidenceFacts
from planish.analyze.explain import Explained
from planish.analyze.image_values import ImageFacts
from planish.analyze.lag import LagNumbers
from planish.analyze.mottle import Mottle
from planish.analyze.refinement import RefinementFacts, RefinementR
from planish.analyze.scales import Scales
from planish.core.checks import Check, State
from planish.core.errors import FileError
from planish.core.facts import (
    DescribedModel,
    HoleTiltFacts,
    InputFile,
    Number,
    Pair,
    SheetNumbers,
    Side,
    Trust,
)
from planish.core.older_names import FORMAT, todays_names
from planish.core.source_hash import is_this_code
from planish.core.tables import naming_faults
from planish.core.typing import Entries, Texts
from planish.flatten import FlatteningQuality


class SurfaceFacts(DescribedModel):
    """What the surface search learnt, and how much of the sheet it measured."""

    through: Literal["z", "y", "x"]
    """Axis through the sheet."""
    top_side: Literal["high", "low"]
    """End of that axis at which the top side lies."""
    row_axis: str
    """Axis of the volume that runs down the rows of the surfaces."""
    col_axis: str
    """Axis of the volume that runs along their columns."""
    thickness_um: Number
    """Median thickness of the sheet, as the first look found it."""
    blur_um: Number
    """Standard deviation of the blur of the scan; None where no edge shows it."""
    fringe: Number
    """Phase-contrast fringe as a share of an edge's step; 0 where there is none."""
    fringe_um: Number
    """Distance of the fringe from the edge."""
    cutoff_um: Number
    """Wavelength of the centre surface that the smoothing halves."""
    bridged_share: Number = None
    """Share of the columns where gaps needed a wider cut-off."""
    bridged_off_rims_share: Number = None
    """The same away from holes and their rims."""
    rim_um: Number
    """Zone around holes and gaps that is left out."""
    missing_share: Number
    """Share of the voxels that are NaN or infinite."""
    empty_share: Number = None
    """Share of the columns that hold nothing but air."""
    polarity: Number
    """1 where the sheet is lighter than air, -1 where it is darker."""
    grey_air: Number
    """Grey of the air."""
    grey_base: Number
    """Grey of the base."""
    grey_coating_top: Number
    """Grey of the top coating; None where there is none."""
    grey_coating_bottom: Number
    """Grey of the bottom coating; None where there is none."""
    grey_noise: Number
    """Standard deviation of the grey from voxel to voxel."""
    columns: int
    """Number of columns."""
    particles_removed: int
    """Particles that were left out: those that float, and those that stick to a face."""
    half_closed_holes: int
    """Holes of which less than 70 % is open."""
    shares: dict[str, float]
    """Share of the columns with each status."""


class PropertyFacts(DescribedModel):
    """Distribution of one property over the columns."""

    WITHHELD: ClassVar = (
        "mean",
        "sd",
        "coefficient_of_variation",
        "p5",
        "median",
        "p95",
        "standard_error",
    )

    units: str
    """Unit of all values; 1 for a share."""
    n: int
    """Columns with a value."""
    mean: Number
    """Mean over the columns."""
    sd: Number
    """Standard deviation over the columns."""
    coefficient_of_variation: Number = None
    """sd over mean, a share; None of what has no zero of its own, such as heights and angles."""
    p5: Number
    """5th percentile."""
    median: Number
    """Median."""
    p95: Number
    """95th percentile."""
    trust: Trust = "ok"
    """What the checks leave of the figures."""
    standard_error: Number = None
    """Median of the standard errors of single columns."""
    n_independent: int | None = None
    """How many independent values the columns have: neighbours share their errors."""
    mean_standard_error: Number = None
    """Standard error of the mean over the columns, from the measurement alone."""
    support_um: Number = None
    """Size of the region that one value stands for."""
    period_deg: Number = None
    """180 for angles of an axis, whose mean and spread these are."""


class SectionFacts(DescribedModel):
    """How serial sections were joined: what was taken off, and what is left of the quick errors."""

    kind: str
    """Photographs of the block face, or of sections."""
    count: int
    """Sections that were read."""
    not_aligned: int
    """Sections that match no neighbour and were left out."""
    missing: int
    """Missing sections that were bridged."""
    cutoff_um: float
    """Waves longer than this along the cut were left alone."""
    fixed: Texts
    """What held the slow waves: row, col, rotation; empty without anything fixed."""
    pairs_used: int
    """Pairs of sections that were compared."""
    pairs_refused: int
    """Pairs that did not agree with the others."""
    gain_sd: Number
    """Standard deviation of the gain from section to section."""
    shift_row_rms_um: Number
    """Shifts along the rows' axis that were removed, rms."""
    shift_col_rms_um: Number
    """The same along the columns' axis."""
    jitter_left_row_um: Number
    """What is left of the quick errors along the rows' axis, standard deviation."""
    jitter_left_col_um: Number
    """The same along the columns' axis."""


class SheetFacts(DescribedModel):
    """A sheet that was measured and flattened."""

    surfaces: SurfaceFacts
    """The surface search."""
    properties: dict[str, PropertyFacts]
    """Distribution of each property, by name."""
    numbers: SheetNumbers | None
    """None where they are withheld."""
    flatten: FlatteningQuality
    """The flattening."""
    sections: SectionFacts | None = None
    """Where the volume was joined of serial sections."""

    @property
    def uncovered_areas(self) -> dict[str, tuple[float | None, float | None]]:
        """Uncovered area ratio of each coating and its standard error, by the name of the map."""
        thin = {} if self.numbers is None else self.numbers.thin
        return {f"coating_{side}": facts.uncovered_area_ratio for side, facts in thin.items()}


class ErrorShares(DescribedModel):
    """Where the expected error of the places comes from: root mean squares over the map, in um."""

    marks_um: Number = None
    """Marks, and what the model of the registration leaves open."""
    neutral_um: Number = None
    """Which surface stays unstrained where the sheet is bent."""
    smoothing_um: Number = None
    """Smoothing of the centre surface, and its bridges over holes."""
    sections_um: Number = None
    """What is left of the poses of serial sections."""
    lines_um: Number = None
    """Uneven motion of the carriage of an office scanner."""
    rms_um: float
    """Root mean square of the whole."""
    largest: Literal["marks", "neutral", "smoothing", "sections", "lines"]
    """The share that is largest."""
    sentence: str
    """The same in words, with what would lower it."""


class ExpectedError(DescribedModel):
    """How far a pixel may be off, rms, over the map."""

    WITHHELD: ClassVar = ("median_um", "largest_um")

    median_um: Number
    """Median over the map."""
    largest_um: Number
    """Largest value of the map."""
    trust: Trust = "ok"
    """What the checks leave of the figures."""
    shares: ErrorShares | None = None
    """Where it comes from; of a sheet only."""


class OrientationFacts(DescribedModel):
    """How two planes lie on each other: side, hand and machine direction, as given."""

    image_side: Side
    """Side that the fixed layer shows."""
    side_given: bool
    """Whether that was given; assumed otherwise."""
    mirrored_volume: bool
    """Whether the marks fit mirrored only: slices numbered against the usual sense."""
    md_deg_moving: Number
    """Machine direction in the moving layer, as given."""
    md_deg_fixed: Number
    """The same in the fixed layer, as given."""
    md_deg_fixed_from_moving: Number
    """The first carried over by the registration; 0 to 180."""
    sentence: str
    """The same in words."""

    @property
    def remedy(self) -> str:
        """What the next run can be given; names parameters."""
        words = [] if self.side_given else ["`image_side`"]
        if self.md_deg_moving is None and self.md_deg_fixed is None:
            words += ["`md_deg`", "`image_md_deg`"]
        return f"Options: {', '.join(words)}." if words else ""


class RegistrationFacts(DescribedModel):
    """How a layer was registered to another one."""

    to: str
    """Layer that it was registered to."""
    path: Texts
    """Layers from this one to the reference."""
    source: str
    """'found', 'texture', or the kind of file that the marks came from."""
    found_moving: int
    """Marks found in the moving layer."""
    found_fixed: int
    """Marks found in the fixed layer."""
    matched: int
    """Pairs in use."""
    second_best: int | None
    """Marks that the second-best match has in common."""
    match_sentence: str | None
    """How the marks were matched."""
    design: str | None = None
    """Name of the pattern that was burnt, where one was given."""
    tilt: HoleTiltFacts | None = None
    """What the holes look like through the sheet."""
    model: str
    """Model of the transform that was fitted."""
    model_sentence: str
    """The model and its errors in words."""
    warnings: Texts
    """What to be careful about."""
    rms_um: float
    """Root mean square of the residuals."""
    leave_one_out_rms_um: Number
    """Root mean square of the leave-one-out errors."""
    expected_error: ExpectedError | None
    """How far a pixel may be off."""
    scale: float
    """Scale of the closest similarity."""
    rotation_deg: float
    """Rotation of the closest similarity."""
    shift_um: Pair
    """Shift of the closest similarity, along x and y."""
    mirrored: bool
    """Whether the transform mirrors."""
    orientation: OrientationFacts
    """Side, hand and machine direction."""
    lag: LagNumbers | None = None
    """The image-based check; of a sheet on an image only."""
    false_probability: Number = None
    """Of a place found by texture: that unrelated layers would have been linked."""
    held_out: RefinementR | None = None
    """r that a place found by texture was not tuned on."""


class LayerFacts(DescribedModel):
    """One layer: a sheet or an image."""

    name: str
    """Name of the layer."""
    kind: Literal["sheet", "image"]
    """sheet or image."""
    source: InputFile
    """The file that it was read from."""
    headline: str
    """The map that stands for the layer."""
    share_of_reference: Number = None
    """Share of the reference's pixels that show the layer."""
    registration: RegistrationFacts | None = None
    """None for the reference."""
    sheet: SheetFacts | None = None
    """None for an image."""
    image: ImageFacts | None = None
    """None for a sheet."""


class LinkedArea(DescribedModel):
    """How much of the reference shows all layers, and how much of that is valid."""

    pixels: int
    """Pixels of the reference."""
    share_on_sheet: float
    """Share of them that shows the sheet."""
    share_valid: float
    """Share of them that is valid."""
    share_valid_of_sheet: float
    """Share of the sheet's pixels that is valid."""
    share_valid_away_from_holes: float
    """The same away from holes and their rims."""


class RegionFacts(DescribedModel):
    """A region that was declared an artefact; its texts are empty where they are not given."""

    name: str
    """Name of the region."""
    reason: str
    """Why its pixels do not count."""
    author: str
    """Who declared it."""
    share: float
    """Share of the reference's pixels."""


class RegionsFacts(DescribedModel):
    """Regions that were declared artefacts.

    Their pixels are not valid and count in no correlation.
    """

    count: int
    """Number of regions."""
    share: float
    """Share of the reference's pixels that lie in a region."""
    regions: tuple[RegionFacts, ...]
    """Each of them."""


class Results(DescribedModel):
    """All numbers of a run: a map of one sheet, or layers linked onto the last one."""

    format: Literal[4] = FORMAT
    """Version of this schema."""
    stored_format: SkipJsonSchema[int] = Field(default=FORMAT, exclude=True)
    """Format of the file that was read; only in Python."""
    planish: str
    """Version of the program."""
    code: str = ""
    """Hash of the program's sources; empty where not all is of one code."""
    commit: str = Field(
        default="",
        description=(
            "Commit of the checkout that ran, with + where files of the program differ from it;"
            " empty where there is none."
        ),
    )
    versions: dict[str, str]
    """Versions of the libraries that numbers depend on."""
    layers: tuple[LayerFacts, ...]
    """In the order given; the last one is the reference of a link."""
    chain: bool = False
    """Whether each layer was registered to the next one."""
    correlations: tuple[CorrelationRow, ...] = ()
    """Every pair of layers at each size of points."""
    comparison: tuple[ComparisonRow, ...] = ()
    """The headline correlation by projection and flattening."""
    evidence: tuple[EvidenceFacts, ...] = ()
    """What stands beside the headline correlation."""
    linked: LinkedArea | None = None
    """How much of the reference is valid; of a link only."""
    regions: RegionsFacts | None = None
    """Declared artefacts, where there are any."""
    mottle: tuple[Mottle, ...] = ()
    """Unevenness of the image by octaves of wavelength."""
    refinement: RefinementFacts | None = None
    """Where the registration was refined by the maps."""
    explained: Explained | None = None
    """The model that the study declares."""
    explain_reason: str = ""
    """Why there is no such model."""
    scales: Scales | None = None
    """Octaves of the maps that the study declares."""
    scales_reason: str = ""
    """Why there are no such octaves."""
    checks: tuple[Check, ...]
    """Every check with its state."""
    parameters: Entries
    """Every parameter of the study; paths are left out."""

    @property
    def is_of_this_code(self) -> bool:
        """Whether the same version made them, from the same sources."""
        return is_this_code(self.planish, self.code)

    @property
    def is_light_off(self) -> bool:
        """Whether a field of light was taken off the image, as the study declared."""
        return self.parameters.get("correlate", {}).get("light") is not None

    @property
    def is_older(self) -> bool:
        """Whether an older version made them, in an older format."""
        return self.stored_format < FORMAT

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return self.state != "fail"

    @property
    def state(self) -> State:
        """The worst state of all checks: fail, look, unknown, or pass."""
        order: tuple[State, ...] = ("fail", "look", "unknown", "pass")
        states = {check.state for check in self.checks} | {"pass"}
        return next(state for state in order if state in states)

    def checks_in(self, *states: State) -> list[Check]:
        """The checks in these states."""
        return [check for check in self.checks if check.state in states]

    @property
    def is_link(self) -> bool:
        """Whether layers were linked; otherwise one sheet was mapped."""
        return len(self.layers) > 1

    @property
    def reference(self) -> LayerFacts:
        """The layer that all others were brought to."""
        return self.layers[-1]

    @property
    def moving(self) -> tuple[LayerFacts, ...]:
        """The layers that were brought to the reference."""
        return self.layers[:-1]

    def layer(self, name: str) -> LayerFacts:
        """The layer of a name."""
        return next(layer for layer in self.layers if layer.name == name)

    def to_json(self) -> str:
        """The text of ``results.json``."""
        return self.model_dump_json(indent=2) + "\n"

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read ``results.json``.

        Raises
        ------
        FileError
            If it cannot be read, is damaged, or has an older format.
        """
        try:
            data: Any = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise FileError(
                f"{path} cannot be read: {error}. Give a whole run folder, or repeat the run."
            ) from error
        if isinstance(data, dict) and str(data.get("planish", "")).startswith("0.1."):  # type: ignore[reportUnknownArgumentType]
            raise FileError(
                f"{path.parent} was made by planish 0.1.0. Its maps and its report.html stay"
                " readable, but the errors stated there are about 1.5 times too small. Repeat it"
                f" with this version: planish run {path.parent}/run.toml"
            )
        if isinstance(data, dict) and data.get("format") in (2, 3):  # type: ignore[reportUnknownMemberType]
            data = _from_older_format(data)  # type: ignore[reportUnknownArgumentType]
        remedy = "Give a whole run folder, or repeat the run."
        with naming_faults(f"{path} is no results file of planish", remedy, error=FileError):
            return cls.model_validate(data)


def _from_older_format(stored_json: Entries) -> Entries:
    """Bring results of format 2 (planish 0.2.0) or 3 to today's format."""
    stored_format = stored_json["format"]
    if stored_format == 2:
        stored_json = _from_format_2(stored_json)
    return todays_names(stored_json) | {"format": FORMAT, "stored_format": stored_format}


# By later formats.
_LEFT_OUT_OF_2 = (
    "saturated_share",
    "null_95",
    "null_99",
    "split_um",
    "lags_of_bands_um",
    "ceiling_sentence",
)


def _from_format_2(stored_json: Any) -> Any:
    """Bring what is read of a file of format 2 (planish 0.2.0) to format 3.

    The gates of format 2 passed or failed.
    """
    if isinstance(stored_json, list):
        return [_from_format_2(part) for part in stored_json]  # type: ignore[reportUnknownVariableType]
    if not isinstance(stored_json, dict):
        return stored_json
    converted: Entries = {
        name: _from_format_2(part)
        for name, part in stored_json.items()
        if name not in (*_LEFT_OUT_OF_2, "gates")
    }
    if "gates" in stored_json:
        checks: list[Any] = []
        for gate in stored_json["gates"]:
            same = {name: gate[name] for name in ("name", "sentence", "value", "limit")}
            checks.append(same | {"state": "pass" if gate["passed"] else "fail"})
        sentence = (
            f"Made by planish {stored_json['planish']}, which made fewer checks and stated no"
            " intervals."
        )
        older_version = {
            "name": "version",
            "state": "unknown",
            "figures": ("correlation", "position"),
            "sentence": sentence,
            "advice": "Repeat it with this version: planish run with the run.toml of this run.",
        }
        converted["checks"] = [*checks, older_version]
    return converted
