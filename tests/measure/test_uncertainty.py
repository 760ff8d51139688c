"""Standard errors of thicknesses: of a single column, of the mean of many, of a pixel."""

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

from planish.measure import Greys, measure_properties, uncertainty
from planish.resample import maps
from planish.run import facts as run_facts
from planish.surface import find_surfaces
from surface.sheets import volume

FINE = 4  # sub-slices a voxel: partial volume, as a scanner shows it
AIR, BASE, COAT = 40.0, 90.0, 200.0
NAMES = ("coating_top", "coating_bottom", "base_thickness", "thickness")


def rough_sheet(voxel, noise, seed):
    """A level sheet with rough faces and pores in its base; its volume and its true thicknesses."""
    rng = np.random.default_rng(seed)
    cols, depth = (110, 120), 70

    def field(sd, length):
        made = ndimage.gaussian_filter(rng.standard_normal(cols), length / voxel, mode="wrap")
        return sd * made / made.std()

    base, own = 50 + field(2, 20) + field(2, 80), field(2, 25)
    top, bottom = 14 + field(2.5, 30), 12 + field(2.5, 30)
    inner_top, inner_bottom = own + base / 2, own - base / 2
    faces = inner_top + top, inner_top, inner_bottom, inner_bottom - bottom
    heights = [0.5 * (depth - 1) * voxel + f for f in faces]
    z = (np.arange(depth * FINE) + 0.5) * voxel / FINE - 0.5 * voxel
    inside = [(z[:, None, None] < h).astype(np.float32) for h in heights]
    pores = (
        1
        + 0.3
        * ndimage.gaussian_filter(rng.standard_normal((depth, *cols)), 1.0).astype(np.float32)
        * 5
    )
    sheet, core = inside[0] - inside[3], inside[1] - inside[2]
    coarse = [part.reshape(depth, FINE, *cols).mean(axis=1) for part in (sheet, core)]
    grey = (COAT - AIR) * (coarse[0] - coarse[1]) + (BASE - AIR) * coarse[1] * pores
    grey = (
        AIR
        + ndimage.gaussian_filter(grey, 0.75)
        + noise * (COAT - AIR) * rng.standard_normal(grey.shape)
    )
    made = volume(np.rint(grey).clip(0, 255).astype(np.uint8), voxel).assign_attrs(
        voxel_um=[voxel] * 3
    )
    return made, dict(zip(NAMES, (top, bottom, base, top + base + bottom), strict=True))


@pytest.mark.ci
def test_z_scores_of_another_makers_sheets():
    """Pooled over sheets with partial volume: rms 0.85 to 1.2, and two standard errors hold 93
    %."""
    scores = {name: [] for name in NAMES}
    for voxel, noise, seed in ((3.0, 0.04, 0), (2.5, 0.09, 1)):
        grey, true = rough_sheet(voxel, noise, seed)
        found = measure_properties(find_surfaces(grey), volume=grey)
        for name in NAMES:
            score = ((found[name].values - true[name]) / found[f"{name}_se"].values)[10:-10, 10:-10]
            scores[name].append(score[np.isfinite(score)])
    pooled = {name: np.concatenate(parts) for name, parts in scores.items()}
    rms = [np.sqrt(np.mean(score**2)) for score in pooled.values()]
    assert all(0.85 < r < 1.2 for r in rms)
    assert np.mean(np.abs(np.concatenate([*pooled.values()])) < 2) >= 0.93


def test_the_mean_counts_what_neighbours_share():
    at = np.arange(77) * 3.0
    se = np.full((77, 77), np.hypot(0.5, 0.1))
    data = xr.Dataset(
        {
            "thickness": (("y", "x"), 80 + 0 * se, {"units": "um", "role": "property"}),
            "thickness_se": (("y", "x"), se, {"patch_um2": 14 * 9.0, "common_um": 0.1}),
        },
        {"y": at, "x": at},
    )
    facts = run_facts.property_facts(data)["thickness"]
    assert facts.n_independent == 77 * 77 // 14
    assert facts.mean_standard_error == pytest.approx(
        np.hypot(0.5 / np.sqrt(77 * 77 / 14), 0.1), rel=1e-3
    )


def test_only_what_has_a_zero_of_its_own_has_a_coefficient_of_variation():
    rng = np.random.default_rng(0)
    shape = 40, 50
    drawn = {
        "coating_top": (rng.normal(0.1, 0.01, shape), "um"),
        "coating_bottom": (np.where(rng.random(shape) < 0.03, -0.01, 2.0), "um"),  # noise at 0
        "topography_top": (rng.normal(0.1, 1.0, shape), "um"),
        "fibre_angle": (rng.normal(40.0, 2.0, shape), "deg"),
        "warp": (np.zeros(shape), "um"),
    }
    data = xr.Dataset(
        {
            name: (("y", "x"), values, {"units": units, "role": "property"})
            for name, (values, units) in drawn.items()
        },
        {"y": 3.0 * np.arange(40), "x": 3.0 * np.arange(50)},
    )
    facts = run_facts.property_facts(data)
    for name, (values, _) in drawn.items():
        found = facts[name].coefficient_of_variation
        if name.startswith("coating"):
            assert found == pytest.approx(values.std() / values.mean())
        else:
            assert found is None


def test_standard_error_of_a_pixel_beside_drawn_fields():
    """A Gaussian autocorrelation of the stated integral: the scatter of means over squares of 1 to
    12 columns."""
    rng = np.random.default_rng(0)
    sigma = 1.5  # of the autocorrelation, in columns
    drawn = ndimage.gaussian_filter(
        rng.standard_normal((1200, 1200)), sigma / np.sqrt(2), mode="wrap"
    )
    drawn /= drawn.std()
    for wide in (3, 6, 12):
        means = drawn.reshape(1200 // wide, wide, 1200 // wide, wide).mean(axis=(1, 3))
        stated = maps.se_of_mean(
            np.ones(1), {"patch_um2": 2 * np.pi * sigma**2 * 4.0, "common_um": 0.0}, wide * 2.0
        )
        assert means.std() == pytest.approx(float(stated[0]), rel=0.06)
    common = maps.se_of_mean(np.ones(1), {"patch_um2": 4.0, "common_um": 0.6}, 1e4)
    assert float(common[0]) == pytest.approx(0.6, rel=1e-3)


def test_averaging_and_shared_noise_leave_fewer_independent_values():
    plain = {
        "air": 40.0,
        "base": 90.0,
        "coating_top": 200.0,
        "coating_bottom": 200.0,
        "polarity": 1.0,
        "blur_um": 2.5,
        "padding": np.nan,
    }

    def shared_noise(noise, single=8.0, averaged=0.0, **more):
        greys = Greys(noise=noise, single_noise=single, averaged=averaged, **plain)
        return uncertainty.SharedNoise.of(
            greys, voxel_um=3.0, pitch_um=(3.0, 3.0), column_px=1.0, **more
        )

    white = shared_noise(8.0)
    assert (white.patch_um2, white.noise_um) == (
        pytest.approx(14 * 9.0),
        pytest.approx(8.0**2 * 3.0),
    )
    averaged = shared_noise(2.0, averaged=1.0)
    assert averaged.patch_um2 == pytest.approx((14 + 4 * np.pi) * 9.0)
    assert averaged.noise_um < white.noise_um
    shared = shared_noise(8.0, noise_um=3 * white.noise_um)
    assert shared.noise_um == pytest.approx(3 * white.noise_um)
    assert shared.patch_um2 == pytest.approx((14 + 8) * 9.0)
    # Without noise, what little scatters in the air is no measure of anything: it made 2.5 mm of a
    # coating's error.
    clean = shared_noise(4e-5, 4e-5, noise_um=0.05)
    assert (clean.patch_um2, clean.common_um) == (
        pytest.approx(14 * 9.0),
        uncertainty.common_errors(3.0),
    )
