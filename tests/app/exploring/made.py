"""Run folders for the tests of the page of ``planish explore``, and what they read of it."""

import base64
import json
import zlib
from html.parser import HTMLParser
from typing import Any

import numpy as np

from planish.io import write_tree
from planish.results import Results
from report.pages import VOID

STUDY = '[[layers]]\nname = "volume"\n\n[layers.volume]\npath = "{name}"\n'


def put(folder, run, *, volume="sheet.tif"):
    """Write a made run: its maps, with places in the volume where it holds a sheet, its results and
    a study."""
    groups = dict(run["groups"])
    if "surfaces" in groups:
        centre, y, x = (groups["surfaces"][name].values for name in ("centre", "y", "x"))
        thickness = np.isfinite(groups["surfaces"]["thickness"].values)
        at = {
            "volume_x": np.where(thickness, x[None, :], np.nan),
            "volume_y": np.where(thickness, y[:, None], np.nan),
            "volume_z": np.where(thickness, centre, np.nan),
        }
        for name in {"linked", "maps"} & set(groups):
            dims = groups[name]["thickness"].dims
            groups[name] = groups[name].assign(
                {k: (dims, v, {"units": "um"}) for k, v in at.items()}
            )
    folder.mkdir(parents=True)
    (folder / "run.toml").write_text(STUDY.format(name=volume), encoding="utf-8")
    (folder / "results.json").write_text(
        Results.model_validate(run["results"]).to_json(), encoding="utf-8"
    )
    write_tree(folder / "maps.zarr", groups)
    return folder


def codes_of(text, shape, bits, order):
    """Codes of a packed map, its differences summed up again: the slow counterpart of the
    script."""
    raw, size = zlib.decompress(base64.b64decode(text)), shape[0] * shape[1]
    differences = [*raw]
    if bits == 16:
        folded = [raw[i] + 256 * raw[size + i] for i in range(size)]
        differences = [f // 2 if f % 2 == 0 else -(f // 2) - 1 for f in folded]
    codes = np.array(differences, dtype=np.int64).reshape(shape)
    if order == 2:
        codes = codes.cumsum(axis=0)
    return codes.cumsum(axis=1) % 2**bits


class Explored(HTMLParser):
    """A page: elements, attributes, its script elements by type, and its text without them."""

    def __init__(self, path):
        super().__init__()
        self.html = path.read_text(encoding="utf-8")
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.blocks: dict[str, str] = {}
        self.running: list[str] = []
        self.style = self.words = ""
        self._open: list[str] = []
        self._inside: dict[str, str] = {}
        self.feed(self.html)
        self.close()
        assert self._open == []
        self.data: dict[str, Any] = json.loads(self.blocks["data"])

    def handle_starttag(self, tag, attrs):
        self._inside = {k: v or "" for k, v in attrs}
        self.elements.append((tag, self._inside))
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        last = self._open[-1] if self._open else ""
        if last == "script" and "type" in self._inside:
            self.blocks[self._inside["id"]] = data
        elif last == "script":
            self.running.append(data)
        elif last == "style":
            self.style += data
        else:
            self.words += data

    def unpack(self, spec):
        """Values of a packed map."""
        codes = codes_of(
            self.blocks[spec["block"]], (spec["rows"], spec["cols"]), spec["bits"], spec["order"]
        )
        values = spec["low"] + spec["step"] * (codes.astype(float) - 2)
        values[codes == 1], values[codes == 2 ** spec["bits"] - 1] = -np.inf, np.inf
        values[codes == 0] = np.nan
        return values

    def map(self, name):
        """The map of a title, and its values."""
        spec = next(one for one in self.data["maps"] if one["title"] == name)
        return spec, self.unpack(spec)
