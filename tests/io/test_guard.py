"""How much memory a run may have, that of its control groups; and what a failed read is called."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from planish.core.errors import FileError
from planish.io import guard


@pytest.mark.parametrize(
    ("groups", "files", "expected"),
    [
        ("0::/system.slice/job_7\n", {"system.slice/job_7/memory.max": "2000"}, 2000),
        (
            "0::/job/step\n",
            {"job/step/memory.max": "max", "job/memory.max": "3000", "memory.max": "9000"},
            3000,
        ),
        ("0::/outside\n", {"memory.max": "4000"}, 4000),
        (
            "9:memory:/slurm/uid_1/job_7\n4:cpu:/x\n",
            {"memory/slurm/uid_1/job_7/memory.limit_in_bytes": "5000"},
            5000,
        ),
        ("4:cpu:/x\n", {"memory/memory.limit_in_bytes": "6000", "x/memory.max": "1"}, 6000),
        ("0::/\n", {}, 2**62),
        (None, {}, 2**62),
    ],
)
def test_the_least_limit_of_the_groups_counts(tmp_path, groups, files, expected):
    own, folder = tmp_path / "cgroup", tmp_path / "fs"
    if groups is not None:
        own.write_text(groups, encoding="utf-8", newline="\n")
    for name, text in files.items():
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(f"{text}\n", encoding="utf-8", newline="\n")
    assert guard._control_group_limit_bytes(own, folder) == expected


@pytest.mark.parametrize("marks", [0x1000, 0x400000, 0])
def test_a_file_that_a_cloud_has_is_not_called_damaged(monkeypatch, tmp_path, marks):
    path = tmp_path / "a.tif"
    path.touch()
    monkeypatch.setattr(Path, "stat", lambda _: SimpleNamespace(st_file_attributes=marks))
    words = "is in a cloud and not on this computer" if marks else "cannot be decoded"
    with pytest.raises(FileError, match=words), guard.reading(path):
        raise OSError(22, "The cloud file provider is not running")
