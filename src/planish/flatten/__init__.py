"""From the warped centre surface to flat coordinates."""

from planish.flatten.curvature import CurvatureCheck, curvature_check, gaussian_curvature
from planish.flatten.distortion import Distortion, cell_strain, edge_strain, measure_distortion
from planish.flatten.geodesics import GeodesicError, geodesic_error
from planish.flatten.multigrid import Step
from planish.flatten.relax import Relaxed, relax_grid
from planish.flatten.relaxation import History, RelaxationParams
from planish.flatten.sheet import Flattened, FlattenParams, flatten_sheet

__all__ = [
    "CurvatureCheck",
    "Distortion",
    "FlattenParams",
    "Flattened",
    "GeodesicError",
    "History",
    "RelaxationParams",
    "Relaxed",
    "Step",
    "cell_strain",
    "curvature_check",
    "edge_strain",
    "flatten_sheet",
    "gaussian_curvature",
    "geodesic_error",
    "measure_distortion",
    "relax_grid",
]
