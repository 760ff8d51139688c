"""Options of the measurement, and the table of the modules with properties: an import, and a base.

Every module declares properties, as :mod:`~planish.measure.registry` says, and its own options as a
``Params`` model; :class:`MeasureParams` inherits these, for the study file, the command line and
the documents. No numba or scipy here.
"""

from typing import Literal

from planish.core.options import Params, option
from planish.measure import lengths, masses, phases, structure


class Common(Params):
    """Options of all properties."""

    maps: tuple[str, ...] = option(
        (),
        cli="--property",
        metavar="NAME",
        help=(
            "A further map, such as porosity or fibre_angle; may be given again. 'planish"
            " properties' lists them."
        ),
    )
    rays: Literal["normal", "vertical"] = option(
        "normal", help="Direction along which further maps are measured."
    )
    edge_um: float | None = option(
        None,
        ge=0,
        cli=None,
        help=(
            "Left out of the base at both ends, where the blur mixes it with what lies beside;"
            " twice the blur's standard deviation where not given."
        ),
    )


# Fields of the last base come first.
class MeasureParams(
    lengths.RoughnessOptions,
    lengths.ThicknessOptions,
    structure.Options,
    lengths.InkOptions,
    phases.Options,
    masses.Options,
    masses.Densities,
    Common,
):
    """Options of the properties; lengths in um, grey levels in the volume's own values."""
