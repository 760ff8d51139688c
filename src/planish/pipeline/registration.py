"""A registration with all marks of both layers: found, matched and fitted, or given; and its file, ``marks.json``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.arrays import check_dataset
from planish.core.errors import MarkError
from planish.core.facts import HoleTiltFacts
from planish.core.frame import Frame
from planish.core.grid import values_at
from planish.core.options import params_of
from planish.marks import hole_tilt
from planish.marks.design import Pattern, read_pattern
from planish.marks.files import LayerPixels, Places, make_marks, pair_of_layers, read_any, write_any
from planish.marks.files.model import RESULTS
from planish.pipeline.layers import Layer
from planish.register import (
    DesignedHoles,
    FittedTransform,
    RegistrationParams,
    need_holes,
    registration_from_json,
    registration_to_json,
)
from planish.register import register_marks as match_and_fit
from planish.study import Study

Array = NDArray[np.float64]


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

    def __call__(self, points: Any) -> Array:
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
        values = {
            "moving_x": fit.moving[:, 0], "moving_y": fit.moving[:, 1], "fixed_x": fit.fixed[:, 0],
            "fixed_y": fit.fixed[:, 1], "residual_x": fit.residuals_um[:, 0], "residual_y": fit.residuals_um[:, 1],
            "residual": np.hypot(*fit.residuals_um.T), "leave_one_out": fit.leave_one_out_um,
        }  # fmt: skip
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
        found = cls(fit=registration_from_json(saved), marks=marks, source="json")
        mask = paired(marks)
        at = [np.stack([marks[f"{s}_{k}"].values[mask] for k in "xy"], axis=1) for s in ("moving", "fixed")]
        if not (np.array_equal(at[0], found.fit.moving) and np.array_equal(at[1], found.fit.fixed)):
            raise MarkError(
                f"The marks in {Path(path).name} were changed after the registration was fitted to them. Register them "
                "again: planish register, or planish link --marks."
            )
        return found


# --- marks that are found ------------------------------------------------------------------------------------------


def register_marks(
    moving: xr.Dataset, fixed: xr.Dataset, *, params: RegistrationParams | None = None,
    hole_um: tuple[float, float] = (100.0, 300.0),
) -> Registration:  # fmt: skip
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
    pattern = read_design(r)
    designed = None
    if pattern is not None:
        designed = DesignedHoles(name=pattern.name, places_um=pattern.imaged_um, labels=tuple(pattern.labels))
    found = match_and_fit(moving, fixed, params=r, pattern=designed, hole_um=hole_um)
    marks = _all_marks(moving, fixed, found.pairs, list(found.labels))
    return Registration(
        fit=found.fit, marks=_with_residuals(marks, found.fit), sentence=found.sentence,
        second_best=found.second_best, design=found.design, tilt=hole_tilt(moving),
    )  # fmt: skip


def _all_marks(moving: xr.Dataset, fixed: xr.Dataset, pairs: NDArray[np.intp], labels: list[str]) -> xr.Dataset:
    """All holes of both layers: the pairs first, then those of the moving and of the fixed layer alone."""
    alone = [np.setdiff1d(np.arange(h.sizes["mark"]), pairs[:, k]) for k, h in enumerate((moving, fixed))]
    nowhere = [np.full(n.size, -1) for n in alone]
    rows = {
        "moving": np.concatenate([pairs[:, 0], alone[0], nowhere[1]]),
        "fixed": np.concatenate([pairs[:, 1], nowhere[0], alone[1]]),
    }
    names = [*labels, *(f"moving {k + 1}" for k in alone[0]), *(f"fixed {k + 1}" for k in alone[1])]
    sides = (("moving", moving), ("fixed", fixed))
    layers = {side: Places.of_holes(h, rows[side], h.attrs.get("source", "detected")) for side, h in sides}
    about = {
        side: {k: h.attrs[name] for k, name in (("title", "layer"), ("side", "seen_from")) if name in h.attrs}
        for side, h in sides
    }
    return make_marks(names, layers, about=about)


def paired(marks: xr.Dataset) -> NDArray[np.bool_]:
    """Marks that are in use and lie in both layers."""
    moving = "volume" if "volume_x" in marks else "moving"  # places in a volume become places on the map of its sheet
    there = [np.isfinite(marks[f"{side}_x"].values) for side in (moving, "fixed")]
    return np.asarray(marks["used"].values, dtype=bool) & there[0] & there[1]


def _with_residuals(marks: xr.Dataset, fit: FittedTransform) -> xr.Dataset:
    """The marks with what the fit leaves of each."""
    used = paired(marks)
    for name, values in (("residual", np.hypot(*fit.residuals_um.T)), ("leave_one_out", fit.leave_one_out_um)):
        all_ = np.full(used.size, np.nan)
        all_[used] = values
        marks = marks.assign({name: ("mark", all_, {"units": "um", "long_name": RESULTS[name]})})
    return marks


# --- marks of two layers ---------------------------------------------------------------------------------------------


def register_layers(layer: Layer, to: Layer, study: Study) -> Registration:
    """Register one layer to another one by the marks that the study names, or by the holes of both."""
    r, params = study.registration, study.holes

    def holes(of: Layer, other: Layer) -> xr.Dataset:
        # A sheet is always seen from its top; its holes are searched in the face that the image shows.
        return of.holes(params, other.side if other.kind == "image" else "top")

    path = layer.params.marks or r.marks
    if path is None:
        return register_marks(holes(layer, to), holes(to, layer), params=r, hole_um=params.hole_um)
    marks = read_given(path, layer, to)
    used = paired(marks)
    sides = {"moving": "bottom" if layer.side != to.side else "top", "fixed": "top"}
    both = [_marked(marks, side, used).assign_attrs(seen_from=seen) for side, seen in sides.items()]
    fit = match_and_fit(*both, params=r, pairs=np.stack([np.flatnonzero(used)] * 2, axis=1)).fit
    for side, one, other in (("moving", layer, to), ("fixed", to, layer)):
        there = np.isfinite(marks[f"{side}_x"].values)
        if f"{side}_diameter" not in marks or not np.isfinite(marks[f"{side}_diameter"].values[there]).all():
            marks = _with_diameters(marks, side, holes(one, other), float(np.mean(params.hole_um)))
    source = str(marks.attrs.get("read_from", {}).get("format", "file"))
    return Registration(fit=fit, marks=_with_residuals(marks, fit), source=source)


def check_marks(layer: Layer | str, to: Layer | str, study: Study, marks: str | None) -> None:
    """Refuse what cannot be registered, before a volume is mapped: too few holes in an image, or marks of no use.

    ``layer`` and ``to`` are names where they are volumes that were not read yet; ``marks`` is the file of this layer.
    """
    path = marks or study.registration.marks
    if path is not None:
        _read_pairs(path, layer, to)
        return
    for one in (layer, to):
        if not isinstance(one, str) and one.kind == "image":
            need_holes(one.holes(study.holes, one.side), study.holes.hole_um)


def read_given(path: str, moving: Layer, fixed: Layer) -> xr.Dataset:
    """Read marks from a file of any known format and put them into the planes of two layers."""
    marks = _read_pairs(path, moving, fixed)
    return volume_to_map(marks, moving) if "volume_x" in marks else marks


def _read_pairs(path: str, moving: Layer | str, fixed: Layer | str) -> xr.Dataset:
    """Read three pairs or more."""
    about = [
        LayerPixels()
        if isinstance(layer, str) or layer.image is None
        else LayerPixels(pixel_um=layer.grid.pixel_um, shape=layer.grid.shape)
        for layer in (moving, fixed)
    ]
    marks = read_any(path, moving=about[0], fixed=about[1])
    pair_of_layers(marks, name=Path(path).name)  # one layer alone is refused
    if int(paired(marks).sum()) < 3:
        raise MarkError(
            f"{Path(path).name} holds {int(paired(marks).sum())} pairs of marks in use; a registration needs 3 to say "
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
    measured, flat = layer.groups["surfaces"], layer.groups["flat"]
    frame = Frame.of(measured)
    points = np.stack([marks[f"volume_{axis}"].values for axis in (frame.cols, frame.rows)], axis=1)
    uv = values_at(flat, ("u", "v"), points)
    known: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=1))
    lost = [str(n) for n, p, k in zip(marks["label"].values, uv, known, strict=True) if k and not np.isfinite(p).all()]
    if lost:
        raise MarkError(
            f"The marks {', '.join(lost)} do not lie on the sheet. Check the axes and the unit (um) of the table."
        )
    moved = marks.drop_vars("volume_z")
    moved = moved.rename({n: str(n).replace("volume_", "moving_") for n in moved if str(n).startswith("volume_")})
    return moved.assign(moving_x=("mark", uv[:, 0]), moving_y=("mark", uv[:, 1]))


def _marked(marks: xr.Dataset, side: str, used: NDArray[np.bool_]) -> xr.Dataset:
    """Marks of one layer as holes; with covariances where those of all pairs are known."""
    names = ["x", "y"]
    spread = [f"cov_{k}" for k in ("xx", "xy", "yy")]
    if all(f"{side}_{k}" in marks and np.isfinite(marks[f"{side}_{k}"].values[used]).all() for k in spread):
        names += spread
    return xr.Dataset({name: ("mark", marks[f"{side}_{name}"].values) for name in names})


def _with_diameters(marks: xr.Dataset, side: str, holes: xr.Dataset, usual_um: float) -> xr.Dataset:
    """Give the marks of a layer the diameters of the holes that they lie in, and add the holes without a mark."""
    at = np.stack([marks[f"{side}_{k}"].values for k in "xy"], axis=1)
    found = np.stack([holes["x"].values, holes["y"].values], axis=1)
    size = holes["diameter"].values.astype(np.float64)
    diameter = np.where(np.isfinite(at[:, 0]), usual_um, np.nan)
    free = np.ones(len(found), dtype=bool)
    if len(found):
        apart = np.linalg.norm(at[:, None] - found, axis=2)
        inside = apart < 0.5 * size
        nearest = np.argmin(np.where(inside, apart, np.inf), axis=1)
        diameter = np.where(inside.any(axis=1), size[nearest], diameter)
        free = ~inside.any(axis=0)
    marks = marks.assign({f"{side}_diameter": ("mark", diameter, {"units": "um"})})
    if not free.any():
        return marks
    extra = xr.Dataset(
        {
            f"{side}_x": ("mark", found[free, 0]), f"{side}_y": ("mark", found[free, 1]),
            f"{side}_diameter": ("mark", size[free]), "used": ("mark", np.ones(int(free.sum()), dtype=bool)),
            "label": ("mark", np.array([f"{side} {k + 1}" for k in np.flatnonzero(free)])),
            f"{side}_source": ("mark", np.array(["detected"] * int(free.sum()))),
        }
    )  # fmt: skip
    joined = xr.concat([marks, extra], dim="mark", data_vars="all", join="outer", combine_attrs="override")
    for name in joined.data_vars:
        if str(name).endswith("_source"):
            joined[name] = joined[name].fillna("imported").astype(str)
    return joined.assign(used=joined["used"].astype(bool), label=joined["label"].astype(str))


def read_design(params: RegistrationParams) -> Pattern | None:
    """Read the pattern that was burnt; None where none is given."""
    return None if params.design is None else read_pattern(params.design)
