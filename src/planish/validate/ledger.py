"""The ledger of one run: an error for every stage, against the truth of the specimen that was measured."""

from __future__ import annotations

from planish.validate import image_errors, volume_errors
from planish.validate.figures import FIGURES
from planish.validate.truth import Comparison, Values


def make_ledger(both: Comparison, *, point_um: float = 100.0) -> Values:
    """Measure the errors of a run; the stages of a map only where it has no image.

    Parameters
    ----------
    both : Comparison
        The run and the truth of its specimen.
    point_um : float
        Edge of the larger points at which the correlation is compared.

    Returns
    -------
    dict
        Figure name to value in the order of the line, None where the run has no such thing (paper without coating).
        Units and sentences are in :data:`planish.validate.figures.FIGURES`.
    """
    values = volume_errors.section_errors(both)
    for errors in (
        volume_errors.surface_errors, volume_errors.centre_errors, volume_errors.thickness_errors,
        volume_errors.flattening_errors,
    ):  # fmt: skip
        values |= errors(both)
    if "linked" in both.groups:
        for errors in (
            image_errors.pixel_errors, image_errors.hole_errors, image_errors.registration_errors,
            image_errors.resampling_errors,
        ):  # fmt: skip
            values |= errors(both)
        values |= image_errors.statistic_errors(both, point_um=point_um)
    return in_order(values)


def in_order(values: Values) -> Values:
    """Figures in the order of the line; what has no value is None, whole stages that are absent are left out."""
    stages = {FIGURES[name].stage for name in values}
    return {name: values.get(name) for name, figure in FIGURES.items() if figure.stage in stages}
