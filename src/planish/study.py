"""Every parameter of a run, checked: what the command line fills in and ``run.toml`` repeats."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import tomli_w
from pydantic import Field, ValidationError, model_validator

from planish.core.errors import FileError, InputError
from planish.core.options import Params
from planish.measure.params import MeasureParams
from planish.surface.params import SurfaceParams

Index = Annotated[int, Field(ge=0)]
Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Axis = Annotated[float, Field(ge=-180, le=180, allow_inf_nan=False)]  # degrees; an axis has no head


class Section(Params):
    """A table of the file: unknown keys are errors, nothing changes once read."""


S = TypeVar("S", bound=Params)


class VolumeSection(Section):
    """The volume and how the sheet lies in it."""

    path: str
    voxel_um: tuple[Length, Length, Length] | None = None
    through: Literal["z", "y", "x"] = "z"
    top: Literal["high", "low"] = "high"
    override_size: bool = False
    channel: Literal["luminance", "red", "green", "blue"] | None = None
    column_um: Length | None = None
    fixed_rows: tuple[Index, Index] | None = None
    fixed_cols: tuple[Index, Index] | None = None
    md_deg: Axis | None = None


class ImageSection(Section):
    """An image, and which side of the sheet it shows."""

    path: str
    pixel_um: tuple[Length, Length] | None = None
    channel: str = "luminance"
    override_size: bool = False
    side: Literal["top", "bottom"] | None = None
    md_deg: Axis | None = None


_PATHS = {"path", "run", "marks", "design"}


class FlattenSection(Section):
    """Choices of the flattening and of the flat maps."""

    mesh_um: Length | None = None
    method: Literal["multigrid", "relaxation"] = "multigrid"
    rest: Literal["arc", "chord"] = "arc"
    map_um: Length | None = None


class RegistrationSection(Section):
    """Choices of hole finding and matching."""

    marks: str | None = None
    design: str | None = None
    hole_um: tuple[Length, Length] = (100.0, 300.0)
    scale_tolerance: Annotated[float, Field(gt=0, lt=0.5)] = 0.03
    tolerance_um: Length = 25.0
    mirror: bool = False
    model: Literal["rigid", "similarity", "affine", "projective", "tps", "auto"] = "auto"
    refine: Literal["affine", "bspline"] | None = None


class CorrelateSection(Section):
    """Choices of the correlation."""

    point_um: Length = 100.0
    thin_um: Length = 5.0


class Study(Section):
    """One run, whole."""

    volume: VolumeSection
    image: ImageSection | None = None
    surface: SurfaceParams = SurfaceParams()
    properties: MeasureParams = MeasureParams()
    flatten: FlattenSection = FlattenSection()
    registration: RegistrationSection = RegistrationSection()
    correlate: CorrelateSection = CorrelateSection()


class LayerSection(Section):
    """One of several layers: a run that is there, a volume that is mapped first, or an image.

    ``marks`` are pairs of points of this layer (moving) and the one that it is registered to (fixed). ``md_deg`` is for
    runs and volumes; an image states its own.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=40)]
    run: str | None = None
    map: Study | None = None
    image: ImageSection | None = None
    marks: str | None = None
    md_deg: Axis | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(part is not None for part in (self.run, self.map, self.image)) != 1:
            raise ValueError("give one of run, map and image")
        if self.map is not None and self.map.image is not None:
            raise ValueError("a volume that is mapped as a layer has no image; give that as a layer of its own")
        return self


class LayersStudy(Section):
    """Several layers that are linked onto the last one, the reference.

    With ``chain`` each layer is registered to the next one and carried on from there, otherwise all are registered to
    the reference.
    """

    layers: Annotated[tuple[LayerSection, ...], Field(min_length=2)]
    chain: bool = False
    rim_um: Annotated[float, Field(ge=0)] = 100.0
    registration: RegistrationSection = RegistrationSection()
    correlate: CorrelateSection = CorrelateSection()

    @model_validator(mode="after")
    def _names(self) -> Self:
        names = [layer.name for layer in self.layers]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(
                f"every layer needs a name of its own (NAME=PATH); {', '.join(twice)} stands there more than once"
            )
        if self.registration.marks is not None:
            raise ValueError("pairs of marks belong to a layer here, not to all")
        if self.layers[-1].marks is not None:
            raise ValueError("the last layer is the reference: it is registered to nothing, so it has no marks")
        return self


def read_study(path: Path) -> Study | LayersStudy:
    """Read a study file, of one volume or of several layers.

    Paths in it are relative to its folder and come back absolute.

    Raises
    ------
    FileError
        If it cannot be read as TOML.
    InputError
        If a parameter is unknown, missing or out of range; all faults are named.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}. Give the run.toml of a run.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FileError(f"{path} is not a TOML file: {error}.") from error
    data.pop("planish", None)
    try:
        study = (LayersStudy if "layers" in data else Study).model_validate(data)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise InputError(f"{path} has {error.error_count()} wrong parameters: {faults}.") from error

    def absolute(p: str) -> str:
        return str((path.parent / p).resolve())

    return with_paths(study, absolute)


def write_study(study: Study | LayersStudy, folder: Path, *, home: Path, version: str) -> None:
    """Write ``run.toml`` into ``folder``, with paths relative to ``home``, the place where the folder will stand.

    Where no relative path exists (another drive) the absolute one is written.
    """

    def relative(p: str) -> str:
        try:
            return Path(os.path.relpath(p, home)).as_posix()
        except ValueError:
            return Path(p).as_posix()

    data: dict[str, Any] = {"planish": version}
    data |= with_paths(study, relative).model_dump(mode="json", exclude_none=True)
    (folder / "run.toml").write_text(tomli_w.dumps(data), encoding="utf-8", newline="\n")


def with_paths(section: S, change: Callable[[str], str]) -> S:
    """Change all paths of a study: those of the files that it reads."""
    update: dict[str, Any] = {}
    for name in type(section).model_fields:
        value = getattr(section, name)
        if name in _PATHS and isinstance(value, str):
            update[name] = change(value)
        elif isinstance(value, Params):
            update[name] = with_paths(value, change)
        elif isinstance(value, tuple) and value and isinstance(value[0], Params):
            update[name] = tuple(with_paths(part, change) for part in value)
    return section.model_copy(update=update)
