"""Marks of two planes, found or given, brought together, and the transformation that they support."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from planish.marks import Side, hole_tilt
from planish.marks.design import Pattern, read_pattern
from planish.pipeline.run import Array
from planish.register import (
    DesignedHoles,
    FittedTransform,
    GivenPairs,
    HolePlane,
    RegistrationParams,
    register_marks,
)
from planish.register import check_enough as _check_enough
from planish.study import RegistrationSection


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """A flattened sheet or an image, as far as the registration needs to know it.

    Attributes
    ----------
    name : str
        What messages call it.
    holes : Dataset (mark) or None
        Of :func:`planish.marks.find_holes`, in the plane's own um; None where pairs of points are given.
    side : {"top", "bottom"} or None
        Which side of the sheet an image shows, if somebody said so; flattened sheets are seen from the top.
    sheet : bool
        Whether it is a flattened sheet.
    md_deg : float or None
        Machine direction, deg clockwise on screen from the x axis, if somebody said so.
    """

    name: str
    holes: xr.Dataset | None
    side: Side | None = None
    sheet: bool = False
    md_deg: float | None = None

    @property
    def faces(self) -> Side:
        """The side it shows; the top where nobody said so."""
        return self.side or "top"

    @property
    def marks(self) -> HolePlane:
        """As the registration takes it."""
        return HolePlane(name=self.name, holes=self.holes, faces=self.faces)


@dataclass(frozen=True, slots=True, kw_only=True)
class Joined:
    """Two planes brought together.

    Attributes
    ----------
    fit : FittedTransform
        Moving to fixed.
    labels : list of str
        Of its marks.
    blocked_um, blocked_diameter_um : (n, 2) and (n,)
        All holes that are known in the fixed plane, also those without a partner.
    seen : dict
        How it came about, for the results.
    """

    fit: FittedTransform
    labels: list[str]
    blocked_um: Array
    blocked_diameter_um: Array
    seen: dict[str, Any]


def join_found(moving: Plane, fixed: Plane, r: RegistrationSection, pattern: Pattern | None = None) -> Joined:
    """Match the holes of two planes and fit the transformation."""
    assert moving.holes is not None
    assert fixed.holes is not None
    for plane in (moving, fixed):
        check_enough(plane, r.hole_um)
    holes = None
    if pattern is not None:
        holes = DesignedHoles(name=pattern.name, places_um=pattern.seen_um, labels=tuple(pattern.labels))
    found = register_marks(moving.marks, fixed.marks, params=_params(r), pattern=holes)
    b, pairs = fixed.marks.places_um, found.pairs
    spare = np.setdiff1d(np.arange(len(b)), pairs[:, 1])
    matched_um = np.maximum(
        moving.holes["diameter"].values[pairs[:, 0]] * found.fit.transform.scale,
        fixed.holes["diameter"].values[pairs[:, 1]],
    )
    seen: dict[str, Any] = {
        "source": "found", f"found_{moving.name}": moving.holes.sizes["mark"], f"found_{fixed.name}": len(b),
        "sentence": found.sentence, "rival_inliers": found.second_best,
    }  # fmt: skip
    if (tilt := hole_tilt(moving.holes)) is not None:
        seen["tilt"] = tilt.model_dump(mode="json")
    if pattern is not None:
        seen["design"] = {"name": pattern.name, "holes": len(pattern.labels), "sentence": found.design}
    return Joined(
        fit=found.fit,
        labels=list(found.labels),
        blocked_um=np.concatenate([b[pairs[:, 1]], b[spare]]),
        blocked_diameter_um=np.concatenate([matched_um, fixed.holes["diameter"].values[spare]]),
        seen=seen,
    )


def join_given(given: xr.Dataset, moving_um: Array, moving: Plane, fixed: Plane, r: RegistrationSection) -> Joined:
    """Fit the transformation to given pairs of points: ``label``, ``fixed_x``, ``fixed_y`` and partners (n, 2)."""
    fixed_um = np.stack([given["fixed_x"].values, given["fixed_y"].values], axis=1)
    sides = (
        replace(plane.marks, holes=xr.Dataset({"x": ("mark", at[:, 0]), "y": ("mark", at[:, 1])}))
        for plane, at in ((moving, moving_um), (fixed, fixed_um))
    )
    rows = np.repeat(np.arange(len(fixed_um))[:, None], 2, axis=1)
    pairs = GivenPairs(rows=rows, labels=tuple(str(v) for v in given["label"].values))
    found = register_marks(*sides, params=_params(r), pairs=pairs)
    return Joined(
        fit=found.fit,
        labels=list(found.labels),
        blocked_um=fixed_um,
        blocked_diameter_um=np.full(len(fixed_um), float(np.mean(r.hole_um))),
        seen={"source": "file"},
    )


def check_enough(plane: Plane, hole_um: tuple[float, float]) -> None:
    """Stop early where there cannot be a match."""
    _check_enough(plane.marks, hole_um)


def _params(r: RegistrationSection) -> RegistrationParams:
    return RegistrationParams(**r.model_dump(exclude={"hole_um"}))


def read_design(path: str | None) -> Pattern | None:
    """Read the pattern that was burnt; None where none is given."""
    return None if path is None else read_pattern(path)
