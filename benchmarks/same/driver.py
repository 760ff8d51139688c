"""Run commands of the installed planish, a child process each, on one core: what each side of a
comparison is.

Reads ``{"arguments": [...], "output": PATH}`` line by line, and answers with the exit code. The
libraries are imported once; no module of planish is, so that nothing passes from one command to the
next.
"""

import importlib
import json
import os
import sys
from pathlib import Path

_LIBRARIES = ("numba", "numpy", "pydantic", "rich", "scipy.ndimage", "tifffile", "xarray", "zarr")


def main():
    """Serve until the input ends."""
    os.sched_setaffinity(0, {int(sys.argv[1])})
    for name in _LIBRARIES:
        importlib.import_module(name)
    for line in sys.stdin:
        asked = json.loads(line)
        child = os.fork()
        if child == 0:
            for number, suffix in ((1, asked["suffix"]), (2, ".err")):
                with Path(asked["output"] + suffix).open("wb") as file:
                    os.dup2(file.fileno(), number)
            importlib.import_module("planish.cli").main(asked["arguments"])  # ends with SystemExit
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


if __name__ == "__main__":
    main()
