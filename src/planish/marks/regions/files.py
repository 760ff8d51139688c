"""Files of regions: which program wrote one is seen by its first bytes."""

from __future__ import annotations

from pathlib import Path

from planish.core.errors import FileError
from planish.core.tables import read_bytes
from planish.marks.regions.geojson import read_geojson
from planish.marks.regions.imagej import ROI, ZIP, read_roi, read_roi_zip
from planish.marks.regions.model import MOST_POINTS, MOST_REGIONS, Regions

_LARGEST_FILE = 64_000_000


def read_regions(path: str | Path) -> Regions:
    """Read regions of GeoJSON, or of ImageJ: a selection or an archive of them.

    Parameters
    ----------
    path : path

    Returns
    -------
    Regions
        In um of GeoJSON; of ImageJ in pixels, which :meth:`Regions.on` turns into um.

    Raises
    ------
    FileError
        If the file cannot be read, is damaged, too large, or holds something else than polygons.
    """
    name = Path(path).name
    content = read_bytes(path, what="file of regions", most=_LARGEST_FILE)
    if content.startswith(ZIP):
        regions = read_roi_zip(content, name, most=_LARGEST_FILE)
    else:
        regions = (read_roi if content.startswith(ROI) else read_geojson)(content, name)
    points = sum(len(ring) for region in regions.declared for rings in region.polygons for ring in rings)
    if not regions.declared:
        raise FileError(f"{name} holds no region. Draw one, or leave --regions out.")
    if len(regions.declared) > MOST_REGIONS or points > MOST_POINTS:
        raise FileError(
            f"{name} holds {len(regions.declared)} regions with {points} points; {MOST_REGIONS} regions with "
            f"{MOST_POINTS} points are the most. Simplify them, or join them to MultiPolygons."
        )
    return regions
