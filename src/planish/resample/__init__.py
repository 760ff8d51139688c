"""From values on the flattened mesh to any regular grid, and from image to image."""

from planish.resample.fields import resample, resample_dataset, resample_labels, support
from planish.resample.places import Places, covering_grid, find_places
from planish.resample.warp import Warped, warp_image

__all__ = [
    "Places",
    "Warped",
    "covering_grid",
    "find_places",
    "resample",
    "resample_dataset",
    "resample_labels",
    "support",
    "warp_image",
]
