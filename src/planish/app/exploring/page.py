"""The page itself: what the reader sees first, the data as text, and a policy that lets nothing else in."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterator, Sequence
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np

from planish.app.exploring.maps import MapsOfPage, map_spec
from planish.app.exploring.packing import Packed
from planish.app.exploring.slices import Stack
from planish.core.area import area_mean
from planish.core.checks import CORRELATION, POSITION, concerned
from planish.pipeline.checks import trust_of
from planish.report import summary
from planish.report.colours import MISSING, colours_in_steps, image_uri
from planish.report.slices import LINES
from planish.report.text import template
from planish.results import Results

_PACKAGE = "planish.app.exploring"
_PARTS = ("unpack.js", "model.js", "mapview.js", "scatter.js", "sliceview.js", "start.js")
_STILL = 640  # pixels along the longer side of the picture that needs no script


class Block(NamedTuple):
    """A piece of data: its name in the page, and its text."""

    name: str
    text: str


def render(results: Results, maps: MapsOfPage, stacks: Sequence[Stack], notes: Sequence[str]) -> str:
    """Return the page as text; the same run gives the same bytes."""
    style = template(_PACKAGE, "explore.css").render()
    script = script_text()
    page = template(_PACKAGE, "explore.html.j2").render(
        results=results, layers=results.layers, titles=maps.titles, summary=summary, maps=maps.maps, lead=maps.maps[0],
        still=_still_picture(maps), notes=notes, stacks=stacks, style=style, script=script,
        policy=_policy(style, script), data=_json(_data(results, maps, stacks)), blocks=list(_blocks(maps, stacks)),
    )  # fmt: skip
    return f"{page}\n"


def script_text() -> str:
    """The script of the page: its parts one after the other, in a scope of their own."""
    folder = files(_PACKAGE) / "script"
    parts = [(folder / name).read_text(encoding="utf-8") for name in _PARTS]
    return "(() => {\n" + '"use strict";\n' + "".join(parts) + "})();\n"


def _policy(style: str, script: str) -> str:
    """A content policy: the style and the script of the page by their hashes, pictures that are data, nothing else."""
    hashes = [
        f"'sha256-{base64.b64encode(hashlib.sha256(part.encode()).digest()).decode()}'" for part in (style, script)
    ]
    return (
        f"default-src 'none'; style-src {hashes[0]}; script-src {hashes[1]}; img-src data: blob:; base-uri 'none'; "
        "form-action 'none'"
    )


def _json(data: Any) -> str:
    """JSON that cannot end the element that it stands in."""
    plain = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return plain.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _blocks(maps: MapsOfPage, stacks: Sequence[Stack]) -> Iterator[Block]:
    """All packed data, under names of the page's own."""
    for k, shown in enumerate(maps.maps):
        yield Block(f"m{k}", shown.packed.text)
    for k, group in enumerate(maps.groups):
        yield from (Block(f"g{k}{axis}", place.text) for axis, place in group.places.items())
        if group.valid is not None:
            yield Block(f"g{k}valid", group.valid.text)
    for k, stack in enumerate(stacks):
        yield from (Block(f"s{k}{name}", line.text) for name, line in stack.lines.items())
        yield Block(f"s{k}used", stack.used.text)
        yield Block(f"s{k}pictures", "".join(stack.pictures))


def _data(results: Results, maps: MapsOfPage, stacks: Sequence[Stack]) -> dict[str, Any]:
    """Give what the script needs beside the blocks."""
    grid = maps.grid
    linked = results.is_link
    return {
        "maps": [_spec(f"m{k}", shown.packed) | map_spec(shown) for k, shown in enumerate(maps.maps)],
        "groups": [
            {
                "sheet": group.sheet,
                "valid": None if group.valid is None else _spec(f"g{k}valid", group.valid),
                "places": {axis: _spec(f"g{k}{axis}", place) for axis, place in group.places.items()},
            }
            for k, group in enumerate(maps.groups)
        ],
        "grid": {
            "rows": grid.shape[0], "cols": grid.shape[1], "dy": grid.pixel_um[0], "dx": grid.pixel_um[1],
            "x0": grid.origin_um[0], "y0": grid.origin_um[1], "names": ["x", "y"] if linked else ["u", "v"],
        },
        "pairs": _pairs(results, maps),
        "halved": maps.halvings > 0,
        "several": len(results.layers) > 2 or len(stacks) > 1,
        "stacks": [
            {
                "sheet": one.sheet, "rows": one.rows, "cols": one.cols, "through": one.through, "sign": one.sign,
                "at": list(one.at_um), "top": list(one.top_um), "start": one.start_um, "size": list(one.size_um),
                "ends": np.cumsum([len(picture) for picture in one.pictures]).tolist(), "kind": one.kind,
                "pictures": f"s{k}pictures", "points": list(one.points_um),
                "lines": {name: _spec(f"s{k}{name}", line) for name, line in one.lines.items()},
                "used": _spec(f"s{k}used", one.used),
            }
            for k, one in enumerate(stacks)
        ],
        "lines": [dict(zip(("name", "title", "colour", "dash"), line, strict=True)) for line in LINES],
        "palettes": {
            name: base64.b64encode(colours_in_steps(name).tobytes()).decode("ascii")
            for name in sorted({one.scale.colours for one in maps.maps})
        },
        "missing": MISSING,
    }  # fmt: skip


def _spec(block: str, packed: Packed) -> dict[str, Any]:
    return packed.spec() | {"block": block}


def _pairs(results: Results, maps: MapsOfPage) -> list[list[Any]]:
    """Pairs of maps whose relation the checks doubt or withhold: both, the word, and the checks."""
    out: list[list[Any]] = []
    for i, a in enumerate(maps.maps):
        for j, b in enumerate(maps.maps[:i]):
            layers = (a.layer, b.layer)
            figures = (a.name, b.name, CORRELATION, *(() if a.layer == b.layer else (POSITION,)))
            trust = trust_of(results.checks, layers, figures)
            if trust != "ok":
                state = "fail" if trust == "withheld" else "look"
                names = [c.name for c in concerned(results.checks, layers, figures) if c.state == state]
                out.append([j, i, trust, names])
    return out


def _still_picture(maps: MapsOfPage) -> str:
    """The map that leads as a picture for those without a script."""
    values = maps.headline
    factor = max(1.0, max(values.shape) / _STILL)
    shown = area_mean(values, (factor, factor)) if factor > 1 else values
    return image_uri(shown, maps.maps[0].scale)
