"""Holes of two planes -> which belong together, and the registration that they support."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotRegister, MarkError
from planish.register.fit import fit_transform
from planish.register.match import match_marks
from planish.register.match_design import match_by_design
from planish.register.model import Floats
from planish.register.params import RegistrationParams
from planish.register.result import FittedTransform

if TYPE_CHECKING:
    import xarray as xr

Ints = NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HolePlane:
    """A flattened sheet or an image, as far as its registration needs to know it.

    Attributes
    ----------
    name : str
        In messages.
    holes : Dataset (mark) or None
        ``x``, ``y`` and, where known, ``diameter`` and the covariance ``cov_xx``, ``cov_xy``, ``cov_yy`` of their
        centres, in um of the plane; None where they were not searched for.
    faces : {"top", "bottom"}
        Side of the sheet that it shows.
    """

    name: str
    holes: xr.Dataset | None
    faces: Literal["top", "bottom"] = "top"

    @property
    def places_um(self) -> Floats:
        """Centres (n, 2) of the holes, ``(x, y)``."""
        if self.holes is None:
            return np.empty((0, 2))
        return np.stack([self.holes["x"].values, self.holes["y"].values], axis=1).astype(np.float64)

    def covariance_um2(self, which: Ints) -> Floats | None:
        """Covariances (k, 2, 2) of some holes; None where they are not known."""
        if self.holes is None or "cov_xx" not in self.holes:
            return None
        xx, xy, yy = (self.holes[f"cov_{k}"].values[which] for k in ("xx", "xy", "yy"))
        return np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignedHoles:
    """Holes of the pattern that was burnt: places (d, 2) in um, as an image shows them, and labels."""

    name: str
    places_um: Floats
    labels: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GivenPairs:
    """Pairs that are known: rows (k, 2) of the holes of the moving and of the fixed plane, and labels."""

    rows: Ints
    labels: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registration:
    """How one plane lies on another.

    Attributes
    ----------
    fit : FittedTransform
        Moving to fixed.
    labels : tuple of str
        Of its marks.
    pairs : ndarray of int, shape (k, 2)
        Row of each mark in the holes of the moving and of the fixed plane.
    source : {"found", "design", "given"}
        Holes matched by their places alone, by the design, or pairs that were given.
    sentence : str
        How many holes match; empty for given pairs.
    second_best : int or None
        Marks that agree in the second-best match; None for given pairs.
    design : str
        About the design, where one was used.
    """

    fit: FittedTransform
    labels: tuple[str, ...]
    pairs: Ints
    source: Literal["found", "design", "given"]
    sentence: str = ""
    second_best: int | None = None
    design: str = ""


def register_marks(
    moving: HolePlane,
    fixed: HolePlane,
    *,
    params: RegistrationParams,
    pattern: DesignedHoles | None = None,
    pairs: GivenPairs | None = None,
) -> Registration:
    """Match the holes of two planes and fit the transformation from one to the other.

    Parameters
    ----------
    moving, fixed : HolePlane
        Planes that show opposite sides of the sheet see each other mirrored.
    params : RegistrationParams
        Tolerances, mirror images and model; ``marks`` and ``design`` are for whoever reads the files.
    pattern : DesignedHoles, optional
        Identifies the holes by their position in the pattern.
    pairs : GivenPairs, optional
        Pairs that are known; nothing is matched then.

    Returns
    -------
    Registration
        Each pair is weighted by the covariances of its two holes where both are known.

    Raises
    ------
    CannotRegister
        If there are too few holes, they do not match, or they fit at a scale that the calibrations exclude.
    MarkError
        If fewer than 3 pairs are given, or they cannot be used.
    """
    a, b = moving.places_um, fixed.places_um
    facing = moving.faces != fixed.faces
    facts: dict[str, Any]
    if pairs is not None:
        rows, facts = pairs.rows, {"labels": pairs.labels, "source": "given"}
        mirrored = None if params.mirror else facing
        if len(rows) < 3:
            raise MarkError(
                f"{len(rows)} control points given, a similarity needs 3 to state its error. Add more, far apart."
            )
    else:
        rows, hand, facts = _matched(a * (-1.0, 1.0) if facing else a, b, (moving.name, fixed.name), params, pattern)
        mirrored = hand != facing
    at, to = a[rows[:, 0]], b[rows[:, 1]]
    weights, spread = None, (moving.covariance_um2(rows[:, 0]), fixed.covariance_um2(rows[:, 1]))
    if spread[0] is not None and spread[1] is not None:
        turn = fit_transform(at, to, mirrored=mirrored).transform.matrix()
        weights = turn @ spread[0] @ turn.T + spread[1]
    fit = fit_transform(at, to, model=params.model, mirrored=mirrored, weights=weights, lowest="similarity")
    off = abs(fit.transform.scale - 1)
    if off > params.scale_tolerance:
        raise CannotRegister(
            f"The marks fit at a scale of {fit.transform.scale:.4f}, which is {100 * off:.1f} % off the calibration; "
            f"{100 * params.scale_tolerance:.0f} % are allowed. Check --voxel-um and --pixel-um, and the marks."
        )
    return Registration(fit=fit, pairs=rows, **facts)


def _matched(
    a: Floats, b: Floats, names: tuple[str, str], params: RegistrationParams, pattern: DesignedHoles | None
) -> tuple[Ints, bool, dict[str, Any]]:
    """Pairs, whether they are mirrored, and how they were found; ``a`` is turned over where the planes face."""
    how: dict[str, Any] = {
        "scale_tolerance": params.scale_tolerance, "tolerance_um": params.tolerance_um, "mirror": params.mirror,
        "names": names,
    }  # fmt: skip
    if pattern is None:
        found = match_marks(a, b, **how)
        facts: dict[str, Any] = {"labels": tuple(f"hole {k + 1}" for k in range(len(found.pairs))), "source": "found"}
    else:
        found = match_by_design(a, b, pattern.places_um, labels=pattern.labels, **how)
        back = ", viewed from behind or drawn with its y axis upwards" if found.fixed.mirrored else ""
        design = f"Holes identified by the pattern {pattern.name} of {len(pattern.labels)} holes{back}."
        facts = {"labels": found.labels, "source": "design", "design": design}
    if len(found.pairs) < 3:
        raise CannotRegister(
            f"Only {len(found.pairs)} designed holes are found in both the {names[0]} and the {names[1]}; 3 are "
            "needed. Image a larger common field."
        )
    return found.pairs, found.mirrored, facts | {"sentence": found.sentence, "second_best": found.second_best}


def check_enough(plane: HolePlane, hole_um: tuple[float, float]) -> None:
    """Stop early where there cannot be a match.

    Raises
    ------
    CannotRegister
        If fewer than three holes were found; where they were not searched for it does not matter.
    """
    places = plane.places_um
    count = len(places)
    if plane.holes is None or count >= 3:
        return
    what = "No hole" if count == 0 else f"Only {count} hole{'s' * (count > 1)}"
    at = "".join(f" ({x:.0f}, {y:.0f}) um" for x, y in places)
    raise CannotRegister(
        f"{what} found in the {plane.name}{' at' + at if at else ''}; at least 3 are needed, and 4 to notice a wrong "
        f"match. Searched for round holes of {hole_um[0]:g} to {hole_um[1]:g} um (--hole-um). Check the "
        "voxel and pixel sizes, or give pairs of points with --marks."
    )
