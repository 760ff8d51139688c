"""Options that all properties share."""

from typing import Literal, TypeVar

from planish.core.options import Names, Params, option

Own = TypeVar("Own", bound=Params)


class Common(Params):
    """Options of all properties."""

    maps: Names = option(
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

    def of(self, model: type[Own]) -> Own:
        """Return these options as those of one property, which has a model of its own."""
        assert isinstance(self, model), f"the measurement has no {model.__name__}"
        return self
