"""Layers of a run: a sheet with its maps or an image; on its own grid, or the reference's."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import xarray as xr

from planish.core.checks import Check
from planish.core.facts import InputFile, Side
from planish.core.grid import Grid
from planish.io.light import CorrectedImage
from planish.register import Chain
from planish.results import SheetFacts
from planish.run.registration import Registration
from planish.run.study import GivenLayer

Groups = Mapping[str, xr.Dataset]
"""Datasets of a sheet or a run, by the names of their groups."""

Datasets = dict[str, xr.Dataset]
Shown = xr.DataArray | Groups
"""What is brought to the reference: an image, or the groups of a sheet; the maps only where it is
the reference."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MappedLayer:
    """A sheet that was measured and flattened, or an image, on a grid of its own."""

    params: GivenLayer  # with the sizes and pitches that were used
    source: InputFile
    # Machine direction, deg clockwise on screen from the x axis, if it was given.
    md_deg: float | None = None
    image: xr.DataArray | None = None
    corrected: CorrectedImage | None = None  # of an image with a white one
    # An image as it is compared; holes are found in the image itself.
    compared: xr.DataArray | None = None
    # Of a sheet: ``surfaces`` and ``flat`` (y, x), ``strain`` (row, col), ``maps`` (v, u),
    # ``slices``, and ``sections`` of serial sections.
    groups: Datasets = field(default_factory=Datasets)
    # Groups that stand in the store of another run with the same bytes, and that store.
    unchanged: dict[str, Path] = field(default_factory=dict[str, Path])
    by_this_code: bool = True  # not of a sheet that was read from a run of other code
    facts: SheetFacts | None = None  # of a sheet
    checks: tuple[Check, ...] = ()  # of a sheet and its volume, or of the file of an image
    side_found: Side | None = None  # that an image shows, by its texture, where none was given

    @property
    def name(self) -> str:
        """Name of the layer."""
        return self.params.name

    @property
    def kind(self) -> Literal["sheet", "image"]:
        """What it is."""
        return "sheet" if self.image is None else "image"

    @property
    def shown(self) -> Shown:
        """What is brought to the reference.

        That is an image as it is compared, or the groups of a sheet.
        """
        return self.groups if self.compared is None else self.compared

    @property
    def grid(self) -> Grid:
        """Its own pixels: of the image, or of the flat maps."""
        return Grid.of(self.groups["maps"] if self.image is None else self.image)

    @property
    def hand_text(self) -> str:
        """What its file says of its hand, where it makes it a mirror image; empty otherwise."""
        return " ".join(
            check.sentence
            for check in self.checks
            if check.name.startswith("hand of") and check.state == "look"
        )

    @property
    def side_given(self) -> Side | None:
        """Side of the sheet that an image shows, if it was given."""
        return None if self.params.image is None else self.params.image.side

    @property
    def side(self) -> Side:
        """Side of the sheet that the layer shows.

        It is the top for flat maps, and for an image of which nothing is known.
        """
        return self.side_given or self.side_found or "top"


Layers = dict[str, MappedLayer]
"""Layers by their names."""


class Link(NamedTuple):
    """How a layer comes to the reference.

    It has its registration to the next layer of the path, and all registrations composed.
    """

    path: list[MappedLayer]
    registration: Registration
    chain: Chain


@dataclass(frozen=True, slots=True, eq=False)
class LinkedLayer:
    """A layer on the pixels of the reference, and how it came there."""

    layer: MappedLayer
    link: Link | None  # None of the reference itself
    maps: xr.Dataset  # (y, x) of the reference

    @property
    def name(self) -> str:
        """Name of the layer."""
        return self.layer.name

    @property
    def kind(self) -> Literal["sheet", "image"]:
        """What it is."""
        return self.layer.kind
