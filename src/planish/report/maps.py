"""Maps of a run by layer.

With their distributions, two side by side, and thin regions outlined on the image.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr
from scipy import ndimage

from planish.core.memory import SAMPLE_PIXELS
from planish.core.numbers import count, in_words, length, number, percent, plain
from planish.core.typing import Bools
from planish.report.colours import Array, Scale, colours_of, limits, partner_of
from planish.report.draw import (
    ACCENT,
    BELOW,
    BESIDE,
    FULL,
    HALF,
    MARGIN,
    THIRD,
    Box,
    Canvas,
    Picture,
    Table,
    draw_map,
    n_of,
    panel_height,
    pixel_of,
    reduced,
)
from planish.report.registration import ARROW, EDGE, ground_of
from planish.report.text import (
    Basis,
    TwoTexts,
    label_of,
    left_out,
    stated_of,
    title_of,
    unit_of,
)
from planish.results import LayerFacts, PropertyFacts, Results

Groups = Mapping[str, xr.Dataset]  # maps and what else a run holds, by the names of its groups
_BESIDE = 162.0  # pixels to the right of a map for the distribution, the colour bar and its numbers
_THINNEST = 5.0  # per cent
_SMALLEST = 12  # pixels of a region that is outlined


@dataclass(frozen=True)
class RunMaps:
    """Results of a run with its maps."""

    results: Results
    # ``layers/NAME`` or ``linked``, and ``layers/NAME/PART`` or, where there is one sheet,
    # ``PART``.
    data: Groups

    def part(self, layer: LayerFacts, name: str) -> xr.Dataset | None:
        """Return what was measured of a sheet.

        That is ``surfaces``, ``flat``, ``strain``, ``maps`` or ``slices``.
        """
        sheet_data = self.data.get(f"layers/{layer.name}/{name}")
        sheets = [other.name for other in self.results.layers if other.sheet is not None]
        if sheet_data is None and sheets == [layer.name]:
            return self.data.get(name)
        return sheet_data

    @property
    def basis(self) -> Basis:
        """What the mask leaves out, and what the maps were registered by."""
        return Basis(left_out(self.results.regions), stated_of(self.results))

    @cached_property
    def linked(self) -> dict[str, xr.Dataset]:
        """Maps of each layer on the pixels of the reference, by the layer's name.

        Empty without a link.
        """
        return self._by_layer(self.data.get)

    @cached_property
    def drawn(self) -> dict[str, xr.Dataset]:
        """The same for figures, with a smaller copy of large maps where the run has one.

        The copy has at most 4 million pixels.
        """
        return self._by_layer(self._smaller)

    def _by_layer(self, read_group: Callable[[str], xr.Dataset | None]) -> dict[str, xr.Dataset]:
        """Maps of each layer, of its own group or of that which a sheet and an image share.

        ``read_group`` gives the group of a name, or None.
        """
        maps_by_layer: dict[str, xr.Dataset] = {}
        if not self.results.is_link:
            return maps_by_layer
        linked_maps = read_group("linked")
        for layer in self.results.layers:
            data = read_group(f"layers/{layer.name}")
            # The shared group holds the maps of the sheet, the image and what is valid in both.
            if data is None and linked_maps is not None:
                data = linked_maps.drop_vars("image")
                if layer.kind == "image":
                    data = linked_maps[["image", "valid"]]
            if data is not None:
                maps_by_layer[layer.name] = data
        return maps_by_layer

    def _smaller(self, name: str) -> xr.Dataset | None:
        """A group, or the finest of its smaller copies that is small enough to be drawn.

        None where there is no such group; the smallest copy where all are too large.
        """
        maps = self.data.get(name)
        k = 1  # copies are numbered from the finest on
        # More pixels than the widest figure has.
        while maps is not None and maps.sizes["y"] * maps.sizes["x"] > SAMPLE_PIXELS:
            smaller = self.data.get(f"overviews/{name}/{k}")
            if smaller is None:
                break
            maps = smaller
            k += 1
        return maps

    @cached_property
    def titles(self) -> dict[TwoTexts, str]:
        """Titles of all maps, by layer and name."""
        titles: dict[TwoTexts, str] = {}
        for layer in self.results.layers:
            for maps in (self.part(layer, "maps"), self.linked.get(layer.name)):
                if maps is not None:
                    for name, data in maps.data_vars.items():
                        titles[layer.name, str(name)] = title_of(data)
        return titles


def draw_maps(
    maps: xr.Dataset,
    facts: Mapping[str, PropertyFacts],
    *,
    headline: str,
    rim_um: float,
    lead_only: bool = False,
) -> list[Picture]:
    """Draw every property that has values, the headline first and large.

    ``rim_um`` around holes is left out.

    ``lead_only``: the first alone, for the first page. Mean and standard deviation are those of
    ``facts``, over the columns of the volume, as everywhere on the page.
    """
    present = filter(maps.__contains__, facts)
    names = [name for name in present if maps[name].notnull().any()]
    names.sort(key=lambda name: name != headline)
    widths = [FULL, *[HALF] * len(names)]
    if lead_only:
        widths = [2 * THIRD]
    pictures: list[Picture] = []
    for name, width in zip(names, widths, strict=False):
        partner = partner_of(name, names)
        picture = _draw_property(maps, name, facts[name], partner, width=width, rim_um=rim_um)
        pictures.append(picture)
    return pictures


def _draw_property(
    maps: xr.Dataset,
    name: str,
    facts: PropertyFacts,
    partner: str | None,
    *,
    width: float,
    rim_um: float,
) -> Picture:
    """Draw a map of a sheet with its colours, which it shares with a partner, and a histogram.

    ``partner``: name of the same map of the other side, or None; ``rim_um``: as for
    :func:`draw_maps`.
    """
    data = maps[name]
    map_px = width - MARGIN - _BESIDE
    values = data.values.astype(np.float64)
    shown = reduced(data, width=map_px)
    highest_px = 640.0
    if width < FULL:
        highest_px = 480.0
    size = shown.fit(map_px, highest_px)
    # Sorted, so that both sides of the sheet pool their values in one order.
    names = sorted({name, partner or name})
    pooled = [maps[key].values.ravel() for key in names]
    scale = colours_of(data, np.concatenate(pooled))
    bar_height = panel_height(size, "colours")
    canvas = Canvas(width, bar_height + BELOW + 38)
    axes = canvas.map_axes(MARGIN, 8, size, shown, scale)
    right = MARGIN + size[0]
    middle = 8 + bar_height / 2
    canvas.colour_bar(right + 12, 8, 13, bar_height, scale)
    canvas.text(right + _BESIDE - 10, middle, label_of(data), anchor="middle", upwards=True)
    histogram_box = (right + 70, 8, 62, bar_height)
    histogram = _draw_histogram(canvas, histogram_box, values, scale, facts)
    canvas.draw_scale_row(axes, 2, "u, v")
    mean_text = ""
    if facts.mean is not None and facts.sd is not None:
        mean = facts.mean
        if abs(mean) < 1e-6 * facts.sd:  # the mean of heights that were levelled
            mean = 0.0
        unit_text = f" {unit_of(data)}".rstrip()
        mean_text = (
            f"{number(mean)} ± {number(facts.sd)}{unit_text} (mean ± standard deviation of n ="
            f" {count(facts.n)} columns). "
        )
    partner_text = ""
    if partner is not None:
        partner_text = f" of this map and {in_words(title_of(maps[partner]))} together"
    caption = (
        f"{mean_text}Drawn: n = {n_of(data)} map pixels of"
        f" {pixel_of(data['v'].values)}; mask: columns with both faces found, without"
        f" holes and a rim of {plain(rim_um)} around them (grey). Colours span the 1st to the"
        f" 99th percentile{partner_text}."
    )
    return canvas.picture(title_of(data), caption, {"histogram": histogram})


def draw_side_by_side(
    maps: tuple[xr.DataArray, xr.DataArray],
    layers: TwoTexts,
    *,
    same_scale: bool,
    basis: Basis,
) -> Picture:
    """Draw two maps (y, x) side by side, NaN where not valid.

    ``same_scale``: on one scale of colours, as for two maps of the same quantity.
    """
    # Both have the size of the first one, on whose grid the second lies as well.
    map_px = HALF - MARGIN - BESIDE
    shown_maps = [reduced(data, width=map_px) for data in maps]
    map_size = shown_maps[0].fit(map_px, 480.0)
    canvas = Canvas(FULL, panel_height(map_size, "colours") + BELOW + 64)
    for k, (data, shown, layer) in enumerate(zip(maps, shown_maps, layers, strict=True)):
        left_px = k * (FULL - HALF)
        canvas.text(left_px + MARGIN, 18, layer, bold=True, size=13)
        scaled_maps = maps if same_scale else [data]
        limit_values = np.concatenate([m.values.ravel() for m in scaled_maps])
        scale = colours_of(data, limit_values)
        canvas.panel(left_px, 24, shown, map_size, scale=scale, label=label_of(data))
    titles = [in_words(title_of(m)) for m in maps]
    units = [unit_of(m) or "none" for m in maps]
    scale_text = "Each has its own"
    if same_scale:
        scale_text = "Both have the same"
    caption = (
        f"Left, {titles[0]} of {layers[0]}; right, {titles[1]} of {layers[1]}, at the same"
        " places."
        f" {scale_text} colour scale, from the 1st to the 99th percentile. n ="
        f" {' and '.join(map(n_of, maps))} pixels of {pixel_of(maps[0]['x'].values)};"
        f" units: {' and '.join(units)}; mask: measured, without {basis.excluded}."
    )
    return canvas.picture(f"{layers[0]} on the pixels of {layers[1]}", caption)


def _draw_histogram(
    canvas: Canvas, box: Box, values: Array, scale: Scale, facts: PropertyFacts
) -> Table:
    """Draw a distribution upwards along a colour bar, with mean and standard deviation.

    Gives what is drawn as a table: edges of each bin, and the map pixels in it.
    """
    limits = (scale.low, scale.high)
    counts, edges = np.histogram(values, bins=80, range=limits)
    max_count = max(int(counts.max()), 1)
    axes = canvas.axes(*box, (0, 1.25 * max_count, *limits))
    # The outline goes over both edges of each bin, from 0 and back to it.
    heights = np.repeat([0, *counts, 0], 2)[1:-1]
    outline = np.column_stack([heights, np.repeat(edges, 2)])
    axes.area(outline, colour="#b9c0c7")
    axes.upright(0, width=1.6)
    if facts.mean is not None and facts.sd is not None:
        x = 1.14 * max_count
        spread = facts.sd * np.array([-1, 0, 1])
        low, mean, high = np.clip(facts.mean + spread, *limits)
        axes.line(x, (low, high), colour=ACCENT, width=1.6)
        axes.dots(x, mean, colour=ACCENT, size=5)
    bin_edges = edges.tolist()
    return {"from": bin_edges[:-1], "to": bin_edges[1:], "map pixels": counts.tolist()}


def draw_outlines(linked: xr.Dataset, *, name: str, thin_um: float, basis: Basis) -> list[Picture]:
    """Draw property and image, and the image with thin regions outlined.

    That is figure 6 of Hirn et al. (2009). ``linked`` (y, x) holds the map ``name`` in um,
    ``image`` and ``valid``, the pixels that count; ``thin_um``: limit of a thin region.
    """
    data = linked[name]
    image = linked["image"]
    valid = linked["valid"].values.astype(bool)
    ground = ground_of(image, layer="image", valid=valid)
    values = np.where(valid, data.values.astype(np.float64), np.nan)
    valid_map = data.copy(data=values)
    title = title_of(data)
    pixel_text = pixel_of(data["x"].values)
    n_text = f"n = {n_of(values)} pixels of {pixel_text}; mask: measured, without {basis.excluded}."
    map_canvas, _ = draw_map(valid_map, scale=limits(values), label=label_of(data))
    image_canvas, _ = draw_map(image, scale=ground.scale, label="")
    canvas, axes = ground.draw(FULL)
    n_known = max(np.isfinite(values).sum(), 1)
    thin_share = np.count_nonzero(values < thin_um) / n_known
    below = f"{in_words(title)} below"
    limit_um = thin_um
    note_text = f"Outlined: {below} {plain(thin_um)}, {percent(thin_share)} of the valid pixels."
    if thin_share < 1e-3:  # the outlines would show next to nothing
        if np.isfinite(values).any():
            limit_um = float(np.nanpercentile(values, _THINNEST))
        too_few_text = f"Only {percent(thin_share)} of the valid pixels are"
        if thin_share == 0:
            too_few_text = "No valid pixel is"
        note_text = (
            f"{too_few_text} below {plain(thin_um)}; too few to outline. Outlined instead: the"
            f" thinnest {_THINNEST:g} %, {below} {length(limit_um)}."
        )
        if thin_share > 0:
            axes.outline(valid_map < thin_um, colour=EDGE, width=1.6)
            note_text = f"{note_text} In blue, what is below {plain(thin_um)}."
    # Pixels that touch at a corner are of one region; label 0 is what is in none.
    labels, _ = ndimage.label(values < limit_um, structure=np.ones((3, 3)))
    region_pixels = np.bincount(labels.ravel())
    is_outlined = (labels > 0) & (region_pixels[labels] >= _SMALLEST)
    axes.outline(data.copy(data=is_outlined), colour=ARROW, width=1.7)
    darkness = _darkness_sentence(image.values.astype(np.float64), is_outlined, valid)
    note_text = f"{note_text} Regions under {_SMALLEST} pixels are not drawn. {darkness}"
    image_text = (
        f"{title_of(image)} between limits set by the valid pixels; n = {n_of(image)} pixels of"
        f" {pixel_text}, no mask."
    )
    map_title = f"(a) {title}, on the image's pixels"
    return [
        map_canvas.picture(map_title, f"Unit {unit_of(data)}. {n_text}"),
        image_canvas.picture("(b) The image, same region", image_text),
        canvas.picture("(c) Thin regions on the image", f"{note_text}{n_text}"),
    ]


def draw_light(light: xr.Dataset, layer: str) -> Picture:
    """Draw what an image was divided by, of pixels that count."""
    factor = light["factor"].where(light["status"] == 0)
    canvas, _ = draw_map(factor, scale=limits(factor), label="")
    caption = (
        "White image less the dark one, over its median: what the image was divided by."
        f" n = {n_of(factor)} pixels of {pixel_of(light['x'].values)}; mask: neither saturated"
        " nor too dark."
    )
    return canvas.picture(f"Light on {layer}", caption)


def _darkness_sentence(image: Array, is_outlined: Bools, valid: Bools) -> str:
    """How the image differs within outlines; all (y, x). Empty where that cannot be said."""
    inside_greys = image[is_outlined & valid]
    outside_greys = image[valid & ~is_outlined]
    if not inside_greys.size or not outside_greys.size or not np.ptp(image[valid]):
        return ""
    difference = float(inside_greys.mean() - outside_greys.mean())
    shift = difference / float(np.std(image[valid]))
    comparative = "darker" if shift < 0 else "lighter"
    return (
        f"Inside, the image is on average {abs(shift):.2f} standard deviations {comparative} than"
        " elsewhere. "
    )
