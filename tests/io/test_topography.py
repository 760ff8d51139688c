"""Height maps: rows, units and missing values as the library of the format wrote them."""

import sys

import numpy as np
import pytest

from folders import refused
from planish.core.errors import FileError, ResourceError, SizeError
from planish.io import guard, read_topography

with guard.quiet:
    from SurfaceTopography import Topography
    from SurfaceTopography.IO.X3P import write_x3p

HEIGHTS = np.random.default_rng(3).normal(0, 2, (9, 14))  # y, x


def write(path, unit, heights=HEIGHTS):
    um = {"nm": 1e3, "um": 1.0, "mm": 1e-3}[unit]
    masked = np.ma.masked_invalid(heights.T * um)
    sizes = (heights.shape[1] * 2.0 * um, heights.shape[0] * 3.0 * um)
    with guard.quiet:
        surface = Topography(masked if masked.mask.any() else masked.data, sizes, unit=unit)
        if path.suffix == ".x3p":
            write_x3p(surface, str(path))
        else:
            surface.to_netcdf(str(path))
    return path


@pytest.mark.parametrize("unit", ["nm", "mm"])
@pytest.mark.parametrize("suffix", [".x3p", ".nc"])
def test_heights_come_in_um(tmp_path, suffix, unit):
    heights = HEIGHTS.copy()
    heights[2, 5] = np.nan
    surface = read_topography(write(tmp_path / f"Fläche 1{suffix}", unit, heights))
    assert surface.dims == ("y", "x")
    np.testing.assert_allclose(surface.values, heights, rtol=1e-12)
    np.testing.assert_allclose(surface.y, np.arange(9) * 3.0)
    np.testing.assert_allclose(surface.x, np.arange(14) * 2.0)
    assert (surface.attrs["units"], surface.attrs["pixel_um"]) == ("um", pytest.approx([3.0, 2.0]))


@pytest.mark.parametrize("suffix", [".x3p", ".nc"])
def test_a_cut_file_is_an_error(tmp_path, suffix):
    path = write(tmp_path / f"s{suffix}", "um")
    data = path.read_bytes()
    for length in (0, 10, len(data) // 3, 2 * len(data) // 3, len(data) - 40):
        path.write_bytes(data[:length])
        refused(FileError, rf"^s\{suffix}", read_topography, path)


def test_contradicting_sizes_and_other_files_are_errors(tmp_path, monkeypatch):
    path = write(tmp_path / "s.x3p", "um")
    assert read_topography(path, pixel_um=(3, 2)).attrs["pixel_um"] == pytest.approx([3.0, 2.0])
    refused(
        SizeError,
        r"s\.x3p: pixel_um= gives .* the topography file states",
        read_topography,
        path,
        pixel_um=5,
    )
    refused(ResourceError, r"s\.x3p needs", read_topography, path, memory_bytes=100)
    refused(
        FileError, r"[/\\]nothing\.sur does not exist", read_topography, tmp_path / "nothing.sur"
    )
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    refused(FileError, r'pip install "planish\[formats\]"', read_topography, path)
