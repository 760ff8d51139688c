"""Options of the corrections of a micro-CT volume."""

from __future__ import annotations

from typing import Literal

from planish.core.options import Params, option

Axis = Literal["z", "y", "x"]


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
