"""The groups of a run by layer: what was measured of a sheet, and the maps on the pixels of the reference."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import count

import xarray as xr

from planish.report.text import title_of
from planish.results import LayerFacts, Results

_MOST_DRAWN = 2**22  # pixels of a map: more than the widest figure has


@dataclass(frozen=True)
class Groups:
    """Results of a run with its maps."""

    results: Results
    # ``layers/NAME`` or ``linked``, and ``layers/NAME/PART`` or, where there is one sheet, ``PART``.
    data: Mapping[str, xr.Dataset]

    def part(self, layer: LayerFacts, name: str) -> xr.Dataset | None:
        """Return what was measured of a sheet: ``surfaces``, ``flat``, ``strain``, ``maps``, ``slices``."""
        only = layer.sheet is not None and sum(other.sheet is not None for other in self.results.layers) == 1
        part = self.data.get(f"layers/{layer.name}/{name}")
        return self.data.get(name) if part is None and only else part

    @cached_property
    def linked(self) -> dict[str, xr.Dataset]:
        """Maps of each layer on the pixels of the reference, by the layer's name; empty without a link."""
        return self._by_layer(self.data.get)

    @cached_property
    def drawn(self) -> dict[str, xr.Dataset]:
        """The same for figures: of large maps a smaller copy of at most 4 million pixels, where the run has one."""
        return self._by_layer(self._smaller)

    def _by_layer(self, group: Callable[[str], xr.Dataset | None]) -> dict[str, xr.Dataset]:
        out: dict[str, xr.Dataset] = {}
        for layer in self.results.layers if self.results.is_link else ():
            data = group(f"layers/{layer.name}")
            if data is None and (maps := group("linked")) is not None:
                data = maps[["image", "valid"]] if layer.kind == "image" else maps.drop_vars("image")
            if data is not None:
                out[layer.name] = data
        return out

    def _smaller(self, name: str) -> xr.Dataset | None:
        """A group, or the finest of its smaller copies that is small enough to be drawn."""
        maps = self.data.get(name)
        for k in count(1):
            smaller = self.data.get(f"overviews/{name}/{k}")
            if maps is None or smaller is None or maps.sizes["y"] * maps.sizes["x"] <= _MOST_DRAWN:
                break
            maps = smaller
        return maps

    @cached_property
    def titles(self) -> dict[tuple[str, str], str]:
        """Titles of all maps, by layer and name."""
        out: dict[tuple[str, str], str] = {}
        for layer in self.results.layers:
            for data in (self.part(layer, "maps"), self.linked.get(layer.name)):
                out |= {} if data is None else {(layer.name, str(k)): title_of(v) for k, v in data.data_vars.items()}
        return out
