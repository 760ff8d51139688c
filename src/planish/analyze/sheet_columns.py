"""The columns of a sheet as two halves of a measurement are taken from them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.transform import Similarity
from planish.core.typing import Floats, Texts
from planish.measure.registry import HEIGHTS, LENGTHS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SheetColumns:
    """The columns of a sheet and where they lie on a reference.

    ``measured`` and ``flat`` (y, x) are those of the sheet. ``similarity`` leads from the flat
    sheet to the reference: what the registration adds to it moves both halves alike.
    ``interpolated`` says whether rows were made of others.
    """

    measured: xr.Dataset
    flat: xr.Dataset
    similarity: Similarity
    interpolated: bool = False

    def part(self, rows: slice) -> SheetColumns:
        """Some rows of columns."""
        measured, flat = (data.isel(y=rows) for data in (self.measured, self.flat))
        return replace(self, measured=measured, flat=flat)

    def values(self, name: str) -> tuple[Floats, bool]:
        """A map by columns, and whether each is of its column alone.

        NaN where it was not measured.
        """
        if name in LENGTHS:
            return self.faces(name), True
        return self.measured[name].values, False

    def faces(self, name: str) -> Floats:
        """A length or a height by the faces at each column, whose noise is of this column alone.

        A map itself is read along normals, between columns, and a height is above its form. So the
        length along z between the faces of a column, or the height of one face, is projected onto
        the normal of the centre surface there: (rows, cols) in um, outwards. Another map is given
        as it is.
        """
        data = self.measured
        ends: Texts = LENGTHS.get(name, ())  # the upper face, then the lower one
        if name in HEIGHTS:
            ends = (HEIGHTS[name],)
        if not ends:
            return data[name].values
        faces: list[Floats] = []
        for end in ends:
            values = data[end].values
            # a side without a coating.
            if end.startswith("interface_") and not np.isfinite(values).any():
                values = data[end.removeprefix("interface_")].values
            faces.append(values)
        slopes = np.gradient(data["centre"].values, *pitch(data))
        cosine = 1 / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
        length_um = faces[0]
        if len(faces) > 1:
            length_um = length_um - faces[1]
        outwards_um = Frame.of(data).sign * length_um * cosine
        return np.where(np.isfinite(data[name].values), outwards_um, np.nan)

    def shared(self, *, alone: bool) -> str:
        """What both halves share, in words.

        ``alone``: whether the map is of each column alone (:meth:`values`).
        """
        attrs = self.measured.attrs
        causes = ["grey levels, blur and rings of one scan"]
        if "from_labels" in attrs:
            causes = ["whatever the program smoothed that made the labels"]
        blend = float(attrs.get("averaged_columns", 0.0))
        if blend > 0:
            causes.append(
                f"noise, as columns were averaged with their neighbours (Gaussian of {blend:.2g}"
                " columns)"
            )
        elif not alone:
            causes.append("noise, as this map is read between columns")
        if self.interpolated:
            causes.append("sections from which others were interpolated")
        return "; ".join(causes)
