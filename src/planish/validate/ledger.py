"""The ledger of one run: an error for every stage, against the truth of the specimen that was measured."""

from __future__ import annotations

from dataclasses import dataclass

from planish.pipeline import Run
from planish.synthetic import InstrumentFiles, Specimen
from planish.validate import image_errors, volume_errors
from planish.validate.figures import FIGURES, KEYS, Figure
from planish.validate.spread import Values
from planish.validate.truth import make_lattice


@dataclass(frozen=True, slots=True, kw_only=True)
class Ledger:
    """All figures of one run in the order of the line.

    Attributes
    ----------
    values : dict
        Figure name to value, None where the run has no such thing (a paper without coating, a map without an image).
        Units and sentences are in :data:`planish.validate.figures.FIGURES`.
    """

    values: Values

    def __getitem__(self, name: str) -> float | None:
        """Value of one figure; None where there is none."""
        return self.values.get(name)

    def figures(self) -> list[tuple[Figure, float | None]]:
        """All figures of this ledger with their values."""
        return [(FIGURES[name], value) for name, value in self.values.items()]

    def key(self, stage: str) -> tuple[str, float] | None:
        """Name and value of the figure that speaks for a stage; None where the run has none of them."""
        for name in KEYS.get(stage, ()):
            value = self.values.get(name)
            if value is not None:
                return name, value
        return None


def make_ledger(specimen: Specimen, files: InstrumentFiles, run: Run, *, point_um: float = 100.0) -> Ledger:
    """Measure the errors of a run.

    Parameters
    ----------
    specimen : Specimen
        With its truth.
    files : InstrumentFiles
        Says where a place in the file lies in the specimen.
    run : Run
        What planish made of these files; the stages of a map are measured where it has no image.
    point_um : float
        Edge of the larger points at which the correlation is compared.

    Returns
    -------
    Ledger
    """
    groups = run.groups
    lattice = make_lattice(specimen, files, groups)
    values: Values = {}
    values |= volume_errors.section_errors(files, groups)
    values |= volume_errors.surface_errors(specimen, files, groups, lattice)
    values |= volume_errors.centre_errors(specimen, files, groups, lattice)
    values |= volume_errors.thickness_errors(specimen, groups, lattice)
    values |= volume_errors.flattening_errors(groups, lattice)
    if "linked" in groups and run.marks is not None:
        pixels = image_errors.make_pixels(specimen, files, groups)
        values |= image_errors.pixel_errors(specimen, run, pixels)
        values |= image_errors.hole_errors(specimen, files, run, lattice)
        values |= image_errors.registration_errors(specimen, run, pixels, lattice)
        values |= image_errors.resampling_errors(specimen, files, run, pixels)
        values |= image_errors.statistic_errors(specimen, run, pixels, point_um=point_um)
    return Ledger(values=in_order(values))


def in_order(values: Values) -> Values:
    """Figures in the order of the line; what has no value is None, whole stages that are absent are left out."""
    stages = {FIGURES[name].stage for name in values}
    return {name: values.get(name) for name, figure in FIGURES.items() if figure.stage in stages}
