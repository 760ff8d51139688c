"""A registration with all marks of both layers: found, matched and fitted, or given; and its file, ``marks.json``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from planish.core.arrays import check_dataset
from planish.core.errors import MarkError
from planish.core.facts import HoleTiltFacts
from planish.core.frame import Frame
from planish.core.grid import values_at
from planish.core.options import params_of
from planish.core.typing import Bools, Floats
from planish.design import Pattern, read_pattern
from planish.marks import hole_tilt
from planish.marks.exchange import LayerPixels, MarkPlaces, make_marks, pair_of_layers, read_any, write_any
from planish.marks.exchange.model import RESULTS
from planish.register import (
    Chain,
    DesignedHoles,
    FittedTransform,
    RegistrationParams,
    need_holes,
    registration_from_json,
    registration_to_json,
)
from planish.register import register_marks as match_and_fit
from planish.run.layers import Layer, LayerHoles
from planish.run.study import Study


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registration:
    """How a layer, the moving one, comes to another one, the fixed one.

    Call it with points ``(..., 2)``, ``(x, y)`` in um of the moving layer to get points of the fixed one.

    Attributes
    ----------
    fit : FittedTransform
        The transformation with its errors.
    marks : Dataset (mark)
        All marks of both layers, matched or not: ``label``, ``used``, ``moving_x``, ``moving_y``, ``fixed_x``,
        ``fixed_y`` in um (NaN where a mark is not in a layer), diameters, covariances, sources, residuals.
    source : str
        ``found``, or the format of the file that the marks came from.
    sentence : str or None
        How the marks were matched.
    second_best : int or None
        Marks that the second-best match has in common.
    design : str or None
        What the designed pattern says.
    tilt : HoleTiltFacts or None
        What the holes look like through the sheet.
    """

    fit: FittedTransform
    marks: xr.Dataset
    source: str = "found"
    sentence: str | None = None
    second_best: int | None = None
    design: str | None = None
    tilt: HoleTiltFacts | None = None

    def __call__(self, points: Any) -> Floats:
        """Take points from the moving to the fixed layer, in um."""
        return self.fit(points)

    def count(self, side: str) -> int:
        """Number of marks in one layer, matched or not."""
        return int(np.isfinite(self.marks[f"{side}_x"].values).sum())

    def agreement(self) -> str:
        """How many marks agree to what, and which were left out, in a sentence."""
        fit, labels = self.fit, self.marks["label"].values[paired(self.marks)]
        used = fit.robust_weights > 0
        loo, text = fit.leave_one_out_rms_um, f"{int(used.sum())} of {used.size}" if not used.all() else f"{used.size}"
        text += f" marks agree to {loo:.1f} um (leave-one-out, rms)." if np.isfinite(loo) else " marks were used."
        off = [f"{labels[k]} is {np.hypot(*fit.residuals_um[k]):.0f} um off" for k in np.flatnonzero(~used)]
        if off:
            text = f"{text.removesuffix('.')}; {', '.join(off)} and {'was' if len(off) == 1 else 'were'} left out."
        return text

    def pairs(self) -> xr.Dataset:
        """The marks that the fit uses: positions, residuals and weights, a row each."""
        fit, um = self.fit, {"units": "um"}
        points = {"moving": fit.moving, "fixed": fit.fixed, "residual": fit.residuals_um}
        values = {f"{name}_{axis}": xy[:, k] for name, xy in points.items() for k, axis in enumerate("xy")}
        values |= {"residual": np.hypot(*fit.residuals_um.T), "leave_one_out": fit.leave_one_out_um}
        data = xr.Dataset({k: ("mark", v, um) for k, v in values.items()})
        labels = self.marks["label"].values[paired(self.marks)]
        return data.assign(weight=("mark", fit.robust_weights, {"units": "1"}), label=("mark", labels.astype(object)))

    def save(self, path: str | Path) -> None:
        """Write ``marks.json``: all marks, and the transformation fitted to them."""
        write_any(self.marks.assign_attrs(registration=registration_to_json(self.fit)), path, to="json")

    @classmethod
    def read(cls, path: str | Path) -> Registration:
        """Read ``marks.json`` with its transformation.

        Raises
        ------
        FileError
            If it cannot be read or is of another format.
        MarkError
            If it holds no transformation, or the marks were changed after the fit.
        """
        marks = read_any(path)
        saved = marks.attrs.pop("registration", None)
        if saved is None:
            raise MarkError(
                f"{Path(path).name} holds marks without a registration. Make one with 'planish register', or give the "
                "marks.json of a run."
            )
        registration = cls(fit=registration_from_json(saved), marks=marks, source="json")
        mask, fit = paired(marks), registration.fit
        for side, fitted in (("moving", fit.moving), ("fixed", fit.fixed)):
            if not np.array_equal(_places(marks, side)[mask], fitted):
                raise MarkError(
                    f"The marks in {Path(path).name} were changed after the registration was fitted to them. Register "
                    "them again: planish register, or planish link --marks."
                )
        return registration


def register_marks(
    moving: xr.Dataset,
    fixed: xr.Dataset,
    *,
    params: RegistrationParams | None = None,
    hole_um: tuple[float, float] = (100.0, 300.0),
) -> Registration:
    """Match the laser holes of two layers, whose rotation and shift are unknown, and fit the transformation.

    Parameters
    ----------
    moving, fixed : Dataset (mark)
        Holes of :func:`planish.find_holes`, or ``x`` and ``y`` in um alone. The attribute ``layer`` says what they are
        called in messages, ``seen_from`` which side of the sheet is seen, ``"top"`` or ``"bottom"``: the top where it
        is missing. Layers that show opposite sides see each other mirrored.
    params : RegistrationParams, optional
    hole_um : (float, float)
        Diameters that were looked for, for messages.

    Returns
    -------
    Registration

    Raises
    ------
    CannotRegister
        If there are too few holes, they do not match, or they ask for a scale that the calibrations exclude.
    MarkError
        If ``seen_from`` is neither top nor bottom.

    Notes
    -----
    Hirn et al. (2009), section 2.4. Each pair is weighted with the covariances of its two holes.
    """
    for holes, call in ((moving, "pl.register_marks({}, fixed)"), (fixed, "pl.register_marks(moving, {})")):
        check_dataset(holes, "x", "y", what="holes", maker="pl.find_holes(...)", call=call)
    r = params_of(RegistrationParams, params, "pl.register_marks")
    designed = None
    if (pattern := read_design(r)) is not None:
        designed = DesignedHoles(name=pattern.name, places_um=pattern.imaged_um, labels=tuple(pattern.labels))
    match = match_and_fit(moving, fixed, params=r, pattern=designed, hole_um=hole_um)
    # The pairs first, then the holes of the moving and of the fixed layer alone.
    names, layers, about = [*match.labels], dict[str, MarkPlaces](), dict[str, dict[str, Any]]()
    single = [np.setdiff1d(np.arange(h.sizes["mark"]), match.pairs[:, k]) for k, h in enumerate((moving, fixed))]
    for k, (side, holes) in enumerate((("moving", moving), ("fixed", fixed))):
        rows = [match.pairs[:, k], *(rest if j == k else np.full(rest.size, -1) for j, rest in enumerate(single))]
        layers[side] = MarkPlaces.of_holes(holes, np.concatenate(rows), holes.attrs.get("source", "detected"))
        attrs = {"title": holes.attrs.get("layer"), "side": holes.attrs.get("seen_from")}
        about[side] = {key: word for key, word in attrs.items() if word is not None}
        names += [f"{side} {number + 1}" for number in single[k]]
    marks = _with_residuals(make_marks(names, layers, about=about), match.fit)
    return Registration(
        fit=match.fit, marks=marks, sentence=match.sentence, second_best=match.second_best, design=match.design,
        tilt=hole_tilt(moving),
    )  # fmt: skip


def _places(marks: xr.Dataset, side: str, axes: str = "xy") -> Floats:
    """Places (mark, 2 or 3) of all marks in a layer, in um."""
    return np.stack([marks[f"{side}_{axis}"].values for axis in axes], axis=1)


def paired(marks: xr.Dataset) -> Bools:
    """Marks that are in use and lie in both layers."""
    moving = "volume" if "volume_x" in marks else "moving"  # places in a volume become places on the map of its sheet
    places = marks[f"{moving}_x"].values + marks["fixed_x"].values
    return np.asarray(marks["used"].values, dtype=bool) & np.isfinite(places)


def _with_residuals(marks: xr.Dataset, fit: FittedTransform) -> xr.Dataset:
    """The marks with what the fit leaves of each."""
    used = paired(marks)
    for name, of_pairs in (("residual", np.hypot(*fit.residuals_um.T)), ("leave_one_out", fit.leave_one_out_um)):
        column = np.full(used.size, np.nan)
        column[used] = of_pairs
        marks = marks.assign({name: ("mark", column, {"units": "um", "long_name": RESULTS[name]})})
    return marks


class Link(NamedTuple):
    """How a layer comes to the reference: its registration to the next layer of the path, and all of them composed."""

    path: list[Layer]
    registration: Registration
    chain: Chain


def register_layers(layer: Layer, to: Layer, holes: LayerHoles, study: Study) -> Registration:
    """Register one layer to another one by the marks that the study names, or by the holes of both."""
    params = study.registration
    path = layer.params.marks or params.marks
    if path is None:
        return register_marks(holes.of(layer, to), holes.of(to, layer), params=params, hole_um=holes.params.hole_um)
    marks = read_given(path, layer, to)
    used = paired(marks)
    seen_from = {"moving": "bottom" if layer.side != to.side else "top", "fixed": "top"}
    placed = [_marked(marks, side, used).assign_attrs(seen_from=seen) for side, seen in seen_from.items()]
    fit = match_and_fit(*placed, params=params, pairs=np.stack([np.flatnonzero(used)] * 2, axis=1)).fit
    for side, a, b in (("moving", layer, to), ("fixed", to, layer)):
        is_placed = np.isfinite(marks[f"{side}_x"].values)
        if f"{side}_diameter" not in marks or not np.isfinite(marks[f"{side}_diameter"].values[is_placed]).all():
            marks = _with_diameters(marks, side, holes.of(a, b), float(np.mean(holes.params.hole_um)))
    source = str(marks.attrs.get("read_from", {}).get("format", "file"))
    return Registration(fit=fit, marks=_with_residuals(marks, fit), source=source)


def check_marks(layer: Layer | str, to: Layer | str, holes: LayerHoles, path: str | None) -> None:
    """Refuse what cannot be registered, before a volume is mapped: too few holes in an image, or marks of no use.

    ``layer`` and ``to`` are names where they are volumes that were not read yet; ``path`` is the file of their marks.
    """
    if path is not None:
        _read_pairs(path, layer, to)
        return
    for image in (layer, to):
        if not isinstance(image, str) and image.kind == "image":
            need_holes(holes.of(image, image), holes.params.hole_um)


def read_given(path: str, moving: Layer, fixed: Layer) -> xr.Dataset:
    """Read marks from a file of any known format and put them into the planes of two layers."""
    marks = _read_pairs(path, moving, fixed)
    return volume_to_map(marks, moving) if "volume_x" in marks else marks


def _read_pairs(path: str, moving: Layer | str, fixed: Layer | str) -> xr.Dataset:
    """Read three pairs or more."""
    pixels = [
        LayerPixels()
        if isinstance(layer, str) or layer.image is None
        else LayerPixels(pixel_um=layer.grid.pixel_um, shape=layer.grid.shape)
        for layer in (moving, fixed)
    ]
    marks = read_any(path, moving=pixels[0], fixed=pixels[1])
    pair_of_layers(marks, name=Path(path).name)  # one layer alone is refused
    if (count := int(paired(marks).sum())) < 3:
        raise MarkError(
            f"{Path(path).name} holds {count} pairs of marks in use; a registration needs 3 to say "
            "how good it is. Add more, far apart."
        )
    return marks


def volume_to_map(marks: xr.Dataset, layer: Layer) -> xr.Dataset:
    """Marks that were set in the volume, on the flat map of its sheet."""
    if layer.kind == "image":
        raise MarkError(
            f"The marks have places in a volume, and {layer.name} is an image. Give marks with places in both images "
            "(moving_x_um, moving_y_um), or the volume."
        )
    frame = Frame.of(layer.groups["surfaces"])
    points = _places(marks, "volume", frame.cols + frame.rows)
    uv = values_at(layer.groups["flat"], ("u", "v"), points)
    off_sheet = np.isfinite(points).all(axis=1) & ~np.isfinite(uv).all(axis=1)
    if off_sheet.any():
        raise MarkError(
            f"The marks {', '.join(map(str, marks['label'].values[off_sheet]))} do not lie on the sheet. Check the "
            "axes and the unit (um) of the table."
        )
    moved = marks.drop_vars("volume_z")
    moved = moved.rename({n: str(n).replace("volume_", "moving_") for n in moved if str(n).startswith("volume_")})
    return moved.assign(moving_x=("mark", uv[:, 0]), moving_y=("mark", uv[:, 1]))


def _marked(marks: xr.Dataset, side: str, used: Bools) -> xr.Dataset:
    """Marks of one layer as holes; with covariances where those of all pairs are known."""
    spread = [f"cov_{k}" for k in ("xx", "xy", "yy")]
    if not all(f"{side}_{k}" in marks and np.isfinite(marks[f"{side}_{k}"].values[used]).all() for k in spread):
        spread = []
    return xr.Dataset({name: ("mark", marks[f"{side}_{name}"].values) for name in ("x", "y", *spread)})


def _with_diameters(marks: xr.Dataset, side: str, holes: xr.Dataset, usual_um: float) -> xr.Dataset:
    """Give the marks of a layer the diameters of the holes that they lie in, and add the holes without a mark."""
    places, centres = _places(marks, side), np.stack([holes["x"].values, holes["y"].values], axis=1)
    size = holes["diameter"].values.astype(np.float64)
    diameter = np.where(np.isfinite(places[:, 0]), usual_um, np.nan)
    distance = np.linalg.norm(places[:, None] - centres, axis=2)
    inside = distance < 0.5 * size
    if len(centres):
        nearest = np.argmin(np.where(inside, distance, np.inf), axis=1)
        diameter = np.where(inside.any(axis=1), size[nearest], diameter)
    free = ~inside.any(axis=0)
    marks = marks.assign({f"{side}_diameter": ("mark", diameter, {"units": "um"})})
    if not free.any():
        return marks
    numbers = np.flatnonzero(free)
    columns = {
        f"{side}_x": centres[free, 0],
        f"{side}_y": centres[free, 1],
        f"{side}_diameter": size[free],
        "used": np.ones(numbers.size, dtype=bool),
        "label": np.array([f"{side} {k + 1}" for k in numbers]),
        f"{side}_source": np.array(["detected"] * numbers.size),
    }
    extra = xr.Dataset({name: ("mark", column) for name, column in columns.items()})
    joined = xr.concat([marks, extra], dim="mark", data_vars="all", join="outer", combine_attrs="override")
    for name in joined.data_vars:
        if str(name).endswith("_source"):
            joined[name] = joined[name].fillna("imported").astype(str)
    return joined.assign(used=joined["used"].astype(bool), label=joined["label"].astype(str))


def read_design(params: RegistrationParams) -> Pattern | None:
    """Read the pattern that was burnt; None where none is given."""
    return None if params.design is None else read_pattern(params.design)
