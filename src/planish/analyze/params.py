"""Options of the correlation."""

from typing import Annotated, Literal

from pydantic import BeforeValidator

from planish.core.options import Names, Params, option


class CorrelateParams(Params):
    """Point-wise correlation of two maps."""

    point_um: float = option(100.0, gt=0, help="Edge of the averaging square (point) in um.")
    headline: str | None = option(
        None,
        metavar="NAME",
        help="Map whose correlation leads; the coating of the given side, where not given.",
    )
    beside: Names = option(
        (),
        metavar="NAME",
        max_length=3,
        help=(
            "A map of the sheet, such as base_thickness, whose part is taken off both sides of the"
            " headline correlation for a second, partial r; may be given again, up to 3 times."
        ),
    )
    regions: str | None = option(
        None,
        metavar="FILE",
        help=(
            "Artefacts (a stain, a crease, a label) whose pixels do not count: polygons in GeoJSON,"
            " in um of the reference, or selections of ImageJ (.roi, .zip), in its pixels; with"
            " reason and author."
        ),
    )
    kubelka_munk: float | None = option(
        None,
        ge=0,
        lt=10,
        metavar="K/S",
        help=(
            "Fit the curve of Kubelka and Munk to the reflectance over the coating that leads, with"
            " this ratio of absorption to scattering (0.002 for a white coating); needs"
            " reflectance, by `white` with `white_exposure` or by `dark_grey` and `white_grey`."
        ),
    )
    light_spread_um: float | None = option(
        None,
        gt=0,
        help=(
            "Also correlate the coating blurred as light is that spreads in paper: length over"
            " which an exponential falls to 1/e."
        ),
    )
    light: Literal["quadratic"] | None = option(
        None,
        metavar="FIELD",
        help=(
            "Take a smooth field of light off the image, fitted together with the map that leads:"
            " quadratic in x and y. Long waves of the paper's own go as well, so declare it before"
            " you look at r; without it, r without the field is stated beside."
        ),
    )
    mottle: bool = option(
        False,
        help="State by octaves of wavelength how uneven each image is (coefficient of variation).",
    )
    error_ratio: float | None = option(
        None,
        gt=0,
        metavar="RATIO",
        help=(
            "Of two volumes: variance of the errors of the second over that of the first; adds the"
            " line between two measurements that both have errors (Deming)."
        ),
    )
    thin_um: float = option(
        5.0, gt=0, cli=None, help="Coating thickness in um below which the page outlines it."
    )


def _each_name(value: object) -> object:
    """Names one by one, whether in a list or with commas between them."""
    texts = (value,) if isinstance(value, str) else value
    if not isinstance(texts, tuple | list):
        return value
    return tuple(name.strip() for text in texts for name in str(text).split(",") if name.strip())


MapNames = Annotated[tuple[str, ...], BeforeValidator(_each_name)]
"""Names of maps; commas separate them where a text has several."""


class ExplainParams(Params):
    """A model that is declared before it is run: which maps explain which."""

    response: str = option("image", metavar="MAP", help="Map that is explained.")
    of: MapNames = option(
        (),
        metavar="MAP,...",
        help="Maps that explain it; may be given again. A map of labels is a factor.",
    )
    cell_um: float = option(100.0, gt=0, help="Edge of the cells over which maps are averaged.")
    corrected: bool = option(
        False,
        help=(
            "Take the stated errors of the maps off, so that coefficients are those of maps without"
            " errors; maps that meet at a surface share its error."
        ),
    )
    factors: str | None = option(
        None,
        metavar="FILE",
        help=(
            "Named regions whose share of a cell explains as well: polygons in GeoJSON, in um of"
            " the reference, or selections of ImageJ, in its pixels."
        ),
    )

    @property
    def is_declared(self) -> bool:
        """Whether it names anything that explains."""
        return bool(self.of) or self.factors is not None
