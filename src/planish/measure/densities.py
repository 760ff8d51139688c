"""Densities and weighed masses: what turns a length or a grey value into grams, given by the user and never assumed."""

from __future__ import annotations

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option


class Densities(Params):
    """What is known of the sheet from elsewhere; all of it may be missing."""

    coating_g_cm3: float | None = option(
        None, gt=0, lt=1e4, cli="--coating-density", metavar="G/CM3",
        help="Density of the coating with its voids, for coat weight; 1.6 is usual for ground calcium carbonate.",
    )  # fmt: skip
    base_g_cm3: float | None = option(
        None, gt=0, lt=1e4, cli="--base-density", metavar="G/CM3",
        help="Density of the base as it lies in the sheet, for grammage.",
    )  # fmt: skip
    filler_g_cm3: float | None = option(
        None, gt=0, lt=1e4, cli=None, help="Density of the filler's grains without voids; calcium carbonate 2.7."
    )
    grammage_g_m2: float | None = option(
        None, gt=0, lt=1e4, cli="--grammage", metavar="G/M2", help="Weighed mass of the sheet."
    )
    coat_weight_top_g_m2: float | None = option(
        None, gt=0, lt=1e4, cli="--coat-weight-top", metavar="G/M2", help="Weighed mass of the top coating."
    )
    coat_weight_bottom_g_m2: float | None = option(
        None, gt=0, lt=1e4, cli="--coat-weight-bottom", metavar="G/M2", help="Weighed mass of the bottom coating."
    )

    def get(self, name: str) -> float | None:
        """Return one of them by name."""
        return getattr(self, name)

    def need(self, what: str, *names: str) -> float:
        """Return the first of ``names`` that is known.

        Raises
        ------
        CannotMeasure
            If none is.
        """
        for name in names:
            value = self.get(name)
            if value is not None:
                return value
        options = " or ".join(names)
        raise CannotMeasure(
            f"{what} in grams needs {options}, and none is known. Give {'one of them' if len(names) > 1 else 'it'} "
            f"in [properties] of the study file, or leave {what.lower()} out."
        )

    def known(self) -> dict[str, float]:
        """Return those that are known, for the attributes of a dataset."""
        found = {name: self.get(name) for name in Densities.model_fields}
        return {name: value for name, value in found.items() if value is not None}
