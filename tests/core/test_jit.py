"""Where the code of compiled kernels is kept."""

import os
import time
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import SimpleNamespace

import numba
import pytest

from planish.core import jit
from planish.core._overview_kernels import halve_values

folder_of = jit.cache_folder.__wrapped__


@pytest.fixture
def user(tmp_path, monkeypatch):
    """The user's folder for caches."""
    folder = tmp_path / "user"
    monkeypatch.setattr(
        jit, "AppDirs", lambda *_names, **_more: SimpleNamespace(user_cache_dir=str(folder))
    )
    return folder


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_kernels_lie_outside_the_program_and_those_of_other_libraries_where_they_were():
    def another(x):
        return x

    kernel = Path(halve_values.stats.cache_path)
    assert kernel == Path(jit.cache_folder(numba.config.CACHE_DIR)) / "core"
    assert not kernel.is_relative_to(jit.PACKAGE)
    assert not Path(numba.njit(cache=True)(another).stats.cache_path).is_relative_to(kernel.parent)


@pytest.mark.ci
@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_another_installation_of_the_same_sources_finds_what_one_compiled(tmp_path, monkeypatch):
    monkeypatch.setattr(jit, "cache_folder", lambda _numba_dir: str(tmp_path / "cache"))
    found = []
    for name in ("one", "two"):
        file = tmp_path / name / "core" / "_some_kernels.py"
        file.parent.mkdir(parents=True)
        file.write_text(
            "from numba import njit\n\n@njit(cache=True)\ndef twice(x):\n    return 2 * x\n"
        )
        monkeypatch.setattr(jit, "PACKAGE", tmp_path / name)
        spec = spec_from_file_location("_some_kernels", file)
        kernels = module_from_spec(spec)
        spec.loader.exec_module(kernels)
        assert kernels.twice(4) == 8
        found.append(sum(kernels.twice.stats.cache_hits.values()))
    assert found == [0, 1]
    assert len(list((tmp_path / "cache" / "core").glob("*.nbc"))) == 1


@pytest.mark.skipif(os.name == "nt", reason="links need a privilege")
def test_an_installation_behind_a_link_has_the_same_folder(tmp_path):
    (tmp_path / "link").symlink_to(jit.PACKAGE)
    found = jit.Locator.from_function(
        halve_values.py_func, str(tmp_path / "link" / "core" / "_overview_kernels.py")
    )
    assert found is not None
    assert found.get_cache_path() == halve_values.stats.cache_path


def test_the_cache_lies_in_the_given_folder_that_of_the_user_or_where_numba_can_write(
    user, tmp_path
):
    assert Path(folder_of("")).parent == user
    assert Path(folder_of(str(tmp_path / "given"))).parent == tmp_path / "given"
    given = tmp_path / "file"
    given.write_text("no folder")
    assert Path(folder_of(str(given))).parent == user
    user.rename(tmp_path / "moved")
    user.write_text("no folder")
    assert (folder_of(str(given)), folder_of("")) == ("", "")


def test_a_user_without_a_home_gets_no_folder_here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        jit, "AppDirs", lambda *_names, **_more: SimpleNamespace(user_cache_dir="~/.cache/numba")
    )
    assert (folder_of(""), list(tmp_path.iterdir())) == ("", [])


def test_kernels_of_other_sources_are_removed_when_nobody_used_them_for_a_month(user, monkeypatch):
    unused, used = user / "planish-0123456789abcdef-0.60.0", Path(folder_of(""))
    unused.mkdir()
    results = user / "planish-demo"  # of a person whose NUMBA_CACHE_DIR is a folder of theirs
    results.mkdir()
    os.utime(results, (0, 0))
    monkeypatch.setattr(jit, "hash_sources", lambda _pattern: "f" * 16)
    for days, left in ((29, [used, unused]), (31, [used])):
        os.utime(unused, 2 * (time.time() - 86400 * days,))
        now = Path(folder_of(""))
        assert sorted(user.iterdir()) == sorted([now, results, *left])
        assert now != used
