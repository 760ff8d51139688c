"""Tables of positions of other programs, and those typed by hand: the headings say whose they are.

The unit is that of the headings (``Centroid X µm``), or that in which the program writes. Read
only.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from planish.core.errors import MarkError
from planish.core.tables import CsvTable, Heading, heading_of, parse_table
from planish.marks.exchange.csv_marks import check_rows, labels_in, rows_in_use
from planish.marks.exchange.formats import Unit
from planish.marks.exchange.lists import Content, PointList


class Layout(NamedTuple):
    """A table that is known by the names of its columns, without their units."""

    lists: Mapping[str, tuple[str, ...]]  #: Columns x, y (and z) by the title of each list.
    unit: Unit | None = None  #: Where the headings state none; None: it is asked for.
    stated: bool = True  #: Whether this unit is certain.
    first_centre: float = 0.0  #: Pixel coordinate of the first pixel's centre.
    also: frozenset[str] = frozenset()  #: Headings that have to be there, letter by letter.
    placed: bool = False  #: Lengths are those of the layer, and do not count from its first pixel.
    source: str = "imported"
    heading_rows: int = 0  #: Further rows of names and units below the first.


_FIXED = {"fixed": ("fixed_x", "fixed_y")}
_MATLAB = {side: (f"{side}points_1", f"{side}points_2") for side in ("moving", "fixed")}
_MANAGER = frozenset(("X", "Y", "Type", "Width", "Height"))
LAYOUTS = (
    # Pairs typed by hand.
    Layout({"moving": ("moving_x", "moving_y")} | _FIXED, placed=True),
    Layout({"volume": ("volume_x", "volume_y", "volume_z")} | _FIXED, placed=True),
    Layout(_MATLAB, "pixel", first_centre=1.0),
    # napari and scikit-image: the first axis of an array runs down.
    Layout({"": ("axis_2", "axis_1", "axis_0")}, "pixel"),
    Layout({"": ("axis_1", "axis_0")}, "pixel"),
    Layout({"": ("centroid_2", "centroid_1", "centroid_0")}, "pixel"),
    Layout({"": ("centroid_1", "centroid_0")}, "pixel"),
    # QuPath, CellProfiler, TrackMate.
    Layout({"": ("centroid_x", "centroid_y")}, first_centre=0.5),
    Layout({"": ("location_center_x", "location_center_y")}, "pixel"),
    Layout({"": ("position_x", "position_y", "position_z")}, heading_rows=3),
    # ImageJ: the list of the ROI Manager, and results.
    Layout({"": ("x", "y")}, "pixel", also=_MANAGER, source="clicked"),
    Layout({"": ("x", "y")}, "um", stated=False, also=frozenset("XY"), source="clicked"),
    # Points typed by hand.
    Layout({"": ("x", "y")}),
)
"""Tables by their columns; the first that fits is taken."""


def looks_like(content: Content) -> bool:
    """Return whether the headings are those of a layout."""
    return _layout_of(content) is not None


def read(content: Content) -> list[PointList]:
    """Read the points of one layer, or of two.

    The first layout of `LAYOUTS` that has the columns says which they are, and the unit where the
    headings state none. Rows that are not in use are left out.
    """
    layout = _layout_of(content)
    assert layout is not None
    table = parse_table(content.text, content.name, needed=(), error=MarkError)
    table.header[:] = content.header  # as they are, for messages
    headings = _headings(table, layout)
    _refuse_other_places(table, layout)
    rows_in_use(table)
    point_lists = [
        _point_list(table, layout, title or content.name, columns, headings)
        for title, columns in layout.lists.items()
    ]
    check_rows(table)
    return point_lists


def _layout_of(content: Content) -> Layout | None:
    names = {heading_of(cell).name for cell in content.header}
    for layout in LAYOUTS:
        has_columns = all(names.issuperset(columns) for columns in layout.lists.values())
        if has_columns and layout.also.issubset(content.header):
            return layout
    return None


def _headings(table: CsvTable, layout: Layout) -> list[Heading]:
    """Headings of the columns, with the units of the last of the further rows of headings.

    These rows are taken out of the table.

    The further rows are as many as the layout says, and only those without a number in the first
    column of positions.
    """
    headings = [heading_of(cell) for cell in table.header]
    first_name, *_ = next(iter(layout.lists.values()))
    column = [heading.name for heading in headings].index(first_name)
    unit_row: list[str] = []
    for row in table.rows[: layout.heading_rows]:
        if table.content.number(row.cells[column]) is None:
            unit_row = row.cells
            table.rows.remove(row)
    for k, cell in enumerate(unit_row):
        unit = heading_of(cell).unit
        if unit:
            headings[k] = headings[k]._replace(unit=unit)
    return headings


def _refuse_other_places(table: CsvTable, layout: Layout) -> None:
    """Refuse points whose x and y are no places in one flat picture.

    MarkError for more axes than z, y, x, for shapes, and for points on several slices of a stack;
    what is no point in a list of the ROI Manager is a fault of its row.
    """
    if "axis-3" in table.header:
        raise MarkError(
            f"{table.name} holds points with more axes than z, y, x. Save points of one channel and"
            " one time."
        )
    if "vertex-index" in table.header:
        raise MarkError(f"{table.name} holds shapes of napari. Save a layer of points.")
    is_flat = all(len(columns) == 2 for columns in layout.lists.values())
    slices = {table.text(row, "Slice") for row in table.rows} - {""}
    if is_flat and len(slices) > 1:
        raise MarkError(
            f"{table.name} holds points on {len(slices)} slices of a stack, without z in um. Click"
            " them in one flat picture, or give volume_x_um, volume_y_um and volume_z_um."
        )
    if layout.also == _MANAGER:
        for row in table.rows:
            if (kind := table.text(row, "Type")).lower() != "point":
                table.fault(row, f"{kind} is no point: X and Y are the corner of its box")


def _point_list(
    table: CsvTable, layout: Layout, title: str, names: Sequence[str], headings: Sequence[Heading]
) -> PointList:
    """Take points from the columns of these names, all of which state one unit, or none.

    Lengths in another unit than um, mm or pixels are turned into um; where the headings state no
    unit it is that of the layout, or None.
    """
    columns = _columns_in_one_unit(headings, names)
    if not columns:
        raise MarkError(
            f"{table.name}: {', '.join(names)} do not state the same unit (found"
            f" {', '.join(table.header)[:120]}). Give one unit to all of them."
        )
    heading = headings[columns[0]]
    column_names = [table.header[k] for k in columns]
    points = table.numbers(column_names)
    unit = layout.unit
    is_stated = layout.stated and unit is not None
    if heading.unit in ("pixel", "mm"):
        unit = heading.unit
    elif heading.um:
        unit = "um"
        points = points * heading.um
    elif heading.unit:
        raise MarkError(
            f"{table.name}: {', '.join(column_names)} are in {heading.unit!r}, which is no length."
            " Give um, mm or px."
        )
    return PointList(
        title=title,
        points=points,
        unit=unit,
        stated=is_stated or bool(heading.unit),
        columns=column_names,
        labels=labels_in(table, unique=not layout.placed),
        placed=layout.placed,
        first_centre=layout.first_centre,
        source=layout.source,
    )


def _columns_in_one_unit(headings: Sequence[Heading], names: Sequence[str]) -> list[int]:
    """Numbers of the columns of these names in the first unit that all have; empty where none."""
    for first in headings:
        choice = [Heading(name, first.unit) for name in names]
        if first.name == names[0] and all(heading in headings for heading in choice):
            return [headings.index(heading) for heading in choice]
    return []
