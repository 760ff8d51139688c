"""``python -m benchmarks [NAME [ARGUMENT]]`` runs all benchmarks, or one."""

from __future__ import annotations

import sys

from benchmarks import acceptance, variants

_ALL = {"acceptance": acceptance.main, "variants": variants.main}


def main(arguments: list[str]) -> int:
    """Run what is named; the exit code is 1 when a limit was missed."""
    names = arguments[:1] or list(_ALL)
    failed = 0
    for name in names:
        print(f"== {name}")
        failed += _ALL[name](*map(int, arguments[1:]))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
