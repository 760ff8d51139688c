from .analyze import correlate as correlate
from .core.errors import PlanishError as PlanishError
from .core.frame import Frame as Frame
from .exports import export as export
from .flatten import flatten_sheet as flatten_sheet
from .io import correct_light as correct_light
from .io import read_image as read_image
from .io import read_volume as read_volume
from .io.arrays import image as image
from .io.arrays import volume as volume
from .measure import measure_properties as measure_properties
from .report import write_report as write_report
from .results import Results as Results
from .run import Registration as Registration
from .run import Run as Run
from .run import correlate_maps as correlate_maps
from .run import find_holes as find_holes
from .run import link as link
from .run import map_sheet as map_sheet
from .run import open_run as open_run
from .run import register_marks as register_marks
from .run import register_texture as register_texture
from .run import resample_maps as resample_maps
from .series import open_study as open_study
from .surface import find_surfaces as find_surfaces
from .synthetic import make_specimen as make_specimen

__version__: str
