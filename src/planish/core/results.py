"""What a run says in numbers: frozen models that make ``results.json``, its JSON schema and the page.

NaN and infinity have no place in JSON: such numbers are None. Lengths are in um where the name says so.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, ValidationError

from planish.core.checks import Check, State
from planish.core.errors import FileError
from planish.core.facts import Facts, KnownPair, Number, Pair, Side

FORMAT = 3
"""Version of the schema; planish 0.1.0 wrote files without one."""

Trust = Literal["ok", "doubtful", "withheld"]
"""What the checks leave of a figure; numbers that are withheld are None."""


class InputFile(Facts):
    """A file that was read, and the hash that tells it from every other."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    bytes: int
    sha256: str
    size_um: tuple[float, ...] = Field(description="Voxel size (z, y, x) or pixel size (y, x).")
    size_source: str


# --- a sheet -------------------------------------------------------------------------------------------------------


class SurfaceFacts(Facts):
    """What the surface search learnt, and how much of the sheet it measured."""

    through: Literal["z", "y", "x"]
    top_side: Literal["high", "low"]
    row_axis: str
    col_axis: str
    thickness_um: Number
    blur_um: Number
    fringe: Number
    fringe_um: Number
    cutoff_um: Number
    bridged_share: Number = Field(None, description="Share of the columns where gaps needed a wider cut-off.")
    bridged_off_rims_share: Number = Field(None, description="The same away from holes and their rims.")
    rim_um: Number
    missing_share: Number
    empty_share: Number = Field(None, description="Share of the columns that hold nothing but air.")
    polarity: Number
    grey_air: Number
    grey_base: Number
    grey_coating_top: Number
    grey_coating_bottom: Number
    grey_noise: Number
    columns: int
    particles_removed: int
    half_closed_holes: int
    shares: dict[str, float] = Field(description="Share of the columns with each status.")


class PropertyFacts(Facts):
    """Distribution of one property over the columns."""

    WITHHELD: ClassVar = ("mean", "sd", "p5", "median", "p95", "standard_error")

    units: str
    n: int
    mean: Number
    sd: Number
    p5: Number
    median: Number
    p95: Number
    trust: Trust = "ok"
    standard_error: Number = Field(default=None, description="Median of the standard errors of single columns.")
    n_independent: int | None = Field(
        default=None, description="How many independent values the columns have: neighbours share their errors."
    )
    mean_standard_error: Number = Field(
        default=None, description="Standard error of the mean over the columns, from the measurement alone."
    )
    support_um: Number = Field(default=None, description="Size of the region that one value stands for.")


class ThinFacts(Facts):
    """Shares of a coating that are thinner than some limits."""

    thinner_than_um: tuple[float, ...]
    share: tuple[Number, ...]
    support_um: float
    warning: str | None


class RoughnessFacts(Facts):
    """Areal roughness numbers (ISO 25178-2) of one face, or the reason why there are none."""

    sa: Number = None
    sq: Number = None
    ssk: Number = None
    sku: Number = None
    sz: Number = None
    sdq: Number = None
    n: int | None = None
    s_filter_um: Number = None
    l_filter_um: Number = None
    reason: str | None = None


class TwoSidesFacts(Facts):
    """Top against bottom."""

    coating_difference_um: Number = None
    coating_sd_ratio: Number = None
    coating_correlation: Number = None
    coating_n: int | None = None
    topography_difference_um: Number = None
    topography_sd_ratio: Number = None
    topography_correlation: Number = None
    topography_n: int | None = None


class ProfileFacts(Facts):
    """Mean of some properties over the depth of the sheet, 0 at the top face and 1 at the bottom face."""

    depth: tuple[float, ...]
    values: dict[str, tuple[Number, ...]]


class SheetNumbers(Facts):
    """What describes a sheet and is no map; keyed by side."""

    thin: dict[Side, ThinFacts]
    roughness: dict[Side, RoughnessFacts]
    two_sides: TwoSidesFacts
    profiles: ProfileFacts | None = None


class Percentiles(Facts):
    """Distribution of one strain over the mesh."""

    median: Number
    p5: Number
    p95: Number
    p95_abs: Number
    max_abs: Number


class GeodesicFacts(Facts):
    """Relative errors of long distances: flat against along the surface."""

    p50: Number
    p95: Number
    largest: Number
    used: int
    dropped: int


class DistortionFacts(Facts):
    """How much the flattening strained the sheet."""

    area: Percentiles
    axial_u: Percentiles
    axial_v: Percentiles
    shear: Percentiles
    cells: int
    inverted_cells: int
    boundary_space_um: Number
    boundary_flat_um: Number
    growth_percent: Number
    growth_anisotropy_percent: Number
    growth_direction_deg: Number
    displacement_median_um: Number
    displacement_p95_um: Number
    displacement_max_um: Number
    geodesics: GeodesicFacts | None


class CurvatureFacts(Facts):
    """Whether the surface can be flat at all."""

    patch_um: float
    limit: float
    share: Number
    largest: Number
    verdict: str


class FlattenFacts(Facts):
    """How the flattening ended."""

    outcome: str
    sentence: str
    steps: int
    energy_um2: float
    mesh_um: float
    folded_cells: int
    edge_strain_p95: Number
    edge_strain_max: Number
    method: str
    neutral: Literal["base", "faces"] = Field("faces", description="Surface that was taken to stay unstrained.")
    springs: int
    straight_share: Number
    distortion: DistortionFacts
    curvature: CurvatureFacts
    largest_move_um: Number


class SectionFacts(Facts):
    """How serial sections were joined: what was taken off, and what is left of the quick errors."""

    kind: str
    count: int
    not_aligned: int
    missing: int
    cutoff_um: float
    fixed: tuple[str, ...]
    pairs_used: int
    pairs_refused: int
    gain_sd: Number
    shift_row_rms_um: Number
    shift_col_rms_um: Number
    jitter_left_row_um: Number
    jitter_left_col_um: Number


class SheetFacts(Facts):
    """A sheet that was measured and flattened."""

    surfaces: SurfaceFacts
    properties: dict[str, PropertyFacts]
    numbers: SheetNumbers | None = Field(description="None where they are withheld.")
    flatten: FlattenFacts
    sections: SectionFacts | None = None


# --- layers brought together -----------------------------------------------------------------------------------------


class HoleTiltFacts(Facts):
    """What the holes of a sheet look like through its thickness."""

    through: int
    closed: int
    unclear: int
    other_side_only: int
    offset_count: int
    offset_um: tuple[Number, Number]
    offset_spread_um: tuple[Number, Number]
    offset_error_um: tuple[Number, Number]
    tilt_deg: tuple[Number, Number] | None = None
    side: Side
    sentence: str


class ErrorShares(Facts):
    """Where the expected error of the places comes from: root mean squares over the map, in um."""

    marks_um: Number = Field(None, description="Marks, and what the model of the registration leaves open.")
    neutral_um: Number = Field(None, description="Which surface stays unstrained where the sheet is bent.")
    smoothing_um: Number = Field(None, description="Smoothing of the centre surface, and its bridges over holes.")
    sections_um: Number = Field(None, description="What is left of the poses of serial sections.")
    rms_um: float
    largest: Literal["marks", "neutral", "smoothing", "sections"]
    sentence: str


class ExpectedError(Facts):
    """How far a pixel may be off, rms, over the map."""

    WITHHELD: ClassVar = ("median_um", "largest_um")

    median_um: Number
    largest_um: Number
    trust: Trust = "ok"
    shares: ErrorShares | None = Field(None, description="Where it comes from; of a sheet only.")


class OrientationFacts(Facts):
    """How two planes lie on each other: side, hand and machine direction, as given."""

    image_side: Side
    side_given: bool
    mirrored_volume: bool
    md_deg_moving: Number
    md_deg_fixed: Number
    md_deg_fixed_from_moving: Number
    sentence: str


class LagTile(Facts):
    """Lag of one part of the map."""

    x: float
    y: float
    lag_um: KnownPair
    distinct: bool


class LagFacts(Facts):
    """What two maps say of their registration by their own texture; a check, and no gate."""

    property: str
    lag_um: KnownPair
    se_um: KnownPair
    length_um: Number
    length_se_um: Number
    r: Number
    r_at_zero: Number
    limit_r: Number = Field(None, description="|r| that unrelated maps exceed in the search in 1 of 1000 cases.")
    silence: str | None
    agrees: bool | None
    expected_um: Number
    sentence: str
    pixel_um: Pair
    n: int
    reach_um: float
    light: Number = Field(None, description="Share of what is explained that needs the slopes of the surface.")
    tile_um: Number
    tiles: tuple[LagTile, ...]


class RegistrationFacts(Facts):
    """How a layer was registered to another one."""

    to: str = Field(description="Layer that it was registered to.")
    path: tuple[str, ...] = Field(description="Layers from this one to the reference.")
    source: str = Field(description="'found', or the kind of file that the marks came from.")
    found_moving: int
    found_fixed: int
    matched: int
    second_best: int | None = Field(description="Marks that the second-best match has in common.")
    match_sentence: str | None
    design: str | None = None
    tilt: HoleTiltFacts | None = None
    model: str
    model_sentence: str
    warnings: tuple[str, ...]
    rms_um: float
    leave_one_out_rms_um: Number
    expected_error: ExpectedError | None
    scale: float
    rotation_deg: float
    shift_um: Pair
    mirrored: bool
    orientation: OrientationFacts
    lag: LagFacts | None = None


class ImageFacts(Facts):
    """What the values of an image are that is compared."""

    quantity: Literal["relative grey", "reflectance"]
    dark_grey: Number = Field(default=None, description="Grey of the dark reference, if it was given.")
    white_grey: Number = Field(default=None, description="Grey of the white reference, whose reflectance counts as 1.")
    screen_um: Number = Field(
        default=None, description="Period of the print screen that was taken off, if it was given."
    )
    sigma_um: Number = Field(default=None, description="Standard deviation of the Gaussian that took it off.")
    reach_um: Number = Field(default=None, description="How far it reaches: so much more around holes is not valid.")

    @property
    def sentence(self) -> str:
        """What a reader has to know of the values."""
        if self.quantity == "reflectance":
            text = f"reflectance: grey {self.dark_grey:g} is 0, grey {self.white_grey:g} is 1"
        else:
            text = "relative grey, as stored: no dark and white reference was given"
        if self.screen_um is not None:
            text += (
                f"; the print screen of {self.screen_um:g} um was taken off by a Gaussian (sigma "
                f"{self.sigma_um:.3g} um) before anything was compared, and {self.reach_um:.3g} um more around "
                "holes are left out"
            )
        return text


class LayerFacts(Facts):
    """One layer: a sheet or an image."""

    name: str
    kind: Literal["sheet", "image"]
    source: InputFile
    headline: str = Field(description="The map that stands for the layer.")
    share_of_reference: Number = None
    registration: RegistrationFacts | None = None
    sheet: SheetFacts | None = None
    image: ImageFacts | None = None


class _Statement(Facts):
    """Correlation of b with a over points of one size, and how sure it is."""

    point_um: float
    n: int = Field(description="Points that are valid in both. Neighbours resemble each other: n is no sample size.")
    r: Number
    r2: Number
    rho: Number = Field(None, description="Spearman's rank correlation.")
    slope: Number = Field(description="Least squares of b on a.")
    intercept: Number
    slope_x_on_y: Number = Field(None, description="Least squares of a on b: a per b.")
    mean_a: Number = None
    mean_b: Number = None
    n_eff: Number = Field(None, description="Independent points that would test r = 0 as well.")
    p: Number = Field(
        None, description="Of the test of r = 0; none where fewer than 10 independent points say nothing."
    )
    interval: KnownPair = Field(None, description="In which r lies with 95 %.")
    n_eff_interval: Number = Field(None, description="Independent points that would give this interval.")
    warnings: tuple[str, ...] = ()
    trust: Trust = "ok"

    @property
    def direction(self) -> int:
        """1 or -1 where the interval of r excludes 0, else 0."""
        low, high = self.interval or (0.0, 0.0)
        return 1 if low > 0 else -1 if high < 0 else 0


_NUMBERS_OF_R = (
    "r", "r2", "rho", "slope", "intercept", "slope_x_on_y", "mean_a", "mean_b", "n_eff", "p", "interval",
    "n_eff_interval",
)  # fmt: skip


class CorrelationRow(_Statement):
    """Correlation of two maps over points of one size; ``slope`` and ``intercept`` give b from a."""

    WITHHELD: ClassVar = (*_NUMBERS_OF_R, "p_of_table", "difference_mean", "difference_sd", "limits")

    a: str
    a_map: str
    b: str
    b_map: str
    p_of_table: Number = Field(None, description="p after Holm, put right for the number of rows at this point size.")
    same_quantity: bool = False
    difference_mean: Number = None
    difference_sd: Number = None
    limits: Pair | None = None
    units: str | None = None


class ComparisonRow(_Statement):
    """The headline correlation by one registration, as the paper compares them, all on the same pixels."""

    WITHHELD: ClassVar = (*_NUMBERS_OF_R, "difference", "difference_interval")

    registration: str
    property: str
    marks_rms_um: float
    difference: Number = Field(None, description="r of the run's own registration minus this r.")
    difference_interval: KnownPair = Field(None, description="In which the difference lies with 95 %.")


class SizeFacts(Facts):
    """Correlation over points of one size, as one of many."""

    point_um: float
    n: int
    r: Number
    n_eff: Number
    interval: KnownPair = Field(description="In which this r lies with 95 %.")
    band: KnownPair = Field(None, description="In which the r of all sizes lie together with 95 %.")


class BandFacts(Facts):
    """What two maps have in common in one octave of wavelengths."""

    shortest_um: float
    longest_um: float
    coherence: Number = Field(description="Squared, put right for chance; a little below 0 where there is nothing.")
    p_of_bands: Number = Field(description="p of all octaves together, after Sidak.")
    phase_deg: Number
    gain: Number = Field(description="Change of b per change of a, with its sign.")
    modes: Number = Field(description="Independent waves.")


class CurveFacts(Facts):
    """Whether an image bends over a property: a parabola beside the straight line, at the larger points."""

    point_um: float
    n: int
    n_eff: Number
    slope: Number
    slope_interval: KnownPair
    curvature: Number = Field(description="Coefficient of the square.")
    interval: KnownPair = Field(description="In which the curvature lies with 95 %.")
    r2_line: Number
    r2_parabola: Number
    words: str


class KubelkaMunkFacts(Facts):
    """Kubelka and Munk's curve of reflectance over the coating, at the larger points."""

    point_um: float
    ratio: float = Field(description="Absorption over scattering, as it was given.")
    n: int | None = None
    n_eff: Number = None
    weight: bool = Field(
        default=False, description="Whether the coating is in g/m2, and S in m2/kg; otherwise um and 1/um."
    )
    scattering: Number = Field(default=None, description="Coefficient S of the coating.")
    scattering_interval: KnownPair = Field(
        default=None, description="In which S lies with 95 %; none where it has no end."
    )
    backing: Number = Field(default=None, description="Reflectance below the coating, extrapolated.")
    backing_interval: KnownPair = Field(default=None, description="In which it lies with 95 %.")
    backing_at_ends: KnownPair = Field(
        default=None, description="Backing that fits best with each end of the interval of S."
    )
    rms: Number = Field(default=None, description="Of what the curve leaves of the reflectance.")
    silence: str | None = Field(default=None, description="Why there is no curve.")


class LightSpreadFacts(Facts):
    """The headline correlation with the coating blurred as light is that spreads in paper."""

    width_um: float = Field(description="Length over which the point spread function falls to 1/e, as it was given.")
    point_um: float
    n: int | None = None
    r: Number = None
    n_eff: Number = None
    interval: KnownPair = Field(default=None, description="In which this r lies with 95 %.")
    difference: Number = Field(
        default=None, description="This r minus that of the coating as it is, at the same points."
    )
    difference_interval: KnownPair = Field(default=None, description="In which the difference lies with 95 %.")
    silence: str | None = Field(default=None, description="Why there is no such r.")


class MottleBandFacts(Facts):
    """How uneven an image is in one octave of wavelength."""

    shortest_um: float
    longest_um: float
    coefficient_of_variation: float


class MottleFacts(Facts):
    """How uneven an image is, by octaves of wavelength; after the idea of ISO/IEC 24790 and ISO 15311."""

    layer: str
    bands: tuple[MottleBandFacts, ...] = ()
    mean: Number = None
    n: int | None = Field(default=None, description="Pixels, or means over several, that are known.")
    measured: str | None = None
    silence: str | None = Field(default=None, description="Why there is none.")


class PartialFacts(Facts):
    """Correlation of what other maps of the sheet do not explain of two maps, by least squares."""

    given: tuple[str, ...] = Field(description="Maps of the sheet whose part was taken off both.")
    point_um: float
    n: int | None = Field(default=None, description="Points that are valid in all maps.")
    r: Number = None
    n_eff: Number = Field(default=None, description="Independent points of what is left.")
    interval: KnownPair = Field(default=None, description="In which r lies with 95 %.")
    silence: str | None = Field(default=None, description="Why there is no partial correlation.")


class ThinRegionFacts(Facts):
    """Mean of the image where the coating is thinner than a limit, minus that elsewhere."""

    thinner_than_um: float
    share: float
    difference: float
    interval: KnownPair = Field(description="In which the difference lies with 95 %.")
    n_eff: Number


class ReliabilityFacts(Facts):
    """How far two half measurements of a map agree: of the odd and of the even rows of its columns."""

    layer: str
    map: str
    point_um: float
    n: int | None = Field(default=None, description="Points that are known in both halves.")
    halves_r: Number = Field(default=None, description="Correlation of both halves.")
    value: Number = Field(
        default=None, description="Share of the variance of the map that both halves show: an upper bound."
    )
    interval: KnownPair = Field(default=None, description="In which it lies with 95 %.")
    n_eff: Number = None
    shared: str | None = Field(default=None, description="What both halves share, which makes it an upper bound.")
    silence: str | None = Field(default=None, description="Why there is none.")


class SecondOpinionFacts(Facts):
    """Interval of r that asks nothing of the covariances of the maps (Conley 1999), at the larger points."""

    point_um: float
    interval: KnownPair = Field(description="In which r lies with 95 %.")
    standard_error: Number = Field(description="Of Fisher's z.")
    critical: Number = Field(description="Standard errors to either side.")
    ratio: Number = Field(description="Standard error over that of the covariances.")


class VariogramFacts(Facts):
    """How a map varies with distance: half of the mean square difference of two points of it, by their distance."""

    layer: str
    map: str
    units: str
    cell_um: Pair = Field(description="What the map was averaged over first, along y and x.")
    nugget: float = Field(description="Variance that neighbouring cells do not share, in the map's units squared.")
    sill: float = Field(description="Variance of the map.")
    range_um: Number = Field(
        description="Distance at which the covariance has fallen to 1/e; none where it does not, or all is nugget."
    )
    md_deg: Number = Field(None, description="Machine direction on the reference, where the run knows it.")
    range_along_um: Number = Field(None, description="The range within 22.5 degrees of the machine direction.")
    range_across_um: Number = Field(None, description="The same across it.")
    ratio: Number = Field(None, description="Range along over range across.")
    distances_um: tuple[float, ...]
    values: tuple[float, ...] = Field(description="At each distance, in the map's units squared.")


class LagProfile(Facts):
    """r of map a with map b moved along one axis, and what unrelated maps of this texture reach."""

    lags_um: tuple[float, ...]
    r: tuple[Number, ...]
    limit: tuple[Number, ...] = Field(description="|r| that unrelated maps exceed at this lag with 1 %.")
    limit_of_any: tuple[Number, ...] = Field(description="|r| that they exceed at any of all lags with 1 %.")


class CorrelogramFacts(Facts):
    """Correlation of map a with map b, moved by every lag along both axes; lags are (y, x)."""

    cell_um: Pair
    reach_um: float
    r_at_zero: Number
    peak_r: float
    lag_um: Pair = Field(description="Of the largest |r|.")
    inner: bool = Field(description="Whether that is a summit, not a slope that goes on beyond the reach.")
    widths_um: KnownPair = Field(description="Full widths at half height, the longer one first.")
    angle_deg: Number = Field(description="Direction of the longer width, clockwise from the x axis.")
    n_eff: Number
    limit_of_any: Number = Field(description="|r| at lag 0 that unrelated maps exceed at any lag with 1 %.")
    beyond_chance: bool | None = Field(description="Whether some lag exceeds that; none where nothing is claimed.")
    along_x: LagProfile
    along_y: LagProfile


class RingFacts(Facts):
    """How far two measurements of one quantity agree in waves of one length."""

    wavelength_um: float
    correlation: float
    threshold: float = Field(description="Correlation at which the mean of both holds half a bit a wave.")
    modes: float = Field(description="Independent waves.")


class TwiceFacts(Facts):
    """Two measurements of one quantity: down to which wavelength they agree, and how far they differ."""

    rings: tuple[RingFacts, ...] = ()
    resolution_um: Number = None
    sentence: str | None = None
    point_um: Number = None
    n: int | None = Field(default=None, description="Points of which bias and scatter are.")
    bias: Number = Field(default=None, description="Mean of b - a at the larger points.")
    bias_interval: KnownPair = Field(default=None, description="In which it lies with 95 %.")
    sd: Number = Field(default=None, description="Standard deviation of b - a.")
    sd_interval: KnownPair = None
    limits: KnownPair = Field(default=None, description="Between them lie 95 % of normal differences.")
    units: str = "1"
    error_ratio: Number = Field(
        default=None, description="Variance of the errors of b over that of a, as it was given."
    )
    error_slope: Number = Field(default=None, description="Slope of b over a where both have such errors (Deming).")
    error_intercept: Number = None
    error_interval: KnownPair = Field(default=None, description="In which that slope lies with 95 %.")


class EvidenceFacts(Facts):
    """What stands beside the correlation of the maps that stand for two layers."""

    a: str
    a_map: str
    b: str
    b_map: str
    declared: bool = Field(description="Whether the study named the map before r was looked at.")
    sizes: tuple[SizeFacts, ...] = ()
    bands: tuple[BandFacts, ...] = ()
    resolution_per_um: Number = Field(None, description="Waves closer in frequency than this are not told apart.")
    origins: tuple[float, float, float] | None = Field(
        None, description="Least, mean and largest r over grids of points that begin elsewhere."
    )
    curve: CurveFacts | None = None
    kubelka_munk: KubelkaMunkFacts | None = Field(None, description="Where the study asks for it.")
    light_spread: LightSpreadFacts | None = Field(None, description="Where the study states how far light spreads.")
    density_g_cm3: Number = Field(
        None, description="Of the coating, where the run knows it: it turns thickness into g/m2."
    )
    thin: tuple[ThinRegionFacts, ...] = ()
    short_waves: SizeFacts | None = Field(None, description="Without waves above short_waves_um.")
    short_waves_um: Number = None
    ceiling: Number = Field(None, description="The r that a perfect relation would show, by misplacement alone.")
    ceiling_sentence: str | None = None
    reliability: tuple[ReliabilityFacts, ...] = Field(
        (), description="Of the maps of sheets among the two, at the larger points."
    )
    ceiling_noise: Number = Field(
        None, description="The r that a perfect relation would show, by the noise of these maps alone: an upper bound."
    )
    ceiling_both: Number = Field(None, description="The same by noise and misplacement together.")
    second_opinion: SecondOpinionFacts | None = None
    variograms: tuple[VariogramFacts, ...] = ()
    correlogram: CorrelogramFacts | None = None
    twice: TwiceFacts | None = Field(None, description="Where both maps are of the same quantity.")
    partial: PartialFacts | None = Field(None, description="Where the study names maps that stand beside.")
    commonality: dict[str, float] | None = Field(
        None,
        description="Shares of the variance of b that the maps explain alone and only together (joined by ' and '), "
        "at the larger points; their sum is r2 of all of them. Below 0 where a map hides what another one does.",
    )


class LinkedArea(Facts):
    """How much of the reference shows all layers, and how much of that is valid."""

    pixels: int
    share_on_sheet: float
    share_valid: float
    share_valid_of_sheet: float
    share_valid_away_from_holes: float


class RegionFacts(Facts):
    """A region that was declared an artefact; its texts are empty where they are not given."""

    name: str
    reason: str
    author: str
    share: float = Field(description="Share of the reference's pixels.")


class RegionsFacts(Facts):
    """Regions that were declared artefacts: their pixels are not valid and count in no correlation."""

    count: int
    share: float = Field(description="Share of the reference's pixels that lie in a region.")
    regions: tuple[RegionFacts, ...]


class RefinementR(Facts):
    """r after a refinement that it was not maximised by, or beside what the search reaches by chance."""

    r: Number
    interval: KnownPair = Field(None, description="In which r lies with 95 %.")
    n_eff: Number = None
    r_of_marks: Number = Field(None, description="By the marks alone, over the same pixels.")
    gain_interval: KnownPair = Field(None, description="In which r - r_of_marks lies with 95 %.")
    registration: str
    sentence: str
    n: int | None = None
    tile_um: Number = None
    guard_um: Number = None
    null_95: Number = None
    p: Number = None
    surrogates: int | None = None


class RefinementFacts(Facts):
    """A registration refined by the maps themselves."""

    model: str
    metric: str
    property: str
    moved_rms_um: float
    moved_most_um: float
    share_of_expected_error: float
    area: tuple[float, ...]
    strain: float
    warnings: tuple[str, ...]
    sentence: str
    longest_wave_um: float
    correlation: RefinementR


class Results(Facts):
    """All numbers of a run: a map of one sheet, or layers linked onto the last one."""

    format: Literal[3] = FORMAT
    planish: str
    versions: dict[str, str]
    layers: tuple[LayerFacts, ...] = Field(description="In the order given; the last one is the reference of a link.")
    chain: bool = False
    correlations: tuple[CorrelationRow, ...] = ()
    comparison: tuple[ComparisonRow, ...] = ()
    evidence: tuple[EvidenceFacts, ...] = ()
    linked: LinkedArea | None = None
    regions: RegionsFacts | None = None
    mottle: tuple[MottleFacts, ...] = ()
    refinement: RefinementFacts | None = None
    checks: tuple[Check, ...]
    parameters: dict[str, Any]

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return self.state != "fail"

    @property
    def state(self) -> State:
        """The worst state of all checks: fail, look, unknown, or pass."""
        states = {check.state for check in self.checks}
        order: tuple[State, ...] = ("fail", "look", "unknown")
        for state in order:
            if state in states:
                return state
        return "pass"

    def spoken(self, *states: State) -> list[Check]:
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
            If it cannot be read, is damaged, or was written by planish 0.1.0.
        """
        try:
            data: Any = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise FileError(f"{path} cannot be read: {error}. Give a whole run folder, or repeat the run.") from error
        if isinstance(data, dict) and str(data.get("planish", "")).startswith("0.1."):  # type: ignore[reportUnknownArgumentType]
            raise FileError(
                f"{path.parent} was made by planish 0.1.0. Its maps and its report.html stay readable, but the errors "
                "stated there are about 1.5 times too small. Repeat it with this version: planish run "
                f"{path.parent}/run.toml"
            )
        if isinstance(data, dict) and data.get("format") == 2:  # type: ignore[reportUnknownMemberType]
            raise FileError(
                f"{path.parent} was made by planish 0.2.0, which checked less than this version does. Its maps and its "
                f"report.html stay readable. Repeat it with this version: planish run {path.parent}/run.toml"
            )
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            first = error.errors()[0]
            raise FileError(
                f"{path} is no results file of planish: {'.'.join(map(str, first['loc']))}: {first['msg']}. "
                "Give a whole run folder, or repeat the run."
            ) from error
