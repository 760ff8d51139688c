#!/usr/bin/env python3
r"""Set planish up in this folder and run it. Needs Python 3.11, 3.12 or 3.13, and nothing else.

    python3 run.py demo     link a made-up specimen; prints the table and the path of the report
    python3 run.py test     run the fast tests; what follows goes to pytest, such as -k flatten
                            --ci runs those that link, open a browser or read whole formats instead
                            --all runs these and all others (Monte Carlo, certificates, whole
                            corpora of damage)
    python3 run.py check    format, lint, types, import contracts, tests (not with --no-tests)
    python3 run.py bench    run the benchmarks
    python3 run.py docs     write the schemas of the results, and build the site into
                            docs/_build/html
    python3 run.py wheel    build wheel and source archive into dist/; same sources, same bytes
    python3 run.py lock     renew requirements/*.lock (needs uv; --upgrade for newer versions)

The first call makes .venv and fills it from the locked requirements, which takes the network and
under a minute; later calls start at once. Afterwards the program itself is .venv/bin/planish
(.venv\Scripts\planish.exe on Windows).
"""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

# Everything above and at the left margin below is read by any Python 3.6, so that an old one gets
# this sentence.
OLDEST, NEWEST = (3, 11), (3, 13)
if not OLDEST <= sys.version_info[:2] <= NEWEST or sys.maxsize < 2**32:
    _found = [name for name in ("python3.13", "python3.12", "python3.11") if shutil.which(name)]
    sys.exit(
        "planish needs a 64-bit Python 3.11, 3.12 or 3.13; this one is {} ({} bit). {}".format(
            ".".join(map(str, sys.version_info[:3])),
            64 if sys.maxsize > 2**32 else 32,
            (
                f"Try: {_found[0]} run.py"
                if _found
                else "Install one of them and start run.py with it."
            ),
        )
    )

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
SCRIPTS = VENV / ("Scripts" if os.name == "nt" else "bin")
SUFFIX = ".exe" if os.name == "nt" else ""
PYTHON = SCRIPTS / f"python{SUFFIX}"
PLANISH = SCRIPTS / f"planish{SUFFIX}"
# Files of tests side by side; `-n 0` after it runs them one after the other, for a debugger.
# tests/tiers.py says which tests run, and puts files that take long first.
PYTEST = [
    *(str(PYTHON), "-m", "pytest", "-n", "auto", "--maxprocesses", "4", "--dist", "loadfile"),
    "--no-loadscope-reorder",
]
LOCKS = ROOT / "requirements"
# Each holds all of those before it, in the same versions.
LOCK_NAMES = ("run.lock", "docs.lock", "dev.lock")
# What was installed; written last, so without it the folder is unfinished.
STAMP = VENV / "planish-setup.json"

# Settings of the user's pip that would send the packages elsewhere or choose others than the lock
# does. Where to get them from (index, folder of wheels, proxy, certificate) stays the user's
# choice.
UNWANTED_PIP = [
    *(
        "CONSTRAINT",
        "DRY_RUN",
        "EDITABLE",
        "IGNORE_INSTALLED",
        "NO_BINARY",
        "NO_DEPS",
        "ONLY_BINARY",
        "PREFIX",
    ),
    *("PYTHON", "REQUIRE_HASHES", "REQUIREMENT", "ROOT", "TARGET"),
]


def main(arguments: list[str]) -> int:  # noqa: PLR0911
    """Carry out one subcommand and return its exit code."""
    name, rest = (arguments[0], arguments[1:]) if arguments else ("--help", [])
    os.chdir(ROOT)
    if name == "demo":
        set_up("run.lock")
        return hand_over([str(PLANISH), "demo", *rest])
    if name == "test":
        set_up("dev.lock")
        return hand_over([*PYTEST, *rest])
    if name == "check" and set(rest) <= {"--no-tests"}:
        set_up("dev.lock")
        return check(tests="--no-tests" not in rest)
    if name == "bench":
        set_up("dev.lock")
        return hand_over([str(PYTHON), "-m", "benchmarks", *rest])
    if name == "docs":
        set_up("docs.lock")
        return docs(rest)
    if name == "wheel" and not rest:
        set_up("run.lock")
        return wheel()
    if name == "lock":
        return lock(rest)
    print((__doc__ or "").strip())
    if name in {"-h", "--help", "help"}:
        return 0
    print("\nNot understood: run.py " + " ".join(arguments), file=sys.stderr)
    return 2


# --- the checks -----------------------------------------------------------------------------------


def check(*, tests: bool) -> int:
    """Run every check to its end, then name those that failed."""
    python = str(PYTHON)
    steps = {
        "format": [python, "-m", "ruff", "format", "--check", "."],
        "lint": [python, "-m", "ruff", "check", "."],
        "types": [python, "-m", "pyright"],
        "imports": [
            python,
            "-c",
            "from importlinter.cli import lint_imports_command; lint_imports_command()",
        ],
    }
    if tests:
        steps["tests"] = PYTEST
    failed: list[str] = []
    for name, command in steps.items():
        say(f"--- {name}")
        if call(command):
            failed.append(name)
    say(f"--- failed: {', '.join(failed)}" if failed else f"--- passed: {', '.join(steps)}")
    return 1 if failed else 0


def docs(options: list[str]) -> int:
    """Write the schemas of the results, build the site, check its links.

    Warnings are errors.
    """
    python, site = str(PYTHON), str(ROOT / "docs" / "_build" / "html")
    doctrees = str(ROOT / "docs" / "_build" / "doctrees")
    build = [
        python,
        "-m",
        "sphinx",
        "-b",
        "html",
        "-E",
        "-a",
        "-W",
        "--keep-going",
        "-q",
        "-d",
        doctrees,
    ]
    build += [*options, "docs", site]
    pages, check = (
        [python, "docs/_ext/program_pages.py"],
        [python, "docs/_ext/check_site.py", "docs/_build/html"],
    )
    for command in (pages, build, check):
        if code := call(command):
            return code
    return 0


def lock(options: list[str]) -> int:
    """Work the three locks out again, with hashes, for every system and Python at once."""
    uv = shutil.which("uv", path=environment()["PATH"])
    if uv is None:
        say("Renewing the locks needs uv, which is not on the path.")
        return 1
    compile_ = [
        uv,
        "pip",
        "compile",
        "--quiet",
        "--universal",
        "--generate-hashes",
        "--python-version",
        "3.11",
    ]
    compile_ += [
        "--no-header",
        "--no-annotate",
        "--no-emit-index-url",
        "--no-emit-find-links",
        *options,
    ]
    compile_ += ["pyproject.toml", "--group", "build"]
    # Each lock constrains the next, so that all three have the same versions.
    for name, more in {
        "run.lock": [],
        "docs.lock": ["--extra", "docs", "-c", "requirements/run.lock"],
        "dev.lock": ["--extra", "docs", "--extra", "dev", "-c", "requirements/docs.lock"],
    }.items():
        if code := call([*compile_, *more, "-o", f"requirements/{name}"]):
            return code
    return 0


# --- what is handed on ----------------------------------------------------------------------------


def wheel() -> int:
    """Build the wheel and the source archive into dist/, in place of those that are there."""
    dist = ROOT / "dist"
    for old in dist.glob("planish-*"):
        old.unlink()
    if code := call([str(PYTHON), "-m", "hatchling", "build", "--directory", str(dist)]):
        return code
    for path in sorted(dist.glob("planish-*")):
        say(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB, sha256 {digest(path)}")
    return 0


# --- setting up -----------------------------------------------------------------------------------


def set_up(lock_name: str) -> None:
    """Bring .venv to the state that the lock and pyproject.toml describe.

    Does nothing where it is there already.
    """
    stamp = read_stamp()
    locks = {name: digest(LOCKS / name) for name in LOCK_NAMES}
    project = digest(ROOT / "pyproject.toml", ROOT / "src" / "planish" / "__init__.py")
    # Scripts in .venv carry the path they were made for.
    moved = stamp.get("root", str(ROOT)) != str(ROOT)
    installed = (
        {} if moved else {name: lock for name, lock in locks.items() if stamp.get(name) == lock}
    )
    if (
        lock_name in installed
        and stamp.get("project") == project
        and PYTHON.exists()
        and PLANISH.exists()
    ):
        return

    STAMP.unlink(missing_ok=True)
    if moved or not usable():
        make_venv()
        installed = {}
    pip = find_pip()
    if lock_name not in installed:
        say(f"Installing the packages of requirements/{lock_name} into .venv ...")
        install(pip, "--require-hashes", "--only-binary=:all:", "-r", str(LOCKS / lock_name))
        installed |= {name: locks[name] for name in LOCK_NAMES[: LOCK_NAMES.index(lock_name) + 1]}
    install(pip, "--no-deps", "--no-build-isolation", "-e", str(ROOT))

    part = STAMP.with_suffix(".part")
    part.write_text(
        json.dumps({"root": str(ROOT), "project": project, **installed}, indent=1),
        encoding="utf-8",
        newline="\n",
    )
    part.replace(STAMP)


def read_stamp() -> dict[str, str]:
    """Return what the last complete set-up noted; empty where there was none."""
    try:
        noted = json.loads(STAMP.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return noted if isinstance(noted, dict) else {}


def digest(*paths: Path) -> str:
    """Return the SHA-256 of the files' bytes, one after the other."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()


def usable() -> bool:
    """Tell if .venv holds an interpreter that starts, has the version, and is an environment."""
    question = (
        "import sys; print(sys.version_info[0], sys.version_info[1], sys.prefix != sys.base_prefix)"
    )
    try:
        answer = subprocess.run(
            [str(PYTHON), "-c", question],
            env=environment(),
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
    except (OSError, subprocess.CalledProcessError):
        return False
    return (
        len(answer) == 3
        and OLDEST <= (int(answer[0]), int(answer[1])) <= NEWEST
        and answer[2] == "True"
    )


def make_venv() -> None:
    """Make an empty .venv in place of whatever is there."""
    if Path(sys.prefix).resolve() == VENV.resolve():
        sys.exit(
            "The environment .venv has to be made anew and is in use: leave it (deactivate) and"
            " start again."
        )
    try:
        import venv
    except ImportError:
        sys.exit(
            "This Python lacks the module venv. On Debian and Ubuntu: apt install python3-venv"
        )
    say("Making .venv ...")
    # Without pip: where ensurepip is missing (Debian without python3-venv) making it with pip stops
    # half way.
    venv.EnvBuilder(clear=True, symlinks=os.name != "nt", with_pip=False).create(VENV)


def find_pip() -> list[str]:
    """Return the command of a pip that installs into .venv.

    It is that of .venv itself, one made by ensurepip, or this Python's.
    """
    own = [str(PYTHON), "-m", "pip"]
    if runs([*own, "--version"]) or runs([str(PYTHON), "-m", "ensurepip", "--default-pip"]):
        return own
    outer = [sys.executable, "-m", "pip", "--python", str(PYTHON)]  # pip 22.3 and later
    if runs([*outer, "--version"]):
        return outer
    sys.exit(
        "This Python has neither ensurepip nor pip 22.3 or later, so nothing can be installed.\n"
        "On Debian and Ubuntu: apt install python3-venv"
    )


def install(pip: list[str], *options: str) -> None:
    """Run one pip install; end with a sentence where it fails."""
    quiet = [
        "--quiet",
        "--disable-pip-version-check",
        "--no-input",
        "--progress-bar=off",
        "--no-warn-script-location",
    ]
    # Not compiled to bytecode ahead: that takes as long as the rest, and most modules are never
    # imported. The first run compiles what it uses; environment() lets it keep that.
    if call([*pip, "install", *quiet, "--no-compile", *options]):
        sys.exit(
            "\nThe installation into .venv failed; pip's reason stands above. Wheels of the locked"
            " versions have to\nbe within reach of pip (its configuration, PIP_INDEX_URL or"
            " PIP_FIND_LINKS). The next call tries again."
        )


# --- running --------------------------------------------------------------------------------------


def environment() -> dict[str, str]:
    """Return the environment for everything started here.

    In it, .venv comes first, and nothing leaks in from outside.
    """
    kept = {
        key: value
        for key, value in os.environ.items()
        if key not in {"PYTHONPATH", "PYTHONHOME", "PYTHONDONTWRITEBYTECODE", "__PYVENV_LAUNCHER__"}
        and key not in {f"PIP_{name}" for name in UNWANTED_PIP}
    }
    return kept | {
        "PATH": str(SCRIPTS) + os.pathsep + kept.get("PATH", os.defpath),
        "VIRTUAL_ENV": str(VENV),
        "PIP_USER": "0",
        "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1",  # else it asks the network for a newer pyright
    }


def runs(command: list[str]) -> bool:
    """Tell whether a command ends well; its output is dropped."""
    return (
        subprocess.run(command, env=environment(), capture_output=True, check=False).returncode == 0
    )


def call(command: list[str]) -> int:
    """Run a command with our output and return its exit code.

    On Ctrl-C the command ends itself first.
    """
    with subprocess.Popen(command, env=environment()) as process:
        while True:
            try:
                return process.wait()
            except KeyboardInterrupt:
                continue


def hand_over(command: list[str]) -> int:
    """Become the command, so that signals and exit codes are its own.

    Windows cannot, there it is waited for.
    """
    if os.name == "nt":
        return call(command)
    sys.stdout.flush()
    os.execve(command[0], command, environment())


def say(text: str) -> None:
    """Print a line at once, so that it stands before the output of what it announces."""
    print(text, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
