"""What a notebook shows of a run and of its results: key numbers, checks, and a small map."""

from html import escape

import numpy as np
import xarray as xr

from planish.core.numbers import number, typeset
from planish.core.parameter_words import in_python_words
from planish.report.colours import colours_of, image_uri
from planish.report.draw import axes_of, pitch
from planish.report.maps import Groups, RunMaps
from planish.report.summary import Titles, check_summary, summarise
from planish.report.text import label_of
from planish.results import Results

# CSS pixels of a small map, at most
_WIDE = 300.0
_HIGH = 260.0
_FAINT = "opacity:0.7;font-size:90%"


def results_html(results: Results, titles: Titles | None = None) -> str:
    """Return the key numbers and checks of a run as HTML.

    Parameters
    ----------
    results : Results
    titles : mapping of (layer, map) to str, optional
        Titles of the maps; their names are used without.
    """
    sentence, tiles = summarise(results, titles or {})
    rows = "".join(
        f'<tr><th style="text-align:left">{escape(t.label)}</th><td'
        f' style="text-align:left"><b>{escape(t.value)}</b> {escape(t.unit)}</td><td'
        f' style="text-align:left;{_FAINT}">{escape(t.note)}</td></tr>'
        for t in tiles
    )
    check_items = "".join(
        f"<li><b>{check.state}</b> {escape(check.name)}:"
        f" {escape(typeset(in_python_words(check.text)))}</li>"
        for check in results.checks_in("fail", "look", "unknown")
    )
    list_of_checks = ""
    if check_items:
        list_of_checks = f"<ul>{check_items}</ul>"
    return (
        f'<div style="max-width:72ch"><p>{escape(sentence)}</p><table>{rows}</table>'
        f"<p>{escape(check_summary(results))}</p>{list_of_checks}</div>"
    )


def run_html(results: Results, groups: Groups) -> str:
    """Return a run as HTML: its key numbers, and small maps of what stands for each layer.

    Parameters
    ----------
    results : Results
    groups : mapping of name to Dataset
        RunMaps of the run, as :func:`planish.report.write_report` takes them.
    """
    run_maps = RunMaps(results, groups)
    map_parts: list[str] = []
    for layer in results.layers:
        maps = run_maps.part(layer, "maps")
        title = ""
        if results.is_link:
            maps = run_maps.drawn.get(layer.name)
            title = layer.name
        if maps is not None and layer.headline in maps:
            map_parts.append(map_html(maps[layer.headline], title=title))
    names = " · ".join(layer.source.name for layer in results.layers)
    maps_row = ""
    if map_parts:
        maps_row = f'<div style="display:flex;flex-wrap:wrap;gap:12px">{"".join(map_parts)}</div>'
    return (
        "<div><b>planish</b>"
        f" {escape(names)}{results_html(results, run_maps.titles)}{maps_row}</div>"
    )


def map_html(data: xr.DataArray, *, title: str = "") -> str:
    """Return a small map with its title and colour limits as HTML.

    Parameters
    ----------
    data : DataArray, dims (rows, cols)
        With coordinates in um.
    title : str
        Written before the title of the map.
    """
    rows, cols = axes_of(data)
    values = data.values.astype(np.float64)
    # One and a half pixels of the image in a CSS pixel.
    stride = max(1, int(cols.size / (1.5 * _WIDE)), int(rows.size / (1.5 * _HIGH)))
    scale = colours_of(data, values[np.isfinite(values)])
    width_um = cols.size * pitch(cols)
    height_um = rows.size * pitch(rows)
    px_per_um = min(_WIDE / width_um, _HIGH / height_um)
    title_text = label_of(data)
    if title:
        title_text = f"{title}: {title_text}"
    image = f'src="{image_uri(values[::stride, ::stride], scale)}" alt="{escape(title_text)}"'
    size = f'width="{round(px_per_um * width_um)}" height="{round(px_per_um * height_um)}"'
    field = f"{width_um / 1000:.3g} × {height_um / 1000:.3g} mm"
    caption = f"{title_text}, colours from {number(scale.low)} to {number(scale.high)}; {field}"
    return (
        f'<figure style="margin:0"><img {image} {size}><figcaption'
        f' style="{_FAINT}">{escape(caption)}</figcaption></figure>'
    )
