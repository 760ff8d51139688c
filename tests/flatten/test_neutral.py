"""Which surface of a bent sheet keeps its lengths: rolled sheets, where the answer is an angle
times a radius."""

import numpy as np
import pytest
import xarray as xr

from flatten.meshes import middles
from planish.core.errors import CannotFlatten
from planish.core.frame import Frame
from planish.core.grid import Grid
from planish.flatten import FlattenParams, flat_moves, flatten_sheet, variants
from planish.register import Chain, fit_transform
from planish.run import position_error

RADIUS, OFFSET = 1500.0, 4.0


def errors_of(groups, fit, grid, values=None, reference=None):
    """Errors of the places of a grid by one fit."""
    errors = position_error.PositionErrors(groups, Chain(fits=(fit,)), grid, reference)
    return errors.on(grid, np.zeros(grid.shape) if values is None else values)


def rolled(offset=OFFSET, frame=None):
    """A sheet rolled around y, its centre at RADIUS; the middle of its base lies ``offset``
    outwards."""
    y, x = np.arange(0, 800, 8.0), np.arange(-900, 901, 8.0)
    angle = np.broadcast_to(np.arcsin(x / RADIUS), (y.size, x.size))
    centre = RADIUS * np.cos(angle)
    data = {
        "centre": centre,
        "base_middle": offset / np.cos(angle),
        "centre_shorter": np.zeros(centre.shape),
    }
    attrs = (frame or Frame()).attrs() | {"thickness_um": 80.0}
    return xr.Dataset({k: (("y", "x"), v) for k, v in data.items()}, {"y": y, "x": x}, attrs), angle


@pytest.mark.parametrize(
    ("neutral", "radius"), [(None, RADIUS + OFFSET), ("base", RADIUS + OFFSET), ("faces", RADIUS)]
)
def test_a_rolled_sheet_has_the_length_of_its_neutral_surface(neutral, radius):
    surfaces, angle = rolled()
    found = flatten_sheet(surfaces, params=FlattenParams(neutral=neutral, mesh_um=24.0))
    assert found.quality.neutral == ("faces" if neutral == "faces" else "base")
    u = found.flat["u"].values
    np.testing.assert_allclose(u - u.mean(), radius * angle, atol=0.05)


def test_the_mean_of_the_faces_where_no_middle_of_the_base_is_known():
    surfaces, _ = rolled()
    assert flatten_sheet(surfaces.drop_vars("base_middle")).quality.neutral == "faces"
    assert flatten_sheet(surfaces.assign_attrs(method="paper")).quality.neutral == "faces"
    with pytest.raises(CannotFlatten, match="Leave neutral= out"):
        flatten_sheet(surfaces.drop_vars("base_middle"), params=FlattenParams(neutral="base"))


@pytest.mark.parametrize("frame", [Frame(), Frame(top="low")])
def test_what_another_surface_moves(frame, monkeypatch):
    """From the base to the faces: minus the offset times the angle; the same on a mesh of four
    times the pitch."""
    surfaces, _angle = rolled(frame=frame)
    base = surfaces["base_middle"].values
    found = []
    for nodes in (40_000, 500):
        monkeypatch.setattr(variants, "_MOST_NODES", nodes)
        moves = flat_moves(surfaces, {"faces": np.zeros(base.shape)}, neutral=base)
        assert moves["faces_u"].size < 1.2 * nodes
        hand = -1.0 if frame.mirrored else 1.0
        at = hand * -OFFSET * np.arcsin(moves["x"].values / RADIUS)
        along = moves["faces_u"].values
        np.testing.assert_allclose(
            along - along.mean(), np.broadcast_to(at, along.shape), atol=0.02
        )
        found.append(moves["faces_v"].values)
        assert np.ptp(found[-1]) < 0.02


def test_shares_of_the_error_of_a_place():
    surfaces, _angle = rolled()
    flat = flatten_sheet(surfaces, params=FlattenParams(mesh_um=24.0)).flat
    rng = np.random.default_rng(0)
    marks = np.stack([rng.uniform(-800, 800, 9), rng.uniform(50, 750, 9)], axis=1)
    fit = fit_transform(marks, marks + rng.normal(0, 0.3, marks.shape), model="similarity")
    grid = Grid(y_um=np.arange(100, 700, 20.0), x_um=np.arange(-800, 800, 20.0))
    known = np.zeros(grid.shape)
    known[:3] = np.nan
    found = errors_of({"surfaces": surfaces, "flat": flat}, fit, grid, known)
    assert set(found) == {"expected_error", "error_marks", "error_neutral", "error_smoothing"}
    squares = sum(
        found[f"error_{name}"].values.astype(float) ** 2
        for name in ("marks", "neutral", "smoothing")
    )
    np.testing.assert_allclose(found["expected_error"].values ** 2, squares, rtol=1e-5)
    assert np.isnan(found["expected_error"].values[:3]).all()
    # a place in the flat map is a length: its angle is the length over the radius
    shorter = np.array([1 - OFFSET / (RADIUS + OFFSET), 1.0])
    places = middles(grid)
    other = fit.refitted(shorter * marks)(shorter * fit.inverse(places))
    left = position_error.NEUTRAL["base"] * np.linalg.norm(other - places, axis=-1)
    np.testing.assert_allclose(found["error_neutral"].values[3:], left[3:], atol=0.03)
    assert np.nanmax(found["error_smoothing"].values) < 1e-3
    shares = position_error.error_shares(xr.Dataset(found))
    assert shares.largest in ("marks", "neutral")
    assert shares.rms_um == pytest.approx(np.sqrt(np.nanmean(squares)), rel=1e-4)
    assert "A shift that all marks share is not in it" in shares.sentence


def test_no_coating_seen_leaves_a_hundredth_of_the_thickness_and_sections_their_jitter():
    surfaces, _ = rolled()
    bare = surfaces.drop_vars("base_middle")
    flat = flatten_sheet(bare).flat
    marks = np.array([[-700, 100.0], [600, 80], [-500, 700], [750, 650], [0, 300]])
    fit = fit_transform(marks, marks + np.array([[0.5, 0], [0, 0.5], [-0.5, 0], [0, -0.5], [0, 0]]))
    grid = Grid(y_um=np.arange(100, 700, 50.0), x_um=np.arange(-800, 800, 50.0))
    shifts = {
        f"shift_{k}": ("section", np.resize([-s, s], 600)) for k, s in (("row", 1.0), ("col", 2.0))
    }
    # What the alignment left; and a wander of a tenth of the true shifts a section, held at sqrt(5)
    # places by 5 marks, unless the stage showed it.
    walks = np.array([1.0**2 - 0.3**2, 2.0**2 - 0.4**2]) * 0.1**2 * 600 / np.sqrt(5) / 6
    for fixed, wander in (([], walks.sum()), (["col"], walks[0]), (["row", "col"], 0.0)):
        poses_left = {"jitter_left_um": [0.3, 0.4], "jitter_estimator": "median section"}
        cut = {"sections": xr.Dataset(shifts, attrs=poses_left | {"fixed": fixed})}
        sheet = {"surfaces": bare, "flat": flat}
        left = np.sqrt(0.5**2 + wander)
        found = errors_of(sheet | cut, fit, grid)
        np.testing.assert_allclose(
            found["error_sections"].values, left * fit.transform.scale, rtol=1e-6
        )
        # The same where the sections are what is moved to, in their own lengths, and of both.
        onto = errors_of(sheet, fit, grid, reference=sheet | cut)
        np.testing.assert_allclose(onto["error_sections"].values, left, rtol=1e-6)
        both = errors_of(sheet | cut, fit, grid, reference=sheet | cut)
        np.testing.assert_allclose(
            both["error_sections"].values, left * np.hypot(1, fit.transform.scale), rtol=1e-6
        )
        image = errors_of(None, fit, grid, reference=sheet | cut)
        assert set(image) == {"expected_error", "error_marks", "error_sections"}
        squares = found["expected_error"].values ** 2 - found["error_sections"].values ** 2
        without = errors_of(sheet, fit, grid)["expected_error"].values
        np.testing.assert_allclose(squares, without**2, rtol=1e-4)
    # An older map names no estimator: what it states is 1.3 times too small.
    older = {"sections": xr.Dataset(shifts, attrs={"jitter_left_um": [0.3, 0.4], "fixed": fixed})}
    found_older = errors_of(sheet | older, fit, grid)["error_sections"].values
    np.testing.assert_allclose(found_older, 1.3 * 0.5 * fit.transform.scale, rtol=1e-6)
    stated = errors_of({"surfaces": surfaces, "flat": flat}, fit, grid)
    # an offset of 0.8 um against one of 4 um, of which faces state NEUTRAL["faces"]
    ratio = found["error_neutral"].values / stated["error_neutral"].values
    np.testing.assert_allclose(
        np.median(ratio), 0.8 / (OFFSET * position_error.NEUTRAL["faces"]), rtol=0.05
    )
