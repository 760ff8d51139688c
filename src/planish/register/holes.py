"""Holes of two layers -> which belong together, and the registration that they support."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from planish.core.errors import CannotRegister, MarkError
from planish.core.facts import Side
from planish.core.typing import Floats, Ints, Pair
from planish.register.fit import fit_transform
from planish.register.match import Matched, match_by_design, match_marks
from planish.register.params import RegistrationParams
from planish.register.result import FittedTransform

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignedHoles:
    """Holes of the pattern that was burnt: places (d, 2) in um, as an image shows them, and labels."""

    name: str
    places_um: Floats
    labels: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HoleRegistration:
    """The transformation between two layers, and the holes that support it.

    Attributes
    ----------
    fit : FittedTransform
        Moving to fixed.
    pairs : ndarray of int, shape (k, 2)
        Row of each mark in the holes of the moving and of the fixed layer.
    labels : tuple of str
        Of the pairs; empty for given pairs.
    sentence : str
        How many holes match; empty for given pairs.
    second_best : int or None
        Marks that agree in the second-best match; None for given pairs.
    design : str or None
        About the design, where one was used.
    """

    fit: FittedTransform
    pairs: Ints
    labels: tuple[str, ...] = ()
    sentence: str = ""
    second_best: int | None = None
    design: str | None = None


def register_marks(
    moving: xr.Dataset,
    fixed: xr.Dataset,
    *,
    params: RegistrationParams,
    pattern: DesignedHoles | None = None,
    pairs: Ints | None = None,
    hole_um: Pair = (100.0, 300.0),
) -> HoleRegistration:
    """Match the holes of two layers and fit the transformation from one to the other.

    Parameters
    ----------
    moving, fixed : Dataset (mark)
        ``x``, ``y`` and, where known, the covariance ``cov_xx``, ``cov_xy``, ``cov_yy`` of the holes' centres, in um.
        The attributes ``layer`` and ``seen_from`` say what a layer is called in messages and which side of the sheet
        it shows, the top where it is missing; layers that show opposite sides see each other mirrored.
    params : RegistrationParams
        Tolerances, mirror images and model; ``marks`` and ``design`` are for whoever reads the files.
    pattern : DesignedHoles, optional
        Identifies the holes by their position in the pattern.
    pairs : ndarray of int, shape (k, 2), optional
        Rows of the moving and of the fixed holes that are known to belong together; nothing is matched then.
    hole_um : (float, float)
        Diameters that were looked for, for messages.

    Returns
    -------
    HoleRegistration
        Each pair is weighted by the covariances of its two holes where both are known.

    Raises
    ------
    CannotRegister
        If there are too few holes, they do not match, or they fit at a scale that the calibrations exclude.
    MarkError
        If fewer than 3 pairs are given, they cannot be used, or ``seen_from`` is no side.
    """
    sides = (moving, fixed)
    a, b = (np.stack([h["x"].values, h["y"].values], axis=1).astype(np.float64) for h in sides)
    names = (str(moving.attrs.get("layer", "moving layer")), str(fixed.attrs.get("layer", "fixed layer")))
    seen_from = [str(h.attrs.get("seen_from", "top")) for h in sides]
    for name, side in zip(names, seen_from, strict=True):
        if side not in get_args(Side):
            raise MarkError(f"The attribute seen_from of the {name} is {side!r}. Set it to 'top' or 'bottom'.")
    facing = seen_from[0] != seen_from[1]
    identity: dict[str, Any] = {}
    if pairs is None:
        for holes, name in zip(sides, names, strict=True):
            need_holes(holes, hole_um, name=name)
        matched, identity = _match(a * (-1.0, 1.0) if facing else a, b, names, params, pattern)
        pairs, mirrored = matched.pairs, matched.mirrored != facing
    else:
        mirrored = None if params.mirror else facing
        if len(pairs) < 3:
            raise MarkError(
                f"{len(pairs)} control points given, a similarity needs 3 to state its error. Add more, far apart."
            )
    marks = a[pairs[:, 0]], b[pairs[:, 1]]
    weights = None
    if all("cov_xx" in h for h in sides):
        turn = fit_transform(*marks, mirrored=mirrored, robust=False).transform.matrix()
        spread = [
            np.stack([h[f"cov_{k}"].values[rows] for k in ("xx", "xy", "xy", "yy")], axis=-1).reshape(-1, 2, 2)
            for h, rows in zip(sides, pairs.T, strict=True)
        ]
        weights = turn @ spread[0] @ turn.T + spread[1]
    fit = fit_transform(*marks, model=params.model, mirrored=mirrored, weights=weights, lowest="similarity")
    scale, most = fit.transform.scale, params.scale_tolerance
    if abs(scale - 1) > most:
        raise CannotRegister(
            f"The marks fit at a scale of {scale:.4f}, which is {100 * abs(scale - 1):.1f} % off the calibration; "
            f"{100 * most:.2g} % are allowed. Check --voxel-um, --pixel-um and the marks; if a calibration is that "
            "uncertain, allow more with --scale-tolerance."
        )
    return HoleRegistration(fit=fit, pairs=pairs, **identity)


def _match(
    moving: Floats, fixed: Floats, names: tuple[str, str], params: RegistrationParams, pattern: DesignedHoles | None
) -> tuple[Matched, dict[str, Any]]:
    """Match holes by the pattern that was burnt, or by their arrangement alone; give the fields of a registration."""
    options: dict[str, Any] = params.model_dump(include={"scale_tolerance", "tolerance_um", "mirror"})
    design = None
    if pattern is None:
        matched = match_marks(moving, fixed, names=names, **options)
        labels = tuple(f"hole {k + 1}" for k in range(len(matched.pairs)))
    else:
        matched = match_by_design(moving, fixed, pattern.places_um, labels=pattern.labels, names=names, **options)
        labels = matched.labels
        from_behind = ", viewed from behind or drawn with its y axis upwards" if matched.behind else ""
        design = f"Holes identified by the pattern {pattern.name} of {len(pattern.labels)} holes{from_behind}."
        if len(labels) < 3:
            raise CannotRegister(
                f"Only {len(labels)} designed holes are found in both the {names[0]} and the {names[1]}; 3 are needed. "
                "Image a larger common field."
            )
    identity = {"labels": labels, "design": design, "sentence": matched.sentence, "second_best": matched.second_best}
    return matched, identity


def need_holes(holes: xr.Dataset, hole_um: Pair, *, name: str | None = None) -> None:
    """Stop early where there cannot be a match; ``name`` is that of the layer, if its attributes do not say it.

    Raises
    ------
    CannotRegister
        If there are fewer than 3 holes.
    """
    count = holes.sizes["mark"]
    if count < 3:
        number = f"Only {count} hole{'s' * (count > 1)}" if count else "No hole"
        places = "".join(f" ({x:.0f}, {y:.0f}) um" for x, y in zip(holes["x"].values, holes["y"].values, strict=True))
        raise CannotRegister(
            f"{number} found in the {name or holes.attrs['layer']}{' at' * bool(count)}{places}; at least 3 are "
            f"needed, and 4 to notice a wrong match. Searched for round holes of {hole_um[0]:g} to {hole_um[1]:g} um "
            "(--hole-um). Check the voxel and pixel sizes; if the image is a print, give --printed; or give pairs of "
            "points with --marks."
        )
