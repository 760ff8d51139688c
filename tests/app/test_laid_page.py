"""All tabs on a sheet through y whose top is at the low end, with an image of its bottom: the frames, by the truth."""

import re

import numpy as np
import pytest

from app.conftest import beside
from app.marks_page import IMAGE, VOLUME, ends, expect, message, pair, settled
from app.test_maps_page import RIGHT, cursor_gives_the_pixel
from app.test_surfaces_page import Shown, face_lies_on_the_top
from planish.core.frame import Frame
from planish.io import read_group
from planish.run import open_run

AROUND_UM = 150.0


def in_volume(specimen, u, v):
    """Where material points lie in the volume that was turned about x: x, y, z in um."""
    x, y, z = np.moveaxis(specimen.warp.points(u, v), -1, 0)
    voxel = specimen.params.scanner.voxel_um
    return np.stack([x, z, (specimen.volume.sizes["y"] - 1) * voxel - y], -1)


def on_the_map(maps, points):
    """Where points of the volume lie on the flat map, which has no values in a hole: by what lies around them."""
    known = np.isfinite(maps.volume_x.values)
    v, u = np.meshgrid(maps.v.values, maps.u.values, indexing="ij")
    x, z, v, u = (values[known] for values in (maps.volume_x.values, maps.volume_z.values, v, u))
    found = []
    for at in points:
        near = np.hypot(x - at[0], z - at[2]) < AROUND_UM
        design = np.stack([np.ones(near.sum()), x[near] - at[0], z[near] - at[2]], 1)
        found.append([np.linalg.lstsq(design, values[near], rcond=None)[0][0] for values in (u, v)])
    return np.array(found)


def test_every_tab_shows_a_sheet_in_its_own_frame_where_the_truth_has_it(kinds, specimen, serve, window, tmp_path):
    run = beside(kinds("laid"), tmp_path)
    shown = window(serve(run))
    hole_is_clicked_predicted_and_snapped(shown, run, specimen)

    tab = Shown(shown, run)
    assert (tab.frame.rows, tab.frame.through, tab.frame.sign) == ("z", "y", -1.0)
    face_lies_on_the_top(tab)

    shown.role("tab", "Maps").click()
    expect(shown.page.get_by_text(re.compile("Scatter of [0-9]+ points"))).to_be_visible()
    left = shown.field("Left layer").input_value()
    assert (left, shown.field("Right layer").input_value()) == ("coating_bottom", RIGHT)
    pixel = cursor_gives_the_pixel(shown, open_run(run).linked, left)
    true = specimen.truth.sel(x=float(pixel.x), y=float(pixel.y), method="nearest")
    place = in_volume(specimen, float(true.u), float(true.v))
    assert [float(pixel[f"volume_{axis}"]) for axis in "xyz"] == pytest.approx(place, abs=15.0)

    shown.role("tab", "Flattening").click()
    expect(shown.role("img", "Sheet in space")).to_have_attribute("data-detail", "full")
    expect(shown.role("application", "Flat sheet")).to_be_visible()
    expect(shown.page.get_by_role("alert")).to_be_hidden()


def hole_is_clicked_predicted_and_snapped(shown, run, specimen):
    """All holes are where the truth has them; one is deleted, set again beside its place, and snapped."""
    holes = specimen.sheet.holes
    assert Frame.of(open_run(run).groups["surfaces"]) == Frame(through="y", top="low")
    flat = on_the_map(read_group(run / "maps.zarr", "maps"), in_volume(specimen, *holes.T))
    image = specimen.pose(holes)
    true = np.concatenate([flat, image], 1)
    before = settled(shown)
    known = ends(before)
    order = [int(np.argmin(np.hypot(*(image - row[2:]).T))) for row in known]
    assert (sorted(order), known) == (sorted(set(order)), pytest.approx(true[order], abs=10.0))

    label, at = before[0][0], known[0]
    shown.role("button", label).click()
    shown.role("button", "Delete").click()
    expect(message(shown)).to_contain_text(f"{label} deleted")
    shown.go(VOLUME, *at[:2], 2.0)
    shown.page.mouse.move(*shown.middle(VOLUME))
    predicted = shown.role("status", "Predicted")
    expect(predicted).to_have_text(re.compile(rf"^{IMAGE} x, y: .* µm; expected error"))
    place = re.search(r"x, y: (-?[\d.]+), (-?[\d.]+) µm", predicted.inner_text())
    assert [float(um) for um in place.groups()] == pytest.approx(at[2:], abs=15.0)
    expect(shown.role("status", "Cursor")).to_contain_text(f"{VOLUME} x, y: {at[0]:.2f}, {at[1]:.2f} µm")
    clicked = at + np.array([6, -5, -4, 7])
    pair(shown, clicked[:2], clicked[2:])
    assert ends(shown.rows())[-1] == pytest.approx(clicked, abs=0.011)
    shown.role("button", shown.rows()[-1][0]).click()
    shown.role("button", "Snap").click()
    expect(message(shown)).to_contain_text("snapped")
    assert ends(settled(shown))[-1] == pytest.approx(at, abs=0.011)
