"""A scenario: which specimens, instrument and nuisances, which errors are allowed.

And every figure of the ledger.
"""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import (
    Field,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from planish.core.errors import FileError, InputError
from planish.core.options import Params
from planish.core.tables import model_faults, naming_faults
from planish.run.study import Study
from planish.synthetic.params import SIZES_UM, SpecimenParams, draw_params
from planish.synthetic.presets import NUISANCES, PRESETS, nuisances_of, with_only

_KINDS = (
    ("bias", "mean error", "mean"),
    ("rmse", "rms error", "root mean square"),
    ("p95", "95 % error", "95th percentile of the absolute value"),
)

Values = dict[str, float | None]  # figure name -> value; None where a run has no such thing


class Figure(NamedTuple):
    """One number of the ledger."""

    name: str  # key in files and in a scenario's limits
    stage: str  # key of :data:`STAGES`
    unit: str  # ``um``, ``%``, ``deg``, ``pitch``, ``s``, or ``1`` for a plain number
    title: str  # for a table, under the title of its stage
    sentence: str  # what is compared with what
    # {"small", "large", "neither"}: which values are better; neither where the figure only
    # describes.
    better: str = "small"


def _figures(stage: str, table: dict[str, Any]) -> Iterator[Figure]:
    for stem, (quantity, sentence) in table.get("errors", {}).items():
        for statistic, title, mean in _KINDS:
            of_figure = (f"{quantity}, {title}", f"{mean} of {sentence}")
            yield Figure(f"{stem}_{statistic}", stage, "um", *of_figure)
    for name, row in table.get("figures", {}).items():
        yield Figure(name, stage, *row)


_TABLES = tomllib.loads(Path(__file__).with_name("figures.toml").read_text(encoding="utf-8"))
STAGES: dict[str, str] = {stage: table["title"] for stage, table in _TABLES.items()}
"""Stages of the ledger and their titles."""
KEYS: dict[str, list[str]] = {
    stage: table["key"] for stage, table in _TABLES.items() if "key" in table
}
FIGURES: dict[str, Figure] = {
    figure.name: figure for stage, table in _TABLES.items() for figure in _figures(stage, table)
}
"""Figures of the ledger by name."""


def in_order(values: Values) -> Values:
    """Figures in the order of the line.

    What has no value is None, whole stages that are absent are left out.
    """
    stages = {FIGURES[name].stage for name in values}
    return {name: values.get(name) for name, figure in FIGURES.items() if figure.stage in stages}


Instrument = Literal["stack", "scanner", "sections"]
Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]
ALL: Literal["all"] = "all"
NONE: Literal["none"] = "none"
PAIR = ("first", "second")  # names of the two layers of a pair
_FOLDER = Path(__file__).with_name("scenarios")
# Field -> the names that it may hold, and what they are
_KNOWN: dict[str, tuple[Mapping[str, Any], str]] = {
    "preset": (PRESETS, "paper"),
    "nuisances": (NUISANCES, "nuisance"),
    "limits": (FIGURES, "figure"),
}


class Limit(Params, populate_by_name=True):
    """Bounds of a figure.

    ``limit`` bounds its absolute value, ``least`` its value from below; ``from`` is their origin.
    """

    limit: float | None = None
    least: float | None = None
    source: str = Field(default="", alias="from")

    @model_validator(mode="after")
    def _check_one_bound(self) -> Self:
        if (self.limit is None) == (self.least is None):
            raise ValueError("give either limit or least")
        return self

    @property
    def bound(self) -> float:
        """The number that is not to be passed."""
        return (self.least or 0.0) if self.limit is None else self.limit

    def met(self, value: float | None) -> bool:
        """Return True if a value keeps the limit; False for one that could not be measured."""
        if value is None:
            return False
        return value >= self.bound if self.limit is None else abs(value) <= self.bound

    def worst(self, values: list[float]) -> float:
        """The value that is nearest to missing the limit, or furthest beyond it."""
        return min(values) if self.limit is None else max(values, key=abs)


class Second(Params):
    """The second instrument of a pair, and what it does otherwise to the same sheet.

    Above all, how the sheet is bent.
    """

    instrument: Instrument
    specimen: dict[str, Any] = Field({})


class Scenario(Params):
    """One kind of specimen and how it is measured."""

    name: str
    title: str
    # {"line", "pair", "mesh"}: the line through files; two linked volumes of one sheet; the spring
    # mesh alone.
    kind: Literal["line", "pair", "mesh"] = "line"
    preset: str = "wfc135"  # paper, a key of :data:`planish.synthetic.presets.PRESETS`
    # ``T0`` to ``T3``, or the lateral extent (x, y) in um.
    size: Literal["T0", "T1", "T2"] | tuple[Length, Length] = "T1"
    instrument: Instrument = "stack"  # {"stack", "scanner", "sections"}
    seeds: Annotated[int, Field(ge=1, le=1000)] = 3  # how many specimens, seeds 0 to seeds - 1
    # Of :data:`planish.synthetic.presets.NUISANCES`.
    nuisances: Literal["all", "none"] | tuple[str, ...] = ALL
    # Whether every parameter is drawn by the seed, over the ranges of
    # :data:`planish.synthetic.params.RANGES`.
    drawn: bool = False
    # Whether a run may also end with a warning of its own: then the limits hold for those that do
    # not.
    or_warned: bool = False
    point_um: Length = 100.0  # edge of the larger points of the correlation
    # Fields of SpecimenParams that differ from their defaults; nested as they are there.
    specimen: dict[str, Any] = Field({})
    second: Second | None = None  # the other instrument of a pair, which is the reference
    # Groups of options that differ from their defaults.
    study: dict[str, dict[str, Any]] = Field({})
    limits: dict[str, Limit] = Field({})

    @field_validator(*_KNOWN)
    @classmethod
    def _check_names(cls, value: Any, info: ValidationInfo) -> Any:
        choices, noun = _KNOWN[str(info.field_name)]
        if value in (ALL, NONE):
            return value
        names = (value,) if isinstance(value, str) else value
        for name in names:
            if name not in choices:
                raise ValueError(
                    f"there is no {noun} {name!r}; known are {', '.join(sorted(choices))}"
                )
        return value

    @model_validator(mode="after")
    def _can_be_made(self) -> Self:
        if (self.kind == "pair") != (self.second is not None):
            raise ValueError("a pair, and nothing else, has a table [second]")
        try:
            (self.params if self.second is None else self.second_params)(0)
        except ValidationError as error:
            raise ValueError("; ".join(model_faults(error, ("specimen",)))) from error
        n_volumes, image = (2, None) if self.second else (1, "image")
        try:
            self.study_of([("volume", "z")] * n_volumes, image)
        except ValidationError as error:
            raise ValueError("; ".join(model_faults(error, ("study",)))) from error
        return self

    def study_of(
        self, volumes: Sequence[tuple[Path | str, str]], image: Path | str | None
    ) -> Study:
        """Study of the files of a specimen: what a user would give on the command line.

        ``volumes`` are paths with the axis that runs through the sheet; of a pair, that of the
        reference is the last. All files state their voxel size, so that none is given.
        """
        tables = _merged({"correlate": {"point_um": self.point_um}}, self.study)
        sections = ("volume", "surface", "properties", "flatten")
        sheet = {name: tables.pop(name, {}) for name in sections}
        names = PAIR if self.second else ("sheet",)
        layers: list[dict[str, Any]] = []
        for name, (path, through) in zip(names, volumes, strict=True):
            volume = {"volume": {"path": str(path), "through": through}}
            layers.append({"name": name} | _merged(volume, sheet))
        if image is not None:
            source = {"path": str(image)} | tables.pop("image", {})
            layers.append({"name": "image", "image": source})
        return Study.model_validate({"layers": layers, **tables})

    def params(self, seed: int, nuisances: str | tuple[str, ...] | None = None) -> SpecimenParams:
        """Parameters of the specimen of ``seed``.

        ``nuisances`` replaces the scenario's own choice.
        """
        chosen = self.nuisances if nuisances is None else nuisances
        size = SIZES_UM[self.size] if isinstance(self.size, str) else self.size
        slab = PRESETS[self.preset][1].as_slab()
        params = amended(SpecimenParams(size_um=size, paper=slab), self.specimen)
        params = replace(params, seed=params.seed + seed)
        if self.drawn:
            params = draw_params(params)
        if chosen == ALL:
            return params
        return with_only(params, () if chosen == NONE else chosen)

    def second_params(self, seed: int) -> SpecimenParams:
        """Parameters of the same sheet under the second instrument."""
        assert self.second is not None
        return amended(self.params(seed), self.second.specimen)

    @property
    def active(self) -> list[str]:
        """Names of the nuisances that are on and that the instrument can see."""
        instrument = "sections" if self.instrument == "sections" else "scanner"
        return nuisances_of(self.params(0), instrument)


def without_none(values: Mapping[str, float | None]) -> dict[str, float]:
    """Those of some values that there are."""
    return {name: value for name, value in values.items() if value is not None}


def amended(params: SpecimenParams, changes: dict[str, Any]) -> SpecimenParams:
    """Replace fields by name, nested as they are.

    Pydantic's ValueError names what is unknown or of a wrong kind.
    """
    return TypeAdapter(SpecimenParams).validate_python(_merged(asdict(params), changes))


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """A nested table with other values in place of some; those of a table within it one by one."""
    merged = base | changes
    for name, value in changes.items():
        if isinstance(value, dict) and isinstance(base.get(name), dict):
            merged[name] = _merged(base[name], changes[name])
    return merged


def scenario_names() -> list[str]:
    """Names of the scenarios that come with planish."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def read_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario that comes with planish, or one from a TOML file.

    Raises
    ------
    FileError
        If there is no such scenario, or the file cannot be read as TOML.
    InputError
        If a key is unknown or a value out of range; all faults are named.
    """
    name = str(name_or_path)
    path = _FOLDER / f"{name}.toml" if name in scenario_names() else Path(name_or_path)
    if not path.is_file():
        raise FileError(
            f"There is no scenario {name!r}. Give one of {', '.join(scenario_names())}, or the path"
            " of a TOML file."
        )
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(f"{name} is not a TOML file that can be read: {error}.") from error
    with naming_faults(f"The scenario {name}", error=InputError):
        return Scenario.model_validate(tables)
