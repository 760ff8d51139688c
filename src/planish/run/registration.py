"""A registration with all marks of both layers: found, matched and fitted, or given.

And its file, ``marks.json``.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import xarray as xr

from planish.core.arrays import check_dataset
from planish.core.errors import MarkError
from planish.core.facts import HoleTiltFacts
from planish.core.options import params_of
from planish.core.typing import Array, Entries, Floats, Pair
from planish.design import read_pattern
from planish.marks import hole_tilt
from planish.marks.exchange import read_any, write_any
from planish.marks.exchange.model import RESULTS, join_holes, paired, points_of
from planish.register import (
    DesignedHoles,
    FittedTransform,
    RegistrationParams,
    registration_from_json,
    registration_to_json,
)
from planish.register import register_marks as match_and_fit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registration:
    """How a layer, the moving one, comes to another one, the fixed one.

    Call it with points ``(..., 2)``, ``(x, y)`` in um of the moving layer to get points of the
    fixed one.
    """

    fit: FittedTransform  #: the transformation with its errors
    #: Dims (mark,): all marks of both layers, matched or not: ``label``, ``used``, ``moving_x``,
    #: ``moving_y``, ``fixed_x``, ``fixed_y`` in um (NaN where a mark is not in a layer), diameters,
    #: covariances, sources, residuals.
    marks: xr.Dataset
    #: ``found``, ``texture``, ``both``, or the format of the file that the marks came from.
    source: str = "found"
    sentence: str | None = None  #: how the marks were matched
    second_best: int | None = None  #: marks that the second-best match has in common
    design: str | None = None  #: what the designed pattern says
    tilt: HoleTiltFacts | None = None  #: what the holes look like through the sheet
    #: of a search by texture: that unrelated layers would have been linked.
    false_probability: float | None = None

    #: Of ``both``: how far apart the places by holes and by texture lie in the middle, and how far
    #: they may, um, rms.
    apart_um: Pair | None = None

    def __call__(self, points: Any) -> Floats:
        """Take points from the moving to the fixed layer, in um."""
        return self.fit(points)

    def count(self, side: str) -> int:
        """Number of marks in one layer, matched or not."""
        return int(np.isfinite(self.marks[f"{side}_x"].values).sum())

    def agreement(self) -> str:
        """How many marks agree to what, and which were left out, in a sentence."""
        return self.fit.agreement(self._labels.tolist())

    @property
    def _labels(self) -> Array:
        """Labels of the marks that the fit uses."""
        return self.marks["label"].values[paired(self.marks)]

    def pairs(self) -> xr.Dataset:
        """The marks that the fit uses: positions, residuals and weights, a row each."""
        fit, um = self.fit, {"units": "um"}
        vectors_um = {"moving": fit.moving, "fixed": fit.fixed, "residual": fit.residuals_um}
        columns: dict[str, Floats] = {}
        for name, xy in vectors_um.items():
            columns[f"{name}_x"], columns[f"{name}_y"] = xy.T
        columns["residual"] = np.hypot(*fit.residuals_um.T)
        columns["leave_one_out"] = fit.leave_one_out_um
        variables: Entries = {name: ("mark", values, um) for name, values in columns.items()}
        variables["weight"] = ("mark", fit.robust_weights, {"units": "1"})
        variables["label"] = ("mark", self._labels.astype(object))
        return xr.Dataset(variables)

    def save(self, path: str | Path) -> None:
        """Write ``marks.json``: all marks, and the transformation fitted to them."""
        saved = registration_to_json(self.fit)
        if self.false_probability is not None:
            saved["search"] = {
                "false_probability": self.false_probability,
                "sentence": self.sentence,
            }
        write_any(self.marks.assign_attrs(registration=saved), path, to="json")

    @classmethod
    def read(cls, path: str | Path) -> Self:
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
                f"{Path(path).name} holds marks without a registration. Make one with 'planish"
                " register', or give the marks.json of a run."
            )
        fit = registration_from_json(saved)
        mask = paired(marks)
        for side, fitted in (("moving", fit.moving), ("fixed", fit.fixed)):
            if not np.array_equal(points_of(marks, side)[mask], fitted):
                raise MarkError(
                    f"The marks in {Path(path).name} were changed after the registration was fitted"
                    " to them. Register them again: planish register, or planish link --marks."
                )
        search = saved.get("search", {})
        return cls(fit=fit, marks=marks, source="json", **search)


def register_marks(
    moving: xr.Dataset,
    fixed: xr.Dataset,
    *,
    params: RegistrationParams | None = None,
    hole_um: Pair = (100.0, 300.0),
) -> Registration:
    """Match the laser holes of two layers and fit the transformation.

    The rotation and shift of the layers are unknown.

    Parameters
    ----------
    moving, fixed : Dataset (mark)
        Holes of :func:`planish.find_holes`, or ``x`` and ``y`` in um alone. The attribute ``layer``
        says what they are called in messages, ``seen_from`` which side of the sheet is seen,
        ``"top"`` or ``"bottom"``: the top where it is missing. Layers that show opposite sides see
        each other mirrored.
    params : RegistrationParams, optional
    hole_um : (float, float)
        Diameters that were looked for, for messages.

    Returns
    -------
    Registration

    Raises
    ------
    CannotRegister
        If there are too few holes, they do not match, or they ask for a scale that the calibrations
        exclude.
    MarkError
        If ``seen_from`` is neither top nor bottom.

    Notes
    -----
    Hirn et al. (2009), section 2.4. Each pair is weighted with the covariances of its two holes.
    """
    calls = ("pl.register_marks({}, fixed)", "pl.register_marks(moving, {})")
    for holes, call in zip((moving, fixed), calls, strict=True):
        check_dataset(
            holes, "x", "y", expected="holes", source="pl.find_holes(...)", call_format=call
        )
    fit_params = params_of(RegistrationParams, params, "pl.register_marks")
    return register_holes(moving, fixed, fit_params, hole_um)


def register_holes(
    moving: xr.Dataset, fixed: xr.Dataset, params: RegistrationParams, hole_um: Pair
) -> Registration:
    """Match the holes of two layers, by their pattern where it is known, and fit to the pairs."""
    designed = None
    if params.design is not None:
        pattern = read_pattern(params.design)
        labels = tuple(pattern.labels)
        designed = DesignedHoles(name=pattern.name, places_um=pattern.imaged_um, labels=labels)
    fit, match = match_and_fit(moving, fixed, params=params, pattern=designed, hole_um=hole_um)
    marks = with_residuals(join_holes(moving, fixed, match.pairs, match.labels), fit)
    return Registration(
        fit=fit,
        marks=marks,
        sentence=match.sentence,
        second_best=match.second_best,
        design=match.design,
        tilt=hole_tilt(moving),
    )


def with_residuals(marks: xr.Dataset, fit: FittedTransform) -> xr.Dataset:
    """The marks with what the fit leaves of each, in um; NaN for those that it does not use."""
    is_paired = paired(marks)
    lengths_um = np.hypot(*fit.residuals_um.T)
    left_um = {"residual": lengths_um, "leave_one_out": fit.leave_one_out_um}
    for name, pairs_um in left_um.items():
        um = np.full(is_paired.size, np.nan)
        um[is_paired] = pairs_um
        attrs = {"units": "um", "long_name": RESULTS[name]}
        marks = marks.assign({name: ("mark", um, attrs)})
    return marks
