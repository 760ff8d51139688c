from .analyze import correlate as correlate
from .core.errors import PlanishError as PlanishError
from .core.frame import Frame as Frame
from .exports import export as export
from .flatten import flatten_sheet as flatten_sheet
from .io import read_image as read_image
from .io import read_volume as read_volume
from .io.arrays import image as image
from .io.arrays import volume as volume
from .measure import measure_properties as measure_properties
from .pipeline import Registration as Registration
from .pipeline import Run as Run
from .pipeline import correlate_maps as correlate_maps
from .pipeline import find_holes as find_holes
from .pipeline import link as link
from .pipeline import map_sheet as map_sheet
from .pipeline import open_run as open_run
from .pipeline import register_marks as register_marks
from .pipeline import resample_maps as resample_maps
from .report import write_report as write_report
from .results import Results as Results
from .series import open_study as open_study
from .surface import find_surfaces as find_surfaces
from .synthetic import make_specimen as make_specimen

__version__: str
