"""Grey scale, second sheet, delamination, few voxels and dust: seen with their number, and not
where all is right."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

from checks.made_windows import window_of
from planish.checks import CHECKS, MeasuredSheet, check_scan, sheets
from planish.checks.greys import clipping, level_jump, noise_width
from planish.checks.scan import core_places, voxels_through
from planish.measure import Greys
from surface.sheets import volume as sheets_volume

RULES = {rule.name: rule for rule in CHECKS}
VOXEL = 3.0


def levels(air, base, coating, noise):
    sign = 1.0 if base >= air else -1.0
    of_all = {
        "air": air,
        "base": base,
        "coating_top": coating,
        "coating_bottom": np.nan,
        "noise": noise,
    }
    return Greys(**of_all, polarity=sign, blur_um=2.4, padding=np.nan)


GREYS = levels(40.0, 90.0, 200.0, 5.0)
SMALL = (110, 120)


def voxels(grey):
    return sheets_volume(grey, VOXEL).assign_attrs(voxel_um=[VOXEL] * 3)


def layered(*, extra=None, depth=40, seed=0, noise=5.0, shape=(190, 200)):
    """A slab of base between coatings of 5 voxels, through z, and what the measurement would give
    of it.

    ``extra`` maps the share of the base's depth (0 at the top interface), rows and columns to a
    grey, or NaN.
    """
    rng = np.random.default_rng(seed)
    rise = (
        np.cumsum(np.full(shape[1], 0.1))[None, :] + 4 * np.sin(np.arange(shape[0]) / 20)[:, None]
    )
    low, high = 20 + rise, 20 + depth + rise
    z = np.arange(int(high.max()) + 30)[:, None, None]
    grey = np.where((z >= low - 5) & (z <= high + 5), 200.0, 40.0)
    inside = (z > low) & (z < high)
    grey[inside] = 90.0
    if extra is not None:
        put = extra((high - z) / depth, *np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"))
        grey = np.where(inside & np.isfinite(put), put, grey)
    texture = ndimage.gaussian_filter(rng.normal(size=grey.shape), 1.5)
    grey += np.where(inside, 12 * texture / texture.std(), 0)
    grey = ndimage.gaussian_filter(grey, 0.8) + rng.normal(0, noise, grey.shape)
    volume = voxels(np.clip(grey, 0, 255).astype(np.uint8))
    heights = {
        "top": high + 5,
        "bottom": low - 5,
        "interface_top": high,
        "interface_bottom": low,
        "centre": (high + low) / 2,
    }
    measured = xr.Dataset(
        {k: (("y", "x"), (v + np.zeros(shape)) * VOXEL) for k, v in heights.items()},
        coords={k: volume[k] for k in "yx"},
        attrs={
            "through": "z",
            "top_side": "high",
            "grey_air": 40.0,
            "grey_base": 90.0,
            "grey_coating_top": 200.0,
            "grey_coating_bottom": 200.0,
            "grey_noise": 5.0,
            "polarity": 1.0,
            "blur_um": 2.4,
        },
    )
    coating = ndimage.gaussian_filter(rng.normal(size=shape), 5)
    for side in ("top", "bottom"):
        measured[f"coating_{side}"] = (("y", "x"), 15 + 3 * coating / coating.std())
    measured["status"] = (("y", "x"), np.zeros(shape, np.uint8))
    return volume, measured


def turned(volume, through):
    """The same with the axis through the sheet along another one."""
    dims = {"z": ("z", "y", "x"), "y": ("y", "z", "x"), "x": ("x", "z", "y")}[through]
    return volume.rename(dict(zip(("z", "y", "x"), dims, strict=True))).transpose("z", "y", "x")


def judged(name, **scan):
    return RULES[name](SimpleNamespace(**scan))


def of_scan(name, volume, measured):
    """The check of this name; None where it says nothing."""
    return {check.name: check for check in check_scan(volume, measured)}.get(name)


@pytest.fixture(scope="module", autouse=True)
def right():
    """A right sheet, whose volume and measurement no test may change; its scan loads the
    kernels."""
    made = layered()
    check_scan(*made)
    return made


def test_right_sheet_passes_every_check_and_threads_change_nothing():
    volume, measured = layered(shape=SMALL)
    checks = check_scan(volume, measured, threads=1)
    assert ([c.name for c in checks if c.state != "pass"], len(checks)) == ([], 12)
    assert checks == check_scan(volume, measured, threads=3)


@pytest.mark.parametrize("through", ["z", "x"])
def test_second_sheet_fails(through):
    """A coating of 10 voxels in the middle of the base in a third of the sheet, through any
    axis."""
    volume, measured = layered(
        extra=lambda t, _r, c: np.where((abs(t - 0.5) < 0.12) & (c < 42), 200.0, np.nan),
        shape=SMALL,
    )
    found = of_scan("one sheet", turned(volume, through), measured.assign_attrs(through=through))
    assert (found.state, found.value) == ("fail", pytest.approx(0.35, abs=0.06))
    assert "second sheet" in found.sentence
    assert set(found.figures) == {"properties", "position"}


@pytest.mark.parametrize(("edge_um", "state"), [(120.0, "pass"), (300.0, "fail")])
def test_a_delamination_fails_from_300_um_on(edge_um, state):
    edge = edge_um / VOXEL
    volume, measured = layered(
        extra=lambda t, r, c: np.where(
            (abs(t - 0.5) < 0.08) & (abs(r - 55) < edge / 2) & (c < edge), 40.0, np.nan
        ),
        shape=SMALL,
    )
    found = of_scan("one sheet", volume, measured)
    assert found.state == state
    assert found.value == pytest.approx((edge_um / 60) ** 2, abs=0.45 * (edge_um / 60) ** 2)
    assert ("split" in found.sentence) == (state == "fail")


def test_a_second_sheet_learnt_as_base_is_seen():
    volume, measured = layered(
        extra=lambda t, _r, _c: np.where(abs(t - 0.5) < 0.12, 200.0, np.nan), shape=SMALL
    )
    measured = measured.assign_attrs(
        grey_base=150.0, grey_coating_top=np.nan, grey_coating_bottom=np.nan
    )
    assert of_scan("one sheet", volume, measured).state == "fail"


def test_strong_noise_is_no_gap():
    """Noise of 1.2 of the step from base to air leaves the median of 49 columns open by a fifth of
    it."""
    volume, measured = layered(noise=60.0, shape=SMALL)
    assert of_scan("one sheet", volume, measured).state == "pass"


@pytest.mark.parametrize(
    ("through", "fades_by", "state"), [("z", 0.3, "look"), ("x", 0.3, "look"), ("z", 0.03, "pass")]
)
def test_a_fading_beam_is_a_look(right, through, fades_by, state):
    """All grey falls along y; of the base's step from the air, 40 of 90, that is 2.25 times as
    much."""
    volume, measured = right
    fade = xr.DataArray(np.linspace(1, 1 - fades_by, volume.sizes["y"]), dims="y")
    volume = (volume * fade).transpose("z", "y", "x").assign_attrs(volume.attrs)
    greys = {f"grey_{k}": v * (1 - fades_by / 2) for k, v in (("air", 40.0), ("base", 90.0))}
    found = of_scan(
        "grey across the sheet",
        turned(volume, through),
        measured.assign_attrs(greys, through=through),
    )
    assert found.state == state
    # From the first tile's middle to the last one's, which is less than the whole.
    whole = fades_by * 90 / (50 * (1 - fades_by / 2))
    assert 0.8 * whole - 0.02 < found.value < whole + 0.02
    assert found.figures == ("properties",)
    along = {"z": "y", "x": "z"}[through]
    assert f"Along {along}" in found.sentence or state == "pass"


def test_a_strip_one_tile_wide_is_judged_along_it():
    """No parabola can be laid through it the other way."""
    volume, measured = layered(shape=(24, 700))
    found = of_scan("grey across the sheet", volume, measured)
    assert found.state == "pass"
    assert found.sentence.startswith("Along x, ")
    assert np.isfinite(found.value)


@pytest.mark.parametrize(("blur", "state"), [(5.5, "pass"), (7.5, "look")])
def test_wide_blurs_are_reported(right, blur, state):
    volume, measured = right
    found = of_scan("blur of the scan", volume, measured.assign_attrs(blur_um=blur))
    assert (found.state, found.value) == (state, pytest.approx(2.3548 * blur / 15, rel=0.02))


def test_what_the_sheet_does_not_show_is_left_out_or_unknown(right):
    volume, measured = right
    assert of_scan("filler", volume, measured) is None
    bare = measured.drop_vars(["coating_top", "coating_bottom"]).assign_attrs(
        grey_coating_top=np.nan
    )
    assert of_scan("blur of the scan", volume, bare) is None
    measured = measured.copy(deep=True)
    measured["status"].values[20:] = 3
    measured["status"].values[:, 100:] = 3
    found = of_scan("one sheet", volume, measured)
    assert found.state == "unknown"
    assert found.sentence.startswith("The base is seen in 5 tiles of 60 um only")


@pytest.mark.ci
@pytest.mark.parametrize(("sigma", "state"), [(1.0, "pass"), (2.5, "look")])
def test_a_filter_is_seen_in_the_noise_of_the_air(sigma, state):
    """White noise smoothed by a Gaussian, with streaks that go on: the width is that of the
    filter."""
    volume, measured = layered(shape=(120, 130))
    rng = np.random.default_rng(1)
    smooth = ndimage.gaussian_filter(rng.normal(size=(260, *volume.shape[1:])), sigma)
    streaks = ndimage.gaussian_filter(rng.normal(size=(260, *volume.shape[1:])), 15)
    air = 40 + 5 * smooth / smooth.std() + 2 * streaks / streaks.std()
    air[100 : 100 + volume.sizes["z"]][volume.values > 60] = 90
    tall = voxels(air.astype(np.float32))
    film = tall.copy()  # below a part of the sheet
    film[98:106, :, :60] += 50
    heights = {k: measured[k] + 100 * VOXEL for k in ("top", "bottom")}
    moved = measured.assign(heights)
    for scan in (tall, film):
        assert noise_width(scan, moved) == pytest.approx(2.3548 * sigma * VOXEL, rel=0.12)
    # The coating has 15 um.
    found = judged("blur of the scan", volume=tall, measured=moved, greys=GREYS)
    assert found.state == state
    assert found.sentence.startswith("The noise is smoothed over ")


def test_tiles_of_a_large_sheet_are_whole_squares():
    """120 x 120 tiles of five columns of 12 um: a sixth of them, in squares, each tile where its
    numbers say."""
    um = np.arange(600) * 12.0
    volume = xr.DataArray(
        np.broadcast_to(np.uint8(0), (40, 600, 600)),
        dims=("z", "y", "x"),
        coords={"z": np.arange(40) * 12.0, "y": um, "x": um},
        attrs={"voxel_um": [12.0] * 3},
    )
    heights = {
        "top": 300.0,
        "bottom": 150.0,
        "interface_top": np.nan,
        "interface_bottom": np.nan,
        "status": 0.0,
    }
    measured = xr.Dataset(
        {name: (("y", "x"), np.full((600, 600), value)) for name, value in heights.items()},
        coords={"y": um, "x": um},
        attrs={"through": "z", "top_side": "high", "blur_um": 10.0},
    )
    core = core_places(volume, measured)
    row, col = core.tiles
    points = core.points.reshape(*core.shape, 3)
    assert 0.9 * 2400 < row.size < 1.1 * 2400
    assert (points[..., 1] // 5 == row[:, None, None]).all()
    assert (points[..., 2] // 5 == col[:, None, None]).all()
    is_chosen = np.zeros((120, 120), bool)
    is_chosen[row, col] = True
    assert np.unique(ndimage.label(is_chosen)[0], return_counts=True)[1].min() >= 100


@pytest.mark.parametrize(
    ("top", "bottom", "state", "words"),
    [
        (200.0, 190.0, "pass", "200 (top) and 190 (bottom); of the base: 90."),
        (200.0, np.nan, "pass", "200 (top); of the base: 90."),
        (301.0, 290.0, "look", "beyond all greys of the volume, which end at 2"),
        (200.0, 150.0, "look", "55 % of the other's contrast"),
        (95.0, np.nan, "look", "On the top side no layer shows"),
    ],
)
def test_a_grey_that_no_coating_has_is_a_look(right, top, bottom, state, words):
    volume, measured = right
    measured = measured.assign_attrs(grey_coating_top=top, grey_coating_bottom=bottom)
    found = of_scan("grey of the coating", volume, measured)
    assert found.state == state
    assert words in found.sentence


@pytest.mark.parametrize(("grain", "state"), [(2, "look"), (7, "pass"), (None, "look")])
def test_filler_is_doubted_where_its_grains_are_not_resolved(grain, state):
    """Grains of some voxels through a base of 40, blurred over 1.9 voxels; coating that has run in
    is no grain."""

    def extra(t, r, c):
        is_column = (r % 15 < 7) & (c % 15 < 7)
        is_grain = is_column & (abs(t - 0.5) < grain / 80) if grain else np.zeros_like(t, bool)
        return np.where(is_grain | ((r < 15) & (t < 0.6)), 200.0, np.nan)

    volume, measured = layered(extra=extra, shape=SMALL)
    found = of_scan("filler", volume, measured.assign(filler=measured["coating_top"]))
    assert (found.state, found.value) == (state, pytest.approx(VOXEL * (grain or 0), abs=VOXEL))
    assert ("No grain" in found.sentence) == (grain is None)


def test_porosity_without_the_grey_of_a_wall_is_doubtful_and_says_what_the_brightest_make_of_it():
    """Walls of 140 take half of a base in air of 40: with their grey the porosity is one half."""

    def walls(t, r, c):
        return np.where((r // 8 + c // 8) % 2 == 0, 140.0, 40.0) + 0 * t

    volume, measured = layered(extra=walls, shape=SMALL)
    assert of_scan("porosity", volume, measured) is None
    measured = measured.assign(porosity=measured["coating_top"])
    found = of_scan("porosity", volume, measured)
    assert (found.state, found.figures) == ("look", ("porosity",))
    assert "below the grey 65:" in found.sentence
    assert found.remedy == "Give it with `solid_grey`."
    brightest, share = re.search(
        r"stay below, ([\d.]+), .* about ([\d.]+)\.", found.sentence
    ).groups()
    assert float(brightest) == pytest.approx(140, abs=10)  # two standard deviations of its noise
    assert float(share) == pytest.approx(0.5, abs=0.05)
    measured["porosity"].attrs["void_grey"] = 80.0
    assert "below the grey 80:" in of_scan("porosity", volume, measured).sentence
    measured["porosity"].attrs["solid_grey"] = 140.0
    found = of_scan("porosity", volume, measured)
    assert (found.state, found.sentence.endswith("is 140.")) == ("pass", True)


def test_sizes_of_pores_are_doubted_as_porosity_is_and_a_dark_sheet_has_its_voids_above():
    """The scan above as a negative: 255 less the grey."""

    def walls(t, r, c):
        return np.where((r // 8 + c // 8) % 2 == 0, 140.0, 40.0) + 0 * t

    volume, measured = layered(extra=walls, shape=SMALL)
    volume = volume.copy(data=255 - volume.values)
    greys = {k: 255.0 - v for k, v in measured.attrs.items() if k.startswith("grey_")}
    greys["grey_noise"] = measured.attrs["grey_noise"]
    measured = measured.assign_attrs(greys | {"polarity": -1.0})
    for names in (("pore_diameter",), ("porosity", "pore_chord", "pore_diameter")):
        maps = measured.assign({name: measured["coating_top"].copy() for name in names})
        found = of_scan("porosity", volume, maps)
        assert (found.state, found.figures) == ("look", names)
        assert "what lies above the grey 190:" in found.sentence
        brightest, share = re.search(
            r"stay above, ([\d.]+), .* about ([\d.]+)\.", found.sentence
        ).groups()
        assert float(brightest) == pytest.approx(115, abs=10)
        assert float(share) == pytest.approx(0.5, abs=0.05)
        maps[names[0]].attrs["solid_grey"] = 115.0
        assert of_scan("porosity", volume, maps).state == "pass"


@pytest.mark.parametrize(
    ("size_um", "form_um", "ratio", "doubted"),
    [
        ((1300.0, 1800.0), 800.0, None, ()),
        ((1300.0, 1800.0), 1200.0, 1.26, ("topography_top", "base_surface_top")),
        ((1100.0, 1100.0), 200.0, 1.375, ("roughness_top",)),
        ((400.0, 4800.0), 400.0, 0.92, ("roughness_top",)),
        (
            (1100.0, 1100.0),
            800.0,
            1.375,
            ("topography_top", "base_surface_top", "roughness_top"),
        ),
    ],
)
def test_heights_of_a_small_field_are_doubted(size_um, form_um, ratio, doubted):
    """By a nesting index of the form, and by one of 800 um of the roughness; air counts not."""
    known = np.ones([round(um / 10) for um in size_um])
    known = np.pad(known, 7, constant_values=np.nan)
    axes = {axis: 10.0 * np.arange(n) for axis, n in zip("yx", known.shape, strict=True)}
    rough = {"top": SimpleNamespace(l_filter_um=800.0), "bottom": SimpleNamespace(l_filter_um=None)}
    facts = SimpleNamespace(
        numbers=SimpleNamespace(form_um=form_um, roughness=rough),
        properties=dict.fromkeys(("thickness", "topography_top", "base_surface_top")),
    )
    maps = xr.Dataset({"topography_top": (("y", "x"), known)}, axes)
    found = RULES["field of the topography"](MeasuredSheet(facts, maps))
    if ratio is None:
        assert found is None
        return
    assert (found.state, found.figures) == ("look" if ratio < 1 else "pass", doubted)
    assert bool(found.remedy) == (found.state == "look")
    assert found.value == pytest.approx(ratio, abs=0.005)
    assert f"of {size_um[0]:.0f} x {size_um[1]:.0f} um is small" in found.sentence


def test_a_base_that_shows_no_pores_says_nothing_of_a_wall(right):
    volume, measured = right
    found = of_scan("porosity", volume, measured.assign(porosity=measured["coating_top"]))
    assert found.state == "look"
    assert found.sentence.endswith("count as wall.")


def test_the_level_of_filler_that_was_given_is_that_of_its_check():
    """Grains of 200 and 8 voxels, half way beyond the base's 90 and the coating's 200, not beyond
    250."""

    def grains(t, r, c):
        return np.where((abs(t - 0.5) < 0.1) & (r % 15 < 7) & (c % 15 < 7), 200.0, np.nan)

    volume, measured = layered(extra=grains, shape=SMALL)
    measured = measured.assign(filler=measured["coating_top"])
    assert of_scan("filler", volume, measured).value == pytest.approx(8 * VOXEL, abs=VOXEL)
    measured["filler"].attrs["filler_grey"] = 250.0
    assert "No grain" in of_scan("filler", volume, measured).sentence


@pytest.mark.parametrize(("voxel", "state"), [(30.0, "pass"), (31.0, "look")])
def test_few_voxels_through_the_sheet(right, voxel, state):
    """150 um between faces that lie level: five voxels of 30 um."""
    volume, measured = right[0], right[1].copy(deep=True)
    measured["top"].values[:] = 150.0
    measured["bottom"].values[:] = measured["centre"].values[:] = 0.0
    voxels = voxels_through(volume.assign_attrs(voxel_um=[voxel] * 3), measured)
    check = judged("voxels through the sheet", voxel_count=voxels)
    assert (check.value, check.state) == (pytest.approx(150 / voxel), state)


def histogram(dtype, scale=1.0, *, seed=0, at=np.inf, n=300_000, sign=1.0):
    rng = np.random.default_rng(seed)
    level = rng.choice([40.0, 90.0, 200.0], n, p=[0.6, 0.3, 0.1])
    grey = np.minimum(level + rng.normal(0, 8, n), at)
    grey = (grey if sign > 0 else 250 - grey) * scale
    return grey.astype(dtype) if np.dtype(dtype).kind == "f" else np.rint(grey).astype(dtype)


KINDS = [(np.uint8, 1.0), (np.uint16, 16.0), (np.int16, 50.0), (np.float32, 1 / 300)]


@pytest.mark.parametrize(("dtype", "scale"), KINDS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_clipping_at_any_level_in_any_type(dtype, scale, sign):
    turned = [v if sign > 0 else 250 - v for v in (40.0, 90.0, 200.0)]
    for at in (np.inf, 150.0, 195.0, 203.0):
        air, base, coating = (v * scale for v in turned)
        greys = levels(air, base, min(coating, at * scale) if sign > 0 else coating, 8 * scale)
        check = judged(
            "clipped grey", sample=histogram(dtype, scale, at=at, sign=sign), greys=greys
        )
        assert check.state == ("pass" if np.isinf(at) else "look"), (at, check.sentence)
        assert ("where the scale was cut off" in check.sentence) == (check.state == "look")
    interfaces = {"base_surface_top", "base_surface_bottom", "base_thickness"}
    assert set(check.figures) == {"coating_top", "coating_bottom", *interfaces, "thickness"}


def test_clipping_above_the_coating_passes_and_is_seen_in_stretched_volumes():
    check = judged("clipped grey", sample=histogram(np.uint8, at=212.0), greys=GREYS)
    assert check.state == "pass"
    assert check.value > 3
    assert "lies well inside" in check.sentence
    eight = histogram(np.uint8, at=150.0).astype(np.uint16) * 257
    spike, share, end = clipping(eight, levels(40 * 257, 90 * 257, 150 * 257, 5 * 257))
    assert spike > 3
    assert (share, end) == (pytest.approx(0.1, abs=0.01), 150 * 257)


def test_slices_scaled_one_by_one_are_seen(right):
    values = np.moveaxis(right[0].values, 1, 0).astype(float)
    right = window_of(values, "y")
    gain = 1 + 0.15 * np.random.default_rng(1).normal(size=len(values))
    wrong = window_of(values * gain[:, None, None], "y")
    print(f"levels jump by {level_jump(right):.2f} and {level_jump(wrong):.2f} greys of 160")
    scan = {"greys": GREYS, "assembled_axes": (), "through": "z"}
    assert judged("grey of the slices", windows={"y": right}, **scan).state == "pass"
    check = judged("grey of the slices", windows={"y": right, "x": wrong}, **scan)
    assert check.state == "look"
    # Of the grey at the 95th percentile, 110 to 200.
    assert 0.1 < check.value < 0.15 * 200 / 160


def test_particles_are_a_look_counted_and_covered_and_filled_valleys_are_none():
    rng = np.random.default_rng(0)
    field = ndimage.gaussian_filter(rng.normal(size=(500, 600)), 8)
    valleys = 15 + 4 * field / field.std()
    face = np.full(valleys.shape, 50.0)
    rows, cols = np.meshgrid(np.arange(500), np.arange(600), indexing="ij")
    for k in range(9):
        valleys[(rows - 40 - 50 * k) ** 2 + (cols - 500 + 55 * k) ** 2 < 36] += 40.0
    assert sheets.find_particles(valleys, face, (3.0, 3.0)).n_particles == 0
    assert dust(valleys, face).state == "pass"
    grains = np.zeros(valleys.shape)
    for k in range(9):
        grains[(rows - 50 - 50 * k) ** 2 + (cols - 60 - 55 * k) ** 2 < 36] += 40.0
    # A thick place over which the face rises by less than half of it is a filled valley as well.
    hardly_raised = sheets.find_particles(valleys + 1.5 * grains, face + 0.6 * grains, (3.0, 3.0))
    assert hardly_raised.n_particles == 0
    grains[:, :5] = np.nan
    found = sheets.find_particles(valleys + grains, face + grains, (3.0, 3.0))
    assert (found.n_particles, found.per_mm2) == (9, pytest.approx(9 / 2.6775))
    assert found.mask.sum() == pytest.approx(9 * 113, rel=0.15)
    check = dust(valleys + grains, face + grains)
    assert check.state == "look"
    assert check.sentence.startswith("9 particles stick out of the top coating, 3.4 per mm²")


def dust(coating, face):
    """What the check says of a coating on a face above a level centre surface."""
    maps = {"coating_top": coating, "top": face, "centre": 0 * face}
    places = {"y": 3.0 * np.arange(500), "x": 3.0 * np.arange(600)}
    return judged(
        "dust, top", measured=xr.Dataset({k: (("y", "x"), v) for k, v in maps.items()}, places)
    )
