"""Files to volumes and images: every format is read here, and every length becomes micrometres."""

from planish.io.describe import describe
from planish.io.fingerprint import fingerprint
from planish.io.formats import find_place
from planish.io.image import read_image
from planish.io.topography import read_topography
from planish.io.volume import read_volume

__all__ = ["describe", "find_place", "fingerprint", "read_image", "read_topography", "read_volume"]
