"""Options of the corrections of a micro-CT volume, and the record of a correction.

The record is for JSON and the store.
"""

from typing import Any

from planish.core.facts import DescribedModel, optional
from planish.core.frame import Axis
from planish.core.options import Params, option
from planish.core.typing import Entries, Pair, Texts


class CorrectParams(Params):
    """Which artefacts are corrected, and around which axis the specimen was turned."""

    rings: bool = option(
        False,
        cli="--correct-rings",
        help="Micro-CT: correct rings around the axis of rotation that exceed the noise.",
    )
    cupping: bool = option(
        False,
        cli="--correct-cupping",
        help=(
            "Micro-CT: correct the loss of the sheet's grey towards the centre, which beam"
            " hardening causes."
        ),
    )
    axis: Axis = option(
        "z",
        cli="--rotation-axis",
        help=(
            "Axis of rotation of the scan; z is the axis along which the slices of a file are"
            " stacked."
        ),
    )
    centre_um: Pair | None = option(
        None,
        cli="--rotation-centre-um",
        metavar="A,B",
        help=(
            "Position of the axis of rotation along the two other axes, in the order z, y, x, in"
            " um from the first voxel; default: the middle of the field. A cropped volume needs it."
        ),
    )

    @property
    def asked(self) -> Texts:
        """Names of the corrections that are asked for."""
        return tuple(name for name in ("rings", "cupping") if getattr(self, name))


class RingArtefact(DescribedModel):
    """One ring that was found."""

    radius_um: float
    """Of the crest."""
    width_um: float
    """Full width at half height."""
    height: float
    """In grey; negative where the ring is darker."""
    share: float
    """The height as a share of the sheet's contrast to air."""
    share_se: float
    """Standard error of the share."""
    share_after: float = float("nan")
    """What is left at this radius after the correction."""
    least: float = 1.0
    """Least factor on the height along the axis; 1 where it does not vary beyond its noise."""
    most: float = 1.0
    """Largest such factor."""


class Trend(DescribedModel):
    """Loss of grey in the middle against the edge of the sheet, from one material."""

    material: str
    """``base`` or ``coating``."""
    before: float
    """In per cent of the material's grey above air; positive where the middle is fainter."""
    se: float
    """Standard error of one of them."""
    after: float | None = optional("The same after the correction.")


Trends = tuple[Trend, ...]


class Cupping(DescribedModel):
    """The cupping that was corrected."""

    percent: float
    """Loss in the middle against the sheet's largest radius."""
    se: float
    """Standard error of that."""
    powers: tuple[float, ...]
    """One factor, on (radius / reach)², relative to the middle."""
    reach_um: float
    """Largest radius at which there is sheet; beyond it the factor stays."""


class CorrectionRecord(DescribedModel):
    """What was found, and what was changed."""

    axis: Axis
    """Axis of rotation."""
    centre_um: Pair
    """Where it stands along the two other axes, in array order."""
    asked: Texts
    """``rings``, ``cupping``."""
    air: float | None = optional("Grey of the air; None where no sheet stands out.")
    sheet: float | None = optional("Grey of the sheet; None where none stands out.")
    rings: tuple[RingArtefact, ...] = ()
    """Those that were corrected."""
    ring_limit: float | None = optional(
        "Median over the radii of the height that would have been found, as a share of the"
        " contrast."
    )
    cupping: Cupping | None = optional("None where nothing was corrected.")
    trends: Trends = ()
    """Of each material against the radius, before and after."""
    clipped: float = 0.0
    """Share of voxels that left the range of their type."""
    slices: int = 0
    """Slices looked at."""
    length: int = 0
    """Slices there are."""
    sentences: Texts = ()
    """What was done or not done, and why."""

    @property
    def changes(self) -> bool:
        """True if any voxel is changed."""
        return bool(self.rings) or self.cupping is not None

    def to_json(self) -> Entries:
        """Return it as plain lists, numbers and text.

        Numbers have six digits, None where one is not known.
        """
        return _plain(self.model_dump())


def _plain(value: Any) -> Any:
    """Turn a record into what JSON has; numbers with six digits."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if abs(value) < float("inf") else None
    return value
