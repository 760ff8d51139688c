"""From the warped centre surface to flat coordinates."""

from planish.flatten.distortion import cell_strain, edge_strain
from planish.flatten.relax import Relaxed, relax_grid
from planish.flatten.sheet import Flattened, FlattenParams, flatten_sheet

__all__ = ["FlattenParams", "Flattened", "Relaxed", "cell_strain", "edge_strain", "flatten_sheet", "relax_grid"]
