"""Options of the corrections of a micro-CT volume, and the record of a correction, for JSON and the store."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from planish.core.frame import Axis
from planish.core.options import Params, option


class CorrectParams(Params):
    """Which artefacts are corrected, and around which axis the specimen was turned."""

    rings: bool = option(
        False, cli="--correct-rings", help="Micro-CT: correct rings around the axis of rotation that exceed the noise."
    )
    cupping: bool = option(
        False,
        cli="--correct-cupping",
        help="Micro-CT: correct the loss of the sheet's grey towards the centre, which beam hardening causes.",
    )
    axis: Axis = option(
        "z",
        cli="--rotation-axis",
        help="Axis of rotation of the scan; z is the axis along which the slices of a file are stacked.",
    )
    centre_um: tuple[float, float] | None = option(
        None,
        cli="--rotation-centre-um",
        metavar="A,B",
        help="Position of the axis of rotation along the two other axes, in the order z, y, x, in um from the first "
        "voxel; the middle of the field where not given. Needed for a cropped volume.",
    )

    @property
    def asked(self) -> tuple[str, ...]:
        """Names of the corrections that are asked for."""
        return tuple(name for name in ("rings", "cupping") if getattr(self, name))


@dataclass(frozen=True, slots=True, kw_only=True)
class RingArtefact:
    """One ring that was found.

    Attributes
    ----------
    radius_um, width_um : float
        Of the crest, and its full width at half height.
    height : float
        In grey; negative where the ring is darker.
    share, share_se : float
        The same as a share of the sheet's contrast to air, and its standard error.
    share_after : float
        What is left at this radius after the correction.
    least, most : float
        Factor on the height along the axis; 1 and 1 where it does not vary beyond its noise.
    """

    radius_um: float
    width_um: float
    height: float
    share: float
    share_se: float
    share_after: float = float("nan")
    least: float = 1.0
    most: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """Loss of grey in the middle against the edge of the sheet, from one material.

    Attributes
    ----------
    material : str
        ``base`` or ``coating``.
    before, after : float
        In per cent of the material's grey above air; positive where the middle is fainter.
    se : float
        Standard error of one of them.
    """

    material: str
    before: float
    se: float
    after: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Cupping:
    """The cupping that was corrected.

    Attributes
    ----------
    percent, se : float
        Loss in the middle against the sheet's largest radius.
    powers : tuple of float
        One factor, on (radius / reach)², relative to the middle.
    reach_um : float
        Largest radius at which there is sheet; beyond it the factor stays.
    """

    percent: float
    se: float
    powers: tuple[float, ...]
    reach_um: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectionRecord:
    """What was found, and what was changed.

    Attributes
    ----------
    axis : {"z", "y", "x"}
        Axis of rotation.
    centre_um : (float, float)
        Where it stands along the two other axes, in array order.
    asked : tuple of str
        ``rings``, ``cupping``.
    air, sheet : float or None
        Greys; None where no sheet stands out.
    rings : tuple of RingArtefact
        Those that were corrected.
    ring_limit : float or None
        Median over the radii of the height that would have been found, as a share of the contrast.
    cupping : Cupping or None
        None where nothing was corrected.
    trends : tuple of Trend
        Of each material against the radius, before and after.
    clipped : float
        Share of voxels that left the range of their type.
    slices, length : int
        Slices looked at, of so many.
    sentences : tuple of str
        What was done or not done, and why.
    """

    axis: Axis
    centre_um: tuple[float, float]
    asked: tuple[str, ...]
    air: float | None = None
    sheet: float | None = None
    rings: tuple[RingArtefact, ...] = ()
    ring_limit: float | None = None
    cupping: Cupping | None = None
    trends: tuple[Trend, ...] = ()
    clipped: float = 0.0
    slices: int = 0
    length: int = 0
    sentences: tuple[str, ...] = ()

    @property
    def changes(self) -> bool:
        """True if any voxel is changed."""
        return bool(self.rings) or self.cupping is not None

    def to_json(self) -> dict[str, Any]:
        """Return it as plain lists, numbers and text; numbers have six digits, None where one is not known."""
        return _plain(asdict(self))


def _plain(value: Any) -> Any:
    """Turn a record into what JSON has; numbers with six digits."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if abs(value) < float("inf") else None
    return value
