"""Installed as users do: wheel and source archive, fresh environments, the locked and the lowest
versions.

    python -m benchmarks installs [PART] [PYTHON]

Parts: demo (also ``planish doctor``); tests (the same, and the fast tests from the unpacked source
archive), where none
is given.
Without PYTHON (3.11, 3.12, 3.13) all interpreters that are found are tried. It takes the network,
and for the lowest
versions uv; what is missing is named and left out.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[1]
_PYTHONS = ("3.11", "3.12", "3.13")
_PIP = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary=:all:")


def main(part="tests", python=None):
    """Print a table; return the number of rows that failed."""
    wanted = (str(python),) if python is not None else _PYTHONS
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wheel, source = _built(folder)
        print(
            f"wheel {wheel.stat().st_size / 1e6:.1f} MB, source archive"
            f" {source.stat().st_size / 1e6:.1f} MB"
        )
        with tarfile.open(source) as tar:
            tar.extractall(folder, filter="data")
        tests = folder / source.name.removesuffix(".tar.gz")
        print(
            "| Python | Versions | Installed, MB | Demo, s | doctor | Fast tests"
            " |\n|---|---|---|---|---|---|"
        )
        for version, kind in [(v, "locked") for v in wanted] + [(v, "lowest") for v in wanted[:1]]:
            found = _interpreter(version)
            if found is None or (kind == "lowest" and shutil.which("uv") is None):
                print(
                    f"| {version} | {kind} | not tried:"
                    f" {'no interpreter' if found is None else 'no uv'} | | | |",
                    flush=True,
                )
                continue
            cells, well = _row(
                found, kind, folder / f"{version}-{kind}", wheel, tests if part == "tests" else None
            )
            print(f"| {' | '.join((version, kind, *cells))} |", flush=True)
            failed += not well
    return failed


def _built(folder):
    """Build both; paths of wheel and source archive."""
    command = [sys.executable, "-m", "hatchling", "build", "--directory", str(folder)]
    subprocess.run(command, cwd=_ROOT, check=True, capture_output=True)
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


def _interpreter(version):
    """An interpreter of this version that starts."""
    names = [sys.executable, shutil.which(f"python{version}")]
    names += map(str, sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python")))
    for name in filter(None, names):
        asked = [name, "-c", "import sys; print('{}.{}'.format(*sys.version_info[:2]))"]
        if (
            subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip()
            == version
        ):
            return name
    return None


def _row(python, kind, folder, wheel, tests):
    """Make an environment, install, try: the cells of a row, and whether all went well."""
    subprocess.run([python, "-m", "venv", str(folder)], check=True)
    scripts = folder / ("Scripts" if os.name == "nt" else "bin")
    own = str(scripts / "python")
    if kind == "locked":
        needed = [
            own,
            *_PIP,
            "--no-deps",
            "--require-hashes",
            "-r",
            str(_ROOT / "requirements" / "dev.lock"),
        ]
    else:
        listed = folder / "lowest.txt"
        command = (
            f"uv pip compile --quiet --resolution lowest-direct --python {own} --extra dev -o"
            f" {listed}"
        )
        subprocess.run(
            [*command.split(), str(_ROOT / "pyproject.toml")], check=True, capture_output=True
        )
        needed = [own, *_PIP, "-r", str(listed)]
    env = {
        k: v
        for k, v in os.environ.items()
        if k not in ("PYTHONPATH", "PYTHONHOME", "NUMBA_CACHE_DIR")
    }
    env |= {"PATH": f"{scripts}{os.pathsep}{env['PATH']}", "OPENBLAS_NUM_THREADS": "1"}
    for command in (needed, [own, *_PIP, "--no-deps", str(wheel)]):
        subprocess.run(command, check=True, env=env)
    size = (
        sum(p.stat().st_size for p in folder.rglob("*") if p.is_file() and not p.is_symlink()) / 1e6
    )
    start = time.monotonic()
    planish = str(scripts / "planish")
    demo = subprocess.run(
        [planish, "demo", "--out", str(folder / "demo")], env=env, capture_output=True, check=False
    )
    took = time.monotonic() - start
    doctor = subprocess.run(
        [planish, "doctor", "--json"], env=env, capture_output=True, text=True, check=False
    )
    well = demo.returncode in (0, 4) and doctor.returncode == 0
    said = "well" if doctor.returncode == 0 else _ill(doctor.stdout)
    passed = "not run"
    if tests is not None:
        command = f"{own} -m pytest -q -n 1 --dist loadfile -p no:cacheprovider tests"
        run = subprocess.run(
            command.split(), cwd=tests, env=env, capture_output=True, text=True, check=False
        )
        lines = run.stdout.splitlines()
        passed = re.sub(r"=+", "", lines[-1]).strip() if lines else run.stderr[-200:]
        well = well and run.returncode == 0
        for line in lines:
            if line.startswith(("FAILED", "ERROR")):
                print(f"  {line}", file=sys.stderr)
    shutil.rmtree(folder)
    return (f"{size:.0f}", f"{took:.0f} (exit {demo.returncode})", said, passed), well


def _ill(text):
    """Names of the checks that do not pass."""
    try:
        return ", ".join(
            c["name"] for c in json.loads(text)["checks"] if c["state"] in ("look", "fail")
        )
    except (ValueError, KeyError):
        return text[-200:]
