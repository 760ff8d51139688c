"""The whole line, from files to linked maps; the only place where stages meet."""

from planish.pipeline.image import ROWS, link_sheet
from planish.pipeline.layers import link_layers
from planish.pipeline.run import Layers, Progress, Run, is_run, read_run
from planish.pipeline.save import run_study, save_layers, save_run
from planish.pipeline.sheet import map_sheet
from planish.pipeline.volume import join_sections, read_whole

__all__ = [
    "ROWS",
    "Layers",
    "Progress",
    "Run",
    "is_run",
    "join_sections",
    "link_layers",
    "link_sheet",
    "map_sheet",
    "read_run",
    "read_whole",
    "run_study",
    "save_layers",
    "save_run",
]
