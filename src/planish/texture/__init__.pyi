from .detrend import in_band as in_band
from .lag_field import LagField as LagField
from .textures import Textures as Textures
from .textures import textures as textures
