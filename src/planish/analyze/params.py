"""Options of the correlation."""

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, model_validator

from planish.core.options import Names, Params, option


class CorrelateParams(Params):
    """Point-wise correlation of two maps."""

    point_um: float = option(100.0, gt=0, help="Edge of the averaging square (point) in um.")
    headline: str | None = option(
        None,
        metavar="NAME",
        help="Headline map; default: the coating of the given side.",
    )
    beside: Names = option(
        (),
        metavar="NAME",
        max_length=3,
        help=(
            "Also state the partial r of the headline map beside this map of the sheet, such as"
            " base_thickness; repeatable, up to 3 times."
        ),
    )
    regions: str | None = option(
        None,
        metavar="FILE",
        help=(
            "Artefacts (a stain, a crease, a label) to leave out: polygons in GeoJSON, in um of"
            " the reference, or selections of ImageJ (.roi, .zip), in its pixels; with reason and"
            " author."
        ),
    )
    kubelka_munk: float | None = option(
        None,
        ge=0,
        lt=10,
        metavar="K/S",
        help=(
            "Fit the curve of Kubelka and Munk to the reflectance over the headline coating, with"
            " this ratio of absorption to scattering (0.002 for a white coating). Needs"
            " reflectance: `white` with `white_exposure`, or `dark_grey` and `white_grey`."
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
            "Take a smooth field of light, quadratic in x and y, off the image, fitted together"
            " with the headline map. Long waves of the paper go with it, so declare it before you"
            " look at r. Without this option, both r are stated."
        ),
    )
    mottle: bool = option(
        False,
        help="State the mottle of each image by octaves of wavelength (coefficient of variation).",
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
    names = ",".join(map(str, texts)).split(",")
    return tuple(name.strip() for name in names if name.strip())


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


class ScalesParams(Params):
    """Which maps are described by octaves of wavelength, and what they are compared with."""

    of: MapNames = option(
        (),
        cli="--map",
        metavar="MAP,...",
        help="Maps whose octaves are stated; may be given again. All maps where none is named.",
    )
    against: str | None = option(
        None,
        metavar="MAP",
        help=(
            "Map that they are compared with, octave by octave: their gain for a change of it,"
            " coherence and phase, such as base_surface_top for the levelling of coating_top."
        ),
    )
    fibre_length_mm: float | None = option(
        None, gt=0, lt=20, metavar="MM", help="Mean length of the fibres, for formation numbers."
    )
    fibre_width_um: float | None = option(
        None, gt=0, lt=500, help="Mean width of the fibres, for formation numbers."
    )
    coarseness_mg_m: float | None = option(
        None,
        gt=0,
        lt=5,
        metavar="MG/M",
        help="Mass of a fibre over its length, for formation numbers.",
    )
    mean_grammage_g_m2: float | None = option(
        None,
        gt=0,
        lt=2000,
        metavar="G/M2",
        help="Grammage of the sheet, for formation numbers of its thickness.",
    )
    formation_cell_um: float = option(
        1000.0, gt=0, help="Edge of the cells that a formation number is of."
    )

    @model_validator(mode="after")
    def _states_whole_fibres(self) -> Self:
        missing = [name for name in FIBRES if getattr(self, name) is None]
        if missing and len(missing) < len(FIBRES):
            raise ValueError(f"formation numbers need all of {', '.join(FIBRES)}")
        return self

    @property
    def is_declared(self) -> bool:
        """Whether a study asks for it."""
        return self != ScalesParams()


FIBRES = ("fibre_length_mm", "fibre_width_um", "coarseness_mg_m", "mean_grammage_g_m2")
"""What a formation number needs to be told."""
