"""Convert files of marks to marks, and back, in any format.

The format is recognised by the content of a file and not by its name.
"""

from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import xarray as xr

from planish.core.errors import FileError, MarkError, SizeError
from planish.core.files import write_whole
from planish.core.typing import Entries, Fields, Floats
from planish.marks.exchange import model
from planish.marks.exchange.formats import (
    FORMATS,
    MarkFormat,
    Unit,
    known_formats,
    module_of,
    target_of,
)
from planish.marks.exchange.lists import Content, LayerPixels, PointList, join_lists, read_content
from planish.marks.exchange.model import about_layer, check_marks, check_plausible, layer_names

_NOTHING = LayerPixels()
_BY_HAND = (
    "Give its positions as a table with the headings label, moving_x_mm, moving_y_mm, fixed_x_mm,"
    " fixed_y_mm, or in um or px, y downwards."
)
# How files begin that hold positions in another format: what they are, and the way on.
_OTHERS = {
    "# Markups fiducial file": "is a point list of Slicer in the old format .fcsv",
    "# Amira": "holds landmarks of Amira or Avizo",
    "# Avizo": "holds landmarks of Amira or Avizo",
    "mapX,": "holds points of QGIS, whose y counts upwards",
    "LM=": "holds landmarks of tpsDig, whose y counts upwards",
    "<": "is XML, such as the named landmarks of Fiji",
}
_WAYS = {"# Markups fiducial file": "Save it in Slicer as .mrk.json."}  # by hand from the others


def read_any(
    path: str | Path,
    second: str | Path | None = None,
    *,
    moving: LayerPixels = _NOTHING,
    fixed: LayerPixels = _NOTHING,
    volume: LayerPixels | None = None,
    unit: Unit | None = None,
    swap: bool = False,
) -> xr.Dataset:
    """Read marks in any of the formats of ``docs/marks-files.md``.

    Parameters
    ----------
    path : str or Path
        A file with both layers, or with one.
    second : str or Path, optional
        The fixed layer, where ``path`` holds the moving one only. Marks belong together in their
        order.
    moving, fixed : LayerPixels
        What is known of the layers: pixel size (needed where the file counts in pixels), place of
        the first pixel, from which other programs count, and size. Where both sizes are known,
        marks that cannot lie in a layer are refused.
    volume : LayerPixels, optional
        The same for positions with z; ``moving`` where not given.
    unit : {"um", "mm", "pixel"}, optional
        Unit of a file that does not state its own; um for BigWarp and results of ImageJ, mm for
        elastix where not given.
    swap : bool
        Whether the moving layer of the file is the fixed one here: the image was moved onto the map
        or the volume.

    Returns
    -------
    Dataset, dims (mark)
        As :func:`planish.marks.exchange.make_marks` makes it, lengths in um, x to the right and y
        down. ``attrs["read_from"]`` says the format, the unit, and whether the file stated the
        unit, ``attrs["from_first_pixel"]`` in which layers the file counts from the first
        pixel, whose place was added.

    Raises
    ------
    FileError
        If a file cannot be read, has more than 10 MB, or is in no known format.
    MarkError
        If marks are missing, malformed, repeated, or cannot lie in their layer.
    SizeError
        If a pixel size is needed and not given, or units contradict each other.
    """
    volume = volume or moving
    contents = [*map(read_content, filter(None, (path, second)))]
    name = " and ".join(content.name for content in contents)
    formats = [*map(_recognised, contents)]
    # Each is a dataset of marks, or one or two lists of points.
    readings: list[Any] = []
    for kind, content in zip(formats, contents, strict=True):
        readings.append(module_of(kind).read(content))
    read_from: Entries = {"format": formats[0], "unit": "um", "stated": True}
    if second is None and isinstance(readings[0], xr.Dataset):
        _check_own(name, unit, swap=swap)
        marks = _with_pixels(readings[0], moving, volume, fixed)
    else:
        lists = _lists_in(contents, readings)
        marks = join_lists(
            lists, name=name, moving=moving, volume=volume, fixed=fixed, unit=unit, swap=swap
        )
        silent = min(lists, key=attrgetter("stated"))
        read_from |= {"unit": unit or silent.unit, "stated": silent.stated}
    marks.attrs["read_from"] = read_from
    check_marks(marks, name)
    if unit != "um":
        check_plausible(marks, name, unit)
    return marks


def _lists_in(contents: Sequence[Content], readings: Sequence[Any]) -> list[PointList]:
    """Lists of points of a file, or of two with one list each."""
    lists: list[PointList] = []
    for content, reading in zip(contents, readings, strict=True):
        if isinstance(reading, xr.Dataset):
            reading = [_single_list(reading, content.name)]
        lists += reading
        if len(contents) == 2 and len(reading) != 1:
            raise MarkError(
                f"{content.name} holds {len(reading)} lists of points already. Give it alone, or"
                " two files with one each."
            )
    return lists


def _check_own(name: str, unit: Unit | None, *, swap: bool) -> None:
    """Refuse what a file of planish says itself."""
    if unit not in (None, "um"):
        raise SizeError(
            f"{name} states its unit, um, and `unit` says {unit}. Leave `unit` out, or correct the"
            " file."
        )
    if swap:
        raise MarkError(
            "A planish file says itself which layer is the moving one. Leave `swap` out."
        )


def _with_pixels(
    marks: xr.Dataset, moving: LayerPixels, volume: LayerPixels, fixed: LayerPixels
) -> xr.Dataset:
    """Marks with what is known of the layers beside what their file states."""
    layers = {layer: dict(about) for layer, about in marks.attrs["layers"].items()}
    facts = {"moving": moving.about(), "volume": volume.about(), "fixed": fixed.about()}
    if list(layers) == ["marks"]:
        facts["marks"] = facts["moving"] | facts["fixed"]
    for side in facts.keys() & layers.keys():
        layers[side] |= facts[side]
    return marks.assign_attrs(layers=layers, from_first_pixel=[])


def write_any(
    marks: xr.Dataset,
    path: str | Path,
    *,
    to: str | None = None,
    moving: LayerPixels = _NOTHING,
    fixed: LayerPixels = _NOTHING,
    unit: Unit | None = None,
    swap: bool = False,
) -> list[Path]:
    """Write marks for planish or for another program.

    Parameters
    ----------
    marks : Dataset, dims (mark)
        As `read_any` gives them; holes go through `marks_of_holes`.
    path : str or Path
        File to make; nothing is overwritten. For elastix, which takes one side from each file,
        ``-moving`` and ``-fixed`` are put before the suffix.
    to : str, optional
        One of `TARGETS`; as the name asks where not given.
    moving, fixed : LayerPixels
        Pixel sizes, in place of those that the marks hold.
    unit : {"um", "mm", "pixel"}, optional
        Unit of a BigWarp (um if not given) or elastix file (mm): that of the images as the other
        program opens them.
    swap : bool
        Whether the fixed layer is to be the moving one of the other program.

    Returns
    -------
    list of Path
        The files that were made.

    Raises
    ------
    FileError
        If a file is there already or cannot be written.
    MarkError
        If the marks lack what the format needs.
    SizeError
        If a pixel size is needed and not known.

    Notes
    -----
    Other programs count from the centre of the first pixel, so the origin of a layer is taken off.
    ``json`` keeps all; ``bigwarp`` and ``slicer`` keep labels, marks that are not used and marks of
    one layer only; ``csv``, ``elastix`` and ``matlab`` hold the pairs in use.
    """
    place = Path(path)
    name = to or target_of(path)
    parts = marks_bytes(marks, name, moving=moving, fixed=fixed, unit=unit, swap=swap)
    files = {place.with_stem(place.stem + end): content for end, content in parts.items()}
    for file in files:
        if file.exists():
            raise FileError(
                f"{file} is already there; nothing is overwritten. Choose another name."
            )
    for file, content in files.items():
        write_whole(file, content)
    return list(files)


def marks_bytes(
    marks: xr.Dataset,
    to: str,
    *,
    moving: LayerPixels = _NOTHING,
    fixed: LayerPixels = _NOTHING,
    unit: Unit | None = None,
    swap: bool = False,
) -> dict[str, bytes]:
    """Give what `write_any` writes, by what it puts before the suffix of the name.

    Parameters and errors as there.

    Parameters
    ----------
    marks : Dataset, dims (mark)
    to : str
        One of `TARGETS`.
    moving, fixed, unit, swap
        As for `write_any`.
    """
    mark_format = FORMATS[to]
    check_marks(marks, "The marks")
    if unit is not None:
        _check_free_unit(mark_format)
    if mark_format.unit is None:
        return module_of(to).write(marks, {})
    # Positions by role, or by the name of the only layer.
    keys = layer_names(marks)
    if len(keys) == 1 and mark_format.single:
        overrides = [moving if moving.pixel_um else fixed]
        layers = keys
    else:
        keys = ["moving", "fixed"]
        overrides = [moving, fixed]
        layers = model.pair_of_layers(marks, name="This set of marks")
    if mark_format.pairs_only:
        marks = _used_in(marks, layers)
    file_points: list[Floats] = []
    file_text = f"The file for {mark_format.title}"
    file_unit = unit or mark_format.unit
    sides = zip(("moving", "fixed"), layers, overrides, strict=False)
    for role, layer, override in sides:
        points = model.points_of(marks, layer)
        pixels = _pixels_of(about_layer(marks, layer), override)
        origin, factor = pixels.frame(file_unit, points.shape[1], file_text, role)
        file_points.append((points - origin) / factor)
    if swap:
        file_points.reverse()
    points_by_key = dict(zip(keys, file_points, strict=True))
    return module_of(to).write(marks, points_by_key)


def _check_free_unit(mark_format: MarkFormat) -> None:
    """Refuse a unit for a format that has its own."""
    if not mark_format.free_unit:
        titles = " and ".join(other.title for other in FORMATS.values() if other.free_unit)
        raise SizeError(
            f"A file for {mark_format.title} has its own unit; only those for {titles} are written"
            " in `out_unit`."
        )


def _used_in(marks: xr.Dataset, layers: Sequence[str]) -> xr.Dataset:
    """Marks that are used and lie in all layers."""
    is_used = model.used_in(marks, layers)
    if not is_used.any():
        raise MarkError(f"No mark is used and lies in {' and '.join(layers)}. Use at least one.")
    return marks.isel(mark=is_used)


def _pixels_of(about: Fields, override: LayerPixels) -> LayerPixels:
    """Pixels of a layer, whose size may be given in place of that of the marks."""
    pixel_um = override.pixel_um
    if "pixel_um" in about and not pixel_um:
        own_um = about["pixel_um"]
        pixel_um = (own_um["y"], own_um["x"])
    first_um = about.get("origin_um", {"x": 0.0, "y": 0.0})
    return LayerPixels(pixel_um, (first_um["x"], first_um["y"]))


def _recognised(content: Content) -> str:
    """Name of the first format that a file looks like; FileError, with the way on, for none.

    Formats are tried in the order of `FORMATS`.
    """
    for name in FORMATS:
        if module_of(name).looks_like(content):
            return name
    text = content.text.lstrip()
    for start, fault in _OTHERS.items():
        if text.startswith(start):
            raise FileError(f"{content.name} {fault}. {_WAYS.get(start, _BY_HAND)}")
    if text.startswith("{"):
        keys = ", ".join(list(content.json)[:6]) or "nothing"
        raise FileError(
            f"{content.name} is JSON, but no file of marks: it holds {keys[:80]}. These are read:"
            f" {known_formats()}."
        )
    first = ",".join(content.header)[:60]
    raise FileError(
        f"{content.name} begins with {first!r} and is in no known format of marks. These are read:"
        f" {known_formats()}."
    )


def _single_list(marks: xr.Dataset, name: str) -> PointList:
    """Take the only layer of a file of planish as a list of points; MarkError for several."""
    layers = layer_names(marks)
    if len(layers) != 1:
        raise MarkError(
            f"{name} already holds the layers {', '.join(layers)}. Give it alone, or two files with"
            " one each."
        )
    (layer,) = layers
    places = model.places_of(marks, layer)
    return PointList(
        title=name,
        labels=model.labels_of(marks),
        points=places.um,
        used=model.used_of(marks).tolist(),
        unit="um",
        placed=True,
        extras=places.extras,
        source=places.source,
        about=about_layer(marks, layer),
    )
