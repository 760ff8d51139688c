"""``planish explore``: a run as one page that is opened without planish, server or network."""

import base64
import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from planish.app.exploring.maps import MapsOfPage, Packed, map_spec, maps_of
from planish.app.exploring.slices import BUDGET, Stack, stack_of
from planish.core.area import area_mean
from planish.core.checks import CORRELATION, POSITION, concerned, trust_of
from planish.core.files import write_whole
from planish.core.threads import limit_threads
from planish.core.typing import Entries, Texts
from planish.io.run_folder import refuse_existing, refuse_inside
from planish.report import summary
from planish.report.colours import MISSING, colours_in_steps, image_uri
from planish.report.slices import LINES
from planish.report.text import template
from planish.results import Results
from planish.run.compute import Compute, Progress, silent
from planish.run.run import open_run

_PACKAGE = "planish.app.exploring"
_SCRIPTS = ("unpack.js", "model.js", "mapview.js", "points.js", "sliceview.js", "start.js")
_OF_THE_APP = ("dom.js", "gestures.js", "viewbar.js", "contrast.js", "scatter.js")
_NAMES = "Contrast, Scatter, bindGestures, drawScaleBar, make, onNumbers, svgOf, viewBar"


def _text(path: str) -> str:
    return (files("planish.app") / path).read_text(encoding="utf-8")


def render(
    results: Results, maps: MapsOfPage, stacks: Sequence[Stack], notes: Sequence[str]
) -> str:
    """Return the page as text; the same run gives the same bytes.

    A browser runs the style and the script whose hashes stand in the page's policy, and no others.
    """
    style = template(_PACKAGE, "explore.css").render() + _text("static/views.css")
    # Views of the app, whose modules become one scope.
    modules = "".join(_text(f"static/{name}") for name in _OF_THE_APP)
    views = re.sub(r"^import .*\n|^export ", "", modules, flags=re.M)
    views = f"const {{ {_NAMES} }} = (() => {{\n{views}return {{ {_NAMES} }};\n}})();\n"
    scripts = "".join(_text(f"exploring/script/{name}") for name in _SCRIPTS)
    # In a scope of their own.
    script = "(() => {\n" + '"use strict";\n' + views + scripts + "})();\n"
    # What functions take and give is for readers of the sources.
    script = re.sub(r"^ */\*\*(?:(?!\*/).)*\*/\n", "", script, flags=re.MULTILINE | re.DOTALL)
    digests = [hashlib.sha256(text.encode()).digest() for text in (style, script)]
    style_hash, script_hash = (base64.b64encode(digest).decode() for digest in digests)
    policy = (
        f"default-src 'none'; style-src 'sha256-{style_hash}'; script-src 'sha256-{script_hash}';"
        " img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    page_data, blocks = _data(results, maps, stacks)
    data_json = json.dumps(page_data, allow_nan=False, separators=(",", ":"))
    for character, escape in (("<", "\\u003c"), (">", "\\u003e"), ("&", "\\u0026")):
        # It cannot end the element that it stands in.
        data_json = data_json.replace(character, escape)
    # The map that leads as a picture of 640 pixels for those without a script.
    factor = max(1.0, max(maps.headline.shape) / 640)
    headline_image = maps.headline
    if factor > 1:
        headline_image = area_mean(maps.headline, (factor, factor))
    page = template(_PACKAGE, "explore.html.j2").render(
        results=results,
        summary=summary,
        maps=maps.maps,
        titles={(m.layer, m.name): m.title for m in maps.maps},
        still=image_uri(headline_image, maps.maps[0].scale),
        notes=notes,
        stacks=stacks,
        style=style,
        script=script,
        policy=policy,
        data=data_json,
        blocks=blocks,
    )
    return f"{page}\n"


def _data(
    results: Results, maps: MapsOfPage, stacks: Sequence[Stack]
) -> tuple[Entries, list[dict[str, str]]]:
    """Give what the script needs, and the blocks of packed data, under names of the page's own."""
    blocks: list[dict[str, str]] = []

    def block(name: str, packed: Packed) -> Entries:
        """Put packed data into a block of its own, and give what unpacks it."""
        blocks.append({"name": name, "text": packed.text})
        return packed.spec() | {"block": name}

    map_specs = [block(f"m{k}", m.packed) | map_spec(m) for k, m in enumerate(maps.maps)]
    groups: list[Entries] = []
    for k, group in enumerate(maps.groups):
        coordinates = {axis: block(f"g{k}{axis}", um) for axis, um in group.coordinates.items()}
        valid = None if group.valid is None else block(f"g{k}valid", group.valid)
        groups.append({"sheet": group.sheet, "valid": valid, "places": coordinates})
    stack_specs: list[Entries] = []
    for k, stack in enumerate(stacks):
        pictures = f"s{k}pictures"
        lines = {name: block(f"s{k}{name}", line) for name, line in stack.lines.items()}
        used = block(f"s{k}used", stack.measured)
        stack_specs.append(stack.spec | {"pictures": pictures, "lines": lines, "used": used})
        blocks.append({"name": pictures, "text": "".join(stack.pictures)})
    palettes: dict[str, str] = {}
    for name in sorted({m.scale.colours for m in maps.maps}):
        palettes[name] = base64.b64encode(colours_in_steps(name).tobytes()).decode("ascii")
    line_keys = ("name", "title", "colour", "dash")
    has_several = len(results.layers) > 2 or len(stacks) > 1
    grid = maps.grid
    data = {
        "maps": map_specs,
        "groups": groups,
        "grid": {
            "rows": grid.shape[0],
            "cols": grid.shape[1],
            "dy": grid.pixel_um[0],
            "dx": grid.pixel_um[1],
            # The middle of the first pixel.
            "x0": grid.origin_um[0],
            "y0": grid.origin_um[1],
            "names": ["x", "y"] if results.is_link else ["u", "v"],
        },
        "pairs": _doubted_pairs(results, maps),
        "halved": maps.halvings > 0,
        "several": has_several,
        "stacks": stack_specs,
        "lines": [dict(zip(line_keys, line, strict=True)) for line in LINES],
        "palettes": palettes,
        "missing": MISSING,
    }
    return data, blocks


def _doubted_pairs(results: Results, maps: MapsOfPage) -> list[list[Any]]:
    """Pairs of maps whose relation the checks doubt or withhold: both, the word, and the checks."""
    pairs: list[list[Any]] = []
    for i, a in enumerate(maps.maps):
        for j, b in enumerate(maps.maps[:i]):
            layers = (a.layer, b.layer)
            figures = [a.name, b.name, CORRELATION]
            if a.layer != b.layer:
                figures.append(POSITION)
            trust = trust_of(results.checks, layers, figures)
            if trust != "ok":
                state = "fail" if trust == "withheld" else "look"
                checks = concerned(results.checks, layers, figures)
                pairs.append([j, i, trust, [c.name for c in checks if c.state == state]])
    return pairs


LARGEST = 12_000_000
"""Bytes that no page exceeds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Explored:
    """A page that was written: its size, what it holds, and what was left out of it in words."""

    path: Path
    bytes: int
    maps: int
    slices: int
    notes: Texts


def explore(
    run: str | Path, out: str | Path, *, compute: Compute | None = None, progress: Progress = silent
) -> Explored:
    """Write the maps of a run, their scatter and its slices as one HTML file.

    A cursor links them.

    Parameters
    ----------
    run : path; folder of a run
    out : path; the file to write
    compute : Compute, optional; what may be used
    progress : callable, optional; called with the name of a step and a few words

    Raises
    ------
    FileError
        If ``run`` is no run or damaged, or ``out`` exists or cannot be written.
    InputError
        If the run holds no maps.

    Notes
    -----
    The volume is read where it stands unchanged; otherwise the page has the slices that the run
    keeps, and says so. No page is larger than 12 MB: maps are averaged and slices left out where
    they would take more.
    """
    compute = compute or Compute()
    out = Path(out)
    refuse_existing(out)
    opened = open_run(run)
    refuse_inside(out, [run])
    with limit_threads(compute.threads):
        progress("maps", str(run))
        maps = maps_of(opened)
        sheets = dict.fromkeys(group.sheet for group in maps.groups if group.sheet)
        letters = BUDGET // max(len(sheets), 1)
        stacks: list[Stack] = []
        for layer in map(opened.results.layer, sheets):
            stack = stack_of(opened, layer, letters, compute, progress)
            if stack is not None:
                stacks.append(stack)
        notes = _notes(maps, stacks)
        page = render(opened.results, maps, stacks, notes).encode()
    assert len(page) <= LARGEST
    write_whole(out, page)
    return Explored(
        path=out,
        bytes=len(page),
        maps=len(maps.maps),
        slices=sum(len(stack.pictures) for stack in stacks),
        notes=notes,
    )


def _notes(maps: MapsOfPage, stacks: list[Stack]) -> Texts:
    """Say what the page holds, and what was left out of it, with ASCII units."""
    dy, dx = maps.grid.pixel_um
    pixel_text = f"{dx:.4g} um" if abs(dy - dx) < 1e-6 * dx else f"{dx:.4g} x {dy:.4g} um"
    rows, cols = maps.grid.shape
    grid_text = f"{cols} x {rows} pixels of {pixel_text}"
    n = 2**maps.halvings
    origin_text = ", as in the run"
    if n > 1:
        origin_text = f": means of {n} x {n} pixels of the run, to keep the page small"
    notes = [f"Maps: {grid_text}{origin_text}."]
    for stack in stacks:
        name = f"{stack.spec['sheet']}: " if len(stacks) > 1 else ""
        notes.append(f"{name}{stack.note[:1].upper()}{stack.note[1:]}.")
    sheets = {group.sheet for group in maps.groups if group.sheet}
    without_slices = sorted(sheets - {stack.spec["sheet"] for stack in stacks})
    if without_slices:
        notes.append(
            f"No slices of {' and '.join(without_slices)}: its surfaces are not in this run."
        )
    elif not stacks:
        notes.append("No slices: the run does not say where its pixels lie in a volume.")
    return tuple(notes)
