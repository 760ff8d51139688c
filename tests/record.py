"""Record the figures of a scenario, and name those that got worse: ``python tests/record.py
FILE``."""

import sys
import tomllib
from pathlib import Path

import tomli_w

from planish.core.errors import FileError
from planish.validate import certify, scenario

_SCENARIO = "small"
_SHARE = 0.02  # of a value that may come and go with the versions of numpy, scipy and the compiler
_SPREADS = 2.0
_FLOOR = {"um": 0.01, "%": 0.01, "deg": 0.01, "1": 0.002, "pitch": 1e-4, "s": 1.0}


def record(certificate):
    """Mean and standard deviation over the seeds of every figure, ready for TOML."""
    figures = {
        name: {"mean": float(f"{found.mean:.5g}"), "sd": float(f"{found.sd or 0.0:.3g}")}
        for name, found in certificate.lines().items()
        if found.mean is not None
    }
    return {
        "scenario": certificate.scenario.name,
        "seeds": [entry.seed for entry in certificate.entries],
        "figures": figures,
    }


def read_recorded(path):
    """Read a record.

    Raises
    ------
    FileError
        If it cannot be read.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise FileError(
            f"{path} cannot be read: {error}. Make it with 'python tests/record.py {path}'."
        ) from error


def worse(certificate, recorded):
    """Name the figures that are worse than recorded by more than the seeds scatter; better ones are
    no fault.

    The allowance is twice the standard deviation over the seeds, 2 % of the value, or a floor,
    whichever is largest. Only figures that say how good something is are compared: where smaller is
    better, their absolute value, and shares of what was found, which ought to be large.
    """
    found = {name: line.mean for name, line in certificate.lines().items() if line.mean is not None}
    faults = []
    for name, old in recorded["figures"].items():
        figure = scenario.FIGURES.get(name)
        if figure is None or figure.better == "neither":
            continue
        if name not in found:
            faults.append(f"{name}: {old['mean']:.4g} was recorded, now there is none")
            continue
        now, then = found[name], float(old["mean"])
        allowed = max(_SPREADS * float(old["sd"]), _SHARE * abs(then), _FLOOR[figure.unit])
        by = abs(now) - abs(then) if figure.better == "small" else then - now
        if by > allowed:
            unit = "" if figure.unit == "1" else f" {figure.unit}"
            faults.append(
                f"{name}: {now:.4g}{unit} now, {then:.4g}{unit} recorded, {allowed:.2g}{unit}"
                " allowed"
            )
    return faults


def main(arguments):
    """Run the scenario and write its record."""
    if len(arguments) != 1:
        sys.stderr.write("usage: python tests/record.py FILE\n")
        return 2

    def report(stage, detail):
        sys.stderr.write(f"{stage}: {detail}\n")

    certificate = certify.run_scenario(scenario.read_scenario(_SCENARIO), progress=report)
    head = (
        "# Figures of the small scenario, mean and standard deviation over its seeds.\n"
        "# Made by: python tests/record.py tests/validate/recorded.toml\n\n"
    )
    Path(arguments[0]).write_text(
        head + tomli_w.dumps(record(certificate)), encoding="utf-8", newline="\n"
    )
    return 0 if certificate.passed else 4


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
