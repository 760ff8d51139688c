"""Densities and weighed masses: what turns a length or a grey value into grams, given by the user and never assumed."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from planish.core.errors import CannotMeasure


@dataclass(frozen=True, slots=True, kw_only=True)
class Densities:
    """What is known of the sheet from elsewhere; all of it may be missing.

    Attributes
    ----------
    coating_g_cm3 : float or None
        Density of the coating layer with its voids; 1.6 is usual for ground calcium carbonate with latex.
    base_g_cm3 : float or None
        Density of the base as it lies in the sheet, with its voids.
    filler_g_cm3 : float or None
        Density of the filler's grains without voids; calcium carbonate 2.7.
    grammage_g_m2 : float or None
        Weighed mass of the whole sheet.
    coat_weight_top_g_m2, coat_weight_bottom_g_m2 : float or None
        Weighed mass of the coating of one side.
    """

    coating_g_cm3: float | None = None
    base_g_cm3: float | None = None
    filler_g_cm3: float | None = None
    grammage_g_m2: float | None = None
    coat_weight_top_g_m2: float | None = None
    coat_weight_bottom_g_m2: float | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that are no densities."""
        for name, value in asdict(self).items():
            if value is not None and not (0 < value < 1e4):
                raise CannotMeasure(f"{name} is {value:g}; it must be a positive number. Correct it in [properties].")

    def get(self, name: str) -> float | None:
        """Return one of them by name."""
        return asdict(self)[name]

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
        return {name: value for name, value in asdict(self).items() if value is not None}
