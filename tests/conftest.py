"""What all tests share: specimens, measured data, repeatable property tests, studies, the limit on CPU time."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from folders import chromium_path, make_once

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line has it; tests run side by side

import numpy as np
import pytest
import tifffile
from filelock import FileLock
from hypothesis import settings
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from planish.cli import main
from planish.run import link, open_run
from planish.synthetic import (
    BurnParams,
    CameraParams,
    ScannerParams,
    SpecimenParams,
    Warp,
    make_specimen,
    write_instruments,
)

ROOT = Path(__file__).resolve().parents[1]

# The same cases on every run, and no time limit on a case: the first one compiles the kernels.
settings.register_profile("planish", derandomize=True, deadline=None)
settings.load_profile("planish")


# --- the fast set and the studies ----------------------------------------------------------------------------
def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--all`` and ``--cpu-limit``."""
    group = parser.getgroup("planish")
    group.addoption("--all", action="store_true", help="run the studies too")
    group.addoption("--cpu-limit", type=float, metavar="SECONDS", help="fail if a fast test uses more CPU time, warm")
    group.addoption("--warm", action="store_true", help="all is compiled: --cpu-limit decides")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark tests on measured data, leave the studies out unless they are asked for, put the longest files first."""
    for item in items:
        if "shared_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.realdata)
    studies = [item for item in items if item.get_closest_marker("study")]
    wanted = config.option.all or "study" in config.option.markexpr or any("::" in name for name in config.args)
    if studies and not wanted:
        config.hook.pytest_deselected(items=studies)
        items[:] = [item for item in items if not item.get_closest_marker("study")]
    # Short files at the end let the workers finish together.
    links = {"specimen", "specimen_files", "measured"}
    long = {item.path for item in items if links & set(getattr(item, "fixturenames", ()))}
    long |= {item.path for item in studies}
    items.sort(key=lambda item: item.path not in long)


# --- CPU time of each test -----------------------------------------------------------------------------------

SHARED = pytest.StashKey[float]()  # CPU seconds spent in fixtures that several tests share
USED = pytest.StashKey[float]()


def cpu_seconds() -> float:
    """CPU time of this process, all its threads, and its children that ended."""
    return sum(os.times()[:4])


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
) -> Generator[None, object, object]:
    """Take the time of a shared fixture off the test that happens to make it."""
    session = request.session
    if fixturedef.scope == "function" or (SHARED in session.stash and session.stash[SHARED] < 0):
        return (yield)
    before, spent = cpu_seconds(), session.stash.get(SHARED, 0.0)
    session.stash[SHARED] = -1.0  # a shared fixture within a shared fixture counts once
    try:
        return (yield)
    finally:
        session.stash[SHARED] = spent + cpu_seconds() - before


def count(item: pytest.Item) -> Generator[None, object, object]:
    """Add what the wrapped step uses to the test's CPU time."""
    before, shared = cpu_seconds(), item.session.stash.get(SHARED, 0.0)
    try:
        return (yield)
    finally:
        used = cpu_seconds() - before - (item.session.stash.get(SHARED, 0.0) - shared)
        item.stash[USED] = item.stash.get(USED, 0.0) + used


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, object, object]:
    return (yield from count(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    try:
        return (yield from count(item))
    finally:
        item.user_properties.append(("study" if item.get_closest_marker("study") else "cpu_s", item.stash[USED]))


class CpuLimit:
    """Collects the tests above the limit; those of a cold run are taken again, warm and one after the other."""

    def __init__(self, limit: float, *, warm: bool) -> None:
        self.limit, self.warm, self.over = limit, warm, dict[str, float]()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        used = dict(report.user_properties).get("cpu_s", 0.0)
        if report.when == "call" and isinstance(used, float) and used > self.limit:
            self.over[report.nodeid] = used

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if not self.over or session.exitstatus == pytest.ExitCode.INTERRUPTED:
            return
        if self.warm:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
            return
        print(f"\n{len(self.over)} tests used more than {self.limit:g} s CPU; once more, now that all is compiled:")
        command = [sys.executable, "-m", "pytest", "-q", "--no-header", "-p", "no:cacheprovider", "--warm"]
        command += ["--cpu-limit", str(self.limit), *self.over]
        if subprocess.run(command, check=False, cwd=session.config.rootpath).returncode:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if self.warm:
            for name, used in self.over.items():
                terminalreporter.line(f"{used:.1f} s CPU, limit {self.limit:g} s: {name}", red=True)


def pytest_configure(config: pytest.Config) -> None:
    limit = config.option.cpu_limit
    if hasattr(config, "workerinput"):
        compile_once(config.rootpath / ".pytest_cache" / "kernels")
    elif limit is not None:
        config.pluginmanager.register(CpuLimit(limit, warm=config.option.warm))


def compile_once(locks: Path) -> None:
    """Let one worker compile a kernel while the others that need it wait, and then find it in numba's cache."""
    compile_here = Dispatcher.compile

    def compile_locked(self: Dispatcher, sig: object) -> object:
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
        if not name.startswith("planish."):
            return compile_here(self, sig)
        # The lock among threads comes first: a thread that held a file and waited for it would stop the others.
        with global_compiler_lock, FileLock(locks / f"{name}.lock", is_singleton=True):
            return compile_here(self, sig)

    Dispatcher.compile = compile_locked


# --- what tests share ----------------------------------------------------------------------------------------
@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Return a function from the name of a data set to its folder; it skips the test where the data are absent."""
    folder = Path(os.environ.get("PLANISH_DATA") or ROOT.parent / "shared" / "data")

    def find(name: str) -> Path:
        path = folder / name
        if not path.exists():
            pytest.skip(f"measured data '{name}' not found; set PLANISH_DATA to the folder that holds it")
        return path

    return find


@pytest.fixture(scope="session")
def specimen():
    """A small specimen with its truth: 1.1 x 0.9 mm, five holes."""
    return make_specimen(
        SpecimenParams(
            size_um=(1300.0, 1000.0),
            holes=BurnParams(pattern="irregular", count=5),
            warp=Warp(slope=0.35, wavelength_um=1800.0),
            scanner=ScannerParams(voxel_um=4.0),
            camera=CameraParams(pixel_um=5.0, radial=0.0, stretch=0.0, shading=0.0, nuisance_sd=0.004),
            seed=5,
        )
    )


@pytest.fixture(scope="session")
def specimen_files(specimen, tmp_path_factory):
    """The same as files: paths of ``volume.tif`` and ``image.tif``."""
    files = write_instruments(specimen, tmp_path_factory.mktemp("specimen"))
    return files.volume, files.image


@dataclass(frozen=True)
class Files:
    """A specimen on disk: the paths, and what ``planish link`` has to be told about them."""

    volume: Path
    image: Path
    options: tuple[str, ...] = ()


@pytest.fixture(scope="session")
def upright(specimen_files) -> Files:
    """The small specimen as it was made: its sheet through z, the image shows the top."""
    return Files(*specimen_files)


@pytest.fixture(scope="session")
def laid(specimen, tmp_path_factory) -> Files:
    """The small specimen turned about x: its sheet through y; the side at the low end is called the top.

    That is the underside of the specimen: the image, of its upper side, shows the bottom.
    """
    folder = tmp_path_factory.mktemp("laid")
    voxel, pixel = specimen.params.scanner.voxel_um, specimen.params.camera.pixel_um
    volume = np.ascontiguousarray(specimen.volume.values[:, ::-1].transpose(1, 0, 2))
    meta = {"spacing": voxel, "unit": "um", "axes": "ZYX"}
    tifffile.imwrite(folder / "volume.tif", volume, imagej=True, resolution=(1 / voxel, 1 / voxel), metadata=meta)
    grey = np.rint(specimen.image.values * 60000).clip(0, 65535).astype(np.uint16)
    size = (1e4 / pixel, 1e4 / pixel)
    tifffile.imwrite(folder / "image.tif", grey, resolution=size, resolutionunit="CENTIMETER")
    options = ("--through", "y", "--top", "low", "--image-side", "bottom")
    return Files(folder / "volume.tif", folder / "image.tif", options)


@pytest.fixture(scope="session")
def linked_run(specimen_files, tmp_path_factory):
    """The small specimen's link, made once for all workers; its run folder, which no test may change."""
    volume, image = specimen_files
    return make_once(lambda folder: link(volume, image, out=folder / "run"), "linked", tmp_path_factory) / "run"


@pytest.fixture(scope="session")
def linked(linked_run):
    """Its maps and its image on the pixels of the image, which no test may change."""
    return open_run(linked_run).linked.load()


@pytest.fixture
def run_copy(linked_run, tmp_path) -> Path:
    """A copy of that run, to be changed."""
    return Path(shutil.copytree(linked_run, tmp_path / "run"))


@pytest.fixture
def unread(monkeypatch):
    """No volume may be mapped; the package hides its modules behind functions of the same names."""
    saving = import_module("planish.run.save")
    monkeypatch.setattr(saving, "map_layer", lambda *_args, **_more: pytest.fail("the volume was mapped"))


@pytest.fixture
def planish(capsys):
    """Call the command line in-process: a function from arguments to (exit code, stdout, stderr)."""

    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as end:
            main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        return int(end.value.code or 0), out, err

    return call


@pytest.fixture
def passes(planish):
    """Call a command that ends well, by default without a check that fails: what it prints, and its messages."""

    def call(*command: object, codes: tuple[int, ...] = (0,)) -> tuple[str, str]:
        code, out, err = planish(*command)
        assert code in codes, err
        return out, err

    return call


@pytest.fixture
def refuses(planish, tmp_path):
    """Call a command, with a run to write, that is refused: its words, no traceback, nothing written; its message."""

    def call(*command: object, words: str | tuple[str, ...], code: int = 3, out: bool = True) -> str:
        before = sorted(tmp_path.rglob("*"))
        exit_code, _, err = planish(*command, *(("--out", tmp_path / "run") if out else ()))
        assert exit_code == code, err
        message = " ".join(err.split())
        assert [word for word in ((words,) if isinstance(words, str) else words) if word not in message] == [], err
        assert "Traceback" not in err
        assert sorted(tmp_path.rglob("*")) == before
        return message

    return call


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """One Chromium for all tests; skipped where it or playwright is absent."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is absent: pip install playwright")
    path = chromium_path()
    if path is None:
        pytest.skip("Chromium is absent: install it (apt-get install chromium), or name it in PLANISH_CHROMIUM")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()
