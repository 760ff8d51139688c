"""Fibre directions of stripes at known angles, on sheets that lie level and askew."""

from dataclasses import replace

import numpy as np
import pytest

from planish.measure import axial_angle, orientation_layers

NAMES = ["fibre_angle", "fibre_anisotropy", "fibre_cos2", "fibre_sin2"]
OPTIONS = {"orientation_rho_um": 20.0, "orientation_sigma_um": 2.0, "edge_um": 3.0}


def stripes(degrees, period=16.0):
    """Stripes along ``degrees`` from u towards v, the same through the whole depth."""
    a = np.deg2rad(degrees)
    return lambda _s, u, v: 25.0 * np.sin(2 * np.pi / period * (-np.sin(a) * u + np.cos(a) * v))


def apart(a, b):
    """Least difference of two axes, degrees."""
    return np.abs((a - b + 90.0) % 180.0 - 90.0)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.0, 0.6), (0.5, 0.0)])
@pytest.mark.parametrize("degrees", [30.0, -65.0])
def test_stripes_on_a_tilted_sheet(made, degrees, slope):
    sheet = made(extra=stripes(degrees), slope=slope, size_um=(140.0, 140.0), top=0.0, bottom=0.0)
    found = sheet.measured(*NAMES, **OPTIONS)
    middle = found.isel(y=slice(25, 45), x=slice(25, 45))
    # steps of a gradient 2 um wide on 16 um stripes turn by less than half a degree
    assert float(apart(middle["fibre_angle"], degrees).max()) < 1.0
    assert float(middle["fibre_anisotropy"].min()) > 0.97
    angle = axial_angle(middle["fibre_cos2"], middle["fibre_sin2"])
    assert float(apart(angle, middle["fibre_angle"]).max()) < 1e-3


def test_a_mirrored_view_turns_the_angle(made):
    """Through z with the top at the low end the array shows the sheet as a mirror does: u runs
    backwards."""
    sheet = made(extra=stripes(30.0), top=0.0, bottom=0.0, size_um=(80.0, 80.0))
    swapped = {
        "top": "bottom",
        "bottom": "top",
        "interface_top": "interface_bottom",
        "interface_bottom": "interface_top",
    }
    low = replace(sheet, surfaces=sheet.surfaces.rename(swapped).assign_attrs(top_side="low"))
    found = low.measured("fibre_angle", **OPTIONS)
    assert float(apart(found["fibre_angle"][20, 20], -30.0)) < 1.0


def test_layers_with_directions_of_their_own(made):
    """Stripes along u in the lower half, along v in the upper."""
    along, across = stripes(0.0), stripes(90.0)
    sheet = made(
        extra=lambda s, u, v: np.where(s < 0, along(s, u, v), across(s, u, v)), top=0.0, bottom=0.0
    )
    layers = orientation_layers(2)
    assert [p.name for p in layers][:2] == ["fibre_angle_layer_1", "fibre_anisotropy_layer_1"]
    found = sheet.measured(*layers, "fibre_anisotropy", **OPTIONS)
    middle = found.isel(y=slice(20, 40), x=slice(25, 50))
    assert float(apart(middle["fibre_angle_layer_1"], 0.0).max()) < 2.0
    assert float(apart(middle["fibre_angle_layer_2"], 90.0).max()) < 2.0
    # both halves together have none
    assert float(middle["fibre_anisotropy"].max()) < 0.15


def test_noise_has_no_direction_and_voids_do_not_count(made):
    sheet = made(noise=20.0, top=0.0, bottom=0.0, size_um=(200.0, 200.0))
    found = sheet.measured("fibre_anisotropy", **OPTIONS)
    assert float(found["fibre_anisotropy"].median()) < 0.1

    def hollow(s, u, v):
        # A void through the middle layer, in which strong stripes run along v; beside it faint ones
        # along u.
        return np.where(
            np.abs(s) < 15, -50.0 + 0.9 * stripes(90.0)(s, u, v), 0.4 * stripes(0.0)(s, u, v)
        )

    sheet = made(extra=hollow, top=0.0, bottom=0.0, blur=0.5)
    found = sheet.measured("fibre_angle", **OPTIONS)
    assert float(apart(found["fibre_angle"][30, 37], 0.0)) < 2.0
