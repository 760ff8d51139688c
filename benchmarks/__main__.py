"""``python -m benchmarks [NAME [ARGUMENTS]]`` runs all benchmarks, or one."""

from __future__ import annotations

import os
import sys
from importlib import import_module

# Each is the function ``main`` of the module of its name, which is imported when it is run: no
# benchmark needs the libraries of another.
_ALL = (
    "flattening",
    "relaxation",
    "optics",
    "holes",
    "no_holes",
    "no_holes_layers",
    "no_holes_scales",
    "texture_fields",
    "strained",
    "registration",
    "specimens",
    "size",
    "startup",
    "large_image",
    "programs",
    "series",
    "series_runs",
    "sides",
    "wrong",
    "right",
    "through_scale",
    "errors",
    "gains",
    "evidence",
    "explain",
    "explain_fibres",
    "scales",
    "uneven",
    "even_light",
    "scanner",
    "fuzz",
    "app",
    "faces",
    "paper",
)
# Only where they are named: two take the network and half an hour, two write documents.
_BY_NAME = ("installs", "pictures", "report", "same")


def main(arguments):
    """Run what is named; the exit code is 1 when a limit was missed or a library is not
    installed."""
    names = arguments[:1] or _ALL
    # Else each program that is timed compiles its modules anew.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    failed = 0
    for name in names:
        if name not in (*_ALL, *_BY_NAME):
            sys.exit(
                f"There is no benchmark '{name}'. Choose one of {', '.join((*_ALL, *_BY_NAME))}."
            )
        print(f"== {name}")
        try:
            benchmark = import_module(f"benchmarks.{name}").main
            failed += benchmark(*(int(a) if a.isdigit() else a for a in arguments[1:]))
        except ModuleNotFoundError as error:
            print(f"not run: {error.name} is not installed")
            failed += 1
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
