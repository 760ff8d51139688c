"""Marks of two planes, found or given, brought together, and the transformation that they support."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import CannotRegister, MarkError
from planish.marks import Side, hole_tilt
from planish.marks.design import Pattern, read_pattern
from planish.pipeline.run import Array
from planish.register import FittedTransform, fit_transform, match_by_design, match_marks
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
    """Match the holes of two planes and fit the transformation.

    Raises
    ------
    CannotRegister
        If there are too few holes, they do not match, or they ask for a scale that the calibrations exclude.
    """
    assert moving.holes is not None
    assert fixed.holes is not None
    names = (moving.name, fixed.name)
    for plane in (moving, fixed):
        check_enough(plane, r.hole_um)
    a, b = (np.stack([h["x"].values, h["y"].values], axis=1) for h in (moving.holes, fixed.holes))
    # Planes that show opposite sides see each other mirrored; after one is turned over they have the same hand.
    facing = moving.faces != fixed.faces
    turned = a * (-1.0, 1.0) if facing else a
    how: dict[str, Any] = {
        "scale_tolerance": r.scale_tolerance, "tolerance_um": r.tolerance_um, "mirror": r.mirror, "names": names
    }  # fmt: skip
    behind = False
    if pattern is None:
        found = match_marks(turned, b, **how)
        labels = [f"hole {k + 1}" for k in range(len(found.pairs))]
    else:
        found = match_by_design(turned, b, pattern.seen_um, labels=pattern.labels, **how)
        labels = list(found.labels)
        behind = found.fixed.mirrored
    pairs = found.pairs
    if len(pairs) < 3:
        raise CannotRegister(
            f"Only {len(pairs)} designed holes are seen in the {names[0]} and in the {names[1]}; 3 are needed. "
            "Image a larger common field."
        )
    fit = _fitted(
        a[pairs[:, 0]], b[pairs[:, 1]], r, mirrored=found.mirrored != facing,
        spread=(_covariance(moving.holes, pairs[:, 0]), _covariance(fixed.holes, pairs[:, 1])),
    )  # fmt: skip
    _check_scale(fit, r)
    spare = np.setdiff1d(np.arange(len(b)), pairs[:, 1])
    matched_um = np.maximum(
        moving.holes["diameter"].values[pairs[:, 0]] * fit.transform.scale, fixed.holes["diameter"].values[pairs[:, 1]]
    )
    seen: dict[str, Any] = {"source": "found", f"found_{names[0]}": len(a), f"found_{names[1]}": len(b),
                            "sentence": found.sentence, "rival_inliers": found.rival_inliers}  # fmt: skip
    if (told := hole_tilt(moving.holes)) is not None:
        seen["tilt"] = told.model_dump(mode="json")
    if pattern is not None:
        seen["design"] = {
            "name": pattern.name,
            "holes": len(pattern.labels),
            "sentence": f"The marks were told by the pattern {pattern.name} of {len(pattern.labels)} holes"
            + (", which is seen from behind, or drawn with its y axis the other way." if behind else "."),
        }
    return Joined(
        fit=fit,
        labels=labels,
        blocked_um=np.concatenate([b[pairs[:, 1]], b[spare]]),
        blocked_diameter_um=np.concatenate([matched_um, fixed.holes["diameter"].values[spare]]),
        seen=seen,
    )


def join_given(given: xr.Dataset, moving_um: Array, moving: Plane, fixed: Plane, r: RegistrationSection) -> Joined:
    """Fit the transformation to pairs of points that somebody has set.

    Parameters
    ----------
    given : Dataset (mark)
        ``label``, ``fixed_x``, ``fixed_y`` in um.
    moving_um : (n, 2)
        Their partners in the moving plane.
    """
    fixed_um = np.stack([given["fixed_x"].values, given["fixed_y"].values], axis=1)
    if len(fixed_um) < 3:
        raise MarkError(
            f"{len(fixed_um)} control points given, a similarity needs 3 to say how good it is. Add more, far apart."
        )
    facing = moving.faces != fixed.faces
    fit = _fitted(moving_um, fixed_um, r, mirrored=None if r.mirror else facing)
    _check_scale(fit, r)
    return Joined(
        fit=fit,
        labels=[str(v) for v in given["label"].values],
        blocked_um=fixed_um,
        blocked_diameter_um=np.full(len(fixed_um), float(np.mean(r.hole_um))),
        seen={"source": "file"},
    )


def read_design(path: str | None) -> Pattern | None:
    """Read the pattern that was burnt; None where none is given."""
    return None if path is None else read_pattern(path)


def _fitted(
    moving: Array, fixed: Array, r: RegistrationSection, *, mirrored: bool | None,
    spread: tuple[Array, Array] | None = None,
) -> FittedTransform:  # fmt: skip
    if spread is None:
        return fit_transform(moving, fixed, model=r.model, mirrored=mirrored, lowest="similarity")
    turn = fit_transform(moving, fixed, mirrored=mirrored).transform.matrix()
    weights = turn @ spread[0] @ turn.T + spread[1]
    return fit_transform(moving, fixed, model=r.model, mirrored=mirrored, weights=weights, lowest="similarity")


def _covariance(holes: xr.Dataset, which: NDArray[np.intp]) -> Array:
    """Covariances (n, 2, 2) of some holes."""
    xx, xy, yy = (holes[f"cov_{k}"].values[which] for k in ("xx", "xy", "yy"))
    return np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)


def _check_scale(fit: FittedTransform, r: RegistrationSection) -> None:
    off = abs(fit.transform.scale - 1)
    if off > r.scale_tolerance:
        raise CannotRegister(
            f"The marks ask for a scale of {fit.transform.scale:.4f}, which is {100 * off:.1f} % off the calibration; "
            f"{100 * r.scale_tolerance:.0f} % are allowed. Check --voxel-um and --pixel-um, and the marks."
        )


def check_enough(plane: Plane, hole_um: tuple[float, float]) -> None:
    """Stop early when there cannot be a match.

    Raises
    ------
    CannotRegister
        If fewer than three holes were found; where pairs are given it does not matter.
    """
    if plane.holes is None:
        return
    holes, count = plane.holes, plane.holes.sizes["mark"]
    if count >= 3:
        return
    what = "No hole was" if count == 0 else f"Only {count} hole{'s were' if count > 1 else ' was'}"
    at = "".join(f" ({x:.0f}, {y:.0f}) um" for x, y in zip(holes["x"].values, holes["y"].values, strict=True))
    raise CannotRegister(
        f"{what} found in the {plane.name}{' at' + at if at else ''}; at least 3 are needed, and 4 to notice a wrong "
        f"match. Looked for round holes of {hole_um[0]:g} to {hole_um[1]:g} um (--hole-um). Check the "
        f"{'voxel' if plane.name == 'volume' else 'pixel'} size, or give pairs of points with --marks."
    )
