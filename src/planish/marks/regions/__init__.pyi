from .files import geojson_text as geojson_text
from .files import read_regions as read_regions
from .model import Region as Region
from .model import Regions as Regions
