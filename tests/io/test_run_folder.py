import errno
import shutil

import numpy as np
import pytest
import xarray as xr

from folders import refused
from planish.core.errors import FileError, ResourceError
from planish.io import new_folder, read_tree, run_folder, work_folder, write_json, write_tree


def test_a_folder_appears_only_when_whole_and_never_over_another(tmp_path):
    with pytest.raises(ResourceError, match="disk is full"), new_folder(tmp_path / "run"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "run").mkdir()
    with pytest.raises(FileError, match="exists already"), new_folder(tmp_path / "run"):
        pytest.fail("must not get here")
    out = tmp_path / "deep" / "run"
    with new_folder(out) as folder:
        (folder / "a.txt").write_text("a")
        assert not out.exists()
    assert ((out / "a.txt").read_text(), [p.name for p in out.parent.iterdir()]) == ("a", ["run"])


@pytest.mark.parametrize("error", [RuntimeError("boom"), KeyboardInterrupt()])
def test_nothing_is_left_when_it_fails(tmp_path, error):
    def fail():
        with new_folder(tmp_path / "run") as folder:
            (folder / "a.txt").write_text("a")
            raise error

    with pytest.raises(type(error)):
        fail()
    assert list(tmp_path.iterdir()) == []


def tree(folder):
    """All that stands in a folder, with the bytes of files and the targets of links."""
    found = {}
    for p in sorted(folder.rglob("*")):
        name = p.relative_to(folder).as_posix()
        found[name] = (
            str(p.readlink()) if p.is_symlink() else p.read_bytes() if p.is_file() else "folder"
        )
    return found


OLD = {"key": "key", "lock": "lock"}  # a work folder before there were markers
IN_THE_WAY = {
    "a linked folder": {"": "-> victim"},
    "a folder": {"data.txt": "years of work"},
    "an empty folder": {"": "folder"},
    "a plain file": {"": "mine"},
    "a broken link": {"": "-> nowhere"},
    "an old folder with more": OLD | {"notes.txt": "mine"},
    "an old folder whose lock is a link": OLD | {"lock": "-> victim/data.txt"},
    "an old folder whose tiles are a link": OLD | {"tiles": "-> victim"},
    "a marked folder with more": {
        run_folder.WORK_MARKER: "marker",
        "thesis/chapter.tex": "years of work",
    },
    "a folder with another marker": {
        run_folder.WORK_MARKER: "of another program",
        "tiles": "folder",
    },
}


def put(place, what, victim):
    place.parent.mkdir(parents=True, exist_ok=True)
    if what == "folder":
        place.mkdir()
    elif what == "marker":
        with work_folder(victim.parent / "marked", "key") as made:
            shutil.copy(made / run_folder.WORK_MARKER, place)
    elif what.startswith("-> "):
        place.symlink_to(victim.parent / what.removeprefix("-> "))
    else:
        place.write_text(what)


@pytest.mark.parametrize("stands_there", IN_THE_WAY.values(), ids=IN_THE_WAY)
def test_what_is_not_ours_is_neither_removed_nor_written_into(tmp_path, stands_there):
    victim, out = tmp_path / "victim", tmp_path / "out"
    put(victim / "data.txt", "years of work", victim)
    out.mkdir()
    for name, what in stands_there.items():
        put(out / ".run.work" / name, what, victim)
    before = tree(tmp_path)
    with (
        pytest.raises(FileError, match=r"\.run\.work .*give another name with out="),
        work_folder(out / "run", "key"),
    ):
        pytest.fail("must not get here")
    assert tree(tmp_path) == before


def test_a_work_folder_goes_and_takes_nothing_along(tmp_path):
    with work_folder(tmp_path / "run", "key") as work:
        (work / "tiles" / "faces").mkdir(parents=True)
    assert list(tmp_path.iterdir()) == []
    with work_folder(tmp_path / "run", "key") as work:
        (work / "tiles").mkdir()
        (work / "notes.txt").write_text("put there meanwhile")
    assert list(tree(work)) == ["notes.txt"]


@pytest.mark.parametrize("version", ["old", "new"])
def test_a_killed_run_finds_its_tiles(tmp_path, version):
    with work_folder(tmp_path / "run", "key") as work:
        (work / "tiles").mkdir()
        (work / "tiles" / "0.npy").write_bytes(b"tile")
        shutil.copytree(work, tmp_path / "killed")
    (tmp_path / "killed").rename(work)
    if version == "old":  # no marker before 0.2
        (work / run_folder.WORK_MARKER).unlink()
        (work / "lock").touch()
    with work_folder(tmp_path / "run", "key") as again:
        assert (again / "tiles" / "0.npy").read_bytes() == b"tile"
    assert list(tmp_path.iterdir()) == []


def test_groups_survive_a_round_trip(tmp_path):
    data = xr.Dataset(
        {
            "a": (("y", "x"), np.arange(6.0).reshape(2, 3), {"units": "um"}),
            "ok": (("y", "x"), np.ones((2, 3), bool)),
        },
        coords={"y": [0.0, 3.0], "x": [0.0, 3.0, 6.0]},
        attrs={"through": "z", "size": [1.0, 2.0]},
    )
    marks = xr.Dataset({"label": ("mark", np.array(["a", "bc"], dtype=object))})
    write_tree(tmp_path / "t.zarr", {"one": data, "marks": marks})
    back = read_tree(tmp_path / "t.zarr")
    xr.testing.assert_identical(back["one"], data)
    assert list(back["marks"]["label"].values) == ["a", "bc"]


def test_a_damaged_store_is_named_and_gives_no_other_value(tmp_path):
    refused(FileError, "no zarr store", read_tree, tmp_path)
    (tmp_path / "zarr.json").write_text("{")
    refused(FileError, "cannot be read", read_tree, tmp_path)
    values = np.random.default_rng(0).normal(size=(40, 50))
    write_tree(tmp_path / "maps.zarr", {"maps": xr.Dataset({"a": (("v", "u"), values)})})
    chunk = tmp_path / "maps.zarr" / "maps" / "a" / "c" / "0" / "0"
    data = chunk.read_bytes()
    for at in range(20, len(data), 997):
        chunk.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        refused(FileError, "damaged", read_tree, tmp_path / "maps.zarr")


@pytest.mark.parametrize(
    ("whole", "damaged"),
    [
        ('"chunk_shape": [', '"chunk_shape": [1e-320, '),
        ('"fill_value"', '"fill_value": 7, "x"'),
        ('"metadata": {', '"metadata": null, "x": {'),
        ('"attributes"', "(" * 200_000 + '"attributes"'),
    ],
)
def test_damaged_metadata_of_a_store_are_one_short_sentence(tmp_path, whole, damaged):
    write_tree(tmp_path / "maps.zarr", {"maps": xr.Dataset({"a": (("v", "u"), np.zeros((4, 5)))})})
    header = tmp_path / "maps.zarr" / "zarr.json"
    text = header.read_text()
    assert whole in text
    header.write_text(text.replace(whole, damaged))
    with pytest.raises(FileError, match="It may be damaged; repeat the run") as caught:
        read_tree(tmp_path / "maps.zarr")
    assert len(str(caught.value)) < 1000


def test_json_refuses_nan(tmp_path):
    refused(ValueError, "JSON compliant", write_json, tmp_path / "r.json", {"a": float("nan")})
