"""A scenario: which specimens, under which instrument, with which nuisances, and which errors are allowed."""

from __future__ import annotations

import tomllib
from dataclasses import asdict, replace
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, field_validator, model_validator

from planish.analyze.params import CorrelateParams
from planish.core.errors import FileError, InputError
from planish.flatten.params import FlattenParams
from planish.io.params import ImageParams, VolumeParams
from planish.marks.params import HoleParams
from planish.measure.params import MeasureParams
from planish.register.params import RegistrationParams
from planish.surface.params import SurfaceParams
from planish.synthetic.draws import draw_params
from planish.synthetic.nuisances import NUISANCES, nuisances_of, with_only, without
from planish.synthetic.params import SIZES_UM, SpecimenParams
from planish.synthetic.presets import PRESETS, preset
from planish.validate.figures import FIGURES

Instrument = Literal["stack", "scanner", "sections"]
Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]
ALL: Literal["all"] = "all"
NONE: Literal["none"] = "none"

# The groups of options that a scenario may change.
_OPTIONS: dict[str, type[BaseModel]] = {
    "volume": VolumeParams, "image": ImageParams, "surface": SurfaceParams, "properties": MeasureParams,
    "flatten": FlattenParams, "holes": HoleParams, "registration": RegistrationParams, "correlate": CorrelateParams,
}  # fmt: skip


class Table(BaseModel):
    """A table of the file: unknown keys are errors, nothing changes once read."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class Limit(Table):
    """What a figure may be: ``limit`` bounds its absolute value from above, ``least`` the value itself from below.

    ``from`` names where the bound comes from.
    """

    limit: float | None = None
    least: float | None = None
    source: str = Field(default="", alias="from")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.limit is None) == (self.least is None):
            raise ValueError("give either limit or least")
        return self

    def met(self, value: float | None) -> bool:
        """Whether a value keeps the limit; what could not be measured does not."""
        if value is None:
            return False
        return abs(value) <= self.limit if self.limit is not None else value >= (self.least or 0.0)

    def worst(self, values: list[float]) -> float:
        """The value that is nearest to missing the limit, or furthest beyond it."""
        return min(values) if self.limit is None else max(values, key=abs)


class Second(Table):
    """The second instrument of a pair, and what it does otherwise to the same sheet (how it is bent, above all)."""

    instrument: Instrument
    specimen: dict[str, Any] = {}


class Scenario(Table):
    """One kind of specimen and how it is measured.

    Attributes
    ----------
    name, title : str
    kind : {"line", "pair", "mesh"}
        The whole line through files; two volumes of one sheet, linked; or the relaxation of the spring mesh alone.
    preset : str
        Paper, a key of :data:`planish.synthetic.presets.PRESETS`.
    size : str or (float, float)
        ``T0`` to ``T3``, or the lateral extent (x, y) in um.
    instrument : {"stack", "scanner", "sections"}
    seeds : int
        How many specimens, seeds 0 to seeds - 1.
    nuisances : "all", "none" or list of names
        Of :data:`planish.synthetic.nuisances.NUISANCES`.
    drawn : bool
        Whether every parameter is drawn by the seed, over the ranges of :data:`planish.synthetic.draws.RANGES`.
    or_warned : bool
        Whether a run may also end with a warning of its own: then the limits hold for those that do not.
    point_um : float
        Edge of the larger points of the correlation.
    specimen : dict
        Fields of SpecimenParams that differ from their defaults; nested as they are there.
    second : Second or None
        The other instrument of a pair, which is the reference.
    study : dict
        Groups of options that differ from their defaults.
    limits : dict of Limit
    """

    name: str
    title: str
    kind: Literal["line", "pair", "mesh"] = "line"
    preset: str = "wfc135"
    size: Literal["T0", "T1", "T2"] | tuple[Length, Length] = "T1"
    instrument: Instrument = "stack"
    seeds: Annotated[int, Field(ge=1, le=1000)] = 3
    nuisances: Literal["all", "none"] | tuple[str, ...] = ALL
    drawn: bool = False
    or_warned: bool = False
    point_um: Length = 100.0
    specimen: dict[str, Any] = {}
    second: Second | None = None
    study: dict[str, dict[str, Any]] = {}
    limits: dict[str, Limit] = {}

    @field_validator("preset")
    @classmethod
    def _known_preset(cls, value: str) -> str:
        return _one_of(value, PRESETS, "paper")

    @field_validator("nuisances")
    @classmethod
    def _known_nuisances(cls, value: str | tuple[str, ...]) -> str | tuple[str, ...]:
        if not isinstance(value, str):
            for name in value:
                _one_of(name, NUISANCES, "nuisance")
        return value

    @field_validator("limits")
    @classmethod
    def _known_figures(cls, value: dict[str, Limit]) -> dict[str, Limit]:
        for name in value:
            _one_of(name, FIGURES, "figure")
        return value

    @model_validator(mode="after")
    def _two_for_a_pair(self) -> Self:
        if (self.kind == "pair") != (self.second is not None):
            raise ValueError("a pair, and nothing else, has a table [second]")
        return self

    @model_validator(mode="after")
    def _can_be_made(self) -> Self:
        try:
            self.params(0)
            if self.second is not None:
                self.second_params(0)
        except ValidationError as error:
            raise ValueError("; ".join(f"specimen.{place}: {fault}" for place, fault in faults_of(error))) from error
        for table, changes in self.study.items():
            _one_of(table, _OPTIONS, "group of options")
            for key in changes:
                _one_of(key, _OPTIONS[table].model_fields, f"key of [{table}]")
        return self

    def params(self, seed: int, nuisances: str | tuple[str, ...] | None = None) -> SpecimenParams:
        """Parameters of the specimen of ``seed``; ``nuisances`` replaces the scenario's own choice."""
        chosen = self.nuisances if nuisances is None else nuisances
        size = SIZES_UM[self.size] if isinstance(self.size, str) else self.size
        params = amended(SpecimenParams(size_um=size, paper=preset(self.preset)), self.specimen)
        params = replace(params, seed=params.seed + seed)
        if self.drawn:
            params = draw_params(params)
        if chosen == ALL:
            return params
        return without(params, NUISANCES) if isinstance(chosen, str) else with_only(params, chosen)

    def second_params(self, seed: int) -> SpecimenParams:
        """Parameters of the same sheet under the second instrument."""
        assert self.second is not None
        return amended(self.params(seed), self.second.specimen)

    @property
    def active(self) -> list[str]:
        """Names of the nuisances that are on and that the instrument can see."""
        return nuisances_of(self.params(0), "sections" if self.instrument == "sections" else "scanner")


def _one_of(value: str, known: Any, what: str) -> str:
    if value not in known:
        raise ValueError(f"there is no {what} {value!r}; known are {', '.join(sorted(known))}")
    return value


def faults_of(error: ValidationError) -> list[tuple[str, str]]:
    """Place and sentence of every fault."""
    unknown = "unexpected_keyword_argument"
    return [
        (
            ".".join(map(str, e["loc"])),
            "no such field" if e["type"] == unknown else e["msg"].removeprefix("Value error, "),
        )
        for e in error.errors()
    ]


def amended(params: SpecimenParams, changes: dict[str, Any]) -> SpecimenParams:
    """Replace fields by name, nested as they are; pydantic's ValueError names what is unknown or of a wrong kind."""
    return TypeAdapter(SpecimenParams).validate_python(_merged(asdict(params), changes))


def _merged(old: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    tables = {k: _merged(old[k], v) for k, v in changes.items() if isinstance(v, dict) and isinstance(old.get(k), dict)}
    return old | changes | tables


def scenario_names() -> list[str]:
    """Names of the scenarios that come with planish."""
    folder = files("planish.validate").joinpath("scenarios")
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


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
    if name in scenario_names():
        text = files("planish.validate").joinpath("scenarios", f"{name}.toml").read_text(encoding="utf-8")
    else:
        path = Path(name_or_path)
        if not path.is_file():
            raise FileError(
                f"There is no scenario {name!r}. Give one of {', '.join(scenario_names())}, or the path of a TOML file."
            )
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise FileError(f"{path} cannot be read: {error}. Give a scenario as a TOML file.") from error
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FileError(f"{name} is not a TOML file: {error}.") from error
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        found = faults_of(error)
        faults = "; ".join(f"{place}: {fault}" if place else fault for place, fault in found)
        raise InputError(f"The scenario {name} has {len(found)} faults: {faults}.") from error
