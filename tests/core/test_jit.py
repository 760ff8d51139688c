"""Where the code of compiled kernels is kept."""

from pathlib import Path
from types import SimpleNamespace

import numba
import pytest

from planish.core import jit
from planish.core._overview_kernels import halve_values

folder_of = jit.cache_folder.__wrapped__


@pytest.fixture
def user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's folder for caches."""
    folder = tmp_path / "user"
    monkeypatch.setattr(jit, "AppDirs", lambda *_names, **_more: SimpleNamespace(user_cache_dir=str(folder)))
    return folder


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_kernels_lie_outside_the_program_and_those_of_other_libraries_where_they_were():
    def another(x):
        return x

    package = Path(jit.__file__).parents[1]
    given = numba.config.CACHE_DIR
    kernel = Path(halve_values.stats.cache_path)
    assert not kernel.is_relative_to(package)
    assert kernel.parent == Path(jit.cache_folder(given))
    assert jit.njit(cache=True)(another).stats.cache_path != numba.njit(cache=True)(another).stats.cache_path
    assert given == numba.config.CACHE_DIR


def test_the_cache_lies_in_the_given_folder_that_of_the_user_or_where_numba_can_write(user: Path, tmp_path: Path):
    assert Path(folder_of("")).parent == user
    assert Path(folder_of(str(tmp_path / "given"))).parent == tmp_path / "given"
    given = tmp_path / "file"
    given.write_text("no folder")
    assert Path(folder_of(str(given))).parent == user
    user.rename(tmp_path / "moved")
    user.write_text("no folder")
    assert (folder_of(str(given)), folder_of("")) == (str(given), "")


def test_a_user_without_a_home_gets_no_folder_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(jit, "AppDirs", lambda *_names, **_more: SimpleNamespace(user_cache_dir="~/.cache/numba"))
    assert (folder_of(""), list(tmp_path.iterdir())) == ("", [])


def test_kernels_of_older_sources_are_removed(user: Path, monkeypatch: pytest.MonkeyPatch):
    before = Path(folder_of(""))
    (before / "kernel.nbi").write_text("compiled")
    other = user / "planish-0123456789abcdef-0123456789abcdef"
    other.mkdir()
    monkeypatch.setattr(jit, "hash_sources", lambda _pattern: "f" * 16)
    after = Path(folder_of(""))
    assert sorted(user.iterdir()) == sorted([after, other])
    assert after != before
