"""ImageJ: points saved as a selection, ``.roi``, or those of the ROI Manager, ``.zip``.

In pixels; a whole number is the centre of a pixel, as in ImageJ's results. Read only.
"""

from pathlib import PurePosixPath

import numpy as np
from roifile import ROI_TYPE

from planish.core.errors import MarkError
from planish.core.tables import raise_faults
from planish.core.typing import Floats
from planish.marks.exchange.lists import MOST_MARKS, SELECTIONS, Content, PointList
from planish.marks.imagej_selections import selection_of, selections_in

_SAVE = "Set the marks with the multi-point tool and save the selection again."


def looks_like(content: Content) -> bool:
    """Return whether it begins as a selection, or an archive."""
    return content.data.startswith(SELECTIONS)


def read(content: Content) -> list[PointList]:
    """Read the points of all selections as one list.

    Each point has the name of its selection, with a number where that has several. MarkError for
    what are no points, and for points on several slices of a stack; names that are there twice are
    left out.
    """
    name = content.name
    faults = list[str]()
    points: list[Floats] = []
    labels: list[str] = []
    slices: set[int] = set()
    for part_name, data in selections_in(content.data, name, most=MOST_MARKS, remedy=_SAVE):
        title = PurePosixPath(part_name).stem
        try:
            roi = selection_of(data)
            if roi.roitype != ROI_TYPE.POINT:
                raise ValueError(f"it is no point, but of the type {roi.roitype.name.lower()}")
            if roi.n_coordinates > MOST_MARKS:
                raise ValueError(f"it has {roi.n_coordinates} points")
            coordinates = np.asarray(roi.coordinates(), dtype=np.float64)
        except ValueError as error:
            faults.append(f"{title[:80]!r}: {error}")
            continue
        points.append(coordinates)
        is_single = len(coordinates) == 1
        labels += [title if is_single else f"{title} {k + 1}" for k in range(len(coordinates))]
        slices |= {roi.position, roi.z_position} - {0}
        if roi.counter_positions is not None:
            slices |= set(roi.counter_positions.tolist()) - {0}
    raise_faults(name, faults, _SAVE, error=MarkError)
    if len(slices) > 1:
        raise MarkError(
            f"{name} holds points on {len(slices)} slices of a stack, without z in um. Click them"
            " in one flat picture."
        )
    is_named = len(set(labels)) == len(labels)
    return [
        PointList(
            title=name,
            points=np.concatenate(points),
            unit="pixel",
            labels=labels if is_named else (),
            source="clicked",
        )
    ]
