from .notebook import map_html as map_html
from .notebook import results_html as results_html
from .notebook import run_html as run_html
from .old import write_layers_report as write_layers_report
from .old import write_report as write_report
