"""Options of the corrections of a micro-CT volume, and the record of a correction.

The record is for JSON and the store.
"""

from typing import Any

from pydantic import Field

from planish.core.facts import ResultModel, optional
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


class RingArtefact(ResultModel):
    """One ring that was found."""

    radius_um: float = Field(description="Of the crest.")
    width_um: float = Field(description="Full width at half height.")
    height: float = Field(description="In grey; negative where the ring is darker.")
    share: float = Field(description="The height as a share of the sheet's contrast to air.")
    share_se: float = Field(description="Standard error of the share.")
    share_after: float = Field(
        default=float("nan"), description="What is left at this radius after the correction."
    )
    least: float = Field(
        default=1.0,
        description=(
            "Least factor on the height along the axis; 1 where it does not vary beyond its noise."
        ),
    )
    most: float = Field(default=1.0, description="Largest such factor.")


class Trend(ResultModel):
    """Loss of grey in the middle against the edge of the sheet, from one material."""

    material: str = Field(description="``base`` or ``coating``.")
    before: float = Field(
        description=(
            "In per cent of the material's grey above air; positive where the middle is fainter."
        )
    )
    se: float = Field(description="Standard error of one of them.")
    after: float | None = optional("The same after the correction.")


Trends = tuple[Trend, ...]


class Cupping(ResultModel):
    """The cupping that was corrected."""

    percent: float = Field(description="Loss in the middle against the sheet's largest radius.")
    se: float = Field(description="Standard error of that.")
    powers: tuple[float, ...] = Field(
        description="One factor, on (radius / reach)², relative to the middle."
    )
    reach_um: float = Field(
        description="Largest radius at which there is sheet; beyond it the factor stays."
    )


class CorrectionRecord(ResultModel):
    """What was found, and what was changed."""

    axis: Axis = Field(description="Axis of rotation.")
    centre_um: Pair = Field(description="Where it stands along the two other axes, in array order.")
    asked: Texts = Field(description="``rings``, ``cupping``.")
    air: float | None = optional("Grey of the air; None where no sheet stands out.")
    sheet: float | None = optional("Grey of the sheet; None where none stands out.")
    rings: tuple[RingArtefact, ...] = Field(default=(), description="Those that were corrected.")
    ring_limit: float | None = optional(
        "Median over the radii of the height that would have been found, as a share of the"
        " contrast."
    )
    cupping: Cupping | None = optional("None where nothing was corrected.")
    trends: Trends = Field(
        default=(), description="Of each material against the radius, before and after."
    )
    clipped: float = Field(
        default=0.0, description="Share of voxels that left the range of their type."
    )
    slices: int = Field(default=0, description="Slices looked at.")
    length: int = Field(default=0, description="Slices there are.")
    sentences: Texts = Field(default=(), description="What was done or not done, and why.")

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
