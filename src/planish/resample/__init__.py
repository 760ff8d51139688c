"""From values on the flattened mesh to any regular grid."""

from planish.resample.fields import resample, resample_dataset, resample_labels, support
from planish.resample.places import Places, covering_grid, find_places

__all__ = ["Places", "covering_grid", "find_places", "resample", "resample_dataset", "resample_labels", "support"]
