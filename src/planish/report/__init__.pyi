from .notebook import map_html as map_html
from .notebook import results_html as results_html
from .notebook import run_html as run_html
from .page import FIGURES as FIGURES
from .page import write_report as write_report
from .series import SmallMap as SmallMap
from .series import series_page as series_page
from .series import small_map as small_map
