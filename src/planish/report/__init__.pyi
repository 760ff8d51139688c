from .old import write_layers_report as write_layers_report
from .old import write_report as write_report
