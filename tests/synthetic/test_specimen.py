"""The specimen's truth has to be exact: everything else is judged by it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planish.synthetic import SpecimenParams, Warp, make_specimen
from planish.synthetic.sheet import SheetParams


@given(slope=st.floats(0, 0.6), ruling=st.floats(-90, 90), wavelength=st.floats(1500, 6000), s=st.floats(-60, 60))
def test_the_inverse_of_the_warp_is_exact(slope, ruling, wavelength, s):
    warp = Warp(slope=slope, ruling_deg=ruling, wavelength_um=wavelength, bump_um=20.0)
    u, v = np.array([-1200.0, 3.0, 900.0]), np.array([700.0, -5.0, -1100.0])
    points = warp.points(u, v) + s * warp.normals(u, v)
    back = warp.material(points)
    np.testing.assert_allclose(back, np.stack([u, v, np.full(3, s)], axis=-1), atol=1e-3)


def test_a_general_cylinder_keeps_every_length():
    warp = Warp(slope=0.577, ruling_deg=35.0, wavelength_um=2500.0)
    t = np.linspace(0, 1, 20_001)
    for direction in ((1.0, 0.0), (0.0, 1.0), (0.6, 0.8)):
        u, v = (2000 * (t - 0.5) * d for d in direction)
        length = np.linalg.norm(np.diff(warp.points(u, v), axis=0), axis=1).sum()
        # chords of 0.1 um are shorter than their arcs by less than 1e-9
        assert length == pytest.approx(2000.0, rel=1e-8)


def test_the_slope_is_the_one_asked_for():
    warp = Warp(slope=0.5, ruling_deg=0.0)
    u = np.linspace(-3000, 3000, 6001)
    normals = warp.normals(u, np.zeros_like(u))
    assert np.max(np.abs(normals[:, 0] / normals[:, 2])) == pytest.approx(0.5, abs=1e-6)


def test_columns_stand_above_their_material():
    warp = Warp(bump_um=30.0)
    under = warp.columns(np.array([-400.0, 250.0]), np.array([-700.0, 10.0, 800.0]))
    points = warp.points(under[..., 0], under[..., 1])
    np.testing.assert_allclose(points[..., 0], [[-700.0, 10.0, 800.0]] * 2, atol=1e-3)
    np.testing.assert_allclose(points[..., 2], under[..., 2], atol=1e-3)


@pytest.fixture(scope="module")
def clean():
    """A flat sheet without blur, noise or texture: voxels are exact means over their height."""
    sheet = SheetParams(base_density_sd=0.0)
    params = SpecimenParams(
        size_um=(700.0, 600.0), holes=1, noise=0.0, blur_um=0.0, warp=Warp(slope=0.0), sheet=sheet,
        dtype=np.float64, grey=(0.0, 1.0, 3.0),
    )  # fmt: skip
    return make_specimen(params)


def test_thickness_is_read_back_from_a_clean_render(clean):
    """Grey sums to base + 3 x coating in every column; away from the hole's burnt rim."""
    where = clean.columns
    at = [clean.sheet.at(f, where["u"].values, where["v"].values) for f in clean.sheet.faces]
    away = clean.sheet.at(clean.sheet.rim_um, where["u"].values, where["v"].values) > 150
    expected = (at[1] - at[2]) + 3 * (at[0] - at[1] + at[2] - at[3])
    found = clean.volume.sum(axis=0) * clean.params.voxel_um
    error = (found - expected)[away]
    print(f"clean render: thickness read back to {np.sqrt(np.mean(error**2)):.3f} um rms")
    assert np.sqrt(np.mean(error**2)) < 0.1 * clean.params.voxel_um


def test_same_seed_same_bytes_on_any_number_of_threads():
    params = SpecimenParams(size_um=(700.0, 600.0), holes=1, voxel_um=5.0)
    one, three = make_specimen(params, threads=1), make_specimen(params, threads=3)
    assert one.volume.tobytes() == three.volume.tobytes()
    assert one.image.tobytes() == three.image.tobytes()
    other = make_specimen(SpecimenParams(size_um=(700.0, 600.0), holes=1, voxel_um=5.0, seed=1))
    assert other.volume.shape != one.volume.shape or other.volume.tobytes() != one.volume.tobytes()


def test_the_sheet_is_what_was_ordered(specimen):
    truth, p = specimen.truth, specimen.params.sheet
    # a field of 1 mm2 holds few flocs and some hundred fibres: the means wander by a few tenths
    assert float(truth["coating_top"].mean()) == pytest.approx(p.coating_top_um, abs=0.7)
    assert float(truth["base_thickness"].mean()) == pytest.approx(p.base_um, abs=3.0)
    # the coating levels the base: thin where the base stands up
    base_top = specimen.sheet.at(specimen.sheet.faces[1], truth["u"].values, truth["v"].values)
    assert np.corrcoef(base_top.ravel(), truth["coating_top"].values.ravel())[0, 1] < -0.6
    assert float((truth["coating_top"] >= 0).mean()) == 1.0
