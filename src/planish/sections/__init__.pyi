from .align import Alignment as Alignment
from .align import align_sections as align_sections
from .band import Band as Band
from .band import SectionSeries as SectionSeries
from .normalise import Gains as Gains
from .normalise import normalise_sections as normalise_sections
from .reference import fixed_places as fixed_places
from .volume import regular_volume as regular_volume
