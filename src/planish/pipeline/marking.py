"""Marks of two planes, found or given, brought together, and the transformation that they support."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import CannotRegister, MarkError
from planish.core.frame import Frame
from planish.marks import Side, find_holes_in_sheet
from planish.marks.design import Pattern, read_pattern
from planish.pipeline.run import Array
from planish.register import FittedTransform, fit_transform, match_by_design, match_marks
from planish.study import RegistrationSection
from planish.surface.presence import LAYERS

_ENOUGH_THROUGH = 4  # holes seen on both sides: the median of fewer is no better than none
_MIDDLE = float(np.mean(LAYERS["presence"]))  # of the layer, as a share of the thickness from the centre surface
_TO_FACE = (0.5 - _MIDDLE) / (_MIDDLE - float(np.mean(LAYERS["presence_bottom"])))


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
    if pattern is None:
        found = match_marks(turned, b, **how)
        labels = [f"hole {k + 1}" for k in range(len(found.pairs))]
    else:
        found = match_by_design(turned, b, pattern.seen_um, labels=pattern.labels, **how)
        labels = list(found.labels)
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
    if (told := in_sheet_results(moving.holes)) is not None:
        seen["tilt"] = told
    if pattern is not None:
        seen["design"] = {"name": pattern.name, "holes": len(pattern.labels)}
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


def holes_of_map(maps: xr.Dataset, hole_um: tuple[float, float], side: Side = "top") -> xr.Dataset:
    """Holes of the flattened sheet, in (u, v), as they are at the face that the other plane shows.

    They are found in a layer below that face, and a laser that stands obliquely shifts them from layer to layer. A
    hole that is seen on both sides is carried on along its own axis to the face, one that is not along the median of
    the others.

    Maps of an older run, which hold one layer only, give those of the top for either side.
    """
    step = float(maps["u"].values[1] - maps["u"].values[0])
    layers = {"top": "presence", "centre": "presence_centre", "bottom": "presence_bottom"}
    whole = "presence_bottom" in maps
    holes = find_holes_in_sheet(
        **{layer: maps[name].values if name in maps else None for layer, name in layers.items()},
        pixel_um=step, origin_um=(float(maps["v"].values[0]), float(maps["u"].values[0])), diameter_um=hole_um,
        side=side if whole else "top", apart_um=maps.attrs.get("layers_apart_um"),
    )  # fmt: skip
    if not whole or holes.attrs["offset_count"] < _ENOUGH_THROUGH:
        return holes
    other = "bottom" if side == "top" else "top"
    outward = -_TO_FACE if side == "top" else _TO_FACE
    own = np.isfinite(holes["offset_x"].values)
    moved: dict[str, Any] = {}
    for axis, shared in zip("xy", holes.attrs["offset_um"], strict=True):
        lean = np.where(own, holes[f"offset_{axis}"].values, shared)
        moved[axis] = holes[axis].copy(data=holes[axis].values + outward * lean)
    for name in ("cov_xx", "cov_xy", "cov_yy"):
        near, far = holes[name].values, holes[f"{name}_{other}"].values
        spread = (1 + _TO_FACE) ** 2 * near + _TO_FACE**2 * far
        moved[name] = holes[name].copy(data=np.where(own, spread, near))
    return holes.assign(moved)


def in_sheet_results(holes: xr.Dataset | None) -> dict[str, Any] | None:
    """What the holes of a sheet look like through its thickness; None where none were looked for in a sheet."""
    if holes is None or "through" not in holes.attrs:
        return None
    counts = {k: int(holes.attrs[k]) for k in ("through", "closed", "unclear", "other_side_only", "offset_count")}
    found = {
        k: [float(v) if np.isfinite(v) else None for v in holes.attrs[k]]
        for k in ("offset_um", "offset_spread_um", "offset_error_um", "tilt_deg")
        if k in holes.attrs
    }
    offset, error = (np.array(holes.attrs[k], dtype=np.float64) for k in ("offset_um", "offset_error_um"))
    text = "No hole was seen on both sides of the sheet."
    if np.isfinite(offset).all():
        text = (
            f"{counts['offset_count']} holes run through the sheet, shifted by {np.hypot(*offset):.1f} um from its "
            "upper to its lower third"
        )
        text += f" (± {np.sqrt(np.mean(error**2)):.1f} um)." if np.isfinite(error).all() else "."
    if counts["closed"]:
        text += f" {counts['closed']} {'is' if counts['closed'] == 1 else 'are'} closed on the other side."
    return counts | found | {"side": str(holes.attrs["side"]), "sentence": text}


def in_flat(given: xr.Dataset, flat: xr.Dataset, surfaces: xr.Dataset) -> Array:
    """Given marks (n, 2) in the flat map: as they are, or from the volume by the column they lie in."""
    if "moving_x" in given:
        return np.stack([given["moving_x"].values, given["moving_y"].values], axis=1)
    frame = Frame.of(surfaces)
    y, x = surfaces["y"].values, surfaces["x"].values
    row = (given[f"volume_{frame.rows}"].values - y[0]) / (y[1] - y[0])
    col = (given[f"volume_{frame.cols}"].values - x[0]) / (x[1] - x[0])
    moving = np.stack([_bilinear(flat[k].values, row, col) for k in ("u", "v")], axis=1)
    lost = [str(n) for n, p in zip(given["label"].values, moving, strict=True) if not np.isfinite(p).all()]
    if lost:
        raise MarkError(
            f"The marks {', '.join(lost)} do not lie on the sheet. Check the axes and the unit (um) of the table."
        )
    return moving


def at_flat(maps: xr.Dataset, names: tuple[str, str], points: Array) -> Array:
    """Values of two maps at points (n, 2) of the flat sheet."""
    u, v = maps["u"].values, maps["v"].values
    row, col = (points[:, 1] - v[0]) / (v[1] - v[0]), (points[:, 0] - u[0]) / (u[1] - u[0])
    found = np.stack([_bilinear(maps[n].values, row, col) for n in names], axis=1)
    if not np.isfinite(found).all():
        raise MarkError("A mark lies outside the flattened sheet. Remove it from the table of marks.")
    return found


def outside_holes(
    y_um: Array, x_um: Array, centres_um: Array, radii_um: Array
) -> NDArray[np.bool_]:  # fmt: skip
    """Pixels of a regular grid that are away from every hole and its rim.

    Parameters
    ----------
    y_um, x_um : (rows,) and (cols,)
        Where the pixels lie.
    centres_um : (n, 2), as (x, y)
    radii_um : (n,)
    """
    away = np.ones((y_um.size, x_um.size), dtype=bool)
    for (x, y), radius in zip(centres_um, radii_um, strict=True):
        rows = slice(*np.searchsorted(y_um, (y - radius, y + radius)))
        cols = slice(*np.searchsorted(x_um, (x - radius, x + radius)))
        away[rows, cols] &= np.hypot(x_um[None, cols] - x, y_um[rows, None] - y) > radius
    return away


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


def _bilinear(field: Array, row: Array, col: Array) -> Array:
    """Value of a field at fractional rows and columns; NaN outside."""
    rows, cols = field.shape
    inside = (row >= 0) & (row <= rows - 1) & (col >= 0) & (col <= cols - 1)
    i = np.clip(np.floor(np.where(inside, row, 0)).astype(int), 0, rows - 2)
    j = np.clip(np.floor(np.where(inside, col, 0)).astype(int), 0, cols - 2)
    fr, fc = row - i, col - j
    value = (field[i, j] * (1 - fc) + field[i, j + 1] * fc) * (1 - fr)
    value += (field[i + 1, j] * (1 - fc) + field[i + 1, j + 1] * fc) * fr
    return np.where(inside, value, np.nan)
