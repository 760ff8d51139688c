import errno

import numpy as np
import pytest
import xarray as xr

from planish.core.errors import FileError, ResourceError
from planish.io.run_folder import new_folder, read_tree, write_json, write_tree


def test_a_folder_appears_only_when_whole(tmp_path):
    out = tmp_path / "deep" / "run"
    with new_folder(out) as folder:
        (folder / "a.txt").write_text("a")
        assert not out.exists()
    assert (out / "a.txt").read_text() == "a"
    assert [p.name for p in out.parent.iterdir()] == ["run"]


@pytest.mark.parametrize("error", [RuntimeError("boom"), KeyboardInterrupt()])
def test_nothing_is_left_when_it_fails(tmp_path, error):
    def fail() -> None:
        with new_folder(tmp_path / "run") as folder:
            (folder / "a.txt").write_text("a")
            raise error

    with pytest.raises(type(error)):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_a_resource_error(tmp_path):
    with pytest.raises(ResourceError, match="disk is full"), new_folder(tmp_path / "run"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_never_touched(tmp_path):
    (tmp_path / "run").mkdir()
    with pytest.raises(FileError, match="exists already"), new_folder(tmp_path / "run"):
        pytest.fail("must not get here")


def test_groups_survive_a_round_trip(tmp_path):
    data = xr.Dataset(
        {"a": (("y", "x"), np.arange(6.0).reshape(2, 3), {"units": "um"}), "ok": (("y", "x"), np.ones((2, 3), bool))},
        coords={"y": [0.0, 3.0], "x": [0.0, 3.0, 6.0]},
        attrs={"through": "z", "size": [1.0, 2.0]},
    )
    marks = xr.Dataset({"label": ("mark", np.array(["a", "bc"], dtype=object))})
    write_tree(tmp_path / "t.zarr", {"one": data, "marks": marks})
    back = read_tree(tmp_path / "t.zarr")
    xr.testing.assert_identical(back["one"], data)
    assert list(back["marks"]["label"].values) == ["a", "bc"]


def test_a_damaged_store_is_named(tmp_path):
    with pytest.raises(FileError, match="no zarr store"):
        read_tree(tmp_path)
    (tmp_path / "zarr.json").write_text("{")
    with pytest.raises(FileError, match="cannot be read"):
        read_tree(tmp_path)


def test_json_refuses_nan(tmp_path):
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(tmp_path / "r.json", {"a": float("nan")})
