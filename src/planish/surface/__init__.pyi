from .assemble import cutoff_check as cutoff_check
from .find import find_surfaces as find_surfaces
from .params import LabelParams as LabelParams
from .params import SurfaceParams as SurfaceParams
