"""Checks of grey levels: cut off, another scale in every slice, shaded, blurred.

And those of an image.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr
from scipy import ndimage

from planish.checks.scan import GreyScan
from planish.checks.windows import Window
from planish.core.checks import PROPERTIES, Check, CheckRule
from planish.core.facts import SIDES, Side
from planish.core.frame import Frame
from planish.core.robust import mad_sd
from planish.core.typing import Array, Bools, Floats, Ints
from planish.measure.greys import FWHM, Greys
from planish.surface.learn import POROUS

# Height of the spike over what the histogram leads to; least share of the voxels.
SPIKE, SHARE = 3.0, 2e-4
_LAST_BIN = 6  # of those that the histogram is continued from
SHADED = 0.15  # of base - air: change of the base's grey across the sheet
_WALL = 0.95  # of the greys of a base with pores lie below that of a wall
_JUMP = 0.1  # of the contrast: moves a face by an eighth of the blur's standard deviation
# Least contrast of a coating to the base: of the base's to the air, of the other side's.
_COATING, _ALIKE = 0.25, 0.75
_DEEPENS = 0.1  # of its contrast: a grey so far off makes a coating a tenth too thick
# Widths of the blur: balls of such chords keep 0.8 of their volume above half of their contrast.
_RESOLVED = 2.0
_EDGE, _DEPTH = 32, 8  # voxels along the edge of a block of air; along the axis through the sheet
_GAP = 6  # voxels between the sheet and a block
_LAGS = 12  # voxels


@dataclass(frozen=True, slots=True)
class SheetImage:
    """A sample of the greys of an image of the sheet, away from holes.

    It may have any shape and numeric type; NaN is left out.
    """

    greys: Array


# --- of a scan ------------------------------------------------------------------------------------


def clipped_grey(rule: CheckRule, scan: GreyScan) -> Check:
    """Judge whether the grey scale ends where the sheet's densest layer lies."""
    greys = scan.greys
    spike, spike_share, end_grey = clipping(scan.sample, greys)
    coating_grey = denser_coating(greys)
    layer, layer_grey = ("base", greys.base) if coating_grey is None else ("coating", coating_grey)
    # So near to the layer's own level, a limit moves it.
    margin = greys.noise + 0.02 * abs(layer_grey - greys.air)
    is_inside = greys.polarity * (end_grey - layer_grey) < margin
    crowd_text = (
        f"{100 * spike_share:.2g} % of the voxels around the sheet have the grey {end_grey:.5g}"
    )
    make_check = functools.partial(rule.check, value=spike, limit=SPIKE)
    if not (spike > SPIKE and spike_share > SHARE):
        sentence = (
            "The grey scale does not end at the sheet: no grey value piles up at the end where the"
            " sheet lies."
        )
        return make_check("pass", sentence, figures=())
    if not is_inside and spike_share < 0.02:
        sentence = (
            f"{crowd_text}, where the scale was cut off; the {layer} lies well inside"
            f" ({layer_grey:.4g})."
        )
        return make_check("pass", sentence, figures=())
    return make_check(
        "look",
        f"{crowd_text}, where the scale was cut off, and the {layer} lies at {layer_grey:.4g}: its"
        " contrast is too low, and its face is displaced.",
        figures=(PROPERTIES,) if coating_grey is None else rule.figures,
        advice="Export the volume with a wider grey window, or as 16 bit.",
    )


def denser_coating(greys: Greys) -> float | None:
    """Level of the coating, of two the one farther from the base; None where there is none."""
    levels = [greys.coating(side) for side in SIDES if greys.coated(side)]
    return max(levels, key=lambda level: abs(level - greys.base), default=None)


def clipping(sample: Array, greys: Greys) -> tuple[float, float, float]:
    """Find a spike at the sheet's end of the grey scale.

    Gives its height over what bins beside it suggest, its share and its grey.
    """
    # Whole numbers are counted once: a large part of a volume is looked at.
    is_integer = sample.dtype.kind != "f"
    if is_integer:
        levels, counts = _levels(sample)
    else:
        levels = sample[np.isfinite(sample)]
        counts = np.broadcast_to(1, levels.shape)
    if levels.size == 0:
        return 0.0, 0.0, float("nan")
    end_grey = float(levels.max() if greys.polarity > 0 else levels.min())
    contrast = abs(end_grey - greys.air)
    width = contrast / 256
    if is_integer:  # a bin holds as many steps of the scale as any other
        near_levels = levels[np.abs(levels.astype(np.float64) - end_grey) <= 0.25 * contrast]
        step = float(np.diff(near_levels.astype(np.float64)).min()) if near_levels.size > 1 else 1.0
        width = max(np.ceil(width / step - 1e-9), 1.0) * step
    # Away from the end; half a step keeps rounding out of the places of the bins.
    rounding = 1e-9 if is_integer else 1e-6
    bins = np.floor(greys.polarity * (end_grey - levels.astype(np.float64)) / width + rounding)
    is_near_end = bins <= _LAST_BIN
    near_bins = bins[is_near_end].astype(np.int64)
    histogram = np.bincount(near_bins, counts[is_near_end], _LAST_BIN + 1)
    # Of real numbers, what was cut off lies at one value exactly; the rest of its bin is as wide as
    # the others.
    end_count = float(histogram[0] if is_integer else np.count_nonzero(levels == end_grey))
    other_counts = histogram[1:] + 0.5
    bin_numbers = np.arange(1.0, histogram.size)
    line = np.polyfit(bin_numbers, np.log(other_counts), 1, w=np.sqrt(other_counts))
    expected = float(np.exp(line[1]))
    spike = end_count / (expected + 3 * np.sqrt(expected) + 1)
    return spike, end_count / int(counts.sum()), end_grey


def _levels(sample: Array) -> tuple[Array, Ints]:
    """Greys of whole numbers that occur, in their order, and how often."""
    if sample.dtype.kind != "u" or sample.dtype.itemsize > 2:
        return np.unique(sample, return_counts=True)
    counts = np.bincount(sample.ravel())
    levels = np.flatnonzero(counts)
    return levels.astype(sample.dtype), counts[levels]


def steady_grey(rule: CheckRule, scan: GreyScan) -> Check:
    """Judge whether all slices have one grey scale; through the sheet, the sheet itself changes."""
    greys = scan.greys
    coating_grey = denser_coating(greys)
    contrast = abs((greys.base if coating_grey is None else coating_grey) - greys.air)
    other_axes = (*scan.assembled_axes, scan.through)
    jumps = {
        axis: level_jump(w) / contrast for axis, w in scan.windows.items() if axis not in other_axes
    }
    axis, jump_share = max(jumps.items(), key=lambda jump: jump[1], default=("z", 0.0))
    return rule.at_most(
        jump_share,
        look=_JUMP,
        sentence=(
            f"From slice to slice along {axis}, grey levels jump by {100 * jump_share:.1f} % of the"
            " contrast between air and sheet."
        ),
        advice="Slices were probably scaled one by one. Export all of them with one grey window.",
    )


def level_jump(window: Window) -> float:
    """Standard deviation of what the levels of single slices jump by, in greys."""
    levels = np.percentile(window.blocks, (5.0, 50.0, 95.0), axis=(1, 2))
    if levels.shape[1] < 8:
        return 0.0
    second_differences = np.abs(np.diff(levels, n=2, axis=1))
    return float(1.4826 / np.sqrt(6) * np.median(second_differences, axis=1).max())


def shading(rule: CheckRule, scan: GreyScan) -> Check:
    """Judge whether the base has one grey from one border of the sheet to the other.

    Along each axis of the sheet a parabola is fitted to the tiles' grey. Its change counts by the
    contrast of the base to the air; where pores make much of the base's grey, and are never as many
    everywhere, by that of the walls.
    """
    greys = scan.greys
    contrast = abs(greys.base - greys.air)
    name = "its contrast"
    wall = wall_grey(scan)
    if wall is not None:
        contrast = abs(wall - greys.air)
        name = "the contrast of a wall"
    is_seen = _visible(scan.core_grey)
    n_seen = np.count_nonzero(is_seen)
    if n_seen < 20 or not contrast > 0:
        return rule.check(
            "unknown", f"The base is seen in {n_seen} tiles only, too few to follow its grey."
        )
    tile_greys = np.nanmedian(scan.core_grey[is_seen], axis=(1, 2))
    frame = Frame.of(scan.measured)
    changes: dict[str, tuple[float, float]] = {}  # along an axis, and how large it may be
    for axis, numbers in zip((frame.rows, frame.cols), scan.core.tiles, strict=True):
        places, strip = np.unique(numbers[is_seen], return_inverse=True)
        if places.size < 4:
            continue
        fit = np.polynomial.Polynomial.fit(numbers[is_seen], tile_greys, 2)
        change_share = float(np.ptp(fit(fit.linspace(41)[0]))) / contrast
        # Chance makes no range of a fitted parabola of 9 standard errors of a mean. Tiles beside
        # each other are of one floc: the strips across the axis show how far their greys go
        # together.
        strip_means = np.bincount(strip, tile_greys - fit(numbers[is_seen])) / np.bincount(strip)
        chance_share = 9.0 * float(np.std(strip_means)) / contrast / np.sqrt(strip_means.size)
        changes[axis] = change_share, max(SHADED, chance_share)
    shaded_axis = max(changes, key=lambda axis: np.subtract(*changes[axis]), default="")
    grey_change, share_limit = changes.get(shaded_axis, (0.0, SHADED))
    return rule.at_most(
        grey_change,
        look=share_limit,
        units="share",
        sentence=(
            f"Along {shaded_axis}, the grey of the base changes by {100 * grey_change:.2g} % of"
            f" {name} to the air."
        ),
        advice=(
            "The beam or the light faded, or the scan is shaded. Correct it by a flat field, or"
            " scan again."
        ),
    )


def _visible(grey: Array) -> Bools:
    return np.any(np.isfinite(grey).all(axis=2), axis=1)


def wall_grey(scan: GreyScan) -> float | None:
    """Grey that hardly any of the base passes; None where pores do not make much of its grey."""
    greys = scan.greys
    grey = scan.core_grey[_visible(scan.core_grey)]
    if not grey.size:
        return None
    spread = np.sqrt(max(mad_sd(grey) ** 2 - greys.single_noise**2, 0.0))
    if not spread > POROUS * abs(greys.base - greys.air):
        return None
    return float(np.nanquantile(grey, _WALL if greys.polarity > 0 else 1.0 - _WALL))


def porosity(rule: CheckRule, scan: GreyScan) -> Check | None:
    """Judge whether the grey of a wall is known that tells voids; None without maps of them."""
    greys, measured = scan.greys, scan.measured
    names = tuple(name for name in rule.figures if name in measured)
    if not names:
        return None
    attrs = measured[names[0]].attrs
    if "solid_grey" in attrs:
        return rule.check("pass", f"The grey of a wall without voids is {attrs['solid_grey']:g}.")
    level = attrs.get("void_grey", 0.5 * (greys.air + greys.base))
    air_side = "below" if greys.polarity > 0 else "above"
    sentence = (
        f"Voids are what lies {air_side} the grey {level:.4g}: the grey of a wall without voids is"
        " not known, and pores that the voxels do not resolve count as wall."
    )
    wall = wall_grey(scan)
    if wall is not None:
        share = (wall - np.nanmean(scan.core_grey)) / (wall - greys.air)
        sentence += (
            f" With the grey that 95 % of the base stay {air_side}, {wall:.4g}, as that of a wall"
            f" the porosity is about {share:.2f}."
        )
    return rule.check(
        "look",
        sentence,
        advice="Read the grey in a thick fibre, or in a scan of cellulose by the same settings.",
        remedy="Give it with `solid_grey`.",
        figures=names,
    )


def coating_grey(rule: CheckRule, scan: GreyScan) -> Check | None:
    """Judge whether what was learnt as a coating can be one; None where no side has a coating."""
    greys = scan.greys
    contrasts: dict[Side, float] = {
        side: greys.polarity * (greys.coating(side) - greys.base)
        for side in SIDES
        if greys.coated(side)
    }
    if not contrasts:
        return None
    contrast_ratio = min(contrasts.values()) / max(contrasts.values())
    levels_text = " and ".join(f"{greys.coating(side):.4g} ({side})" for side in contrasts)
    faults = _coating_faults(scan, contrasts, contrast_ratio)
    sentence = f"Grey of the coating: {levels_text}; of the base: {greys.base:.4g}."
    check = functools.partial(rule.check, value=contrast_ratio, limit=_ALIKE, units="share")
    if not faults:
        return check("pass", sentence)
    return check(
        "look",
        " ".join([sentence, *faults]),
        advice=(
            "Film, tape or fringes may have been taken for a coating. Look at the slices; crop the"
            " volume to the sheet."
        ),
        remedy="Or give `coating_grey`.",
    )


def _coating_faults(
    scan: GreyScan, contrasts: dict[Side, float], contrast_ratio: float
) -> list[str]:
    """What speaks against coatings of these contrasts to the base."""
    greys = scan.greys
    sample = scan.sample[np.isfinite(scan.sample)]
    end_grey = float(sample.max() if greys.polarity > 0 else sample.min())
    sentences = [
        f"The grey of the {side} coating lies beyond all greys of the volume, which end at"
        f" {end_grey:.4g}."
        for side in contrasts
        if greys.polarity * (greys.coating(side) - end_grey) > 0
    ]
    sentences += [
        f"On the {side} side no layer shows that is denser than the base."
        for side, contrast in contrasts.items()
        if contrast < _COATING * abs(greys.base - greys.air)
    ]
    if contrast_ratio < _ALIKE:
        sentences.append(
            f"One coating has {100 * contrast_ratio:.0f} % of the other's contrast to the base."
        )
    for side, contrast in contrasts.items():
        change, error = scan.measured.attrs.get(f"coating_deepens_{side}", (0.0, 0.0))
        if abs(change) > max(_DEEPENS * contrast, 3.0 * error):
            kind = "denser" if change > 0 else "less dense"
            sentences.append(
                f"The half of the {side} coating next to the base is {kind} than its outer half"
                f" by {abs(change):.3g}: a pre-coat of another grey, or a grey that changes with"
                " depth."
            )
    return sentences


def filler(rule: CheckRule, scan: GreyScan) -> Check | None:
    """Judge whether grains of filler are larger than the blur.

    None where filler was not measured.
    """
    greys = scan.greys
    core = scan.core
    if "filler" not in scan.measured or not core.is_base.any():
        return None
    level = scan.measured["filler"].attrs.get("filler_grey")
    if level is None:
        level = 0.5 * (greys.base + np.nanmean([greys.coating_top, greys.coating_bottom]))
    columns = (greys.polarity * (scan.core_grey - level) > 0)[core.is_base]
    along_column = [[0, 0, 0], [1, 1, 1], [0, 0, 0]]
    labels, _ = ndimage.label(columns, along_column)
    sizes = np.bincount(labels.ravel())
    # What reaches the end of a column is coating that has run in.
    sizes[labels[:, [0, -1]]] = sizes[0] = 0
    blur_um = FWHM * greys.blur_um
    grain_um = 0.0
    sentence = "No grain of filler is seen in the base."
    if sizes.any():
        k = "zyx".index(scan.through)
        depths = core.points.reshape(*core.shape, 3)[core.is_base][..., k]
        length_um = scan.volume.attrs["voxel_um"][k] * np.mean(np.ptp(depths, axis=1))
        step_um = float(length_um / (core.shape[2] - 1))
        grain_um = step_um * float(np.median(sizes[sizes > 0]))
        sentence = (
            f"Bright grains in the base measure {grain_um:.2g} um through the sheet; the blur is"
            f" {blur_um:.3g} um wide."
        )
    return rule.at_least(
        grain_um,
        look=_RESOLVED * blur_um,
        units="um",
        sentence=sentence,
        advice=(
            "Grains below a voxel or below the blur are lost, and with them most of the filler."
            " Scan with smaller voxels, or weigh the ash."
        ),
    )


def blur(rule: CheckRule, scan: GreyScan) -> Check | None:
    """Judge whether a coating is thicker than the blur of the scan is wide.

    None where none is seen, and unknown where no edge shows the blur.

    What is flattened lies between the faces: where they are moved, so are its places. A filter that
    keeps edges, as a median, takes thin layers away all the same. The noise of the air shows it.
    """
    measured = scan.measured
    if np.isnan(measured.attrs["blur_um"]):
        fringe_text = "Fringes lie beside the faces. " if measured.attrs.get("fringe") else ""
        return rule.check(
            "unknown",
            f"{fringe_text}Walls and pores show no edge that is known to be sharp: the blur is not"
            " known, and faces lie where the grey passes half of a wall's.",
        )
    names = [f"coating_{side}" for side in SIDES if f"coating_{side}" in measured]
    coatings = [measured[name].values for name in names]
    medians_um = [float(np.nanmedian(um)) for um in coatings if np.isfinite(um).any()]
    if not medians_um:
        return None
    thinnest_um = min(medians_um)
    edge_um = FWHM * float(measured.attrs["blur_um"])
    width_um = float(np.fmax(edge_um, noise_width(scan.volume, measured)))
    share = width_um / max(thinnest_um, 1e-9)
    cause_text = "An edge is blurred" if width_um == edge_um else "The noise is smoothed"
    return rule.at_most(
        share,
        look=1.0,
        units="of the coating",
        sentence=(
            f"{cause_text} over {width_um:.3g} um, full width at half maximum; the coating is"
            f" {thinnest_um:.3g} um thick."
        ),
        advice=(
            "Thickness and grey level of a layer that is thinner than the blur cannot be"
            " distinguished. Scan with smaller voxels, and leave out filters that smooth."
        ),
    )


def noise_width(volume: xr.DataArray, measured: xr.Dataset) -> float:
    """FWHM (um) of the Gaussian that makes white noise the air's: its autocorrelation's over √2.

    NaN without air.
    """
    # Noise below half a step of the grey scale is that of rounding.
    least_variance = 0.0 if volume.dtype.kind == "f" else 0.5**2
    block_lags = [_mean_products(grey) for grey in _air_blocks(volume, measured)]
    block_lags = [lags for lags in block_lags if least_variance < lags[0] < np.inf]
    # Blocks that hold more than air, such as a part of a film, vary more.
    largest_variance = 2 * min((lags[0] for lags in block_lags), default=0.0)
    lags = sum((lags for lags in block_lags if lags[0] < largest_variance), np.zeros(_LAGS))
    if not lags[0] > lags[-1]:
        return float("nan")
    # What goes on farther is no noise but streaks and shading.
    correlation = (lags - lags[-1]) / (lags[0] - lags[-1])
    k = int(np.argmax(correlation < 0.5))
    half_width_px = k - (0.5 - correlation[k]) / (correlation[k - 1] - correlation[k])
    voxel_um = float(np.cbrt(np.prod([float(v) for v in volume.attrs["voxel_um"]])))
    return np.sqrt(2.0) * half_width_px * voxel_um


def _mean_products(grey: Floats) -> Floats:
    """Mean products with the neighbours at 0, 1, 2 ... voxels along the two axes of the sheet."""
    grey = grey - grey.mean()
    lags = np.zeros(_LAGS)
    for turned in (grey, grey.swapaxes(0, 1)):
        for k in range(_LAGS):
            lags[k] += 0.5 * np.mean(turned[k:] * turned[: len(turned) - k])
    return lags


def _air_blocks(volume: xr.DataArray, measured: xr.Dataset) -> Iterator[Floats]:
    """Yield the grey (rows, cols, depth) of blocks above and below the sheet.

    There are four blocks along either axis of it.
    """
    frame = Frame.of(measured)
    axes = (frame.rows, frame.cols, frame.through)
    rows_um, cols_um, heights = (
        np.asarray(volume.coords[axis].values, dtype=np.float64) for axis in axes
    )
    faces = np.stack([measured["top"].values, measured["bottom"].values]).astype(np.float64)
    if min(rows_um.size, cols_um.size) < _EDGE:
        return
    for row, col in product(_spread_slices(rows_um.size), _spread_slices(cols_um.size)):
        rows = _within(measured["y"].values, rows_um[row])
        cols = _within(measured["x"].values, cols_um[col])
        block_faces = faces[:, rows][:, :, cols]
        if not np.isfinite(block_faces).any():
            continue
        low = np.searchsorted(heights, np.nanmin(block_faces))
        high = np.searchsorted(heights, np.nanmax(block_faces))
        for start in (high + _GAP, low - _GAP - _DEPTH):
            if 0 <= start <= heights.size - _DEPTH:
                depth = slice(start, start + _DEPTH)
                block = volume.isel(dict(zip(axes, (row, col, depth), strict=True)))
                yield np.array(block.transpose(*axes).values, dtype=np.float64)


def _spread_slices(size: int) -> list[slice]:
    """Four places for a block along an axis, away from its ends."""
    starts = np.linspace(0, size - _EDGE, 6)[1:-1].astype(int)
    return [slice(start, start + _EDGE) for start in np.unique(starts).tolist()]


def _within(places_um: Floats, block_um: Floats) -> Bools:
    return (places_um >= block_um[0]) & (places_um <= block_um[-1])


# --- of an image ----------------------------------------------------------------------------------


def clipped_image(rule: CheckRule, image: SheetImage) -> Check:
    """Judge whether the greys of an image are cut off."""
    grey = np.asarray(image.greys, dtype=np.float64)
    grey = grey[np.isfinite(grey)]
    clipped_share = 0.0
    tone = "dark"
    if grey.size and np.unique(grey).size >= 8:  # fewer levels are an image of areas
        lowest = float(grey.min())
        highest = float(grey.max())
        near_width = 1 / 64 * (highest - lowest)  # counted as next to an end
        for end_tone, end_grey in (("dark", lowest), ("bright", highest)):
            end_share = float(np.mean(grey == end_grey))
            near_share = float(np.mean((grey != end_grey) & (np.abs(grey - end_grey) < near_width)))
            if end_share > SPIKE * near_share and end_share > clipped_share:
                clipped_share, tone = end_share, end_tone
    sentence = "The image's grey scale does not end within the sheet's greys."
    if clipped_share > 0.01:
        sentence = (
            f"{100 * clipped_share:.2g} % of the image's pixels on the sheet are as {tone} as its"
            " scale allows."
        )
    return rule.at_most(
        clipped_share,
        look=0.01,  # from which on a correlation suffers
        units="share",
        sentence=sentence,
        advice=(
            "The true grey of these pixels is lost, and r is too weak. Take the image again with"
            " another exposure, or export it with a wider grey window."
        ),
    )
