"""A registration with all marks of both layers: found, matched and fitted, or given.

And its file, ``marks.json``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
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
from planish.core.typing import Floats
from planish.design import read_pattern
from planish.marks import hole_tilt
from planish.marks.exchange import (
    LayerPixels,
    holes_of,
    marks_of_holes,
    pair_of_layers,
    read_any,
    write_any,
)
from planish.marks.exchange.model import (
    RESULTS,
    join_holes,
    paired,
    points_of,
    tiles_of,
    with_holes,
)
from planish.register import (
    Chain,
    DesignedHoles,
    FittedTransform,
    RegistrationParams,
    fit_pairs,
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
    apart_um: tuple[float, float] | None = None

    def __call__(self, points: Any) -> Floats:
        """Take points from the moving to the fixed layer, in um."""
        return self.fit(points)

    def count(self, side: str) -> int:
        """Number of marks in one layer, matched or not."""
        return int(np.isfinite(self.marks[f"{side}_x"].values).sum())

    def agreement(self) -> str:
        """How many marks agree to what, and which were left out, in a sentence."""
        return self.fit.agreement(self.marks["label"].values[paired(self.marks)].tolist())

    def pairs(self) -> xr.Dataset:
        """The marks that the fit uses: positions, residuals and weights, a row each."""
        fit, um = self.fit, {"units": "um"}
        vectors_um = {"moving": fit.moving, "fixed": fit.fixed, "residual": fit.residuals_um}
        columns = {
            f"{name}_{axis}": xy[:, k]
            for name, xy in vectors_um.items()
            for k, axis in enumerate("xy")
        }
        columns |= {
            "residual": np.hypot(*fit.residuals_um.T),
            "leave_one_out": fit.leave_one_out_um,
        }
        data = xr.Dataset({k: ("mark", v, um) for k, v in columns.items()})
        labels = self.marks["label"].values[paired(self.marks)]
        return data.assign(
            weight=("mark", fit.robust_weights, {"units": "1"}),
            label=("mark", labels.astype(object)),
        )

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
                f"{Path(path).name} holds marks without a registration. Make one with 'planish"
                " register', or give the marks.json of a run."
            )
        registration = cls(
            fit=registration_from_json(saved), marks=marks, source="json", **saved.get("search", {})
        )
        mask, fit = paired(marks), registration.fit
        for side, fitted in (("moving", fit.moving), ("fixed", fit.fixed)):
            if not np.array_equal(points_of(marks, side)[mask], fitted):
                raise MarkError(
                    f"The marks in {Path(path).name} were changed after the registration was fitted"
                    " to them. Register them again: planish register, or planish link --marks."
                )
        return registration


def register_marks(
    moving: xr.Dataset,
    fixed: xr.Dataset,
    *,
    params: RegistrationParams | None = None,
    hole_um: tuple[float, float] = (100.0, 300.0),
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
    for holes, call in (
        (moving, "pl.register_marks({}, fixed)"),
        (fixed, "pl.register_marks(moving, {})"),
    ):
        check_dataset(
            holes, "x", "y", expected="holes", source="pl.find_holes(...)", call_format=call
        )
    fit_params = params_of(RegistrationParams, params, "pl.register_marks")
    designed = None
    if fit_params.design is not None:
        pattern = read_pattern(fit_params.design)
        designed = DesignedHoles(
            name=pattern.name, places_um=pattern.imaged_um, labels=tuple(pattern.labels)
        )
    fit, match = match_and_fit(moving, fixed, params=fit_params, pattern=designed, hole_um=hole_um)
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
    """The marks with what the fit leaves of each."""
    is_paired = paired(marks)
    for name, pair_values_um in (
        ("residual", np.hypot(*fit.residuals_um.T)),
        ("leave_one_out", fit.leave_one_out_um),
    ):
        mark_values_um = np.full(is_paired.size, np.nan)
        mark_values_um[is_paired] = pair_values_um
        marks = marks.assign(
            {name: ("mark", mark_values_um, {"units": "um", "long_name": RESULTS[name]})}
        )
    return marks


class Link(NamedTuple):
    """How a layer comes to the reference.

    It has its registration to the next layer of the path, and all registrations composed.
    """

    path: list[Layer]
    registration: Registration
    chain: Chain


def register_layers(layer: Layer, fixed: Layer, holes: LayerHoles, study: Study) -> Registration:
    """Register one layer to another by the marks that the study names, or by the holes of both."""
    params = study.registration
    path = layer.params.marks or params.marks
    if path is None:
        hole_um = holes.params.hole_um
        return register_marks(
            holes.of(layer, fixed), holes.of(fixed, layer), params=params, hole_um=hole_um
        )
    marks = volume_to_map(read_given(path, layer, fixed), layer.name, layer.groups)
    fit = fit_marks(
        marks, params=params, mirrored=None if params.mirror else layer.side != fixed.side
    )
    for side, own_layer, other_layer in (("moving", layer, fixed), ("fixed", fixed, layer)):
        is_placed = np.isfinite(marks[f"{side}_x"].values)
        if (
            f"{side}_diameter" not in marks
            or not np.isfinite(marks[f"{side}_diameter"].values[is_placed]).all()
        ):
            hole_marks = marks_of_holes(
                holes.of(own_layer, other_layer)[["x", "y", "diameter"]], layer=side
            )
            labels = np.array(
                [f"{side} {k + 1}" for k in range(hole_marks.sizes["mark"])], dtype=np.str_
            )
            hole_marks = hole_marks.assign(label=("mark", labels))
            marks = with_holes(
                marks, hole_marks, side, usual_um=float(np.mean(holes.params.hole_um))
            )
    source, search = str(marks.attrs.get("read_from", {}).get("format", "file")), dict[str, Any]()
    is_tile = tiles_of(marks)[paired(marks)]
    if is_tile.any():  # tiles of a run: what was said of them holds still, where the file has it
        saved = marks.attrs.get("registration", {})
        source, search = "texture" if is_tile.all() else "both", saved.get("search", {})
        fit = replace(fit, shared_um=float(saved.get("shared_um", 0.0)))
    return Registration(fit=fit, marks=with_residuals(marks, fit), source=source, **search)


def fit_marks(
    marks: xr.Dataset, *, params: RegistrationParams, mirrored: bool | None
) -> FittedTransform:
    """Fit the marks in use that lie in both layers, as a run fits marks that it is given."""
    pairs = marks.isel(mark=np.flatnonzero(paired(marks)))
    return fit_pairs(
        holes_of(pairs, "moving"), holes_of(pairs, "fixed"), params=params, mirrored=mirrored
    )


def check_marks(
    layer: Layer | str,
    fixed: Layer | str,
    holes: LayerHoles,
    path: str | None,
    *,
    needed: bool = True,
) -> None:
    """Refuse what cannot be registered, before a volume is mapped.

    That is an image with too few holes, or marks of no use.

    ``layer`` and ``to`` are names where they are volumes that were not read yet; ``path`` is the
    file of their marks. Holes are not needed where the texture can take their place.
    """
    if path is not None:
        read_given(path, layer, fixed)
        return
    for image in (layer, fixed):
        if needed and not isinstance(image, str) and image.kind == "image":
            need_holes(holes.of(image, image), holes.params.hole_um)


def read_given(path: str, moving: Layer | str, fixed: Layer | str) -> xr.Dataset:
    """Read marks from a file of any known format: three pairs or more."""
    pixels = [
        (
            LayerPixels()
            if isinstance(layer, str) or layer.image is None
            else LayerPixels(pixel_um=layer.grid.pixel_um, shape=layer.grid.shape)
        )
        for layer in (moving, fixed)
    ]
    marks = read_any(path, moving=pixels[0], fixed=pixels[1])
    pair_of_layers(marks, name=Path(path).name)  # one layer alone is refused
    if (n_pairs := int(paired(marks).sum())) < 3:
        raise MarkError(
            f"{Path(path).name} holds {n_pairs} pairs of marks in use; a registration needs 3 to"
            " say how good it is. Add more, far apart."
        )
    return marks


def volume_to_map(marks: xr.Dataset, name: str, groups: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """Marks on the flat map of a layer, those too that were set in its volume.

    Without ``groups`` it is an image.
    """
    if "volume_x" not in marks:
        return marks
    if not groups:
        raise MarkError(
            f"The marks have places in a volume, and {name} is an image. Give marks with places in"
            " both images (moving_x_um, moving_y_um), or the volume."
        )
    frame = Frame.of(groups["surfaces"])
    points = points_of(marks, "volume")[:, ["xyz".index(axis) for axis in (frame.cols, frame.rows)]]
    uv = values_at(groups["flat"], ("u", "v"), points)
    is_off_sheet = np.isfinite(points).all(axis=1) & ~np.isfinite(uv).all(axis=1)
    if is_off_sheet.any():
        raise MarkError(
            f"The marks {', '.join(map(str, marks['label'].values[is_off_sheet]))} do not lie on"
            " the sheet. Check the axes and the unit (um) of the table."
        )
    names = {
        n: str(n).replace("volume_", "moving_")
        for n in marks
        if str(n).startswith("volume_") and n != "volume_z"
    }
    return (
        marks.drop_vars("volume_z")
        .rename(names)
        .assign(moving_x=("mark", uv[:, 0]), moving_y=("mark", uv[:, 1]))
    )
