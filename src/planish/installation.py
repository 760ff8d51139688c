"""Whether this installation can do its work: what ``planish doctor`` reports, in a form that can be mailed."""

from __future__ import annotations

import importlib
import locale
import os
import pkgutil
import platform
import shutil
import struct
import sys
import tempfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

import planish
from planish.core.checks import Check
from planish.core.files import longest_path
from planish.core.memory import FREE_SHARE
from planish.core.threads import available
from planish.io.guard import default_memory_limit

EXTRAS = {
    "formats": "reads packed MHA and MHD, and files of instruments for topography",
    "refine": "registration refined by the images themselves (--refine)",
    "export": "maps for NetCDF and Gwyddion, a run as RO-Crate (planish export)",
    "parquet": "the figures of a series as Parquet (planish study, planish compare)",
    "cluster": "work on several machines or processes (--scheduler)",
}
"""Extra of the package -> what it gives."""

NO_CACHE = "No folder can be written in which compiled kernels could be kept."
ANOTHER_CACHE = "Set the variable NUMBA_CACHE_DIR to a folder that you may write."


def is_no_cache(error: Exception) -> bool:
    """Whether numba found no folder for compiled kernels, which it says when one is loaded."""
    return isinstance(error, RuntimeError) and "cannot cache function" in str(error)


def describe_installation() -> dict[str, str]:
    """Versions of planish, Python and system."""
    bits = struct.calcsize("P") * 8
    return {
        "planish": planish.__version__,
        "python": f"{platform.python_version()} ({platform.python_implementation()}, {bits} bit)",
        "system": f"{platform.system()} {platform.release()} ({platform.machine()})",
    }


def check_installation() -> Iterator[Check]:
    """Check one thing after the other; states other than ``pass`` and ``unknown`` come with what to do.

    Names of folders are not in it, but for a folder that cannot be written.
    """
    version, bits = platform.python_version(), struct.calcsize("P") * 8
    needed = "" if bits == 64 and (3, 11) <= sys.version_info[:2] <= (3, 13) else "3.11 to 3.13"
    advice = f"Needed is a 64-bit Python from {needed}." if needed else ""
    yield _check("Python", f"{version}, {bits} bit.", state="fail" if needed else "pass", advice=advice)
    yield _command()
    yield _libraries()
    yield _compile_cache()
    free = int(default_memory_limit() / FREE_SHARE)
    sentence = f"{free / 1e9:.1f} GB are free; a run takes half of that where --memory is not given."
    low = f"Close other programs; volumes of more than {free / 3e9:.1g} GB want 'planish import' first."
    yield _check("memory", sentence, advice=low if free < 2e9 else "", value=free / 1e9, units="GB")
    yield _check("processors", f"{available()} may be used; {os.cpu_count()} are there.")
    temporary = "Set TMPDIR (on Windows TMP) to a folder that you may write."
    yield _disk("temporary folder", Path(tempfile.gettempdir()), temporary)
    yield _disk("this folder", Path.cwd(), "Go to another folder, or give one with --out.")
    yield _console()
    if os.name == "nt":
        is_short = longest_path() is not None
        short = "Windows takes paths of up to 259 characters; runs in deep folders are refused."
        text = short if is_short else "Windows takes paths of more than 259 characters."
        yield _check("long paths", text, state="unknown" if is_short else "pass")
    for extra, gives in EXTRAS.items():
        yield _extra(extra, gives)


def _check(name: str, sentence: str, *, advice: str = "", state: Any = None, **more: Any) -> Check:
    return Check(name=name, state=state or ("look" if advice else "pass"), sentence=sentence, advice=advice, **more)


def _command() -> Check:
    """Whether the command in the terminal is this installation."""
    program = shutil.which("planish")
    if program is None:
        sentence = "planish is not on the search path."
        advice = "Activate its environment, or write the path of the program in front of its name."
        return _check("command", sentence, state="unknown", advice=advice)
    # Tools that give a program an environment of its own put a link to it on the path.
    if Path(sys.executable).absolute().parent in (Path(program).absolute().parent, Path(program).resolve().parent):
        return _check("command", "planish in a terminal is this installation.")
    sentence = "planish in a terminal may be another installation."
    advice = "Compare 'planish --version' with the first line."
    return _check("command", sentence, state="unknown", advice=advice)


def _libraries() -> Check:
    """Versions of all libraries against the lower bounds, and whether they can be imported."""
    needed = _requirements(None)
    if needed is None:
        return _check("libraries", "planish runs from a folder and is not installed.", state="unknown")
    versions = [(requirement.name, *_fault_of(requirement)) for requirement in needed]
    if wrong := [fault for _, _, fault in versions if fault]:
        how = "pip install --upgrade, and the path of its wheel or folder."
        advice = f"Install planish again, best into an environment of its own: {how}"
        return _check("libraries", f"{'; '.join(wrong)}.", state="fail", advice=advice)
    return _check("libraries", f"{', '.join(f'{library} {version}' for library, version, _ in versions)}.")


def _fault_of(requirement: Requirement) -> tuple[str, str | None]:
    """Version of a library, and what is wrong with it."""
    try:
        version = metadata.version(requirement.name)
    except metadata.PackageNotFoundError:
        return "missing", f"{requirement.name} is missing"
    if not requirement.specifier.contains(version, prereleases=True):
        return version, f"{requirement.name} is {version}, needed is {requirement.specifier}"
    try:
        for module in _modules(requirement.name):
            importlib.import_module(module)
    except Exception as error:  # noqa: BLE001  # a library that does not load may raise anything
        return version, f"{requirement.name} {version} cannot be loaded ({' '.join(str(error).split())[:120]})"
    return version, None


def _modules(library: str) -> list[str]:
    """Names by which the packages of a library are imported, which need not be its own."""
    files = [str(file) for file in metadata.files(library) or ()]
    packages = [file.split("/")[0] for file in files if file.endswith("/__init__.py")]
    single = [file.removesuffix(".py") for file in files if "/" not in file and file.endswith(".py")]
    modules = dict.fromkeys([*packages, *single])
    alike = [name for name in modules if _plain(name) in _plain(library) or _plain(library) in _plain(name)]
    return alike or [name for name in modules if name.isidentifier() and not name.startswith("_")][:1]


def _plain(name: str) -> str:
    return name.casefold().replace("-", "").replace("_", "").replace(".", "")


def _requirements(extra: str | None) -> list[Requirement] | None:
    """What planish, or one of its extras, needs on this machine; None where planish is not installed."""
    try:
        texts = metadata.requires("planish") or []
    except metadata.PackageNotFoundError:
        return None
    needed: list[Requirement] = []
    for requirement in map(Requirement, texts):
        marker = requirement.marker
        is_extra = marker is not None and "extra" in str(marker)
        if is_extra == (extra is not None) and (marker is None or marker.evaluate({"extra": extra or ""})):
            needed.append(requirement)
    return needed


def _compile_cache() -> Check:
    """Whether compiled kernels can be kept, and how many are."""
    name = "compile cache"
    try:
        kernels = list(_kernels())
    except (ImportError, OSError) as error:
        return _check(name, f"The kernels cannot be loaded ({error}).", state="fail", advice="See libraries.")
    except RuntimeError as error:
        if not is_no_cache(error):
            raise
        return _check(name, NO_CACHE, state="fail", advice=ANOTHER_CACHE)
    folders, compiled = set[Path](), 0
    for kernel in kernels:
        folders.add(folder := Path(kernel.stats.cache_path))
        index = f"{kernel.py_func.__module__.rpartition('.')[2]}.{kernel.py_func.__qualname__}-*.nbi"
        compiled += any(folder.glob(index))
    for folder in sorted(folders):
        if not _may_write(folder):
            return _check(name, f"{_short(folder)} cannot be written.", state="fail", advice=ANOTHER_CACHE)
    where = "beside the program" if all(f.name == "__pycache__" for f in folders) else "in the user's folder for caches"
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen and all(folder.is_relative_to(chosen) for folder in folders):
        where = "in NUMBA_CACHE_DIR"
    first = "" if compiled else " The first run takes about a minute longer, to compile them."
    return _check(name, f"{compiled} of {len(kernels)} kernels are compiled and kept {where}.{first}")


def _kernels() -> Iterator[Any]:
    """All compiled functions of the package that keep their code."""
    for info in pkgutil.walk_packages(planish.__path__, "planish."):
        if info.name.rpartition(".")[2].startswith("_") and info.name.endswith("kernels"):
            module = importlib.import_module(info.name)
            for value in vars(module).values():
                if hasattr(value, "py_func") and value.py_func.__module__ == info.name and value.stats.cache_path:
                    yield value


def _short(folder: Path) -> str:
    """A folder without the name of the user."""
    try:
        return f"~/{folder.relative_to(Path.home()).as_posix()}"
    except ValueError:
        return str(folder)


def _may_write(folder: Path) -> bool:
    """Whether a file can be made in a folder, which is made where it is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _disk(name: str, folder: Path, elsewhere: str) -> Check:
    free = shutil.disk_usage(folder).free
    if not _may_write(folder):
        return _check(name, f"{_short(folder)} cannot be written.", state="fail", advice=elsewhere)
    sentence = f"{free / 1e9:.1f} GB are free, and it can be written."
    low = "Free some space: maps, working stores and tiles need it."
    return _check(name, sentence, advice=low if free < 2e9 else "", value=free / 1e9, units="GB")


def _console() -> Check:
    """Encodings and appearance of the terminal."""
    terminal = f"a terminal of {shutil.get_terminal_size().columns} columns" if sys.stdout.isatty() else "no terminal"
    streams = f"output {sys.stdout.encoding}, messages {sys.stderr.encoding}"
    files = f"names of files {sys.getfilesystemencoding()}"
    texts = f"texts of other programs {locale.getpreferredencoding(do_setlocale=False)}"
    utf8 = f"UTF-8 mode {'on' if sys.flags.utf8_mode else 'off'}"
    return _check("console", f"{streams}; {files}, {texts}; {utf8}; {terminal}.")


def _extra(extra: str, gives: str) -> Check:
    name = f"extra {extra}"
    needed = _requirements(extra)
    if needed is None:
        return _check(name, f"{gives}.", state="unknown")
    faults = [(requirement.name, *_fault_of(requirement)) for requirement in needed]
    wrong = {library: fault for library, version, fault in faults if fault and version != "missing"}
    if wrong:
        again = " ".join(f'"{library.name}{library.specifier}"' for library in needed if library.name in wrong)
        return _check(name, f"{'; '.join(wrong.values())}.", advice=f"Run: pip install --upgrade {again}")
    if any(version == "missing" for _, version, _ in faults):
        return _check(name, f'not installed; pip install "planish[{extra}]" gives it: {gives}.')
    return _check(name, f"installed ({', '.join(f'{library} {v}' for library, v, _ in faults)}): {gives}.")
