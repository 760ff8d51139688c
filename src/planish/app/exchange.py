"""Marks of a session from files of any format, and to them."""

import base64
import io
import tempfile
import zipfile
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from planish.app.changes import ChangeError, Import, checked_label
from planish.app.fits import Fitted
from planish.app.picture import PLANES, Plane, layer_run
from planish.app.session import Session, dataset_of, pairs_of
from planish.io.map_groups import read_group
from planish.marks.exchange import FORMATS, LayerPixels, marks_bytes, pair_of_layers, read_any
from planish.marks.exchange.formats import TARGETS
from planish.marks.exchange.lists import Part
from planish.run.marks_registration import volume_to_map
from planish.run.run import MAPS


class MarkFile(Part):
    """A file that the page read: its name, and its text or, of one that is no text, its bytes."""

    name: Annotated[str, Field(max_length=255)]
    text: str | None = None
    base64: str | None = None

    @property
    def suffix(self) -> str:
        """Suffix of its name that says the format; nothing else of the name is used."""
        suffixes = [suffix for file_format in FORMATS.values() for suffix in file_format.suffixes]
        return max(filter(self.name.lower().endswith, suffixes), key=len, default=".csv")

    def content(self) -> bytes:
        """Its bytes; ChangeError where there are none."""
        if self.text is not None and self.base64 is None:
            return self.text.encode("utf-8", "surrogatepass")
        if self.text is not None or self.base64 is None:
            raise ChangeError("A file of marks is sent as text or as base64.")
        try:
            return base64.b64decode(self.base64, validate=True)
        except ValueError as error:
            raise ChangeError(f"This is not base64: {error}.") from error


def imported(
    session: Session, layer: str, file: MarkFile, fixed_file: MarkFile | None = None
) -> Import:
    """The marks of a file, in the planes of a registration, as a change.

    ``fixed_file``: the fixed layer, of a format with one a file. FileError, MarkError, SizeError
    for a faulty one.
    """
    with tempfile.TemporaryDirectory(prefix="planish-") as folder:
        paths: list[Path] = []
        for stem, upload in (("marks", file), ("second", fixed_file)):
            if upload is not None:
                paths.append(Path(folder) / f"{stem}{upload.suffix}")
                paths[-1].write_bytes(upload.content())
        pixels = {plane: _pixels(session, layer, plane) for plane in PLANES}
        marks = read_any(*paths, **pixels, volume=LayerPixels())
    moving, fixed = pair_of_layers(marks, name=file.name)
    if moving == "volume":
        store = layer_run(session.folder, layer) / MAPS
        is_sheet = session.results.layer(layer).sheet is not None
        groups = {group: read_group(store, group) for group in ("surfaces", "flat") if is_sheet}
        marks = volume_to_map(marks, layer, groups)
        moving = "moving"
    pairs = pairs_of(marks, moving, fixed, label=lambda name: checked_label(str(name)))
    return Import(layer=layer, marks=pairs)


def exported(session: Session, layer: str, format_name: str, fitted: Fitted) -> tuple[str, bytes]:
    """Name and bytes of a file of marks, or a ZIP where the format has several files.

    ``fitted`` is the fit that is shown, whose residuals go into the file as far as it has room for
    them. ChangeError for a format that does not exist, MarkError where it can hold none of these.
    """
    if format_name not in TARGETS:
        raise ChangeError(f"Marks are written as {', '.join(TARGETS)}.")
    marks = session.state.of(layer)
    # Marks that are no pair have the row behind the last, of NaN.
    row_of = {mark.id: k for k, mark in enumerate(fitted.pairs)}
    rows = np.array([row_of.get(mark.id, len(row_of)) for mark in marks], np.intp)
    errors_um = {"residual": fitted.residual_um, "leave_one_out": fitted.leave_one_out_um}
    results = {name: np.append(um, np.nan)[rows] for name, um in errors_um.items()}
    about = {plane: _pixels(session, layer, plane).about() for plane in PLANES}
    dataset = dataset_of(marks, about=about, results=results)
    suffix = next(iter(FORMATS[format_name].suffixes), ".csv")
    files = marks_bytes(dataset, format_name)
    if len(files) == 1:
        return f"marks{suffix}", files[""]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name_end, content in files.items():
            archive.writestr(f"marks{name_end}{suffix}", content)
    return "marks.zip", buffer.getvalue()


def _pixels(session: Session, layer: str, plane: Plane) -> LayerPixels:
    on_plane = session.pictures.on(*session.shown_by(layer, plane))
    if not on_plane:
        return LayerPixels()
    grid = on_plane[0].grid
    return LayerPixels(pixel_um=grid.pixel_um, origin_um=grid.origin_um, shape=grid.shape)
