"""Tell whether this installation can do its work.

``planish doctor`` reports it, in a form that can be mailed.
"""

import importlib
import locale
import os
import pkgutil
import platform
import re
import shutil
import struct
import sys
import tempfile
from collections.abc import Iterable, Iterator
from importlib import metadata
from itertools import chain
from pathlib import Path
from types import FunctionType
from typing import Any

from packaging.requirements import Requirement

import planish
from planish import exports
from planish.core.checks import Check
from planish.core.errors import PlanishError
from planish.core.files import longest_path
from planish.core.memory import FREE_SHARE
from planish.core.plugins import GROUPS, Kind, find_plugin, plugins
from planish.core.source_hash import PACKAGE, find_commit, hash_sources, report_to
from planish.core.text import without_folders
from planish.core.threads import available
from planish.io.formats import FORMATS, PICTURES, TIFF
from planish.io.guard import default_memory_limit
from planish.measure import Property, registered

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
        "source": f"commit {find_commit()}" if find_commit() else f"sources {hash_sources()}",
        "report": f"Report faults {report_to()}.",
    }


def report_text() -> str:
    """What is handed on with a report: versions, settings, checks, the last fault; no folders."""
    prefixes = ("PLANISH_", "NUMBA_", "OMP_", "OPENBLAS_", "LANG", "LC_", "TMP")
    names = [name for name in sorted(os.environ) if name.startswith(prefixes)]
    settings = [f"{name}={os.environ[name]}" for name in names]
    checks = [
        f"{check.state} {check.name}: {check.sentence} {check.advice}".rstrip()
        for check in check_installation()
    ]
    sections = {
        "Installation": describe_installation().values(),
        "Settings": settings or ["none"],
        "Checks": checks,
        "Last fault": [_last_fault()],
    }
    lines = [f"# {name}\n" + "\n".join(texts) for name, texts in sections.items()]
    text = "\n\n".join(lines).replace(f"{PACKAGE.parent}{os.sep}", "")
    return f"{without_folders(text)}\n"


def _last_fault() -> str:
    """Text of the newest log of a fault that may be read."""
    logs = Path(tempfile.gettempdir()).glob("planish-*.log")
    readable_logs = [log for log in logs if os.access(log, os.R_OK)]
    if not readable_logs:
        return "none"
    newest = max(readable_logs, key=lambda log: log.stat().st_mtime)
    return newest.read_text(encoding="utf-8", errors="replace").rstrip()


def check_installation() -> Iterator[Check]:
    """Check one thing after the other.

    States other than ``pass`` and ``unknown`` come with what to do.

    Names of folders are not in it, but for a folder that cannot be written.
    """
    version = platform.python_version()
    bits = struct.calcsize("P") * 8
    is_supported = bits == 64 and (3, 11) <= sys.version_info[:2] <= (3, 14)
    advice = "" if is_supported else "Needed is a 64-bit Python from 3.11 to 3.14."
    yield _check(
        "Python", f"{version}, {bits} bit.", state="pass" if is_supported else "fail", advice=advice
    )
    yield _command()
    yield _libraries()
    yield _compile_cache()
    free_gb = int(default_memory_limit() / FREE_SHARE) / 1e9
    sentence = f"{free_gb:.1f} GB are free; a run takes half of that where --memory is not given."
    advice = (
        f"Close other programs; volumes of more than {free_gb / 3:.1g} GB want 'planish import'"
        " first."
    )
    yield _check(
        "memory", sentence, advice=advice if free_gb < 2 else "", value=free_gb, units="GB"
    )
    yield _check("processors", f"{available()} may be used; {os.cpu_count()} are there.")
    temporary_advice = "Set TMPDIR (on Windows TMP) to a folder that you may write."
    yield _disk("temporary folder", Path(tempfile.gettempdir()), temporary_advice)
    yield _disk("this folder", Path.cwd(), "Go to another folder, or give one with --out.")
    yield _console()
    if os.name == "nt":
        if longest_path() is None:
            yield _check("long paths", "Windows takes paths of more than 259 characters.")
        else:
            short_text = (
                "Windows takes paths of up to 259 characters; runs in deep folders are refused."
            )
            yield _check("long paths", short_text, state="unknown")
    for extra, purpose in EXTRAS.items():
        yield _extra(extra, purpose)
    if any(map(plugins, GROUPS)):
        yield _packages()


def _check(name: str, sentence: str, *, advice: str = "", state: Any = None, **more: Any) -> Check:
    return Check(
        name=name,
        state=state or ("look" if advice else "pass"),
        sentence=sentence,
        advice=advice,
        **more,
    )


def _command() -> Check:
    program = shutil.which("planish")
    if program is None:
        advice = "Activate its environment, or write the path of the program in front of its name."
        return _check(
            "command", "planish is not on the search path.", state="unknown", advice=advice
        )
    # Tools that give a program an environment of its own put a link to it on the path.
    programs = (Path(program).absolute(), Path(program).resolve())
    if Path(sys.executable).absolute().parent in [path.parent for path in programs]:
        return _check("command", "planish in a terminal is this installation.")
    advice = "Compare 'planish --version' with the first line."
    return _check(
        "command",
        "planish in a terminal may be another installation.",
        state="unknown",
        advice=advice,
    )


def _libraries() -> Check:
    """Versions of all libraries against the lower bounds, and whether they can be imported."""
    requirements = _requirements(None)
    if requirements is None:
        return _check(
            "libraries", "planish runs from a folder and is not installed.", state="unknown"
        )
    versions: list[str] = []
    faults: list[str] = []
    for requirement in requirements:
        version, fault = _version_and_fault(requirement)
        versions.append(f"{requirement.name} {version}")
        if fault:
            faults.append(fault)
    if faults:
        how = "pip install --upgrade, and the path of its wheel or folder."
        advice = f"Install planish again, best into an environment of its own: {how}"
        return _check("libraries", f"{'; '.join(faults)}.", state="fail", advice=advice)
    return _check("libraries", f"{', '.join(versions)}.")


def _version_and_fault(requirement: Requirement) -> tuple[str, str | None]:
    """Version of a library, and what is wrong with it, if anything."""
    try:
        version = metadata.version(requirement.name)
    except metadata.PackageNotFoundError:
        return "missing", f"{requirement.name} is missing"
    if not requirement.specifier.contains(version, prereleases=True):
        return version, f"{requirement.name} is {version}, needed is {requirement.specifier}"
    try:
        for module in _modules_of(requirement.name):
            importlib.import_module(module)
    except Exception as error:  # noqa: BLE001  # a library that does not load may raise anything
        reason = " ".join(str(error).split())[:120]
        return version, f"{requirement.name} {version} cannot be loaded ({reason})"
    return version, None


def _modules_of(library: str) -> list[str]:
    """Names by which a library is imported, which need not be its own."""
    files = metadata.files(library) or []
    packages = [file.parts[0] for file in files if file.name == "__init__.py"]
    modules = [file.stem for file in files if len(file.parts) == 1 and file.suffix == ".py"]
    names = dict.fromkeys([*packages, *modules])
    plain = _plain(library)
    matching = [name for name in names if _plain(name) in plain or plain in _plain(name)]
    return matching or [name for name in names if name.isidentifier() and name[0] != "_"][:1]


def _plain(name: str) -> str:
    return re.sub("[-_.]", "", name.casefold())


def _requirements(extra: str | None) -> list[Requirement] | None:
    """What planish, or one of its extras, needs on this machine.

    None where planish is not installed.
    """
    try:
        texts = metadata.requires("planish") or []
    except metadata.PackageNotFoundError:
        return None
    requirements: list[Requirement] = []
    for requirement in map(Requirement, texts):
        marker = requirement.marker
        is_of_extra = "extra" in str(marker)
        applies = marker is None or marker.evaluate({"extra": extra or ""})
        if applies and is_of_extra == (extra is not None):
            requirements.append(requirement)
    return requirements


def _compile_cache() -> Check:
    """Whether kernels can be loaded, and kept where they are compiled."""
    name = "compile cache"
    try:
        kernels = list(_kernels())
    except (ImportError, OSError) as error:
        return _check(
            name, f"The kernels cannot be loaded ({error}).", state="fail", advice="See libraries."
        )
    except RuntimeError as error:
        if not is_no_cache(error):
            raise
        return _check(name, NO_CACHE, state="fail", advice=ANOTHER_CACHE)
    folders = set[Path]()
    n_compiled = 0
    for kernel in kernels:
        folder = Path(kernel.stats.cache_path)
        folders.add(folder)
        module_name = kernel.py_func.__module__.rpartition(".")[2]
        n_compiled += any(folder.glob(f"{module_name}.{kernel.py_func.__qualname__}-*.nbi"))
    for folder in sorted(folders):
        if not _is_writable(folder):
            sentence = f"{_without_user(folder)} cannot be written."
            return _check(name, sentence, state="fail", advice=ANOTHER_CACHE)
    is_beside = all(folder.name == "__pycache__" for folder in folders)
    place_text = "beside the program" if is_beside else "in the user's folder for caches"
    cache_dir = os.environ.get("NUMBA_CACHE_DIR")
    if cache_dir and all(folder.is_relative_to(cache_dir) for folder in folders):
        place_text = "in NUMBA_CACHE_DIR"
    sentence = f"{n_compiled} of {len(kernels)} kernels are compiled and kept {place_text}."
    if not n_compiled:
        sentence += " The first run takes about a minute longer, to compile them."
    return _check(name, sentence)


def _kernels() -> Iterator[Any]:
    for info in pkgutil.walk_packages(planish.__path__, "planish."):
        if info.name.rpartition(".")[2].startswith("_") and info.name.endswith("kernels"):
            for function in vars(importlib.import_module(info.name)).values():
                module_name = getattr(getattr(function, "py_func", None), "__module__", "")
                if module_name == info.name and function.stats.cache_path:
                    yield function


def _without_user(folder: Path) -> str:
    try:
        return f"~/{folder.relative_to(Path.home()).as_posix()}"
    except ValueError:
        return str(folder)


def _is_writable(folder: Path) -> bool:
    """Whether a file can be made in a folder, which is made where it is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _disk(name: str, folder: Path, other_folder_advice: str) -> Check:
    free_gb = shutil.disk_usage(folder).free / 1e9
    if not _is_writable(folder):
        return _check(
            name,
            f"{_without_user(folder)} cannot be written.",
            state="fail",
            advice=other_folder_advice,
        )
    advice = "Free some space: maps, working stores and tiles need it." if free_gb < 2 else ""
    return _check(
        name,
        f"{free_gb:.1f} GB are free, and it can be written.",
        advice=advice,
        value=free_gb,
        units="GB",
    )


def _console() -> Check:
    terminal = "no terminal"
    if sys.stdout.isatty():
        terminal = f"a terminal of {shutil.get_terminal_size().columns} columns"
    streams = f"output {sys.stdout.encoding}, messages {sys.stderr.encoding}"
    files = f"names of files {sys.getfilesystemencoding()}"
    texts = f"texts of other programs {locale.getpreferredencoding(do_setlocale=False)}"
    utf8 = f"UTF-8 mode {'on' if sys.flags.utf8_mode else 'off'}"
    return _check("console", f"{streams}; {files}, {texts}; {utf8}; {terminal}.")


def _packages() -> Check:
    """What other packages add; each is imported."""
    endings = [end for form in (*FORMATS, *PICTURES, TIFF) for end in form.suffixes]
    planish_kinds: dict[Kind, tuple[type, Iterable[str]]] = {
        "property": (Property, registered()),
        "format": (FunctionType, {end[1:] for end in endings}),
        "export": (exports.ExportFormat, exports.FORMATS),
    }
    faults = list[str]()
    names = list[str]()
    for plugin in chain.from_iterable(map(plugins, GROUPS)):
        names.append(f"{plugin.package} {plugin.version} ({plugin.kind} {plugin.name})")
        expected, planish_names = planish_kinds[plugin.kind]
        if plugin.name in planish_names:
            faults.append(f"{plugin} is not used: planish has that name itself.")
            continue
        try:
            find_plugin(plugin.kind, plugin.name)
            plugin.load(expected)
        except PlanishError as error:
            faults.append(error.text)
    advice = " ".join(dict.fromkeys(faults))
    return _check("packages", f"{', '.join(names)}.", advice=advice)


def _extra(extra: str, purpose: str) -> Check:
    """Check the packages of an optional part: installed, missing, or of a wrong version."""
    name = f"extra {extra}"
    requirements = _requirements(extra)
    if requirements is None:
        return _check(name, f"{purpose}.", state="unknown")
    versions: list[str] = []
    wrong_packages: list[str] = []
    faults: list[str] = []
    for requirement in requirements:
        version, fault = _version_and_fault(requirement)
        versions.append(f"{requirement.name} {version}")
        if fault and version != "missing":
            faults.append(fault)
            wrong_packages.append(f'"{requirement.name}{requirement.specifier}"')
    if faults:
        advice = f"Run: pip install --upgrade {' '.join(wrong_packages)}"
        return _check(name, f"{'; '.join(faults)}.", advice=advice)
    if any(version.endswith(" missing") for version in versions):
        return _check(name, f'not installed; pip install "planish[{extra}]" gives it: {purpose}.')
    return _check(name, f"installed ({', '.join(versions)}): {purpose}.")
