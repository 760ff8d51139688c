"""How maps vary with distance: variograms, two maps moved against each other, two measurements of one quantity."""

from __future__ import annotations

import math
from collections.abc import Sequence

from planish.analyze import CorrelogramProfiles, LagProfile
from planish.core.facts import is_known
from planish.report.draw import ACCENT, FULL, POINT, SOFT, Axes, Canvas, Picture, Table
from planish.report.scale import known, powers
from planish.report.text import capital, count, fixed, in_words, left_out, number, percent, plain, unit
from planish.results import EvidenceFacts, MapVariogram, Twice

_TOP, _HIGH, _WIDE = 40.0, 235.0, 400.0
_LEFT, _RIGHT = 85.0, 635.0
_ROOM = 1.08


def draw_variograms(found: EvidenceFacts, *, titles: Sequence[str], regions: bool = False) -> Picture:
    """Draw the variogram of each of the two maps, with its sill and range; ``titles`` are those of the maps."""
    canvas = Canvas(FULL, 345)
    for left, one, title in zip((_LEFT, _RIGHT), found.variograms, titles, strict=False):
        _variogram(canvas, left, one, title)
    cells = " × ".join(f"{v:g}" for v in dict.fromkeys(round(v, 3) for v in found.variograms[0].cell_um))
    return canvas.picture(
        title=f"How {' and '.join(in_words(title) for title in titles)} vary with distance",
        caption=(
            "Half of the mean square difference of two places of a map, by their distance (variogram). It begins at "
            "what neighbours do not share (nugget: noise, and texture finer than a cell) and rises to the variance of "
            "the map (sill, dashed). Dotted: the range, at which the covariance has fallen to 1/e; over shorter "
            f"distances neighbours resemble each other. Means over {cells} µm, in both maps where both are valid: "
            f"without {left_out(regions)}."
        ),
        data={
            name: {
                "distance / µm": list(one.distances_um),
                f"half mean square difference / {_squared(one, title)}": list(one.values),
            } for name, one, title in zip(_names(found), found.variograms, titles, strict=True)
        },
    )  # fmt: skip


def _names(found: EvidenceFacts) -> list[str]:
    """Names of the tables of both maps, which may be of one name."""
    same = len({one.map for one in found.variograms}) < len(found.variograms)
    return [(f"{one.layer}-" if same else "") + one.map.replace("_", "-") for one in found.variograms]


def _squared(one: MapVariogram, title: str) -> str:
    """Unit of a variance; of what has no unit its name."""
    return f"{unit(one.units) or in_words(title.partition(',')[0])}²"


def _variogram(canvas: Canvas, left: float, one: MapVariogram, title: str) -> None:
    far = one.distances_um[-1]
    high = _ROOM * max(*one.values, one.sill, 1e-12)
    axes = canvas.axes(left, _TOP, _WIDE, _HIGH, (0.0, far, 0.0, high))
    axes.line([(0.0, one.sill), (far, one.sill)], colour=SOFT, width=1.2, dash="6 4")
    if is_known(one.range_um):
        axes.line([(one.range_um, 0.0), (one.range_um, high)], colour=SOFT, width=1.2, dash="2 3")
    points = list(zip(one.distances_um, one.values, strict=True))
    axes.line([(0.0, one.nugget), *points], colour=ACCENT, width=2.0)
    axes.dots([(0.0, one.nugget)], colour=ACCENT, size=6)
    canvas.ticks(axes, "distance / µm", f"half mean square difference / {_squared(one, title)}")
    canvas.text(left, 22, title, bold=True)


def draw_correlogram(found: CorrelogramProfiles, *, names: tuple[str, str], regions: bool = False) -> Picture:
    """Draw r of both maps, one moved along x and along y, with what unrelated maps reach."""
    canvas = Canvas(FULL, 345)
    for left, axis, profile in ((_LEFT, "x", found.along_x), (_RIGHT, "y", found.along_y)):
        _profile(canvas, left, axis, profile)
    cells = " × ".join(f"{v:g}" for v in dict.fromkeys(round(v, 3) for v in found.cell_um))
    return canvas.picture(
        title=f"{capital(names[0])} moved against {names[1]}",
        caption=(
            "Correlation of both maps where the second is moved along x (left) and along y (right). Shaded: what "
            "unrelated maps of these textures exceed at a given lag with 1 %; dashed: what they exceed at any of all "
            "lags with 1 %. Each lag has the pairs and means of its own overlap; a profile is one line through all "
            f"lags, whose largest r may lie beside it. Means over {cells} µm, where both are valid: without "
            f"{left_out(regions)}."
        ),
        data={f"along-{axis}": _lags(axis, profile) for axis, profile in (("x", found.along_x), ("y", found.along_y))},
    )  # fmt: skip


def _lags(axis: str, profile: LagProfile) -> Table:
    return {
        f"lag along {axis} / µm": list(profile.lags_um), "r": known(profile.r),
        "|r| that 1 % exceed at this lag": known(profile.limit),
        "|r| that 1 % exceed at any lag": known(profile.limit_of_any),
    }  # fmt: skip


def _profile(canvas: Canvas, left: float, axis: str, profile: LagProfile) -> None:
    ends = [abs(v) for row in (profile.r, profile.limit_of_any, profile.limit) for v in row if is_known(v)]
    high = min(_ROOM * max(ends, default=1.0), 1.0)
    span = profile.lags_um[0], profile.lags_um[-1]
    axes = canvas.axes(left, _TOP, _WIDE, _HIGH, (*span, -high, high))
    held = [(at, v) for at, v in zip(profile.lags_um, profile.limit, strict=True) if is_known(v)]
    if len(held) > 1:
        axes.area(held + [(at, -v) for at, v in reversed(held)], colour=POINT, opacity=0.2)
    axes.line([(span[0], 0.0), (span[1], 0.0)], colour=SOFT, width=0.8)
    axes.line([(0.0, -high), (0.0, high)], colour=SOFT, width=0.8)
    for sign in (1, -1):
        limits = [sign * v if is_known(v) else math.nan for v in profile.limit_of_any]
        axes.line(list(zip(profile.lags_um, limits, strict=True)), colour=POINT, width=1.2, dash="6 4")
    axes.line(list(zip(profile.lags_um, profile.r, strict=True)), colour=ACCENT, width=2.2)
    canvas.ticks(axes, f"lag along {axis} / µm", "r")


def draw_rings(found: Twice, *, name: str, layers: tuple[str, str], regions: bool = False) -> Picture:
    """Draw how far two measurements of one map agree, against wavelength."""
    canvas = Canvas(FULL, 345)
    at = [math.log10(ring.wavelength_um) for ring in found.rings]
    low = min(0.0, *(ring.correlation for ring in found.rings))
    span = min(at) - 0.03, max(at) + 0.03
    axes: Axes = canvas.axes(_LEFT, _TOP, FULL - _LEFT - 30, _HIGH, (*span, low - 0.05, 1.04))
    axes.line([(span[0], 0.0), (span[1], 0.0)], colour=SOFT, width=0.8)
    axes.line(
        [(x, ring.threshold) for x, ring in zip(at, found.rings, strict=True)], colour=SOFT, width=1.4, dash="6 4"
    )
    if found.resolution_um:
        x = math.log10(found.resolution_um)
        axes.line([(x, low - 0.05), (x, 1.04)], colour=SOFT, width=1.2, dash="2 3")
    points = [(x, ring.correlation) for x, ring in zip(at, found.rings, strict=True)]
    axes.line(points, colour=ACCENT, width=2.0)
    axes.dots(points, colour=ACCENT, size=4)
    powers(canvas, axes, "wavelength / µm", "correlation of both measurements")
    return canvas.picture(
        title=f"Down to which wavelength {layers[0]} and {layers[1]} show the same {name}",
        caption=(
            "Correlation of both measurements in rings of wavelength (Fourier ring correlation). Dashed: where the "
            "mean of both holds half a bit of information a wave (van Heel and Schatz 2005); dotted: where the curve "
            "first falls below it. Errors that both share count as what they show, and an error of the registration "
            f"counts as disagreement. Mask: measured in both, without {left_out(regions)}."
        ),
        data={
            "rings": {
                "wavelength / µm": [ring.wavelength_um for ring in found.rings],
                "correlation": [ring.correlation for ring in found.rings],
                "half bit": [ring.threshold for ring in found.rings],
                "independent waves": [ring.modes for ring in found.rings],
            }
        },
    )  # fmt: skip


def of_each(found: EvidenceFacts, titles: Sequence[str]) -> list[str]:
    """Say nugget, range and direction of each map, and where both agree best."""
    out = [_of_one(one, title) for one, title in zip(found.variograms, titles, strict=True)]
    if found.correlogram is not None:
        out.append(_of_both(found.correlogram))
    return out


def _of_one(one: MapVariogram, title: str) -> str:
    share = one.nugget / one.sill if one.sill > 0 else 1.0
    noise = (
        f"nugget {number(one.nugget, 2)} {_squared(one, title)}, {percent(share, 2)} of the sill"
        if share > 5e-4
        else "no nugget"
    )
    if share > 0.999:
        nugget = f"{number(one.nugget, 2)} {_squared(one, title)}"
        return f"{title}: neighbours share nothing (nugget {nugget}): noise, no texture."
    far = plain(round(one.distances_um[-1]))
    reach = f"range {_range(one.range_um, far)}"
    if not is_known(one.md_deg):
        turned = "no direction, as the machine direction is not given (--md-deg, --image-md-deg)"
    else:
        ratio = f" ({number(one.ratio, 2)} times as far)" if is_known(one.ratio) else ""
        turned = (
            f"{_range(one.range_along_um, far)} along and {_range(one.range_across_um, far)} across the machine "
            f"direction{ratio}"
        )
    return f"{title}: {noise}; {reach}; {turned}."


def _range(value: float, far: str) -> str:
    return plain(round(value, 0 if value >= 10 else 1)) if is_known(value) else f"beyond {far}"


def _of_both(found: CorrelogramProfiles) -> str:
    limit = f"|r| above {fixed(found.limit_of_any, 2)} is exceeded at any lag by 1 % of unrelated maps"
    if not is_known(found.limit_of_any):
        limit = "fewer than 10 independent points: what unrelated maps reach is not known"
    elif not found.beyond_chance:
        limit += ", and no lag reaches that"
    if not found.inner:
        return f"Moved against each other, the maps have no summit of r within {plain(round(found.reach_um))}; {limit}."
    down, across = (fixed(v, 0 if abs(v) >= 10 else 1) for v in found.lag_um)
    wide = ""
    if is_known(found.widths_um):
        widths = " × ".join(fixed(v, 0) for v in found.widths_um)
        wide = f" (width at half height {widths} µm)"
    return (
        f"Moved against each other, the maps agree best at a lag of {across} µm along x and {down} µm along y, with "
        f"r = {fixed(found.peak_r, 2)}{wide}; {limit}."
    )


def of_twice(found: Twice, layers: tuple[str, str]) -> list[str]:
    """Say down to which wavelength two measurements agree, and how far they differ."""
    out = [found.sentence.replace(" um", "\u202fµm")] if found.sentence else []
    if is_known(found.bias) and is_known(found.point_um):
        units, size = unit(found.units), plain(found.point_um)
        sure = _between(found.bias_interval)
        text = (
            f"{layers[1]} minus {layers[0]}, over {count(found.n)} points of {size}: {fixed(found.bias, 2)} {units} on "
            f"average ({sure or 'no interval'})"
        )
        spread = _between(found.sd_interval, units)
        out.append(f"{text}; standard deviation of a point within {spread}." if spread else f"{text}.")
    if is_known(found.error_ratio):
        if not is_known(found.error_slope):
            out.append("No line between both: they do not vary together, or too few points are independent.")
        else:
            sure, ratio = _between(found.error_interval) or "no interval", number(found.error_ratio)
            out.append(
                f"Line between both where each has errors (Deming, variances in a ratio of {ratio}, as declared): "
                f"slope {number(found.error_slope)} ({sure})."
            )
    return out


def _between(limits: tuple[float, float], units: str = "") -> str:
    end = f" {units}" if units else ""
    return f"95 %: {fixed(limits[0], 2)} to {fixed(limits[1], 2)}{end}" if is_known(limits) else ""
