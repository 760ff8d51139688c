"""``python -m benchmarks NAME [ARGUMENTS]``: acceptance, variants, flattening, relaxation or resampling."""

import sys

from benchmarks import acceptance, flattening, relaxation, resampling, variants


def _number(text):
    return int(text) if text.lstrip("-").isdigit() else text


def main():
    parts = {k.__name__.rpartition(".")[2]: k for k in (acceptance, variants, flattening, relaxation, resampling)}
    name, *arguments = sys.argv[1:] or ["acceptance"]
    if name not in parts:
        sys.exit(f"There is no benchmark '{name}'. Choose one of {', '.join(parts)}.")
    return parts[name].main(*map(_number, arguments))


if __name__ == "__main__":
    sys.exit(main())
