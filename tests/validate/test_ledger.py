"""Errors of a known size are put into a run that is otherwise exact: the ledger has to say that
size."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from planish.core.status import Status
from planish.core.transform import Similarity
from planish.register import fit_transform
from planish.validate import Comparison, errors, example, make_ledger, scenario
from planish.validate.truth import FACES

ROWS, COLS, PITCH = 75, 100, 10.0  # columns of the volume
PIXEL = 5.0
SLOPE = 0.25  # of a plane along x: u is longer than x by sqrt(1 + slope^2)
LONG = float(np.hypot(1.0, SLOPE))
FACES_UM = (45.0, 28.0, -27.0, -43.0)  # s of a sheet of even layers, which are made to wave below
HOLES = np.array([[200.0, 150.0], [820.0, 180.0], [230.0, 600.0], [800.0, 560.0]])


@pytest.fixture(autouse=True)
def few_places(monkeypatch):
    """Similarities are fitted to 60 places instead of 400: of exact places any few are enough."""
    monkeypatch.setattr(errors, "FITTED", 60)


@dataclass
class Plane:
    """A tilted flat sheet: x = u / LONG, z rises with it; s along the normal."""

    def material(self, points):
        x, y, z = np.moveaxis(points, -1, 0)
        off = z - SLOPE * x
        return np.stack([LONG * x + off * SLOPE / LONG, y, off / LONG], axis=-1)

    def normals(self, u, v):
        shape = np.broadcast_shapes(np.shape(u), np.shape(v))
        return np.broadcast_to(np.array([-SLOPE, 0.0, 1.0]) / LONG, (*shape, 3))


@dataclass
class EvenSheet:
    """Faces are numbers; the coating's outer face waves, so that its thickness is known
    everywhere."""

    holes: np.ndarray
    faces = np.array(FACES_UM)
    rim_um = (1000.0, 1000.0)  # no hole anywhere near

    def at(self, field, u, v):
        # Differences of faces and faces themselves arrive as numbers: the wave belongs to what
        # holds the top face.
        holds_top = np.isclose(float(field), [45.0, 17.0, 88.0]).any()
        return float(field) + (wave(u) if holds_top else 0.0) + 0.0 * v


def wave(u):
    return 6.0 * np.sin(2 * np.pi * np.asarray(u) / 400.0)


def exact_run(*, shift=(0.0, 0.0), lift=0.0, stretch=1.0, thicker=0.0):
    """A specimen, its files, and a run that is exact but for what is asked for.

    Parameters
    ----------
    shift : of the places in the volume that the pixels are given, in the sheet (u, v)
    lift : of the top face along the normal
    stretch : of the flat map along u and v
    thicker : of the top coating as measured
    """
    warp, sheet = Plane(), EvenSheet(holes=HOLES)
    pose = Similarity(scale=1.01, rotation_rad=0.03, shift_um=(40.0, 30.0))
    y, x = np.arange(ROWS) * PITCH, np.arange(COLS) * PITCH
    xx, yy = np.meshgrid(x, y)
    u, v = LONG * xx, yy

    def height(s):
        """z at which the column meets the level s: there u is larger by s * slope."""
        return SLOPE * xx + s * LONG

    def solved(face, extra=0.0):
        s = np.full(xx.shape, face + extra)
        for _ in range(20):  # where the level waves, its u at this column depends on its own height
            s = face + extra + (wave(u + SLOPE * s) if face == 45.0 else 0.0)
        return s

    dims = ("y", "x")
    levels = dict(
        zip(("top", "interface_top", "interface_bottom", "bottom"), FACES_UM, strict=True)
    )
    values = {
        name: (dims, height(solved(s, lift if name == "top" else 0.0)))
        for name, s in levels.items()
    }
    values |= {
        "centre": (dims, height(np.zeros(xx.shape))),
        "status": (dims, np.zeros(xx.shape, dtype=np.int8)),
        "coating_top": (dims, 17.0 + wave(u) + thicker),
        "base_thickness": (dims, np.full(xx.shape, 55.0)),
        "thickness": (dims, 88.0 + wave(u)),
    }
    attrs = {"through": "z", "top_side": "high", "row_axis": "y", "col_axis": "x"}
    surfaces = xr.Dataset(values, coords={"y": y, "x": x}, attrs=attrs)
    surfaces["coating_top_se"] = surfaces["top"] * 0 + 0.4
    flat = xr.Dataset(
        {
            "u": (dims, stretch * u + 100.0),
            "v": (dims, stretch * v - 50.0),
            "projected_u": (dims, xx),
            "projected_v": (dims, yy),
        },
        coords={"y": y, "x": x},
    )
    shape = 152, 208
    iy, ix = np.arange(shape[0]) * PIXEL, np.arange(shape[1]) * PIXEL
    pu, pv = np.moveaxis(pose.inverse(np.stack(np.meshgrid(ix, iy), axis=-1)), -1, 0)
    inside = (pu > 20) & (pu < u.max() - 20) & (pv > 20) & (pv < v.max() - 20)
    place = {"x": (pu + shift[0]) / LONG, "y": pv + shift[1], "z": SLOPE * (pu + shift[0]) / LONG}
    coating = 17.0 + wave(pu)
    linked = xr.Dataset(
        {f"volume_{a}": (dims, np.where(inside, p, np.nan)) for a, p in place.items()}
        | {
            "coating_top": (dims, coating + thicker),
            "base_thickness": (dims, np.full(shape, 55.0)),
            "thickness": (dims, 71.0 + coating),
            "image": (dims, disc_image(pose(HOLES), ix, iy, coating)),
            "valid": (dims, inside),
            "expected_error": (dims, np.full(shape, 1.5)),
        },
        coords={"y": iy, "x": ix},
    )
    truth = xr.Dataset({"u": (dims, pu), "v": (dims, pv)}, coords={"y": iy, "x": ix})
    mu, mv = np.arange(0, stretch * u.max() + 200, PIXEL), np.arange(-50, stretch * v.max(), PIXEL)
    at_u, at_v = (
        (mu[None, :] - 100.0) / stretch + 0 * mv[:, None],
        (mv[:, None] + 50.0) / stretch + 0 * mu[None, :],
    )
    on = (at_u >= 0) & (at_u <= u.max()) & (at_v >= 0) & (at_v <= v.max())
    presence = 1.0 - (
        np.hypot(at_u[..., None] - HOLES[:, 0], at_v[..., None] - HOLES[:, 1]).min(axis=-1) < 88
    )
    maps = xr.Dataset(
        {
            "presence": (("v", "u"), np.where(on, presence, np.nan)),
            "volume_x": (("v", "u"), at_u / LONG),
            "volume_y": (("v", "u"), at_v),
            "volume_z": (("v", "u"), SLOPE * at_u / LONG),
            "projected_u": (("v", "u"), at_u / LONG),
            "projected_v": (("v", "u"), at_v),
        },
        coords={"v": mv, "u": mu},
    )
    moving = stretch * HOLES + [100.0, -50.0]
    fixed = pose(HOLES)
    study = SimpleNamespace(
        holes=SimpleNamespace(hole_um=(100.0, 300.0)),
        correlate=SimpleNamespace(thin_um=13.0, point_um=100.0),
    )
    run = SimpleNamespace(
        groups={"surfaces": surfaces, "flat": flat, "linked": linked, "maps": maps},
        study=study,
        registrations={"sheet": SimpleNamespace(fit=fit_transform(moving, fixed))},
        results=SimpleNamespace(layers=[SimpleNamespace(headline="coating_top", sheet=True)]),
    )
    specimen = SimpleNamespace(warp=warp, sheet=sheet, pose=pose, truth=truth)
    files = SimpleNamespace(to_physical=lambda points, _sections=None: points)
    return specimen, files, run


def figures(stage, specimen, files, run):
    """What one stage of the ledger, or all of it, says of a run."""
    return stage(Comparison(specimen, files, run))


def disc_image(centres, x, y, coating):
    """Dark discs on a ground that follows the coating."""
    away = np.hypot(x[None, :, None] - centres[:, 0], y[:, None, None] - centres[:, 1]).min(axis=-1)
    return np.where(away < 88, 0.05, 0.7 + 0.01 * coating) + np.random.default_rng(0).normal(
        0, 0.002, away.shape
    )


def test_an_exact_run_has_no_errors():
    found = figures(make_ledger, *exact_run())
    exact = [f"{face}_rmse" for face in FACES]
    exact += [
        "centre_rms",
        "angle_rms",
        "column_coating_top_rmse",
        "pixel_coating_top_rmse",
        "node_rms",
        "flat_scale",
    ]
    exact += ["strain_rms", "tre_rms", "fre_rms", "scale_deviation", "r_difference_pixel"]
    assert [found[name] for name in exact] == pytest.approx([0.0] * len(exact), abs=1e-6)
    assert (found["thin_dice"], found["thin_lag"], found["measured_share"]) == (1.0, 0.0, 100.0)
    # hole finding is run for real: discs of 175 um in pixels of 5 um
    assert (found["recall_image"], found["recall_volume"]) == (1.0, 1.0)
    assert (found["false_image"], found["false_volume"]) == (0.0, 0.0)
    assert found["fle_image"] < 0.5
    assert found["fle_volume"] < 0.5
    # linear interpolation over 10 um columns of a wave of 400 um and 6 um height: (2 pi / 400)^2
    # 10^2 / 8 of it
    assert found["resampling_rmse"] < 6.0 * (2 * np.pi / 400) ** 2 * PITCH**2 / 8


def test_a_false_and_a_missed_hole():
    specimen, files, run = exact_run()
    specimen.sheet.holes = np.concatenate([HOLES[:3], [[500.0, 380.0]]])
    found = figures(errors.hole_errors, specimen, files, run)
    for side in ("image", "volume"):
        assert (found[f"recall_{side}"], found[f"false_{side}"]) == (0.75, 1.0)


def test_pictures_of_errors():
    pictures = example.draw_example(Comparison(*exact_run(shift=(3.0, 0.0), thicker=-0.4)), 7)
    assert [picture.title for picture in pictures] == [
        "The image of one specimen",
        "Measured coating thickness",
        "Error of place",
        "Error of the coating thickness",
    ]
    assert "Seed 7; pixels of 5" in pictures[0].caption
    assert "below 3.00" in pictures[2].caption
    assert "−0.400" in pictures[3].caption


def test_a_shift_of_pixels_and_a_lifted_face_are_their_errors():
    found = figures(errors.registration_errors, *exact_run(shift=(3.0, 4.0)))
    for name in ("tre_median", "tre_p95", "tre_max", "tre_rms"):
        assert found[name] == pytest.approx(5.0, abs=1e-9)
    assert found["predicted_ratio"] == pytest.approx(5.0 / 1.5)
    found = figures(errors.surface_errors, *exact_run(lift=0.7))
    # the lifted top is compared at its own place: along a slope of 0.25 the wave moves by 0.7 *
    # 0.25 um at most
    assert found["top_bias"] == pytest.approx(0.7, abs=0.01)
    assert found["top_rmse"] == pytest.approx(0.7, abs=0.02)
    assert found["bottom_rmse"] < 1e-6
    # three exact faces and one that is off
    assert found["surfaces_rmse"] == pytest.approx(found["top_rmse"] / 2, rel=1e-6)


def test_a_coating_that_is_too_thick():
    made = exact_run(thicker=-0.4)
    found = figures(errors.thickness_errors, *made) | figures(errors.pixel_errors, *made)
    for where in ("column", "pixel"):
        assert found[f"{where}_coating_top_bias"] == pytest.approx(-0.4, abs=1e-9)
        assert found[f"{where}_coating_top_p95"] == pytest.approx(0.4, abs=1e-9)
        assert found[f"{where}_thickness_rmse"] < 1e-9
    # the thin region grows: the contour of 13 um lies where the true coating is 13.4
    lag = 400 / (2 * np.pi) * (np.arcsin(4.0 / 6.0) - np.arcsin(3.6 / 6.0))
    assert found["thin_lag"] == pytest.approx(1.01 * lag, rel=0.05)
    assert 0.9 < found["thin_dice"] < 1.0
    # a constant changes no correlation
    assert abs(figures(errors.statistic_errors, *made)["r_difference_pixel"]) < 1e-12


def test_a_flat_map_that_is_too_large():
    made = exact_run(stretch=1.002)
    found = figures(errors.flattening_errors, *made)
    assert found["flat_scale"] == pytest.approx(0.2, abs=1e-9)
    assert found["strain_rms"] == pytest.approx(0.2, abs=1e-9)
    # places are off by 0.2 % of their distance from the middle
    u, v = np.meshgrid(LONG * PITCH * np.arange(COLS), PITCH * np.arange(ROWS))
    expected = 0.002 * np.sqrt(u.var() + v.var())
    assert found["node_rms"] == pytest.approx(expected, rel=1e-6)
    # the marks take the scale back
    deviation = figures(errors.registration_errors, *made)["scale_deviation"]
    assert deviation == pytest.approx(100 * (1 / 1.002 - 1), abs=1e-9)


def test_what_the_projection_misses():
    found = figures(errors.registration_errors, *exact_run())
    # a tilted plane is projected shorter along u: a similarity takes the mean, the difference of
    # the axes stays
    marks = HOLES / [LONG, 1.0]
    fit = fit_transform(marks, HOLES)
    u, v = np.meshgrid(LONG * PITCH * np.arange(COLS), PITCH * np.arange(ROWS))
    there = np.stack([u, v], axis=-1)
    seen = fit(there / [LONG, 1.0])
    image = Similarity(scale=1.01, rotation_rad=0.03, shift_um=(40.0, 30.0))(there)
    inside = np.all((image >= 0) & (image <= [207 * PIXEL, 151 * PIXEL]), axis=-1)
    expected = np.percentile(np.linalg.norm(seen - there, axis=-1)[inside], 95)
    assert found["tre_projection_p95"] == pytest.approx(expected, rel=1e-6)
    assert expected > 5.0


def test_marks_that_disagree_predict_their_error():
    specimen, files, run = exact_run()
    fit = run.registrations["sheet"].fit
    off = np.array([[2.0, 0.0], [-2.0, 0.0], [-2.0, 0.0], [2.0, 0.0]])
    run.registrations["sheet"].fit = fit_transform(fit.moving, fit.fixed + off)
    found = figures(errors.registration_errors, specimen, files, run)
    assert found["fre_rms"] == pytest.approx(2.0, rel=0.05)
    assert found["loo_rms"] > found["fre_rms"]
    assert found["predicted_rms"] == pytest.approx(1.5)  # as the linked maps state it
    # the places themselves were left exact
    assert found["predicted_ratio"] < 1e-6


def test_columns_that_were_lost_count_and_rims_do_not():
    specimen, files, run = exact_run()
    status = run.groups["surfaces"]["status"].values
    status[:15] = Status.FACE_NOT_FOUND
    status[15:30] = Status.RIM
    found = figures(errors.surface_errors, specimen, files, run)
    assert found["found_share"] == found["measured_share"] == pytest.approx(100 * 45 / 60)
    status[:15] = Status.NORMAL_LEAVES_SHEET
    found = figures(errors.surface_errors, specimen, files, run)
    assert (found["found_share"], found["measured_share"]) == (100.0, pytest.approx(100 * 45 / 60))


def test_residual_poses_of_sections():
    _, files, run = exact_run()
    attrs = {"cutoff_um": 50 * PITCH}
    run.groups["sections"] = xr.Dataset({"position": ("section", np.arange(3.0))}, attrs=attrs)
    # a stack whose rows run through the sheet; what is left of the poses is white and known, and
    # along x also slow
    surfaces = run.groups["surfaces"]
    surfaces.attrs |= {"through": "y", "row_axis": "z", "col_axis": "x"}
    rng = np.random.default_rng(3)
    white = rng.normal(0, [0.5, 0.3, 0.2], (ROWS, 3))  # x, y, z in space
    left = white + np.outer(2 * np.sin(2 * np.pi * np.arange(ROWS) / ROWS), [1, 0, 0])

    def to_physical(points, _sections=None):
        k = np.rint(points[:, 2] / PITCH).astype(int)
        return np.stack([points[:, 0], points[:, 2], points[:, 1]], axis=1) + left[k]

    files.to_physical = to_physical
    found = figures(errors.section_errors, None, files, run)
    # fitted straight lines take 2 of 150 degrees of freedom
    for name, k in (("sections_place_rms", 1), ("sections_z_rms", 2)):
        assert found[name] == pytest.approx(left[:, k].std(), rel=0.05)
    # a straight line takes some of a single slow wave
    assert 1.5 * white[:, 0].std() < found["sections_x_rms"] <= left[:, 0].std()
    for name, k in (("sections_x_jitter", 0), ("sections_z_jitter", 2)):
        assert found[name] == pytest.approx(white[:, k].std(), rel=0.08)


def test_a_paper_without_coating_has_no_figures_of_it():
    specimen, files, run = exact_run()
    for group in ("surfaces", "linked"):
        run.groups[group]["coating_top"] = np.nan * run.groups[group]["coating_top"]
    for face in ("interface_top", "interface_bottom"):
        run.groups["surfaces"][face] = np.nan * run.groups["surfaces"][face]
    run.results.layers[0].headline = "thickness"
    found = figures(make_ledger, specimen, files, run)
    assert (found["interface_top_rmse"], found["pixel_coating_top_bias"]) == (None, None)
    assert (found["thin_dice"], found["column_coating_top_rmse"]) == (None, None)
    assert found["column_thickness_rmse"] == pytest.approx(0.0, abs=1e-9)
    assert found["tre_rms"] < 1e-9


def test_runs_without_an_image_or_any_value_have_no_figures_of_them():
    specimen, files, run = exact_run()
    linked = run.groups.pop("linked")
    found = figures(make_ledger, specimen, files, run)
    assert found["top_rmse"] < 1e-6
    assert not any(scenario.FIGURES[name].stage == "registration" for name in found)
    run.groups["linked"] = linked
    run.groups["surfaces"]["status"] += 3
    linked["valid"][:] = False
    found = figures(make_ledger, specimen, files, run)
    assert (found["top_bias"], found["tre_median"], found["predicted_ratio"]) == (None, None, None)


def test_figures_are_named_once_and_outlines_of_discs_are_as_far_apart_as_their_radii():
    assert all(
        figure.stage in scenario.STAGES and figure.sentence and figure.title
        for figure in scenario.FIGURES.values()
    )
    assert all(
        name in scenario.FIGURES and scenario.FIGURES[name].stage == stage
        for stage, names in scenario.KEYS.items()
        for name in names
    )
    assert next(iter(scenario.in_order({"tre_rms": 1.0, "top_bias": 2.0}))) == "top_bias"
    y, x = np.mgrid[:120, :120] * 2.0
    one, two = (np.hypot(x - 120, y - 118) - r for r in (60.0, 67.0))
    assert errors.outline_lag(one, two, 0.0, (2.0, 2.0)) == pytest.approx(7.0, abs=0.05)
    points = errors.contour_points(one, 0.0) * 2.0
    np.testing.assert_allclose(np.hypot(points[:, 1] - 120, points[:, 0] - 118), 60.0, atol=0.02)
    assert errors.dice(one < 0, two < 0) == pytest.approx(2 * 60**2 / (60**2 + 67**2), rel=0.01)
    assert (
        errors.outline_lag(one, two + 1e3, 0.0, (2.0, 2.0)),
        errors.dice(one > 1e9, one > 1e9),
    ) == (None, None)
