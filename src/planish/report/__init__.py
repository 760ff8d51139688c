"""From results to one HTML page that can be handed on."""

from planish.report.page import write_report

__all__ = ["write_report"]
