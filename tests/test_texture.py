"""What layers of a link say by their own texture."""

import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

from planish.analyze import texture_of

PIXEL_UM = 5.0


def field(seed, shape=(180, 220), sigma=3.0):
    made = ndimage.gaussian_filter(
        np.random.default_rng(seed).standard_normal(shape), sigma, mode="wrap"
    )
    return made / made.std()


def layer(expected_um=None, **maps):
    shape = next(iter(maps.values())).shape
    y, x = (PIXEL_UM * np.arange(n) for n in shape)
    data = {k: (("y", "x"), m) for k, m in maps.items()}
    if expected_um is not None:
        data["expected_error"] = (("y", "x"), np.full(shape, expected_um))
    return xr.Dataset(
        data | {"valid": (("y", "x"), np.ones(shape, dtype=bool))}, coords={"y": y, "x": x}
    )


def a_sheet(expected_um=2.0):
    top, bottom, base = field(0), field(1), field(2)
    return layer(
        expected_um,
        coating_top=12 + 3 * top,
        coating_bottom=12 + 3 * bottom,
        thickness=80 + 3 * (top + bottom + base),
        topography_top=40 + 3 * top + 2 * base,
        topography_bottom=40 + 3 * bottom + 2 * base,
    )


def test_a_sheet_and_its_image_in_either_order():
    sheet = a_sheet()
    # 15 um to the right.
    image = layer(image=200 - 20 * np.roll(field(0), 3, axis=1) + 10 * field(9))
    for a, b, names in ((sheet, image, ("sheet", "photo")), (image, sheet, ("photo", "sheet"))):
        lag, (side, position) = texture_of(a, b, names)
        assert side.state == "pass"
        assert side.sentence.startswith(
            "Photo correlates with the coating of the top side (r = -0.6"
        )
        assert (position.state, position.figures) == ("look", ("position", "correlation"))
        assert (lag.lag_um, lag.property) == (pytest.approx((15.0, 0.0), abs=1.0), "coating_top")
    far = layer(image=200 - 20 * np.roll(field(0), 16, axis=1) + 10 * field(9))
    lost, displaced = texture_of(sheet, far, ("sheet", "photo")).checks
    assert (lost.state, displaced.state) == ("look", "look")
    assert lost.sentence.endswith("Moved by 81.1 um they do go together (position by texture).")
    turned = texture_of(sheet, image, ("sheet", "photo"), side="bottom")
    # The lag is that of the face that goes with it.
    assert [check.state for check in turned.checks] == ["fail", "look"]


def test_an_image_in_transmitted_light_lies_by_the_thickness_and_not_by_slopes():
    """With the coating alone, slopes stood for the base: 0.73 of R2, and a lag of 20 um."""
    sheet = a_sheet()
    image = layer(image=np.exp(-0.01 * sheet["thickness"].values) + 0.01 * field(9, sigma=1.0))
    lag, (side, position) = texture_of(sheet, image, ("sheet", "radiograph"))
    assert (side.state, position.state, lag.property) == ("unknown", "pass", "thickness")
    assert lag.length_um < 1.0
    assert lag.light < 0.05


def test_the_texture_of_a_small_sheet_is_that_of_paper_in_its_own_unit():
    sheet, image = a_sheet(), layer(image=200 - 20 * np.roll(field(0), 3, axis=1) + 10 * field(9))
    lag, (side, _) = texture_of(sheet, image, ("sheet", "photo"))
    small = [d.assign_coords(y=0.01 * d["y"], x=0.01 * d["x"]) for d in (sheet, image)]
    small[0]["expected_error"] *= 0.01
    small_lag, (small_side, _) = texture_of(*small, ("sheet", "photo"), unit_um=0.01)
    assert small_side.state == "pass"
    assert small_side.value == pytest.approx(side.value)
    for key in ("lag_um", "se_um", "length_um", "length_se_um", "reach_um", "expected_um"):
        assert 100 * np.array(getattr(small_lag, key)) == pytest.approx(
            np.array(getattr(lag, key)), abs=1e-6
        )
    assert (small_lag.agrees, small_lag.r) == (lag.agrees, pytest.approx(lag.r))


def test_coatings_within_their_error_and_pixels_too_large_for_texture_are_inconclusive():
    sheet = a_sheet()
    errors = {f"coating_{side}_se": sheet["coating_top"] * 0 + 5.0 for side in ("top", "bottom")}
    noise = sheet.assign(errors)
    side = texture_of(noise, layer(image=field(30)), ("sheet", "photo")).checks[0]
    assert side.state == "unknown"
    assert "no coating is seen on the top side" in side.sentence
    assert texture_of(sheet, layer(image=field(30)), ("sheet", "photo")).checks[0].state == "look"
    coarse = layer(image=field(0)).assign_coords(y=80.0 * np.arange(180), x=80.0 * np.arange(220))
    lag, (only,) = texture_of(coarse, coarse, ("a", "b"))
    assert (lag, only.state) == (None, "unknown")
    assert "pixels of 62.5 um or less" in only.sentence


@pytest.mark.parametrize("other", [a_sheet(), layer(image=field(30))], ids=["sheet", "image"])
def test_layers_without_a_valid_pixel_in_common_are_inconclusive(other):
    checks = texture_of(
        a_sheet(), other.assign(valid=other["valid"] & False), ("sheet", "other")
    ).checks
    assert [check.state for check in checks] == ["unknown"] * len(checks)
    assert "inconclusive" in checks[0].sentence


SCRIPT = """
import numpy as np
from planish.texture.textures import relate, unexplained
for seed in range(4):
    a, b = np.random.default_rng(seed).standard_normal((2, 240, 300))
    relation = relate(a, a + b, np.ones(a.shape, bool), (5.0, 5.0))
    print(relation, relation.r.hex(), float(np.sum(unexplained(a, b))).hex())
"""


@pytest.mark.ci
def test_a_relation_is_the_same_on_any_number_of_threads_of_numpy():
    texts = [
        subprocess.run(
            [sys.executable, "-c", SCRIPT],
            env=os.environ | {"OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2", "3")
    ]
    assert texts[0] == texts[1] == texts[2]
