"""Photographs of serial sections -> one volume: neighbours aligned, grey levels made equal, gaps bridged."""

from planish.sections.align import Alignment, align_sections
from planish.sections.band import Band, find_band
from planish.sections.normalise import Gains, normalise_sections
from planish.sections.reference import fixed_places
from planish.sections.volume import regular_volume

__all__ = [
    "Alignment",
    "Band",
    "Gains",
    "align_sections",
    "find_band",
    "fixed_places",
    "normalise_sections",
    "regular_volume",
]
