"""What a series of specimens is looked at for, declared before it is looked at."""

from pydantic import field_validator

from planish.core.options import Params, option


class Declared(Params):
    """What is compared, and which difference would matter."""

    compare: str | None = option(
        None,
        cli="--by",
        metavar="FACTOR",
        help=(
            "Factor whose levels are compared; default: the first of treatment, paper and side"
            " that varies."
        ),
    )
    headline: tuple[str, ...] = option(
        (),
        metavar="MAP",
        help="Map to compare; repeatable, the headline first; default: those of the runs.",
    )
    margin: dict[str, float] = option(
        {},
        cli=None,
        help=(
            "Largest difference that does not matter, by MAP (its mean), MAP.sd, MAP.thin_share"
            " or r."
        ),
    )
    thin_um: float | None = option(
        None,
        ge=0,
        help="Limit of the thin share that is compared; default: that of the runs.",
    )
    doubtful: bool = option(
        False, cli="--with-doubtful", help="Include doubtful figures in means and comparisons."
    )

    @field_validator("margin")
    @classmethod
    def _above_zero(cls, margin: dict[str, float]) -> dict[str, float]:
        for name, value in margin.items():
            if not value > 0:
                raise ValueError(f"the margin of {name} has to be above 0")
        return margin
