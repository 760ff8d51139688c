"""Options of the correlation."""

from __future__ import annotations

from planish.core.options import Params, option


class CorrelateParams(Params):
    """Point-wise correlation of two maps."""

    point_um: float = option(100.0, gt=0, help="Edge of the averaging square (point) in um.")
    headline: str | None = option(
        None, metavar="NAME", help="Map whose correlation leads; the coating of the given side, where not given."
    )
    beside: tuple[str, ...] = option(
        (), metavar="NAME", max_length=3,
        help="A map of the sheet, such as base_thickness, whose part is taken off both sides of the headline "
        "correlation for a second, partial r; may be given again, up to 3 times.",
    )  # fmt: skip
    regions: str | None = option(
        None,
        metavar="FILE",
        help="Artefacts (a stain, a crease, a label) whose pixels do not count: polygons in GeoJSON, in um of the "
        "reference, or selections of ImageJ (.roi, .zip), in its pixels; with reason and author.",
    )
    thin_um: float = option(5.0, gt=0, cli=None, help="Coating thickness in um below which the page outlines it.")
