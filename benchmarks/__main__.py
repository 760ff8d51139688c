"""``python -m benchmarks [NAME [ARGUMENTS]]`` runs all benchmarks, or one."""

from __future__ import annotations

import sys

from benchmarks import (
    app,
    app_apply,
    app_space,
    artefacts,
    brightness,
    errors,
    evidence,
    exporting,
    faces,
    flattening,
    fuzz,
    holes,
    installs,
    large_image,
    matching,
    optics,
    pictures,
    programs,
    properties,
    registration,
    relaxation,
    resampling,
    resume,
    right,
    series,
    series_runs,
    same,
    sides,
    size,
    specimens,
    through_scale,
    uneven,
    variants,
    warping,
    wrong,
)

_MODULES = (
    app_apply,
    variants,
    flattening,
    relaxation,
    resampling,
    matching,
    optics,
    holes,
    properties,
    registration,
    specimens,
    size,
    large_image,
    exporting,
    programs,
    resume,
    series,
    series_runs,
    same,
    sides,
    artefacts,
    brightness,
    warping,
    wrong,
    right,
    through_scale,
    errors,
    evidence,
    uneven,
    fuzz,
    app,
)
_ALL = {k.__name__.rpartition(".")[2]: k.main for k in _MODULES} | {"surfaces": faces.main}
# Only where they are named: one takes the network and half an hour, one writes documents, one wants a run.
_BY_NAME = {"installs": installs.main, "pictures": pictures.main, "app_space": app_space.main}


def main(arguments: list[str]) -> int:
    """Run what is named; the exit code is 1 when a limit was missed."""
    names = arguments[:1] or list(_ALL)
    failed = 0
    for name in names:
        known = _ALL | _BY_NAME
        if name not in known:
            sys.exit(f"There is no benchmark '{name}'. Choose one of {', '.join(known)}.")
        print(f"== {name}")
        failed += known[name](*(int(a) if a.isdigit() else a for a in arguments[1:]))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
