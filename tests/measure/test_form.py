"""Faces of known spectra above their own forms, flat and bent, with borders and holes."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from planish.measure import MeasureParams, measure_properties, scale_limited, sheet_numbers
from planish.measure.rays import meet
from planish.surface.centre import gaussian_regression
from planish.synthetic import BurnParams, PaperParams, make_sheet
from planish.synthetic.sheet import PITCH_UM

HALF_UM, NESTING_UM = 40.0, 800.0
HOLES = ((500.0, 700.0, 200.0), (0.0, 1600.0, 300.0))


def waves(sq, *, seed, low=100.0, high=400.0, number=12):
    """A height (um) over u, v that is a sum of waves, and the same of what a filter leaves."""
    rng = np.random.default_rng(seed)
    length = np.exp(rng.uniform(np.log(low), np.log(high), number))
    way, phase = rng.uniform(0, 2 * np.pi, (2, number))
    size = np.sqrt(length)
    size *= sq / np.sqrt(0.5 * np.sum(size**2))

    def height(u, v):
        found = np.zeros(np.broadcast(u, v).shape)
        for k in range(number):
            along = np.cos(way[k]) * u + np.sin(way[k]) * v
            found += size[k] * np.cos(2 * np.pi * along / length[k] + phase[k])
        return found

    return height


def bent(heights, *, rise, length, angle, pitch=8.0, shape=(200, 300)):
    """Surfaces of a sheet that is bent to waves ``rise`` um high across ``angle``, and the heights
    of its faces over the middle, as drawn, on the rays of the columns.

    A sheet that is bent along one way has its lengths across it as arcs of the wave.
    """
    y, x = (np.arange(n) * pitch for n in shape)
    yy, xx = np.meshgrid(y - y.mean(), x - x.mean(), indexing="ij")
    across = xx * np.cos(angle) + yy * np.sin(angle)
    v = yy * np.cos(angle) - xx * np.sin(angle)
    k = 2 * np.pi / length
    line = np.linspace(across.min() - 300, across.max() + 300, 20001)
    steps = np.hypot(np.diff(line), np.diff(rise * np.sin(k * line)))
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    is_hole = np.zeros(shape, dtype=bool)
    for hole_y, hole_x, radius in HOLES:
        is_hole |= np.hypot(y[:, None] - hole_y, x[None, :] - hole_x) < radius
    drawn = {side: height(np.interp(across, line, arc), v) for side, height in heights.items()}
    faces = {}
    for side, outwards in (("top", 1.0), ("bottom", -1.0)):
        foot = across
        for _ in range(15):
            slope = rise * k * np.cos(k * foot)
            cosine = 1 / np.hypot(1, slope)
            distance = outwards * (HALF_UM + heights[side](np.interp(foot, line, arc), v))
            foot = across + slope * cosine * distance
        faces[side] = np.where(is_hole, np.nan, rise * np.sin(k * foot) + cosine * distance)
    faces["centre"] = gaussian_regression(
        0.5 * (faces["top"] + faces["bottom"]), (pitch, pitch), cutoff_um=400.0
    )
    faces["interface_top"] = faces["interface_bottom"] = np.full(shape, np.nan)
    data = {name: (("y", "x"), values) for name, values in faces.items()}
    data["status"] = (("y", "x"), is_hole.astype(np.uint8))
    attrs = {"through": "z", "top_side": "high", "cutoff_um": 400.0}
    return xr.Dataset(data, coords={"y": y, "x": x}, attrs=attrs), drawn


@pytest.mark.parametrize(
    ("rise", "length", "angle"),
    [
        (0.0, 6000.0, 0.0),
        (300.0, 6000.0, 0.3),
        # slopes to 60 degrees, radii down to 1.1 and 0.55 mm
        (3300.0, 12000.0, 0.5),
        (1650.0, 6000.0, 0.7),
    ],
)
def test_a_face_has_its_height_flat_and_bent(rise, length, angle):
    heights = {"top": waves(3.0, seed=1), "bottom": waves(4.0, seed=2)}
    surfaces, drawn = bent(heights, rise=rise, length=length, angle=angle)
    found = measure_properties(surfaces)
    known = found["status"].values == 0
    _, faces = meet(surfaces, "normal")
    met = np.isfinite(faces["top"]) & np.isfinite(faces["bottom"]) & (surfaces["status"] == 0)
    np.testing.assert_array_equal(known, met)
    for side in ("top", "bottom"):
        topography = found[f"topography_{side}"]
        assert np.isfinite(topography.values[known]).all()
        assert topography.attrs["form_um"] == NESTING_UM
        sq = float(topography.std())
        assert sq == pytest.approx(drawn[side][known].std(), rel=0.03)
        half = faces[side][known] * (1.0 if side == "top" else -1.0)
        assert np.corrcoef(topography.values[known], drawn[side][known])[0, 1] > 0.98
        assert half.mean() == pytest.approx(HALF_UM, abs=1.0)


@pytest.mark.ci
def test_the_form_is_that_of_the_centre_surface_and_halves_its_nesting_index():
    y, x = np.mgrid[:104, :120] * 25.0
    for length, share in ((400.0, 1.0), (800.0, 0.5)):
        wave = np.cos(2 * np.pi * (0.6 * x + 0.8 * y) / length)
        left = scale_limited(wave, (25.0, 25.0), s_filter_um=5.0, l_filter_um=NESTING_UM)
        inner = (slice(44, 60), slice(44, 76))
        gain = np.sum(left[inner] * wave[inner]) / np.sum(wave[inner] ** 2)
        assert gain == pytest.approx(share, abs=0.012)
    height = waves(3.0, seed=3, high=3000.0)(x, y)
    height[:24, :24] = height[48:58, 72:88] = np.nan
    left = scale_limited(height, (25.0, 25.0), s_filter_um=5.0, l_filter_um=NESTING_UM)
    form = gaussian_regression(height, (25.0, 25.0), cutoff_um=NESTING_UM)
    known = np.isfinite(height)
    np.testing.assert_array_equal(np.isfinite(left), known)
    assert np.std((height - left - form)[known]) < 0.03 * np.std(form[known])


@pytest.mark.ci
def test_heights_of_small_fields_are_too_low_by_as_much_as_is_documented():
    """Waves to twice the nesting index; parts of a field by themselves, and within it."""
    y, x = np.mgrid[:175, :175] * 16.0
    filters = {"s_filter_um": 5.0, "l_filter_um": NESTING_UM}
    power = {25: [], 50: []}
    for seed in range(3):
        height = waves(3.0, seed=seed, low=40.0, high=1600.0, number=60)(x, y)
        within = scale_limited(height, (16.0, 16.0), **filters)
        for side, powers in power.items():
            for row in range(37, 137, side):
                for col in range(37, 137, side):
                    part = (slice(row, row + side), slice(col, col + side))
                    alone = scale_limited(height[part], (16.0, 16.0), **filters)
                    powers.append((np.mean(alone**2), np.mean(within[part] ** 2)))
    for side, share in ((25, 0.66), (50, 0.85)):  # 400 and 800 um
        alone, within = np.mean(power[side], axis=0)
        assert np.sqrt(alone / within) == pytest.approx(share, abs=0.06)


def test_a_coating_levels_the_surface_of_its_base_as_drawn():
    """Gain of the coating over the base's surface: what the levelling takes off, with its sign."""
    paper = PaperParams(coating_sd_um=0.0, coating_noise_sd_um=0.0, coating_top_um=40.0)
    high = np.array([2400.0, 1600.0])
    sheet = make_sheet(
        paper, BurnParams(), low=np.zeros(2), high=high, centres=np.zeros((0, 2)), seed=0
    )
    step = max(1, round(5.0 / PITCH_UM))
    heights = sheet.faces[:, ::step, ::step].astype(float)
    pitch = step * PITCH_UM
    names = ("top", "interface_top", "interface_bottom", "bottom")
    data = {name: (("y", "x"), height) for name, height in zip(names, heights, strict=True)}
    middle = 0.5 * (heights[0] + heights[3])
    data["centre"] = (("y", "x"), gaussian_regression(middle, (pitch, pitch), cutoff_um=400.0))
    data["status"] = (("y", "x"), np.zeros(middle.shape, np.uint8))
    coords = {axis: np.arange(n) * pitch for axis, n in zip("yx", middle.shape, strict=True)}
    attrs = {"through": "z", "top_side": "high", "cutoff_um": 400.0}
    found = measure_properties(xr.Dataset(data, coords=coords, attrs=attrs))
    window = np.hanning(middle.shape[0])[:, None] * np.hanning(middle.shape[1])
    spectra = {}
    for name in ("coating_top", "base_surface_top"):
        values = np.nan_to_num(found[name].values - float(found[name].mean()))
        spectra[name] = np.fft.fft2(window * values)
    frequency = np.hypot(
        *np.meshgrid(*(np.fft.fftfreq(n, pitch) for n in middle.shape), indexing="ij")
    )
    coating, base = spectra["coating_top"], spectra["base_surface_top"]
    for wave in (80.0, 125.0, 250.0, 350.0):
        ring = np.abs(frequency * wave - 1) < 0.12
        gain = np.sum(coating[ring] * base[ring].conj()) / np.sum(np.abs(base[ring]) ** 2)
        left = 1 - 0.5 ** ((paper.levelling_um / wave) ** 2)
        assert gain.real == pytest.approx(-left, abs=0.06)
        assert abs(gain.imag) < 0.05


def test_a_side_without_a_coating_has_no_surface_of_a_base_and_halves_add_up(made):
    sheet = made(bottom=0.0, slope=(0.0, 0.3), size_um=(80.0, 100.0))
    found = measure_properties(sheet.surfaces, params=MeasureParams(form_um=250.0))
    assert np.isnan(found["base_surface_bottom"]).all()
    assert np.isfinite(found["base_surface_top"]).any()
    assert found["topography_bottom"].attrs["form_um"] == 250.0
    halves = sheet.measured("half_thickness_top", "half_thickness_bottom", "thickness")
    total = halves["half_thickness_top"] + halves["half_thickness_bottom"]
    np.testing.assert_allclose(total, halves["thickness"], atol=1e-3)


def test_numbers_of_roughness_are_those_of_the_face_on_a_small_field(rough):
    found = measure_properties(rough.surfaces)
    for l_filter_um in (100.0, 800.0):
        params = MeasureParams(l_filter_um=l_filter_um)
        numbers = sheet_numbers(found, volume=None, params=params)
        maps = rough.measured("roughness_top", l_filter_um=l_filter_um)
        assert numbers.form_um == 800.0
        assert numbers.roughness["top"].reason is None
        assert numbers.roughness["top"].sq == pytest.approx(
            float(maps["roughness_top"].std()), rel=1e-4
        )


def test_heights_along_vertical_rays_are_longer_by_the_cosine(made):
    sheet = made(slope=(0.0, 0.5), size_um=(120.0, 150.0))
    wave = np.cos(2 * np.pi * sheet.surfaces["y"] / 40.0)
    surfaces = sheet.surfaces.assign(top=sheet.surfaces["top"] + wave)
    waved = replace(sheet, surfaces=surfaces)
    sq = {
        rays: float(waved.measured("topography_top", rays=rays)["topography_top"].std())
        for rays in ("normal", "vertical")
    }
    assert sq["vertical"] == pytest.approx(np.sqrt(0.5), rel=0.03)
    assert sq["vertical"] / sq["normal"] == pytest.approx(np.hypot(1, 0.5), rel=0.01)


def test_halves_of_the_thickness_need_no_grey(made):
    """They are those measured in the volume; of labels, and of surfaces alone, too."""
    names = ("half_thickness_top", "half_thickness_bottom", "half_thickness_difference")
    sheet = made(bottom=0.0, slope=(0.0, 0.3), size_um=(80.0, 100.0))
    params = MeasureParams(maps=names)
    in_volume = measure_properties(sheet.surfaces, volume=sheet.volume, params=params)
    labelled = sheet.surfaces.assign_attrs(from_labels="base 1")
    alone = measure_properties(sheet.surfaces, params=params)
    for found in (alone, measure_properties(labelled, volume=sheet.volume, params=params)):
        for name in names:
            np.testing.assert_allclose(found[name], in_volume[name], atol=1e-3)
            assert found[name].attrs == {
                "units": "um",
                "long_name": in_volume[name].long_name,
                "role": "property",
            }
    assert measure_properties(alone, params=params).identical(alone)
    assert "half_thickness_top" not in measure_properties(sheet.surfaces)
    assert not {*names} & {*measure_properties(alone).data_vars}
