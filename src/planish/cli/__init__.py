"""The command line: parse, call, show. Everything it does is a function of the package.

``main`` is the group; ``options`` are made of parameter models. ``runs``, ``stages``, ``series``,
``files``, ``marks``, ``export``, ``validate`` and ``setup`` hold the commands; ``show`` and
``console`` what a terminal shows.
"""

import os

# Before numpy is loaded: its matrices here are small, and threads on them cost ten times what they
# save.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from planish.cli.main import main, planish

__all__ = ["main", "planish"]
