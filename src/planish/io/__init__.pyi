from .formats import find_place as find_place
from .hashes import fingerprint as fingerprint
from .image import read_image as read_image
from .info import describe as describe
from .params import ImageParams as ImageParams
from .params import VolumeParams as VolumeParams
from .topography import read_topography as read_topography
from .volume import read_volume as read_volume
