"""From values on the flattened mesh to any regular grid."""

from planish.resample.quads import Places, covering_grid, find_places, resample, resample_dataset

__all__ = ["Places", "covering_grid", "find_places", "resample", "resample_dataset"]
