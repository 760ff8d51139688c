"""What all tests share: specimens, linked runs, measured data, repeatable property tests."""

import os
import shutil
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from cpu_time import SHARED
from folders import chromium_path

# As the command line has it; tests run side by side.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from filelock import FileLock
from hypothesis import settings
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from kinds import Files, Kinds
from planish.cli import main
from planish.run import open_run

ROOT = Path(__file__).resolve().parents[1]

pytest_plugins = ("tiers",)

# The same cases on every run, and no time limit on a case: the first one compiles the kernels.
settings.register_profile("planish", derandomize=True, deadline=None)
settings.load_profile("planish")


def pytest_configure(config: pytest.Config) -> None:
    """Let the workers share what they compile."""
    compile_once(config.rootpath / ".pytest_cache" / "kernels")


def compile_once(locks: Path) -> None:
    """Let one worker compile a kernel while the others that need it wait, and then find it in
    numba's cache."""
    compile_here = Dispatcher.compile

    def compile_locked(self: Dispatcher, sig: object) -> object:
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
        if not name.startswith("planish."):
            return compile_here(self, sig)
        # The lock among threads comes first: a thread that held a file and waited for it would stop
        # the others.
        with (
            global_compiler_lock,
            FileLock(locks / f"{name}.lock", is_singleton=True),
            SHARED.within(),
        ):
            return compile_here(self, sig)

    Dispatcher.compile = compile_locked


# --- what tests share -----------------------------------------------------------------------------
@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Return a function from the name of a data set to its folder; it skips the test where the data
    are absent."""
    folder = Path(os.environ.get("PLANISH_DATA") or ROOT.parent / "shared" / "data")

    def find(name: str) -> Path:
        path = folder / name
        if not path.exists():
            pytest.skip(
                f"measured data '{name}' not found; set PLANISH_DATA to the folder that holds it"
            )
        return path

    return find


@pytest.fixture(scope="session")
def made_once(tmp_path_factory) -> Kinds:
    """Specimens and files of `tests/kinds.py`; a test that wants a run of them takes ``kinds``."""
    return Kinds(tmp_path_factory)


@pytest.fixture(scope="session")
def kinds(made_once) -> Kinds:
    """Linked runs of each pose and kind, made once for all workers; no test may change them."""
    return made_once


@pytest.fixture(scope="session")
def specimen(made_once):
    """A small specimen with its truth: 1.1 x 0.9 mm, five holes."""
    return made_once.specimen("small")


@pytest.fixture(scope="session")
def specimen_files(made_once):
    """The same as files: paths of ``volume.tif`` and ``image.tif``."""
    return made_once.small.volume, made_once.small.image


@pytest.fixture(scope="session")
def laid(made_once) -> Files:
    """The small specimen turned about x, as files."""
    return made_once.laid


@pytest.fixture(scope="session")
def linked_run(kinds):
    """The small specimen's link; its run folder, which no test may change."""
    return kinds("upright")


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
    saving = import_module("planish.run.workspace")
    monkeypatch.setattr(
        saving, "map_layer", lambda *_args, **_more: pytest.fail("the volume was mapped")
    )


@pytest.fixture
def planish(capsys):
    """Call the command line in-process: a function from arguments to (exit code, stdout,
    stderr)."""

    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as end:
            main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        return int(end.value.code or 0), out, err

    return call


@pytest.fixture
def passes(planish):
    """Call a command that ends well, by default without a check that fails: what it prints, and its
    messages."""

    def call(*command: object, codes: tuple[int, ...] = (0,)) -> tuple[str, str]:
        code, out, err = planish(*command)
        assert code in codes, err
        return out, err

    return call


@pytest.fixture
def refuses(planish, tmp_path):
    """Call a command, with a run to write, that is refused: its words, no traceback, nothing
    written; its message."""

    def call(
        *command: object, words: str | tuple[str, ...], code: int = 3, out: bool = True
    ) -> str:
        before = sorted(tmp_path.rglob("*"))
        exit_code, _, err = planish(*command, *(("--out", tmp_path / "run") if out else ()))
        assert exit_code == code, err
        message = " ".join(err.split())
        assert [
            word for word in ((words,) if isinstance(words, str) else words) if word not in message
        ] == [], err
        assert "Traceback" not in err
        assert sorted(tmp_path.rglob("*")) == before
        return message

    return call


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """One Chromium for all tests; skipped where it or playwright is absent."""
    api = pytest.importorskip(
        "playwright.sync_api", reason="playwright is absent: pip install playwright"
    )
    path = chromium_path()
    if path is None:
        pytest.skip(
            "Chromium is absent: install it (apt-get install chromium), or name it in"
            " PLANISH_CHROMIUM"
        )
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()
