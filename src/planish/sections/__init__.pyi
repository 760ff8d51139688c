from .align import Alignment as Alignment
from .align import align_sections as align_sections
from .align import fixed_places as fixed_places
from .band import Gains as Gains
from .band import SectionSeries as SectionSeries
from .band import SheetBand as SheetBand
from .band import normalise_sections as normalise_sections
from .volume import regular_volume as regular_volume
