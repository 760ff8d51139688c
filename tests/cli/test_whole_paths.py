"""A path that is misspelt: the message says the whole path, and that nothing is there."""

import pytest


@pytest.mark.parametrize(
    "command",
    [
        ("info", "sacn"),
        ("map", "sacn", "--out", "r"),
        ("link", "sacn", "i.tif", "--out", "r"),
        ("report", "sacn", "--out", "p.html"),
        ("explore", "sacn", "--out", "p.html"),
        ("view", "sacn"),
        ("export", "sacn", "--to", "tiff", "--out", "m"),
        ("compare", "sacn", "sacn2"),
        ("run", "sacn"),
        ("flatten", "sacn", "--out", "f.zarr"),
        ("study", "sacn", "--out", "s"),
        ("new", "s.toml", "sacn"),
    ],
)
def test_a_missing_path_is_named_whole(command, planish, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, err = planish(*command)
    assert code == 3, err
    assert f"{tmp_path / 'sacn'} does not exist. Check the name and the folder." in " ".join(
        err.split()
    )
