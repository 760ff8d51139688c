"""A disk that fills up at eight moments: one sentence, exit code 5, nothing left, and nothing in
the way afterwards.

A limit on the size of files makes the real write fail: files that are not larger than it are
written before.
"""

import traceback
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

import planish.synthetic as synthetic
from folders import write_volume
from planish.core import files

resource = pytest.importorskip("resource", reason="this system limits no sizes of files")


@contextmanager
def full_after(size):
    """No file may grow beyond so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def failed_in(monkeypatch):
    """Of each write that failed the functions and the name of the file, or folder."""
    found = []
    write_failure = files.write_failure

    def noted(error, path, *, needed=None):
        found.append(
            [frame.name for frame in traceback.extract_tb(error.__traceback__)] + [path.name]
        )
        return write_failure(error, path, needed=needed)

    monkeypatch.setattr(files, "write_failure", noted)
    return found


@pytest.fixture
def given(specimen, specimen_files, linked_run, tmp_path_factory, monkeypatch):
    """What the commands read, outside of the folder that is compared.

    The link has compiled what they need.
    """
    # The least that has room for three holes.
    monkeypatch.setitem(synthetic.SIZES_UM, "T0", (560.0, 420.0))
    corner = write_volume(
        tmp_path_factory.mktemp("corner") / "volume.tif", specimen.volume.values[:, :125, :200]
    )
    return SimpleNamespace(corner=corner, volume=specimen_files[0], run=linked_run)


def entries(folder):
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*"))


# Of each command the limits, and the function or file that fails under them.
CASES = {
    "map": (lambda given: ("map", given.corner), (0, "claim_folder"), (2000, "take")),
    "import": (
        lambda given: ("import", given.volume),
        (0, "claim_folder"),
        (50_000, "_write_shards"),
    ),
    "specimen": (
        lambda _given: ("specimen", "--size", "T0", "--seed", "7", "--instrument", "image"),
        (100, "write_image"),
        (50_000, "write_truth"),
    ),
    "report": (lambda given: ("report", given.run), (0, "out"), (900_000, "out")),
}


@pytest.mark.parametrize("command", CASES)
def test_a_full_disk_leaves_nothing_and_blocks_nothing(
    planish, passes, given, tmp_path, failed_in, command
):
    arguments, *moments = CASES[command]
    (tmp_path / "thesis.txt").write_text("years")
    out = tmp_path / "out"
    before = entries(tmp_path)
    for limit, place in moments:
        failed_in.clear()
        with full_after(limit):
            code, said, err = planish(*arguments(given), "--out", out)
        assert code == 5, err
        assert f"The disk is full while writing {out}: " in err
        assert f" MB are free in {tmp_path}" in err
        assert "Free some space, or give --out on another disk." in err
        assert "Traceback" not in said + err
        assert place in failed_in[0], failed_in
        assert entries(tmp_path) == before
    passes(*arguments(given), "--out", out, codes=(0, 4))
    assert out.exists()
    assert {name.partition("/")[0] for name in entries(tmp_path)} == {"thesis.txt", "out"}
