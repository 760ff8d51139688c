"""Sheets of fibres: none of their pores, valleys and specks is a fault, and their faults are
seen."""

import numpy as np
import pytest
from scipy import ndimage

from planish.checks import check_scan
from planish.measure import measure_properties
from planish.surface import find_surfaces
from planish.synthetic import (
    BurnParams,
    FibreParams,
    PaperParams,
    ScannerParams,
    SpecimenParams,
    make_specimen,
)

pytestmark = pytest.mark.nightly

PAPER = PaperParams(
    base_um=52.0,
    coating_top_um=11.0,
    coating_bottom_um=13.0,
    coating_sd_um=4.0,
    roughness_um=3.5,
    filler=0.1,
    fibres=FibreParams(g_per_m2=36.0, flexibility=(0.12, 0.2)),
)
SCANNER = ScannerParams(voxel_um=2.8, fwhm_um=4.0, noise=0.08, grey=(40.0, 110.0, 190.0))


@pytest.fixture(scope="module")
def coated():
    specimen = make_specimen(
        SpecimenParams(
            size_um=(900.0, 800.0),
            paper=PAPER,
            scanner=SCANNER,
            seed=4,
            holes=BurnParams(pattern="irregular", count=1),
        )
    )
    surfaces = find_surfaces(specimen.volume)
    return specimen.volume, measure_properties(surfaces, volume=specimen.volume)


def split(volume, measured, width_um):
    """The sheet with a gap of 15 um in the middle of its base, round and narrowing to its rim."""
    heights = volume.z.values[:, None, None]
    middle = 0.5 * (measured["top"] + measured["bottom"]).values
    is_whole = ndimage.uniform_filter(
        (measured["status"].values == 0).astype(float), int(width_um / 2.8), mode="constant"
    )
    row, col = np.unravel_index(np.argmax(is_whole), is_whole.shape)
    away = np.hypot(
        measured.y.values[:, None] - measured.y.values[row],
        measured.x.values - measured.x.values[col],
    )
    half_um = 7.5 * np.maximum(1 - (2 * away / width_um) ** 2, 0) ** 0.25
    air = ndimage.gaussian_filter((np.abs(heights - middle) < half_um).astype(float), 0.6)
    noise = np.random.default_rng(0).normal(40.0, 12.0, air.shape)
    return volume.copy(data=np.clip(volume * (1 - air) + noise * air, 0, 255).astype(np.uint8))


def spoken(volume, measured):
    return {
        check.name: check.state for check in check_scan(volume, measured) if check.state != "pass"
    }


def test_a_right_sheet_of_fibres_raises_no_light(coated):
    assert spoken(*coated) == {}


@pytest.mark.parametrize("width_um", [300.0, 500.0])
def test_delaminations_among_fibres_are_seen(coated, width_um):
    volume, measured = coated
    assert spoken(split(volume, measured, width_um), measured)["one sheet"] == "fail"
