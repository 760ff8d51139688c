"""The command line: parse, call, show. Everything it does is a function of the package."""

import os

# Before numpy is loaded: its matrices here are small, and threads on them cost ten times what they save.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from planish.cli.main import main, planish

__all__ = ["main", "planish"]
