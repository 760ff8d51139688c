"""Light from one side: a map that is displaced towards it can correlate more, and the page cautions
of it."""

import numpy as np
import pytest
from scipy import ndimage

import planish as pl
from planish.analyze import texture_lag
from planish.core.grid import Grid
from planish.report import reading_r, tables
from planish.results import Results
from planish.synthetic import (
    PRESETS,
    CameraParams,
    SpecimenParams,
    Warp,
    image_material,
    make_specimen,
)
from planish.texture import textures
from report.runs import a_run

POINT_UM, PIXEL_UM, BORDER = 100.0, 6.0, 20


def seen(shading):
    """True coating and face on the pixels of an image, the image, and where they count; no marks,
    so no errors."""
    camera = CameraParams(shading=shading, oracle_r2=0.2, pixel_um=PIXEL_UM)
    params = SpecimenParams(
        size_um=(3000.0, 2200.0),
        paper=PRESETS["wfc90"][1].as_slab(),
        warp=Warp(bump_um=0.0),
        camera=camera,
        seed=1,
    )
    made = make_specimen(params)
    sheet, (u, v) = made.sheet, image_material(made.pose, made.image.shape, PIXEL_UM)
    top, below = (sheet.at(face, u, v) for face in sheet.faces[:2])
    use = sheet.at(sheet.rim_um[0], u, v) > 100.0
    use[:BORDER], use[-BORDER:], use[:, :BORDER], use[:, -BORDER:] = False, False, False, False
    return top - below, top, made.image, use


def displaced(coating, image, use, by_um):
    """r of 100 um points with the coating displaced to the right, where the light does not come
    from."""
    moved = ndimage.shift(coating, (0, by_um / PIXEL_UM), order=1, mode="nearest")
    both = (np.where(use, m, np.nan) for m in (moved, image.values))
    return pl.correlate(*both, pixel_um=Grid.of(image).pixel_um, point_um=POINT_UM).r


@pytest.mark.ci
@pytest.mark.parametrize(("shading", "diffuse"), [(0.003, True), (0.02, False)])
def test_a_displacement_towards_the_light_raises_r_only_under_light_from_one_side(shading, diffuse):
    coating, face, image, use = seen(shading)
    towards, right, away = (displaced(coating, image, use, by) for by in (-30.0, 0.0, 30.0))
    maps = {"coating": coating, "face": face, "image": image.values}
    known = {k: np.where(use, m, np.nan) for k, m in maps.items()}
    found = textures(known, use, Grid.of(image).pixel_um).with_slopes("face")
    lag = texture_lag(found, ["coating", "face_x", "face_y"], "image", slopes=2, reach_um=150.0)
    print(f"shading {shading}: {towards:.3f}, {right:.3f}, {away:.3f}; light {lag.light:.2f}")
    assert (lag.light < reading_r.SIDE_LIGHT) == diffuse
    assert lag.length_um < 1.0  # with the slopes beside the coating, the lag stays right
    assert away < right  # by 0.02 and more
    if diffuse:
        assert towards < right
    else:
        assert 0.02 < towards - right < 0.12


def sentence_with(light):
    """What the page says of flattening where ``light`` of the texture needs the slopes."""
    results = Results.model_validate(a_run()["results"])
    layer = results.layers[0]
    lag = layer.registration.lag.model_copy(update={"light": light})
    registration = layer.registration.model_copy(update={"lag": lag})
    layers = (layer.model_copy(update={"registration": registration}), *results.layers[1:])
    apart = {"difference": 0.1, "difference_interval": (0.05, 0.15)}
    rows = tuple(row.model_copy(update=apart) for row in results.comparison)
    return tables.comparison_sentence(
        results.model_copy(update={"layers": layers, "comparison": rows})
    )


def test_the_page_cautions_where_the_image_shows_slopes():
    assert "displaced towards the light can have a larger r" in sentence_with(0.6)
    assert "(60 % of what" in sentence_with(0.6)
    for even in (np.nan, 0.0, 0.2):
        said = sentence_with(even)
        assert "r changes by" in said
        assert "light" not in said
