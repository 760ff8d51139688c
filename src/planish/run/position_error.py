"""How far a pixel may be off.

The errors are those of marks and model, the neutral surface, the smoothing, and the poses of
sections.

None of them sees the others. Marks and model are the registration's own statement. Which surface of
a bent sheet stays unstrained is not known: it is the middle of the base or the mean of the faces
where the coating is 0 and 1 times as stiff as the base, and it may be 3. What the other surface
moves, registered to the same marks, is the measure D of that; the error is c D, one c for all
sheets (below). In the same way the smoothing of the centre surface is judged by what five eighths
of its cut-off move. What is left of the poses of serial sections displaces their pixels: their
quick errors, of which the alignment sees most, and a slow wander that it leaves alone, since it
looks like the sheet's own.
"""

import numpy as np
import xarray as xr

from planish.core.bands import rms_of
from planish.core.frame import Frame
from planish.core.grid import Grid, bilinear, filled, pitch
from planish.core.typing import Array, Floats, Pair
from planish.flatten import flat_moves
from planish.register import Chain
from planish.resample import Lattice, covering_grid, find_places, resample
from planish.results import ErrorShares
from planish.run.layers import Groups

# Root mean square over stiffness ratios coating/base drawn evenly from 0 to 3 of the neutral
# surface's distance from the one that was flattened, in distances of the two: e(r) = r sum(t z) /
# (b + r sum(t)), e(0) = 0, e(1) = 1; with a base of 50-60 um and coatings of 9-20 um, e(3) =
# 1.7-1.9.
NEUTRAL = {"base": 1.25, "faces": 0.55}
# Of serial sections, the step of the slow wander, which no alignment sees, for a quick shift of 1:
# microtomes of the field jitter by 1-2 um and wander by 0.1-0.2 um a section.
_WANDER = 0.1
# True over stated error of what is left, of older maps: they state the mean over the sections
# without Newton's step and no ``jitter_estimator`` (1.2-2.1 on ten drawn specimens).
_OLDER_JITTER = 1.3
# By which an office scanner puts lines off a smooth course within 2 mm, rms: 0.1 to 2 um of drawn
# ones (:class:`planish.synthetic.FlatbedParams`). Marks and tiles average it.
_LINES_UM = 1.0
_SHARES = {  # their words, and what would lower them
    "marks": ("marks and model", "more marks, spread over the field"),
    "neutral": (
        "the surface that is taken to stay unstrained",
        "a flatter specimen, or the surface that stays unstrained known from elsewhere",
    ),
    "smoothing": (
        "smoothing of the centre surface",
        "a shorter cut-off of that surface, or fewer holes with narrower rims",
    ),
    "sections": (
        "poses of the sections",
        "a volume in place of sections, or sections with more in common",
    ),
    "lines": ("lines of the scan", "a scanner with a steadier carriage"),
}


class PositionErrors:
    """How far the pixels of a reference (``grid``) may be off, computed at the places of a lattice.

    ``sheet`` holds ``surfaces``, ``flat`` and, of serial sections, ``sections``; None for an image
    that was moved. ``chain`` goes from its map to the reference, of which ``reference`` holds the
    same where it is a sheet. ``is_scan``: an office scanner took one of both.
    """

    def __init__(
        self,
        sheet: Groups | None,
        chain: Chain,
        grid: Grid,
        reference: Groups | None = None,
        *,
        is_scan: bool = False,
    ) -> None:
        """Compute the shares of the error at the places of the lattice."""
        self._lattice = Lattice(grid)
        places = self._lattice.places
        uv = chain.inverse(places)
        marks_um = chain.expected_error_um(uv).astype(np.float64)
        self._shares = {"marks": marks_um}  # um, (rows, cols) of the lattice
        if sheet is not None:
            self._shares |= _moved(sheet, chain, uv)
        # Poses of layers in between move marks only: a place goes over the link before and the link
        # after as if they were right.
        sections_um2 = 0.0
        if sheet is not None and "sections" in sheet:
            moved_um2 = _sections_um2(sheet, marks=len(chain.fits[0].moving))
            sections_um2 += chain.similarity.scale**2 * moved_um2
        if reference is not None and "sections" in reference:
            sections_um2 += _sections_um2(reference, marks=len(chain.fits[-1].moving))
        if sections_um2 != 0:
            self._shares["sections"] = np.full(marks_um.shape, np.sqrt(sections_um2))
        if is_scan:
            self._shares["lines"] = np.full(marks_um.shape, _LINES_UM)
        self._whole = self._shares.keys() == {"marks"} and sheet is None

    def on(self, part: Grid, layer_values: Floats) -> dict[str, xr.DataArray]:
        """Give the rms errors of the place of some pixels of the reference (y, x), in um.

        They are ``expected_error``, and shares of it.

        ``layer_values`` (y, x) is finite where a pixel shows the layer. The shares of a sheet are
        ``error_marks``, ``error_neutral``, ``error_smoothing``, ``error_sections`` and
        ``error_lines`` where they exist.
        """
        is_shown = np.isfinite(layer_values)
        shares: dict[str, Floats] = {}
        for k, of_lattice in self._shares.items():
            on_part = self._lattice.between(of_lattice, part)
            shares[k] = np.where(is_shown, on_part, np.nan)
        squares = [share**2 for share in shares.values()]
        total_um = np.sqrt(np.sum(squares, axis=0))
        titled = {"expected_error": (total_um, "Expected error of the place, rms")}
        for k, share in shares.items():
            if not self._whole:
                titled[f"error_{k}"] = (share, f"Expected error by {_SHARES[k][0]}")
        maps: dict[str, xr.DataArray] = {}
        for name, (um, title) in titled.items():
            attrs = {"long_name": title, "units": "um"}
            values = um.astype(np.float32)
            maps[name] = xr.DataArray(values, part.coords, ("y", "x"), attrs=attrs)
        return maps


def add_place_errors(maps: xr.Dataset, pixel_um: Pair) -> xr.Dataset:
    """Add to the standard errors of maps what the error of their place makes of it.

    A value that is read beside its place is wrong by the slope of its map times the distance along
    the slope, which is ``expected_error`` over the square root of 2. Maps of angles have no slope.
    """
    names = [
        str(name)
        for name, values in maps.items()
        if f"{name}_se" in maps and "period_deg" not in values.attrs
    ]
    errors: dict[str, xr.DataArray] = {}
    for name in names:
        values = maps[name].values
        slope_y = _slope(values) / pixel_um[0]
        slope_x = _slope(values.T).T / pixel_um[1]
        square = 0.5 * maps["expected_error"].values ** 2 * (slope_y**2 + slope_x**2)
        added = np.where(np.isnan(square), 0.0, square)
        se = maps[f"{name}_se"]
        total = np.sqrt(se.values**2 + added)
        errors[f"{name}_se"] = se.copy(data=total)
    return maps.assign(errors)


def _slope(values: Array) -> Array:
    """Change from row to row: the mean of those before and after, or the one that is known."""
    unknown = np.full_like(values[:1], np.nan)
    steps = np.diff(values, axis=0, prepend=unknown, append=unknown)
    before = steps[:-1]
    after = steps[1:]
    one_side = np.where(np.isnan(before), after, before)
    both_sides = before + after
    return np.where(np.isnan(both_sides), one_side, 0.5 * both_sides)


def error_shares(maps: xr.Dataset, *, has_shared: bool = False) -> ErrorShares | None:
    """Give the root mean square of each share over the pixels.

    It comes with which share is the largest, and what would lower it.

    ``has_shared`` says that the error of the marks holds what all of them share. None where the
    maps have no shares, as of an image that was moved.
    """
    rms: dict[str, float] = {}
    for name in _SHARES:
        if f"error_{name}" in maps:
            rms[name] = rms_of(maps[f"error_{name}"]) or 0.0
    if not rms:
        return None
    total_um2 = sum(um**2 for um in rms.values())
    total_um = float(np.sqrt(total_um2))
    largest_share = max(rms, key=lambda name: rms[name])
    shares_text = ", ".join(f"{_SHARES[name][0]} {value:.2g}" for name, value in rms.items())
    sentence = f"Expected error {total_um:.2g} um rms over the map: {shares_text} um. "
    if total_um > 0:
        share_name, remedy = _SHARES[largest_share]
        percent = 100 * (rms[largest_share] / total_um) ** 2
        sentence += f"{percent:.0f} % of its square is {share_name}; {remedy} would lower it. "
    if has_shared:
        sentence += "What light from one side moves all tiles by is in it."
    else:
        sentence += (
            "A shift that all marks share is not in it: no mark can show that, only the maps"
            " themselves."
        )
    shares_um = {f"{name}_um": value for name, value in rms.items()}
    return ErrorShares.model_validate(
        shares_um | {"rms_um": total_um, "largest": largest_share, "sentence": sentence}
    )


def _sections_um2(groups: Groups, *, marks: int) -> float:
    """Mean square of what is left of the sections' shifts in the plane of the sheet, in um**2.

    ``groups`` are those of the sheet, ``marks`` is how many marks hold it. The wander is a random
    walk with a step q a section. Marks hold it at the square root of their number of places along
    the cut; n sections between two such places leave q sqrt(n / 6), the mean over a Brownian
    bridge.
    """
    sections = groups["sections"]
    through = Frame.of(groups["surfaces"]).through
    n_between_marks = sections.sizes["section"] / np.sqrt(max(marks, 1))
    jitter_factor = 1.0 if "jitter_estimator" in sections.attrs else _OLDER_JITTER
    square_um2 = 0.0
    jitter_left_um = sections.attrs["jitter_left_um"]
    # A shift of a section's rows is along y of the volume, one of its columns along x.
    axes = (("y", "row"), ("x", "col"))
    for (axis, name), jitter_um in zip(axes, jitter_left_um, strict=True):
        if axis == through:
            continue
        left_um2 = (jitter_factor * float(jitter_um)) ** 2
        square_um2 += left_um2
        if name not in sections.attrs.get("fixed", ()):
            # What was taken off holds the shift that was there and the error that is left.
            taken_um2 = float(np.var(sections[f"shift_{name}"].values))
            quick_um2 = max(taken_um2 - left_um2, 0.0)
            square_um2 += _WANDER**2 * quick_um2 * n_between_marks / 6
    return square_um2


def _moved(sheet: Groups, chain: Chain, uv: Floats) -> dict[str, Floats]:
    """Give what other surfaces move at places (rows, cols, 2) of the sheet, in um of the reference.

    They are registered to the same marks. ``neutral`` is what another unstrained surface moves,
    ``smoothing`` what a shorter cut-off of the centre surface does, both as rms errors. The height
    of the surface that was flattened over the centre is 0 for the mean of the faces.
    """
    surfaces, attrs = sheet["surfaces"], sheet["flat"].attrs
    if "centre_shorter" not in surfaces or "neutral" not in attrs:
        return {}  # of a run that does not say what was flattened
    neutral = other_neutral = np.zeros(surfaces["centre"].shape)
    error_factor = NEUTRAL[attrs["neutral"]]
    if "base_middle" in surfaces:
        base_middle = surfaces["base_middle"].values.astype(np.float64)
        if attrs["neutral"] == "base":
            neutral = base_middle
        else:
            other_neutral = base_middle
    elif attrs["neutral"] == "faces":
        # Where no coating is seen, the neutral surface lies off by so much of the thickness.
        other_neutral = neutral + 0.01 * float(surfaces.attrs["thickness_um"])
        error_factor = 1.0
    shorter = neutral + surfaces["centre_shorter"].values
    others = {"neutral": other_neutral, "smoothing": shorter}
    moves = flat_moves(surfaces, others, neutral=neutral, rest=attrs["rest"])
    # From the nodes of their mesh to places of the flat map, carried on beyond the sheet.
    nodes = sheet["flat"].sel(y=moves["y"], x=moves["x"])
    nodes_uv = np.stack([nodes[axis].values for axis in "uv"], axis=-1)
    grid = covering_grid(nodes_uv, min(pitch(moves)))
    map_places = find_places(nodes_uv, grid)
    fields = {str(name): filled(resample(moves[name].values, map_places)) for name in moves}
    x, y = grid.origin_um
    dy_um, dx_um = grid.pixel_um
    rows, cols = grid.shape

    def moves_of(name: str, uv: Floats) -> Floats:
        u, v = np.moveaxis(uv, -1, 0)
        row = np.clip((v - y) / dy_um, 0, rows - 1)
        col = np.clip((u - x) / dx_um, 0, cols - 1)
        moves_uv = [bilinear(fields[f"{name}_{axis}"], row, col) for axis in "uv"]
        return np.stack(moves_uv, axis=-1)

    fit = chain.fits[0]
    linked_places = chain(uv)
    errors_um: dict[str, Floats] = {}
    for name, scale in (("neutral", error_factor), ("smoothing", 1.0)):
        refitted = fit.refitted(fit.moving + moves_of(name, fit.moving))
        shifted_places = refitted(uv + moves_of(name, uv))
        for link in chain.fits[1:]:
            shifted_places = link(shifted_places)
        moved_um = np.linalg.norm(shifted_places - linked_places, axis=-1)
        errors_um[name] = scale * filled(moved_um)
    return errors_um
