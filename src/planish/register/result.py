"""A fitted transformation, and a chain of them from map to map, with their expected errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from planish.core.errors import MarkError
from planish.core.text import and_join_few
from planish.core.transform import Similarity, Transform, nearest_similarity
from planish.core.typing import Entries, Floats, Texts
from planish.register.bent import LocalStrain, lay_out_arrays, strain_of
from planish.register.field import DeviationField
from planish.register.models import MODELS, model_named
from planish.register.pairs import Pairs, points_of, weighted_rms

_SIMILARITY = ("scale", "rotation_rad", "shift_um", "mirrored")
_ERRORS = ("rms_um", "localisation_error_um", "leave_one_out_um")
_ARRAYS = ("moving", "fixed", "information", "robust_weights", "residuals_um")


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedTransform:
    """A transformation fitted to marks, and its errors.

    Call it with points ``(..., 2)``, ``(x, y)`` in um of the moving frame to get points of the
    fixed frame.
    """

    #: Moving to fixed, with ``scale``, ``rotation_rad``, ``shift_um`` and ``mirrored`` of the
    #: closest similarity.
    transform: Transform
    model: str  #: its name; ``rigid`` keeps scale 1
    moving: Floats  #: the marks as given, (n, 2) in um
    fixed: Floats  #: as ``moving``
    #: (n, 2, 2), inverse covariances up to one factor, those of marks in doubt weighted down.
    information: Floats
    #: (n,): 1, or 0 for marks that do not agree with the others and were left out.
    robust_weights: Floats
    residuals_um: Floats  #: (n, 2), ``fixed - transform(moving)`` in the fixed frame
    sentence: str  #: model and residuals
    #: Marks left out or given twice, few marks, a model that leaves structure, a scale far from 1,
    #: strain above 1 %.
    warnings: Texts = ()
    #: error that all marks share and none of them shows, rms, where it is known.
    shared_um: float = 0.0
    likely: DeviationField | None = None  # where it is there already

    def __post_init__(self) -> None:
        """Lay the arrays out as read back from a file."""
        lay_out_arrays(self)

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points of shape ``(..., 2)``, in um, from the moving to the fixed frame."""
        return self.transform(points)

    @property
    def inverse(self) -> Callable[[ArrayLike], Floats]:
        """The transformation from the fixed to the moving frame.

        That of a spline is NaN where it finds no point.
        """
        return self.transform.inverse

    @property
    def mirrored(self) -> bool:
        """True where the transformation changes handedness."""
        return self.transform.mirrored

    @property
    def weights(self) -> Floats:
        """Relative weights (n,) of the marks in the fit: half the trace of their information."""
        return self._pairs.weights

    @property
    def _pairs(self) -> Pairs:
        return Pairs(moving=self.moving, fixed=self.fixed, information=self.information)

    @cached_property
    def field(self) -> DeviationField:
        """The map and errors that the marks in use make likely, whichever model was fitted."""
        used_pairs = self._pairs.take(self.weights > 0)
        return self.likely or DeviationField(used_pairs, self.mirrored)

    @cached_property
    def leave_one_out_um(self) -> Floats:
        """Distance by which the fit to all other marks misses each mark, shape (n,), in um.

        NaN where the others fix no transformation. All weights, also the robust ones, the smoothing
        of a spline and the probabilities of an averaged map stay as they are in the fit to all
        marks. A mark that is left out of the fit is missed by its residual.
        """
        missed = self.residuals_um.copy()
        used = self.weights > 0
        model = MODELS[self.model]
        missed[used] = model.left_out(self._pairs.take(used), self.transform, self.field)
        return np.linalg.norm(missed, axis=1)

    @property
    def leave_one_out_rms_um(self) -> float:
        """Root mean square of the leave-one-out errors, weighted as in the fit, in um."""
        return weighted_rms(self.leave_one_out_um, self.weights)

    def agreement(self, labels: Sequence[str]) -> str:
        """State in a sentence how many marks agree, how well, and which do not and were left out.

        ``labels`` (n,) are those of all marks; "agree to" is the leave-one-out error, rms.
        """
        excluded = np.flatnonzero(self.robust_weights == 0)
        used_count = np.count_nonzero(self.weights > 0)
        rms = self.leave_one_out_rms_um
        sentence = f"{used_count}"
        if excluded.size:
            sentence += f" of {used_count + excluded.size}"
        if np.isfinite(rms):
            sentence += f" marks agree to {rms:.1f} um (leave-one-out, rms)"
        else:
            sentence += " marks were used"
        if excluded.size:
            names_text = and_join_few([str(labels[int(k)]) for k in excluded])
            distances_um = np.hypot(*self.residuals_um[excluded].T)
            distances_text = and_join_few([f"{distance:.0f}" for distance in distances_um])
            verb, auxiliary = ("are", "were") if excluded.size > 1 else ("is", "was")
            sentence += f"; {names_text} {verb} {distances_text} um off and {auxiliary} left out"
        return sentence + "."

    @property
    def rms_um(self) -> float:
        """Weighted rms length of the residuals, in um (fiducial registration error)."""
        return weighted_rms(np.linalg.norm(self.residuals_um, axis=1), self.weights)

    @property
    def localisation_error_um(self) -> float:
        """Error of one pair of marks, rms in the plane, in um.

        NaN where the marks leave no residual.

        With weights, that of a pair of mean weight. It is what is left when all deviations that the
        marks make likely are taken off, and does not depend on the model.
        """
        used = self.weights > 0
        given_weights = self.weights[used] / self.robust_weights[used]
        return float(np.sqrt(2.0 * self.field.mark_variance / np.mean(given_weights)))

    def expected_error_um(self, points: ArrayLike) -> Floats:
        """Expected distance between the fitted and the true image of each point.

        Parameters
        ----------
        points : array-like, shape (..., 2), in um
            Places ``(x, y)`` in the moving frame, as taken by the transformation itself. For places
            of the fixed frame pass ``fit.inverse(points)``.

        Returns
        -------
        ndarray, shape (...), in um
            Root mean square error. All NaN where the marks fit exactly by their number, so that
            their error is unknown.

        Notes
        -----
        The map is taken for a similarity with affine and smooth deviations whose sizes and lengths
        the marks make likely (:mod:`planish.register.field`); the error is the rms distance of such
        maps from the fitted one. So it holds what a model with too few parameters leaves. Where the
        marks show no deviation it is close to that of a similarity, ``FLE**2 / n * (1 + d**2 /
        f**2)`` with the distance ``d`` from the centroid of the marks, their rms distance ``f``
        from it, and ``FLE`` from `localisation_error_um` (Fitzpatrick and West 2001). With fewer
        than 6 marks it is itself known to no better than about 40 %.

        References
        ----------
        Fitzpatrick and West (2001), IEEE Trans. Med. Imaging 20, 917, doi:10.1109/42.952729.
        """
        points_um = np.asarray(points, dtype=np.float64)
        flat_points = points_um.reshape(-1, 2)
        squares_um2 = self.field.expected_square(flat_points, self.transform(flat_points))
        errors_um = np.sqrt(squares_um2 + self.shared_um**2)
        return errors_um.reshape(points_um.shape[:-1])

    def refitted(self, moving: ArrayLike) -> Transform:
        """Fit the same pairs with other moving places, from another flattening of the sheet.

        Parameters
        ----------
        moving : array-like, shape (n, 2), in um
            Places of all marks, in their order, used or not.

        Returns
        -------
        Transform
            Of the same model; weights, smoothing and all else that the first fit chose stay as they
            are.

        Raises
        ------
        MarkError
            If the shape is another one or a place is not finite.
        """
        places = points_of(moving, "moving marks")
        used = self.weights > 0
        if places.shape != self.moving.shape or not np.isfinite(places[used]).all():
            raise MarkError(
                f"{len(places)} places given for {len(self.moving)} marks, or some not finite. Give"
                " one (x, y) in um for each mark of the fit."
            )
        pairs = replace(self._pairs, moving=places).take(used)
        return MODELS[self.model].refit(pairs, self.transform, self.field)

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)`` of the moving frame.

        The shape is ``(..., 2, 2)``: a row for x and y of the image.
        """
        return self.transform.jacobian(points)

    @cached_property
    def strain(self) -> LocalStrain:
        """Range of local strain and area between the marks, the overall scale taken off."""
        return strain_of(self.transform, self.moving[self.weights > 0], self.mirrored)


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Fitted transformations from a map over others to a reference, composed.

    Nothing is resampled twice.

    Call it with points ``(..., 2)``, ``(x, y)`` in um of the first map to get points of the last
    one.
    """

    fits: tuple[FittedTransform, ...]  #: the first is applied first; at least one

    def __call__(self, points: ArrayLike) -> Floats:
        """Take points ``(..., 2)`` of the first map to the last one, in um; NaN stays NaN."""
        for fit in self.fits:
            points = fit(points)
        return np.asarray(points)

    def inverse(self, points: ArrayLike) -> Floats:
        """Take points ``(..., 2)`` of the last map back to the first one, in um.

        NaN where a link finds no point.
        """
        for fit in reversed(self.fits):
            points = fit.inverse(points)
        return np.asarray(points)

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)`` of the first map: ``(..., 2, 2)``."""
        points_um = np.asarray(points, dtype=np.float64)
        jacobians = np.eye(2)
        for fit in self.fits:
            jacobians = fit.jacobian(points_um) @ jacobians
            points_um = fit(points_um)
        return jacobians

    @property
    def similarity(self) -> Similarity:
        """The closest similarity at the middle of the first link's marks."""
        first_fit = self.fits[0]
        if len(self.fits) == 1:
            return first_fit.transform.similarity
        centre = first_fit.moving.mean(axis=0)
        return nearest_similarity(self.jacobian(centre), centre, self(centre))

    @property
    def mirrored(self) -> bool:
        """True where handedness changes."""
        return sum(fit.mirrored for fit in self.fits) % 2 == 1

    def expected_error_um(self, points: ArrayLike) -> Floats:
        """Expected rms distance between the composed and the true image of points.

        The points ``(..., 2)`` are of the first map.

        In um of the last map: the errors of the links are independent, and each is carried on by
        the links after it, with the mean square of their stretch.
        """
        points_um = np.asarray(points, dtype=np.float64)
        square_errors = np.zeros(points_um.shape[:-1])
        for fit in self.fits:
            squared_slopes = fit.jacobian(points_um) ** 2
            stretch = 0.5 * np.sum(squared_slopes, axis=(-2, -1))
            square_errors = square_errors * stretch + fit.expected_error_um(points_um) ** 2
            points_um = fit(points_um)
        return np.sqrt(square_errors)


FORMAT = "planish registration 1"


def registration_to_json(fit: FittedTransform) -> Entries:
    """Return a fit as numbers, texts, lists and dictionaries, for :func:`json.dump`; lengths in um.

    Besides what `registration_from_json` needs it holds numbers to read: scale, rotation, errors of
    every mark. NaN becomes None.
    """
    kind = model_named(fit.model).transform
    parameters = [field.name for field in fields(kind)]
    entries: Entries = {"format": FORMAT}
    entries |= _plain_fields(fit, ("model", "sentence", "warnings"))
    entries |= _plain_fields(fit.transform, _SIMILARITY)
    entries |= _plain_fields(fit, _ERRORS)
    if fit.shared_um:
        entries["shared_um"] = fit.shared_um
    entries["transform"] = _plain_fields(fit.transform, parameters)
    return entries | _plain_fields(fit, _ARRAYS)


def _plain_fields(holder: object, names: Sequence[str]) -> Entries:
    """Attributes of an object, by their names, as JSON has them."""
    return {name: _plain(getattr(holder, name)) for name in names}


def registration_from_json(data: Any) -> FittedTransform:
    """Read back what `registration_to_json` returned.

    Raises
    ------
    MarkError
        If it is no such fit.
    """
    try:
        if data["format"] != FORMAT:
            raise MarkError(
                f"The registration has the format {data['format']!r}; {FORMAT!r} is read."
            )
        kind = model_named(data["model"]).transform
        hints = get_type_hints(kind)
        parameters: Entries = {}
        for field in fields(kind):
            parameters[field.name] = _read(data["transform"][field.name], hints[field.name])
        arrays = {name: _read(data[name], Floats) for name in _ARRAYS}
        return FittedTransform(
            transform=kind(**parameters),
            model=str(data["model"]),
            sentence=str(data["sentence"]),
            warnings=tuple(map(str, data["warnings"])),
            shared_um=float(data.get("shared_um", 0.0)),
            **arrays,
        )
    except (ValueError, KeyError, TypeError, IndexError) as fault:
        raise MarkError(
            f"This is no registration written by planish ({fault!r}). Register the marks again and"
            " save that."
        ) from fault


def _plain(value: Any) -> Any:
    """Lists for arrays and tuples; None for NaN, texts for infinities, which JSON does not have."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]  # pyright: ignore[reportUnknownVariableType]
    if isinstance(value, float) and not np.isfinite(value):
        return None if np.isnan(value) else str(value)
    return value


def _read(value: Any, hint: Any) -> Any:
    """Turn a value of JSON into the type of a field: an array, a tuple, a bool or a number."""
    if hint == Floats:
        return np.array(value, dtype=np.float64)
    if isinstance(value, list):
        return tuple(_read(v, None) for v in value)  # pyright: ignore[reportUnknownVariableType]
    if isinstance(value, bool):
        return value
    return float("nan") if value is None else float(value)
