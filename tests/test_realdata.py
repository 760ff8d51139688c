"""Measured data: a lab X-ray scan of a wound cell, whose can wall was measured independently."""

import json

import numpy as np
import pytest
import xarray as xr

# Measured on the full slices by another program: centre of the can (x, y) in the full image and its
# outer radius, px.
CENTRE_X, CENTRE_Y, RADIUS = 366.4, 378.7, 312.3
# The crop starts at column 600 and row 230.
FIRST_X, FIRST_Y = 600, 230
OPTIONS = ("--voxel-um", 1, "--through", "x")


@pytest.fixture(scope="module")
def wall(shared_data, tmp_path_factory):
    """Map the can wall through the command line."""
    from planish.cli import main

    out = tmp_path_factory.mktemp("wall") / "run"
    arguments = (
        "map",
        shared_data("battery_sector_right"),
        *OPTIONS,
        "--sheet-grey",
        "100,255",
        "--out",
        out,
    )
    with pytest.raises(SystemExit) as end:
        main([str(a) for a in arguments])
    assert end.value.code == 0
    with xr.open_datatree(out / "maps.zarr", engine="zarr") as tree:
        return json.loads((out / "results.json").read_text())["layers"][0]["sheet"], tree.load()


def test_the_wall_is_measured_in_every_slice_on_its_circle(wall):
    results, _ = wall
    median = results["properties"]["thickness"]["median"]
    print(f"thickness of the wall: median {median:.2f} px; measured independently 6.6 px")
    assert median == pytest.approx(6.6, abs=0.3)
    surfaces = wall[1]["surfaces"].to_dataset()
    x = surfaces["top"].values + FIRST_X - CENTRE_X
    y = surfaces["x"].values[None, :] + FIRST_Y - CENTRE_Y
    radius = np.nanmedian(np.hypot(x, y), axis=1)
    print(
        f"outer radius by slice: {radius.min():.2f} to {radius.max():.2f} px; measured"
        f" independently {RADIUS} px"
    )
    assert radius.size == 45
    assert np.abs(radius - RADIUS).max() < 1.0
    # Electrode layers lie behind the wall from the middle of the stack on; they change nothing.
    status = wall[1]["surfaces"].to_dataset()["status"].values
    share = (status == 0).mean(axis=1)
    print(f"measured share of a slice: {share.min():.3f} at least")
    assert share.min() > 0.9
    flatten = wall[0]["flatten"]
    strain = flatten["edge_strain_p95"], flatten["edge_strain_max"]
    print("edge strain: {:.4%} (p95), {:.4%} (largest)".format(*strain))
    assert flatten["outcome"] == "RESTED"
    assert flatten["edge_strain_max"] < 1e-3


def test_without_the_grey_range_the_way_out_is_named(shared_data, refuses):
    words = ("several sheets", "--sheet-grey LOW,HIGH")
    refuses("map", shared_data("battery_sector_right"), *OPTIONS, words=words)
