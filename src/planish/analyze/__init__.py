"""From maps on one grid to point-wise correlation."""

from planish.analyze.correlate import Correlation, correlate, correlate_at

__all__ = ["Correlation", "correlate", "correlate_at"]
