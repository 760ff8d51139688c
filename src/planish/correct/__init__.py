"""Rings and cupping of a micro-CT volume: found, taken off, and told."""

from planish.correct.picture import write_picture
from planish.correct.record import Corrections, Cupping, Ring, Trend
from planish.correct.volume import Corrected, correct_volume

__all__ = ["Corrected", "Corrections", "Cupping", "Ring", "Trend", "correct_volume", "write_picture"]
