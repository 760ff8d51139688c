"""Links whose maps are too large for the memory: tile by tile, from a store, with the same
results."""

import json

import numpy as np
import pytest
import tifffile
import xarray as xr

from planish.core import bands
from planish.io import map_store
from planish.run import open_run


def numbers(value, place=""):
    """All numbers of a document by their places."""
    if not isinstance(value, dict | list):
        return {place: value}
    parts = value.items() if isinstance(value, dict) else enumerate(value)
    return {
        name: number
        for key, part in parts
        for name, number in numbers(part, f"{place}/{key}").items()
    }


@pytest.mark.parametrize("kind", ["upright", "images"])
def test_tiles_and_a_store_change_nothing(passes, kinds, tmp_path, monkeypatch, kind):
    layers = {
        "upright": (kinds("upright"), kinds.small.image),
        "images": (f"white={kinds.small.image}", f"uv={kinds.other.image}"),
    }[kind]
    names = {"upright": ["linked"], "images": ["layers/white", "layers/uv"]}[kind]
    monkeypatch.setattr(map_store, "LARGE_BYTES", 1)
    monkeypatch.setattr(map_store, "_TILE", (128, 192))
    monkeypatch.setattr(bands, "BAND", 100)
    passes("link", *layers, "-o", tmp_path / "tiles", codes=(0, 4))
    one, other = open_run(kinds(kind)), open_run(tmp_path / "tiles")
    for name in names:
        a, b = one.groups[name].load().drop_attrs(), other.groups[name].load().drop_attrs()
        assert min(a.sizes.values()) > 200
        assert set(a.data_vars) == set(b.data_vars)
        for key in a.data_vars:
            np.testing.assert_allclose(a[key], b[key], rtol=1e-6, atol=1e-9)
        xr.testing.assert_allclose(a.coords.to_dataset(), b.coords.to_dataset())
    found, expected = (numbers(json.loads(run.results.to_json())) for run in (other, one))
    assert found.keys() == expected.keys()
    assert len(expected) > 100
    for key, value in expected.items():
        assert found[key] == (
            pytest.approx(value, rel=1e-5, abs=1e-9) if isinstance(value, float) else value
        ), key
    # The page of the run as it is read again is the one that was written.
    passes("report", tmp_path / "tiles", "-o", tmp_path / "again.html")
    assert (tmp_path / "again.html").read_bytes() == (
        tmp_path / "tiles" / "report.html"
    ).read_bytes()
    assert not list(tmp_path.glob(".*"))


def test_an_image_beyond_the_memory_is_refused_by_its_header(refuses, linked_run, tmp_path):
    big = tmp_path / "big.tif"
    tifffile.imwrite(
        big,
        shape=(30000, 30000),
        dtype=np.uint8,
        resolution=(7299, 7299),
        resolutionunit="CENTIMETER",
    )
    words = ("900 million pixels takes 14.8 GB", "--memory 14.8GB")
    refuses("link", linked_run, big, "--memory", "2GB", words=words, code=5)
