from .files import read_regions as read_regions
from .geojson import geojson_text as geojson_text
from .model import Region as Region
from .model import Regions as Regions
