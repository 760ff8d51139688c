"""Holes of two layers -> which belong together, and the registration that they support."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args

import numpy as np

from planish.core.errors import CannotRegister, MarkError
from planish.core.facts import Side
from planish.core.grid import centres_of
from planish.core.typing import Entries, Floats, Pair, Texts
from planish.register.fit import fit_transform, has_other_unit
from planish.register.match import Matched, match_by_design, match_marks
from planish.register.params import RegistrationParams
from planish.register.result import FittedTransform

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignedHoles:
    """Holes of the burnt pattern: places (d, 2) in um, as an image shows them, and labels."""

    name: str
    places_um: Floats
    labels: Texts


def register_marks(
    moving: xr.Dataset,
    fixed: xr.Dataset,
    *,
    params: RegistrationParams,
    pattern: DesignedHoles | None = None,
    hole_um: Pair = (100.0, 300.0),
) -> tuple[FittedTransform, Matched]:
    """Match the holes of two layers and fit the transformation from one to the other.

    Parameters
    ----------
    moving, fixed, hole_um
        As for :func:`planish.register_marks`.
    params : RegistrationParams
        ``marks`` and ``design`` are for whoever reads the files.
    pattern : DesignedHoles, optional
        Identifies the holes by their position in the pattern.

    Returns
    -------
    FittedTransform, Matched
        The fit, and the rows of the holes that belong together.

    Raises
    ------
    CannotRegister
        If there are too few holes, they do not match, or they fit at a scale that the calibrations
        exclude.
    MarkError
        If the pairs cannot be used, or ``seen_from`` is no side.
    """
    sides = (moving, fixed)
    moving_name = str(moving.attrs.get("layer", "moving layer"))
    fixed_name = str(fixed.attrs.get("layer", "fixed layer"))
    names = (moving_name, fixed_name)
    seen_from = [str(h.attrs.get("seen_from", "top")) for h in sides]
    for name, side in zip(names, seen_from, strict=True):
        if side not in get_args(Side):
            raise MarkError(
                f"The attribute seen_from of the {name} is {side!r}. Set it to 'top' or 'bottom'."
            )
    for holes, name in zip(sides, names, strict=True):
        need_holes(holes, hole_um, name=name)
    is_facing = seen_from[0] != seen_from[1]
    moving_um, fixed_um = map(centres_of, sides)
    options: Entries = params.model_dump(include={"scale_tolerance", "tolerance_um", "mirror"})
    # Turned over, so that both sides are of one hand.
    points = (moving_um * (-1.0, 1.0) if is_facing else moving_um), fixed_um
    if pattern is None:
        matched = match_marks(*points, names=names, **options)
    else:
        options |= {"labels": pattern.labels, "name": pattern.name}
        matched = match_by_design(*points, pattern.places_um, names=names, **options)
        if (count := len(matched.pairs)) < 3:
            raise CannotRegister(
                f"Only {count} designed holes are found in both the {moving_name} and the"
                f" {fixed_name}; 3 are needed. Image a larger common field."
            )
    i, j = matched.pairs.T
    is_mirrored = matched.mirrored != is_facing
    sides = (moving.isel(mark=i), fixed.isel(mark=j))
    fit = fit_pairs(*sides, params=params, mirrored=is_mirrored)
    return fit, matched


def fit_pairs(
    moving: xr.Dataset, fixed: xr.Dataset, *, params: RegistrationParams, mirrored: bool | None
) -> FittedTransform:
    """Fit the transformation between marks that belong together, row by row.

    Parameters
    ----------
    moving, fixed : Dataset (mark)
        ``x``, ``y`` and, where known, the covariance ``cov_xx``, ``cov_xy``, ``cov_yy`` of the
        marks' centres, in um: each pair is weighted by those of its two marks where all are known.
    params : RegistrationParams
        Model and tolerance of the scale.
    mirrored : bool or None
        Whether the layers see each other mirrored; None for whichever fits better.

    Raises
    ------
    CannotRegister
        If the marks fit at a scale that the calibrations exclude.
    MarkError
        If fewer than 3 pairs are given, or they cannot be used.
    """
    sides = (moving, fixed)
    source, target = map(centres_of, sides)
    if len(source) < 3:
        raise MarkError(
            f"{len(source)} control points given, a similarity needs 3 to state its error. Add"
            " more, far apart."
        )
    weights = None
    moving_cov, fixed_cov = map(_covariances, sides)
    if np.isfinite(moving_cov).all() and np.isfinite(fixed_cov).all():
        # Turned into the fixed frame.
        first_fit = fit_transform(source, target, mirrored=mirrored, robust=False)
        rotation = first_fit.transform.matrix()
        weights = rotation @ moving_cov @ rotation.T + fixed_cov
    fit = fit_transform(
        source, target, model=params.model, mirrored=mirrored, weights=weights, lowest="similarity"
    )
    scale = fit.transform.scale
    tolerance = params.scale_tolerance
    deviation = abs(scale - 1)
    if deviation > tolerance and has_other_unit(scale):
        raise CannotRegister(
            f"The marks fit at a scale of {scale:.4g}: one side is probably in pixels, the other in"
            " um. Give both in um; planish marks convert turns pixels into um, given `unit=pixel`,"
            " `moving_pixel_um` and `fixed_pixel_um`."
        )
    if deviation > tolerance:
        raise CannotRegister(
            f"The marks fit at a scale of {scale:.4f}, which is {100 * deviation:.1f} % off"
            f" the calibration; {100 * tolerance:.2g} % are allowed. Check `voxel_um`, `pixel_um`"
            " and the marks; if a calibration is that uncertain, allow more with"
            " `scale_tolerance`."
        )
    return fit


def _covariances(holes: xr.Dataset) -> Floats:
    """Covariances (n, 2, 2) of the centres, along x and y, in um2; NaN where they are not known."""
    unknown = np.full(holes.sizes["mark"], np.nan)
    covariances = [holes.get(f"cov_{axes}", unknown) for axes in ("xx", "xy", "xy", "yy")]
    return np.stack(covariances, axis=-1).reshape(-1, 2, 2)


def need_holes(holes: xr.Dataset, hole_um: Pair, *, name: str | None = None) -> None:
    """Stop early where there cannot be a match.

    Parameters
    ----------
    holes : Dataset (mark); of one layer
    hole_um : (float, float), in um; diameters that were searched
    name : str, optional; of the layer, if its attributes do not say it

    Raises
    ------
    CannotRegister
        If there are fewer than 3 holes.
    """
    count = holes.sizes["mark"]
    if count < 3:
        count_text = f"Only {count} hole{'s' * (count > 1)}" if count else "No hole"
        places_text = "".join(f" ({x:.0f}, {y:.0f}) um" for x, y in centres_of(holes))
        rejected: dict[str, int] = holes.attrs.get("not_taken", {})
        open_count = rejected.get("open", 0) + rejected.get("not_round", 0)
        open_text = ""
        if open_count:
            open_text = f" Not taken: {open_count} not round, or open to one side as slots are."
        raise CannotRegister(
            f"{count_text} found in the"
            f" {name or holes.attrs['layer']}{' at' * bool(count)}{places_text}; at least 3 are"
            f" needed, and 4 to notice a wrong match. Searched for round holes of {hole_um[0]:g} to"
            f" {hole_um[1]:g} um (`hole_um`).{open_text} Check the voxel and pixel sizes;"
            " if the image is a print, give `printed=True`; or give pairs of points with `marks`."
        )
