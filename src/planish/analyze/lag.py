"""Image-based check of how far one map lies off others on the same grid.

It goes by their common texture alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np

from planish.core.checks import CORRELATION, POSITION, Check
from planish.core.errors import SizeError
from planish.core.facts import NULL, DescribedModel, Interval, Value
from planish.core.numbers import in_ascii, to_spread
from planish.core.typing import Entries, Floats, Pair, Shape2D, pair_of
from planish.texture.detrend import PhaseSurrogate
from planish.texture.lag_field import LagField, lag_field
from planish.texture.lag_search import LagSearch
from planish.texture.ncc import MARGIN, Peak, find_peak, rival_of, within
from planish.texture.textures import Textures

Reason = Literal["few", "texture", "border", "rival", "light"]
NAME = "position by texture"
ALLOWED = math.sqrt(-math.log(0.05))
"""Of their rms, what 95 % of displacements stay below that are normal with one spread along x and
y."""

_REASONS: dict[Reason, str] = {
    "few": "too few pixels are known in all maps",
    "texture": "the maps have no texture in common that stands out from chance",
    "border": "the correlation still rises at the largest lag searched",
    "rival": "a second peak is nearly as high, as where a pattern repeats itself",
    "light": (
        "the image follows the slopes of the face, and light from one side cannot be distinguished"
        " from a shift"
    ),
}


def inconclusive(sentence: str) -> Check:
    """The check of a place that says nothing."""
    return Check(name=NAME, state="unknown", sentence=sentence, figures=(POSITION,))


class LagTile(DescribedModel):
    """Lag of one part of the map."""

    x: float
    """Middle of the tile, um."""
    y: float
    """Middle of the tile, um."""
    lag_um: Interval
    """Lag of the tile, along x and y."""
    distinct: bool
    """Whether its peak stands out from chance."""


class LagNumbers(DescribedModel):
    """What two maps say of their registration by their own texture, for a check."""

    property: str
    """The map that was compared with the image."""
    lag_um: Interval
    """The image shows at p + lag what the map shows at p; along x and y. None where
    inconclusive."""
    se_um: Interval
    """Standard error of the lag, along x and y."""
    length_um: Value
    """Length of the lag."""
    length_se_um: Value
    """Standard error of the length."""
    r: Value
    """r at the best lag; it was searched for and measures no relation."""
    r_at_zero: Value
    """r without any lag."""
    limit_r: Value = NULL
    """|r| that unrelated maps exceed in the search in 1 of 1000 cases."""
    reason: str | None
    """Why the lag is inconclusive: few, texture, border, rival or light."""
    agrees: bool | None
    """Whether the lag agrees with the marks; None where inconclusive."""
    expected_um: Value
    """Expected error of the registration, rms over the map."""
    sentence: str
    """The same in words."""
    pixel_um: Pair
    """Pixel of the maps that were compared, along y and x."""
    n: int
    """Pixels that are known."""
    reach_um: float
    """Largest lag that was searched."""
    light: Value = NULL
    """Share of what is explained that needs the slopes of the surface."""
    tile_um: Value
    """Side of a tile."""
    tiles: tuple[LagTile, ...]
    """Lags of parts of the map."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lag:
    """Where the last map's texture lies, relative to that of the first ones.

    Its numbers are those of :class:`LagNumbers`. ``r`` is a multiple correlation, with the sign of
    that of the very first map; ``lag_um`` and ``covariance_um2`` (2, 2) are NaN unless distinct;
    ``field``: lags of tiles, if asked for.
    """

    reach_um: float
    pixel_um: Pair
    n: int
    reason: Reason | None
    lag_um: Pair = (math.nan, math.nan)
    covariance_um2: Floats = field(default_factory=lambda: np.full((2, 2), np.nan))
    r: float = math.nan
    r_at_zero: float = math.nan
    limit_r: float = math.nan
    light: float = math.nan
    field: LagField | None = None

    @property
    def distinct(self) -> bool:
        """Whether the peak is above chance, inside the search, the only one, and well located."""
        return self.reason is None

    @property
    def se_um(self) -> Pair:
        """Standard errors along x and y, in um."""
        return pair_of(np.sqrt(np.diag(self.covariance_um2)))

    @property
    def length_um(self) -> float:
        """Length of the lag, in um."""
        return math.hypot(*self.lag_um)

    @property
    def length_se_um(self) -> float:
        """Standard error of the lag along its own direction, in um."""
        along = np.full(2, math.sqrt(0.5))
        if self.length_um > 0:
            along = np.array(self.lag_um) / self.length_um
        return float(np.sqrt(along @ self.covariance_um2 @ along))

    def agrees(self, expected_error_um: float) -> bool | None:
        """Whether the lag is one that the expected error of the registration allows.

        None if it is inconclusive.

        Parameters
        ----------
        expected_error_um : float, in um
            Rms distance between the fitted and the true place (rms over the map).

        Notes
        -----
        The limit is 1.73 times the rms of expected error and standard error of the lag together: 95
        % of normal errors are smaller. A lag that is known less well than the registration agrees
        easily.
        """
        if not self.distinct or not math.isfinite(expected_error_um):
            return None
        return self.length_um <= self._allowed_um(expected_error_um)

    def _allowed_um(self, expected_error_um: float) -> float:
        """Length that 95 % of the lags of right registrations stay below."""
        return ALLOWED * math.hypot(expected_error_um, *self.se_um)

    def scaled(self, factor: float) -> Lag:
        """The same with lengths that are larger by a factor."""
        field = self.field
        if field is not None:
            field = field.scaled(factor)
        pixel_um = np.multiply(factor, self.pixel_um)
        lag_um = np.multiply(factor, self.lag_um)
        return replace(
            self,
            reach_um=factor * self.reach_um,
            pixel_um=pair_of(pixel_um),
            lag_um=pair_of(lag_um),
            covariance_um2=factor**2 * self.covariance_um2,
            field=field,
        )

    def check(self, expected_error_um: float | None = None) -> Check:
        """State what the lag says of the registration.

        The expected error of the registration (rms, in um) may be unknown: None or NaN. A lag that
        is as short as both errors allow passes. A longer one asks for a look where it is above 3 of
        its own standard errors, and is inconclusive below, as is one without a distinct peak.
        Sentences give lengths to the digits that their error bears.
        """
        start = "Image-based check: inconclusive, because"
        if self.reason is not None:
            return inconclusive(f"{start} {_REASONS[self.reason]}.")
        length, length_error = self.length_um, self.length_se_um
        lengths_um = (length, length_error, *self.lag_um)
        length_text, error_text, x_text, y_text = (
            in_ascii(to_spread(um, length_error)) for um in lengths_um
        )
        offset = (
            f"y their texture the maps lie {length_text} ± {error_text} um apart (x {x_text}, y"
            f" {y_text} um)"
        )
        if expected_error_um is None or not math.isfinite(expected_error_um):
            sentence = f"{start} the marks give no expected error; b{offset}."
            return Check(name=NAME, state="unknown", sentence=sentence, value=length, units="um")
        limit_um = self._allowed_um(expected_error_um)
        expected = f"expected error {to_spread(expected_error_um, expected_error_um)} um"
        judge = partial(Check, name=NAME, value=length, limit=limit_um, units="um")
        judge = partial(judge, figures=(POSITION, CORRELATION))
        if length <= limit_um:
            verdict = "agrees"
            if math.hypot(*self.se_um) > max(expected_error_um, *self.pixel_um):
                verdict += ", but is less certain than the marks"
            return judge(state="pass", sentence=f"B{offset}, {expected}: {verdict}.")
        excess = f"more than the marks allow ({expected})"
        if length <= 3.0 * length_error:
            sentence = f"{start} b{offset}, which is {excess} but within 3 standard errors."
            return judge(state="unknown", sentence=sentence)
        return judge(
            state="look",
            sentence=f"B{offset}, {excess}. Nothing else shows a shift that all marks share.",
            advice=(
                "Compare the outlines of maps and image; if it is real, correct it, or use marks at"
                " the face that the image shows."
            ),
        )

    def sentence(self, expected_error_um: float | None = None) -> str:
        """The lag, and whether it agrees with the expected error (rms, in um) if that is given."""
        return self.check(expected_error_um).sentence

    def numbers(self, property_name: str, expected_error_um: float | None = None) -> LagNumbers:
        """Return what stands in the results of a run.

        With the first map's property, and the expected error (rms, in um) if known. Fields that the
        lag itself has under the same name are taken from it.
        """
        expected_um = math.nan if expected_error_um is None else expected_error_um
        field = self.field
        tile_um = math.nan
        tiles: list[LagTile] = []
        if field is not None:
            tile_um = field.tile_um
            rows = zip(field.at_um, field.lag_um, field.distinct, strict=True)
            for (x, y), lag, distinct in rows:
                tile = LagTile(x=x, y=y, lag_um=pair_of(lag), distinct=distinct)
                tiles.append(tile)
        of_run: Entries = {
            "property": property_name,
            "agrees": self.agrees(expected_um),
            "expected_um": expected_um,
            "sentence": self.sentence(expected_um),
            "tile_um": tile_um,
            "tiles": tuple(tiles),
        }
        of_lag = {k: getattr(self, k) for k in LagNumbers.model_fields if k not in of_run}
        return LagNumbers(**of_lag | of_run)


def texture_lag(  # noqa: PLR0911
    texture: Textures,
    first: Sequence[str],
    last: str,
    *,
    reach_um: float,
    tiles_um: float | None = None,
    slopes: int = 0,
) -> Lag:
    """Find the lag between some maps and another one, and whether it is conclusive.

    Parameters
    ----------
    texture : Textures, of :func:`textures`
    first : sequence of str
        Maps that the last one may follow, with either sign and together: a coating and, for light
        from one side, the slopes of the surface. The last ``slopes`` of them are such slopes.
    last : str
    reach_um : float, in um; largest lag searched, in every direction; at most a quarter of the map
    tiles_um : float or None, in um; side of square tiles, half overlapping, whose lags are found
    one by one

    Returns
    -------
    Lag

    Raises
    ------
    SizeError
        If reach or tiles do not fit the maps.

    Notes
    -----
    At every lag the last map is regressed on the first ones, each in two halves at 60 um, so that
    either may be more
    blurred than the other; the peak of R² is the lag. What follows the slopes of a surface is an
    odd relation, which
    alone would move the peak of r. The limit is what R² of unrelated textures exceeds
    anywhere in the search in 1 of 1000 cases (chi-square field of as many degrees as maps; Worsley
    1994). The standard
    error is that of an M-estimator, from the scatter of tiles.

    References
    ----------
    Worsley (1994), Adv. Appl. Probab. 26, 13, doi:10.2307/1427576.
    """
    pixel = texture.pixel_um
    reach = _reach_px(texture, reach_um)
    build_lag = partial(Lag, reach_um=reach_um, pixel_um=pixel, n=texture.n)
    if not _have_texture(texture, (*first, last)):
        return build_lag(reason="few")
    halves = [texture.halves(k) for k in first]
    x = np.concatenate(halves)
    y = texture.maps[last]
    # Lags beyond the reach are needed to see a peak at its border.
    no_lag = (reach[0] + MARGIN, reach[1] + MARGIN)
    search = LagSearch(x, y, texture.known, no_lag)
    allowed = within(reach)
    limit = search.limit(reach)  # of R², which chance exceeds in 1 of 1000 cases
    above = allowed & (search.height > limit)
    is_above = above.any()
    peak = find_peak(search.share, above if is_above else allowed)
    share_at_zero = max(search.share[no_lag], 0)
    r_at_zero = math.sqrt(share_at_zero)
    lag = build_lag(reason="texture", limit_r=math.sqrt(limit), r_at_zero=r_at_zero)
    if peak is None:
        return lag
    # The sign is that of what follows the very first map in the fit.
    weights = search.weights(peak.lag_px)
    n_first = len(halves[0])
    fitted = np.tensordot(weights[:n_first], x[:n_first], 1)
    sign = np.vdot(fitted, texture.maps[first[0]])
    multiple_r = math.sqrt(max(peak.r, 0.0))
    lag = replace(lag, r=math.copysign(multiple_r, sign))
    if not is_above:
        return lag
    if not peak.inner:
        return replace(lag, reason="border")
    # A second peak of four fifths of the first one's R² may be the right one.
    if rival_of(search.share, peak, allowed) > max(limit, 0.8 * peak.r):
        return replace(lag, reason="rival")
    n_slopes = sum(map(len, halves[len(first) - slopes :]))
    lag = _located(lag, search, peak, halves_of_slopes=n_slopes)
    if tiles_um is None or not lag.distinct:
        return lag
    surrogates = PhaseSurrogate(y, texture.known)
    unrelated = surrogates.draws(19, np.random.default_rng(20090501))
    all_fitted = np.tensordot(weights, x, 1)
    field_of_lags = lag_field(
        all_fitted,
        y,
        texture.known,
        pixel,
        reach=reach,
        tile_um=tiles_um,
        unrelated=[*unrelated],
    )
    return replace(lag, field=field_of_lags)


def _reach_px(texture: Textures, reach_um: float) -> Shape2D:
    """The reach in pixels; SizeError where it does not fit the maps."""
    row_um, col_um = texture.pixel_um
    rows, cols = texture.known.shape
    sides_um = (rows * row_um, cols * col_um)
    least_um = 3 * max(row_um, col_um)
    most_um = min(sides_um) / 4
    if not least_um <= reach_um <= most_um:
        raise SizeError(
            f"A reach of {reach_um:g} um does not fit maps of {sides_um[1]:.3g} x {sides_um[0]:.3g}"
            f" um in pixels of {max(row_um, col_um):g} um. Take one from 3 pixels ({least_um:g} um)"
            f" to a quarter of the shorter side ({most_um:.3g} um)."
        )
    return int(reach_um / row_um + 1e-9), int(reach_um / col_um + 1e-9)


def _have_texture(texture: Textures, names: Sequence[str]) -> bool:
    """Whether enough pixels are known, and each of some maps is there and varies."""
    if texture.n < 400:
        return False
    return all(k in texture.maps and texture.maps[k].any() for k in names)


def _located(lag: Lag, search: LagSearch, peak: Peak, *, halves_of_slopes: int) -> Lag:
    """The lag with its place and covariance, or why it locates nothing; and the share of light.

    The last ``halves_of_slopes`` maps of the search are slopes of the face in two halves each: the
    share of what is explained that needs them is that of light from one side. The place is that of
    the peak between the pixels, (x, y) as the search has (row, column).
    """
    unsure: Reason = "texture"
    if halves_of_slopes:
        unsure = "light"
        share = search.share_of(slice(0, -halves_of_slopes), peak.lag_px)
        lag = replace(lag, light=1.0 - share / peak.r)
    step_um = np.array(lag.pixel_um[::-1])
    covariance_px2 = search.covariance(peak, lag.pixel_um)[::-1, ::-1]
    covariance = covariance_px2 * np.outer(step_um, step_um)
    between_pixels_um = 0.1 * max(lag.pixel_um)  # error of the place of a summit between pixels
    covariance += between_pixels_um**2 * np.eye(2)
    largest_variance = np.linalg.eigvalsh(covariance)[-1]
    if not math.sqrt(largest_variance) < lag.reach_um / 4:
        return replace(lag, reason=unsure)
    lag_um = pair_of(peak.summit_px[::-1] * step_um)
    return replace(lag, reason=None, lag_um=lag_um, covariance_um2=covariance)
