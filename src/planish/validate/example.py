"""Pictures of one specimen beside its truth."""

from functools import partial

import numpy as np
import xarray as xr

from planish.core.grid import pitch
from planish.core.numbers import length, plain
from planish.report.colours import ERROR, GREYS, SIGNED, Array, Scale, limits
from planish.report.draw import Picture, draw_map
from planish.validate.truth import Comparison, mean_of, percentile

_NAMES = {"coating_top": "coating thickness", "thickness": "sheet thickness"}


def draw_example(comparison: Comparison, seed: int) -> list[Picture]:
    """Draw what a run's image showed, what was measured, and errors of place and thickness."""
    name = _NAMES[comparison.headline]
    image = comparison.linked["image"].values.astype(np.float64)
    measured_map = comparison.linked_values(comparison.headline)
    error_map = measured_map - comparison.pixel_thickness(comparison.headline, *comparison.true_uv)
    largest_error = percentile(comparison.place_error_um, 99.9) or 1.0
    valid = image[comparison.valid] if comparison.valid.any() else image
    draw = partial(_picture, comparison.linked["y"].values, comparison.linked["x"].values)
    return [
        draw(
            image,
            limits(valid, GREYS, percent=0.2),
            "The image of one specimen",
            f"Seed {seed}; pixels of {plain(round(pitch(comparison.linked)[1], 4))}.",
            label="",
        ),
        draw(
            measured_map,
            limits(measured_map),
            f"Measured {name}",
            "On the image's pixels; grey is not valid: holes with their rims, and what lies beside"
            " the volume.",
        ),
        draw(
            comparison.place_error_um,
            Scale(0.0, max(largest_error, 1e-6), ERROR),
            "Error of place",
            "Distance in the sheet between the material that a pixel shows and the one whose"
            f" thickness it was given; 99.9 % of the pixels are below {length(largest_error)}.",
        ),
        draw(
            error_map,
            limits(error_map, SIGNED, symmetric=True),
            f"Error of the {name}",
            f"Measured minus true; {length(mean_of(error_map))} in the mean.",
        ),
    ]


def _picture(
    rows: Array,
    cols: Array,
    values: Array,
    scale: Scale,
    title: str,
    caption: str,
    label: str = "µm",
) -> Picture:
    data = xr.DataArray(values, [("y", rows), ("x", cols)])
    canvas, _ = draw_map(data, scale=scale, label=label)
    return canvas.picture(title, caption)
