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
    """Judge whether the grey scale ends where the sheet's densest layer lies.

    Greys that were cut off pile up in a spike at that end. The end of the scale is harmless where
    it lies farther from the air than the layer does, by more than the layer's own scatter.
    """
    greys = scan.greys
    spike, spike_share, end_grey = clipping(scan.sample, greys)
    layer, layer_grey = densest_layer(greys)
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
        figures=(PROPERTIES,) if layer == "base" else rule.figures,
        advice="Export the volume with a wider grey window, or as 16 bit.",
    )


def densest_layer(greys: Greys) -> tuple[str, float]:
    """Name and grey of the coating, of two the one farther from the base; of the base without."""
    levels = [greys.coating(side) for side in SIDES if greys.coated(side)]
    if not levels:
        return "base", greys.base
    return "coating", max(levels, key=lambda level: abs(level - greys.base))


def clipping(sample: Array, greys: Greys) -> tuple[float, float, float]:
    """Find a spike at the sheet's end of the grey scale: where it is lightest, or darkest.

    ``sample`` holds greys of any shape, NaN where there is none. Gives the number of voxels at the
    end over what the histogram beside it leads to there (with its chance, so that right scans stay
    below `SPIKE`), their share of all, and their grey; NaN for that without any grey.
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
    from_end = greys.polarity * (end_grey - levels.astype(np.float64))  # 0 at the end, else above
    if is_integer:  # a bin holds as many steps of the scale as any other
        near_end = from_end[from_end <= 0.25 * contrast]
        step = 1.0
        if near_end.size > 1:
            step = float(np.abs(np.diff(near_end)).min())
        width = max(np.ceil(width / step - 1e-9), 1.0) * step
    # A little keeps rounding out of the places of the bins.
    rounding = 1e-9 if is_integer else 1e-6
    bins = np.floor(from_end / width + rounding)
    is_near_end = bins <= _LAST_BIN
    near_bins = bins[is_near_end].astype(np.int64)
    histogram = np.bincount(near_bins, counts[is_near_end], _LAST_BIN + 1)
    # Of real numbers, what was cut off lies at one value exactly; the rest of its bin is as wide as
    # the others.
    end_count = float(histogram[0] if is_integer else np.count_nonzero(from_end == 0))
    # A straight line through the logarithms of the other bins, carried on to the first; half a
    # voxel more gives an empty bin a logarithm.
    other_counts = histogram[1:] + 0.5
    bin_numbers = np.arange(1.0, histogram.size)
    weights = np.sqrt(other_counts)
    _, log_expected = np.polyfit(bin_numbers, np.log(other_counts), 1, w=weights)
    expected = float(np.exp(log_expected))
    largest_by_chance = expected + 3 * np.sqrt(expected) + 1
    end_share = end_count / int(counts.sum())
    return end_count / largest_by_chance, end_share, end_grey


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
    _, densest_grey = densest_layer(greys)
    contrast = abs(densest_grey - greys.air)
    jumps: dict[str, float] = {}  # in greys
    for scanned_axis, window in scan.windows.items():
        if scanned_axis not in (*scan.assembled_axes, scan.through):
            jumps[scanned_axis] = level_jump(window)
    axis = max(jumps, key=lambda name: jumps[name], default="z")
    jump_share = jumps.get(axis, 0.0) / contrast
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
    """Standard deviation of what the levels of single slices jump by, in greys.

    A jump of its own in each slice has second differences of sqrt(6) times its standard deviation,
    and 1.4826 medians of their size are one. Levels are three percentiles: the largest counts.
    """
    levels = np.percentile(window.blocks, (5.0, 50.0, 95.0), axis=(1, 2))
    if levels.shape[1] < 8:
        return 0.0
    second_differences = np.abs(np.diff(levels, n=2, axis=1))
    largest_median = np.median(second_differences, axis=1).max()
    return float(1.4826 / np.sqrt(6) * largest_median)


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
    sheet_axes = (frame.rows, frame.cols)
    for axis, numbers in zip(sheet_axes, scan.core.tiles, strict=True):
        tile_numbers = numbers[is_seen]
        places, strip = np.unique(tile_numbers, return_inverse=True)
        if places.size < 4:
            continue
        parabola = np.polynomial.Polynomial.fit(tile_numbers, tile_greys, 2)
        _, course = parabola.linspace(41)
        change_share = float(np.ptp(course)) / contrast
        # Chance makes no range of a fitted parabola of 9 standard errors of a mean. Tiles beside
        # each other are of one floc: the strips across the axis show how far their greys go
        # together.
        rest = tile_greys - parabola(tile_numbers)
        strip_means = np.bincount(strip, rest) / np.bincount(strip)
        strip_sd = float(np.std(strip_means))
        chance_share = 9.0 * strip_sd / contrast / np.sqrt(strip_means.size)
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
    """Tell which tiles of greys (tiles, columns, depths) have a column that was read as a whole."""
    is_whole = np.isfinite(grey).all(axis=2)
    return np.any(is_whole, axis=1)


def wall_grey(scan: GreyScan) -> float | None:
    """Grey that hardly any of the base passes; None where pores do not make much of its grey.

    It stands for a wall without pores: that of which 5 % of the base are farther from the air.
    """
    greys = scan.greys
    grey = scan.core_grey[_visible(scan.core_grey)]
    if not grey.size:
        return None
    variance = mad_sd(grey) ** 2 - greys.single_noise**2  # of walls and pores, without the noise
    spread = np.sqrt(max(variance, 0.0))
    if not spread > POROUS * abs(greys.base - greys.air):
        return None
    quantile = _WALL if greys.polarity > 0 else 1.0 - _WALL
    return float(np.nanquantile(grey, quantile))


def porosity(rule: CheckRule, scan: GreyScan) -> Check | None:
    """Judge whether the grey of a wall is known that tells voids; None without maps of them.

    The figures of the rule are the maps of voids. Where the user gave the grey (``solid_grey``),
    there is nothing to doubt; else the sentence says what the porosity would be with the wall's
    grey as the base of the scan shows it.
    """
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
    """Judge whether what was learnt as a coating can be one; None where no side has a coating.

    The value is the contrast to the base of the fainter coating over that of the other one.
    """
    greys = scan.greys
    contrasts: dict[Side, float] = {}  # above zero where the coating is denser than the base
    for side in SIDES:
        if greys.coated(side):
            contrasts[side] = greys.polarity * (greys.coating(side) - greys.base)
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
    """What speaks against coatings of these contrasts to the base, in sentences.

    ``contrast_ratio`` is the lowest of them over the highest; 1 with one coating.
    """
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
    attrs = scan.measured.attrs
    for side, contrast in contrasts.items():
        change, error = attrs.get(f"coating_deepens_{side}", (0.0, 0.0))
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

    None where filler was not measured. A grain is a run of depths in a column of the base whose
    grey lies beyond the level from which filler was counted; the median run is compared with the
    full width at half maximum of the blur.
    """
    greys = scan.greys
    core = scan.core
    if "filler" not in scan.measured or not core.is_base.any():
        return None
    level = scan.measured["filler"].attrs.get("filler_grey")
    if level is None:
        level = 0.5 * (greys.base + np.nanmean([greys.coating_top, greys.coating_bottom]))
    column_greys = scan.core_grey[core.is_base]  # (columns, depths)
    is_filler = greys.polarity * (column_greys - level) > 0
    along_column = [[0, 0, 0], [1, 1, 1], [0, 0, 0]]
    labels, _ = ndimage.label(is_filler, along_column)
    sizes = np.bincount(labels.ravel())
    # What reaches the end of a column is coating that has run in.
    sizes[labels[:, [0, -1]]] = sizes[0] = 0
    blur_um = FWHM * greys.blur_um
    grain_um = 0.0
    sentence = "No grain of filler is seen in the base."
    if sizes.any():
        k = "zyx".index(scan.through)
        points = core.points.reshape(*core.shape, 3)[core.is_base]
        length_px = np.mean(np.ptp(points[..., k], axis=1))  # from the first depth to the last
        length_um = scan.volume.attrs["voxel_um"][k] * length_px
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

    NaN without air, and where the noise is not correlated less at the largest lag than at none.
    Blocks of air with more variance than twice the least one are left out. A voxel counts as a cube
    of the same volume.
    """
    # Noise below half a step of the grey scale is that of rounding.
    least_variance = 0.0 if volume.dtype.kind == "f" else 0.5**2
    block_lags = [_mean_products(grey) for grey in _air_blocks(volume, measured)]
    block_lags = [lags for lags in block_lags if least_variance < lags[0] < np.inf]
    # Blocks that hold more than air, such as a part of a film, vary more.
    largest_variance = 2 * min((lags[0] for lags in block_lags), default=0.0)
    of_air = [lags for lags in block_lags if lags[0] < largest_variance]
    lags = sum(of_air, np.zeros(_LAGS))
    if not lags[0] > lags[-1]:
        return float("nan")
    # What goes on farther is no noise but streaks and shading.
    correlation = (lags - lags[-1]) / (lags[0] - lags[-1])
    # Between the last lag above a half and the first below it.
    k = int(np.argmax(correlation < 0.5))
    before, after = correlation[k - 1 : k + 1]
    half_width_px = k - (0.5 - after) / (before - after)
    sides_um = [float(v) for v in volume.attrs["voxel_um"]]
    voxel_um = float(np.cbrt(np.prod(sides_um)))
    # Its full width is twice the half; that of the Gaussian itself is by sqrt(2) narrower.
    return np.sqrt(2.0) * half_width_px * voxel_um


def _mean_products(grey: Floats) -> Floats:
    """Mean products (lags) with the neighbours at 0, 1, 2 ... voxels along the axes of the sheet.

    ``grey`` is (rows, cols, depth); both axes count alike, and the mean is taken off first.
    """
    grey = grey - grey.mean()
    lags = np.zeros(_LAGS)
    for turned in (grey, grey.swapaxes(0, 1)):
        for k in range(_LAGS):
            lags[k] += 0.5 * np.mean(turned[k:] * turned[: len(turned) - k])
    return lags


def _air_blocks(volume: xr.DataArray, measured: xr.Dataset) -> Iterator[Floats]:
    """Yield the grey (rows, cols, depth) of blocks above and below the sheet.

    There are four blocks along either axis of it. A block keeps `_GAP` voxels off the highest and
    the lowest face within its rows and columns; none where a face lies too near to the end of the
    volume, or the whole of it is smaller than a block.
    """
    frame = Frame.of(measured)
    axes = (frame.rows, frame.cols, frame.through)
    rows_um, cols_um, heights = (volume.coords[axis].values.astype(np.float64) for axis in axes)
    faces = np.stack([measured[side].values for side in SIDES]).astype(np.float64)
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
                box = dict(zip(axes, (row, col, depth), strict=True))
                block = volume.isel(box).transpose(*axes)
                yield np.array(block.values, dtype=np.float64)


def _spread_slices(size: int) -> list[slice]:
    """Four places for a block along an axis, away from its ends."""
    starts = np.linspace(0, size - _EDGE, 6)[1:-1].astype(int)
    return [slice(start, start + _EDGE) for start in np.unique(starts).tolist()]


def _within(places_um: Floats, block_um: Floats) -> Bools:
    """Tell which places lie between the first and the last place of a block."""
    return (places_um >= block_um[0]) & (places_um <= block_um[-1])


# --- of an image ----------------------------------------------------------------------------------


def clipped_image(rule: CheckRule, image: SheetImage) -> Check:
    """Judge whether the greys of an image are cut off.

    They are where one end of its scale holds several times as many pixels as the next 64th of the
    scale does.
    """
    grey = image.greys.astype(np.float64)
    grey = grey[np.isfinite(grey)]
    clipped_share = 0.0
    tone = "dark"
    if grey.size and np.unique(grey).size >= 8:  # fewer levels are an image of areas
        lowest = float(grey.min())
        highest = float(grey.max())
        near_width = 1 / 64 * (highest - lowest)  # counted as next to an end
        for end_tone, end_grey in (("dark", lowest), ("bright", highest)):
            from_end = np.abs(grey - end_grey)
            end_share = float(np.mean(from_end == 0))
            near_share = float(np.mean((from_end > 0) & (from_end < near_width)))
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
