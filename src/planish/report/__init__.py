"""From results to one HTML page that can be handed on."""

from planish.report.layers import write_layers_report
from planish.report.page import write_report

__all__ = ["write_layers_report", "write_report"]
