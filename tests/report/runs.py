"""Small runs as the pipeline gives them, for the tests of their page."""

import numpy as np
import xarray as xr

from planish.report import page
from planish.results import Results
from report.pages import Page

PROPERTIES = {
    "coating_top": "Coating thickness, top side",
    "coating_bottom": "Coating thickness, bottom side",
    "base_thickness": "Base thickness",
    "thickness": "Sheet thickness",
}
TITLES = {name: {"units": "um", "long_name": title} for name, title in PROPERTIES.items()}
TITLES["image"] = {"long_name": "Grey value, uncalibrated, luminance", "units": "1"}
COATING = ("coating_top", "coating_bottom", "base_thickness")
ROWS = ("projection, no scale", "projection, similarity", "flattened, similarity")
UM = {"units": "um"}
IMAGE_PAIR = {"a": "volume", "a_map": "coating_top", "b": "image", "b_map": "image"}


def planes(values, dims=("y", "x")):
    """Return maps with their units and titles."""
    return {name: (dims, plane, TITLES.get(name, UM)) for name, plane in values.items()}


def marks_of(fixed, residual, labels):
    """Return marks at these places."""
    parts = {"moving": fixed + 5.0, "fixed": fixed, "residual": residual}
    values = {
        f"{name}_{axis}": places[:, k]
        for name, places in parts.items()
        for k, axis in enumerate("xy")
    }
    values |= {"residual": np.hypot(*residual.T), "label": np.array(labels, dtype=object)}
    return xr.Dataset({name: ("mark", column) for name, column in values.items()})


def a_run(*, linked=True, coated=True, top="high", relation=40.0, **correlation):
    """Return a small bent sheet, 90 um thick under a 20 um coating, and an image of it that follows
    the coating.

    ``correlation`` stands in every correlation of the results.
    """
    rng = np.random.default_rng(7)
    up = 1.0 if top == "high" else -1.0
    y, x = 6.0 * np.arange(90), 6.0 * np.arange(140)
    centre = 300 + 40 * np.sin(x / 200)[None, :] + 0 * y[:, None]
    coating = (
        20
        + 4 * np.sin(y / 31)[:, None] * np.cos(x / 45)[None, :]
        + rng.normal(0, 0.5, (y.size, x.size))
    )
    hole = np.hypot(y[:, None] - 260, x[None, :] - 300) < 90
    layers = {
        "coating_top": coating,
        "coating_bottom": coating[::-1],
        "base_thickness": 90 - coating - coating[::-1],
        "thickness": np.full(coating.shape, 90.0),
    }
    properties = {
        k: np.where(hole | (not coated and k in COATING), np.nan, layers[k]) for k in PROPERTIES
    }
    heights = {
        "top": centre + up * 45,
        "bottom": centre - up * 45,
        "interface_top": centre + up * (45 - properties["coating_top"]),
        "interface_bottom": centre - up * (45 - properties["coating_bottom"]),
        "centre": centre,
    }
    frame = {"through": "z", "top_side": top, "row_axis": "y", "col_axis": "x"}
    surfaces = xr.Dataset(planes(heights | properties), {"y": y, "x": x}, frame)
    across, v = (np.broadcast_to(a, coating.shape) for a in (x, y[:, None]))
    places = planes({"u": 1.02 * across, "v": v, "projected_u": across, "projected_v": v})
    flat = xr.Dataset(places, {"y": y, "x": x}, frame | {"mirrored_view": int(top == "low")})
    cells = (22, 34)
    strain = xr.Dataset(
        {
            k: (("row", "col"), at + 1e-4 * rng.normal(size=cells))
            for k, at in {
                "area_ratio": 1.0,
                "stretch_max": 1.0,
                "stretch_min": 1.0,
                "shear": 0.0,
                "needed_strain": 0.001,
            }.items()
        },
        {"y": ("row", 24.0 * np.arange(22)), "x": ("col", 24.0 * np.arange(34))},
    )
    strain["step_nodes"] = (("step",), np.array([80.0, 250.0, 805.0, 805.0]))
    strain["step_move"] = (("step",), np.array([3.0, 1.0, 0.3, 0.01]))
    maps = xr.Dataset(planes(properties, ("v", "u")), {"v": y, "u": 1.02 * x})
    at = np.array([20, 45, 70])
    z = 6.0 * np.arange(100)
    grey = np.where(
        np.abs(z[None, :, None] - centre[at][:, None, :]) < 45, 150.0, 30.0
    ) + rng.normal(0, 4, (3, 100, 140))
    slices = xr.Dataset(
        {"grey": (("slice", "height", "x"), grey.astype(np.float32)), "row": ("slice", at)},
        {"slice": y[at], "height": z, "x": x},
        frame,
    )
    groups = {"surfaces": surfaces, "flat": flat, "strain": strain, "maps": maps, "slices": slices}
    shares = {"measured": 0.9, "no_sheet": 0.1, "rim": 0.0}
    statistics = {
        "units": "um",
        "n": 12_000,
        "mean": 20.0,
        "sd": 2.0,
        "p5": 17.0,
        "median": 20.0,
        "p95": 23.0,
    }
    percentiles = {"median": 1e-5, "p5": -2e-4, "p95": 2e-4, "p95_abs": 2e-4, "max_abs": 3e-4}
    facts = {
        "surfaces": (
            frame
            | {
                "thickness_um": 90.0,
                "blur_um": 4.0,
                "fringe": None,
                "fringe_um": None,
                "cutoff_um": 400.0,
                "rim_um": 100.0,
                "missing_share": 0.0,
                "polarity": 1.0,
                "grey_air": 30.0,
                "grey_base": 150.0,
                "grey_coating_top": 200.0 if coated else None,
                "grey_coating_bottom": None,
                "grey_noise": 4.0,
                "columns": 12_600,
                "particles_removed": 0,
                "half_closed_holes": 0,
                "shares": shares,
            }
        ),
        "properties": {k: statistics for k in PROPERTIES if np.isfinite(properties[k]).any()},
        "numbers": {"thin": {}, "roughness": {}, "two_sides": {}},
        "flatten": {
            "outcome": "RESTED",
            "sentence": "The mesh came to rest.",
            "steps": 4,
            "energy_um2": 1e-7,
            "mesh_um": 24.0,
            "folded_cells": 0,
            "edge_strain_p95": 4e-4,
            "edge_strain_max": 1e-3,
            "largest_move_um": 16.8,
            "method": "multigrid",
            "springs": 3100,
            "straight_share": 0.001,
            "curvature": {
                "patch_um": 1000.0,
                "limit": 0.005,
                "share": 0.0,
                "largest": 0.001,
                "verdict": "The surface can be a sheet of paper.",
            },
            "distortion": {
                **dict.fromkeys(("area", "axial_u", "axial_v", "shear"), percentiles),
                "cells": 748,
                "inverted_cells": 0,
                "boundary_space_um": 1.0,
                "boundary_flat_um": 1.0,
                "growth_percent": 1.0,
                "growth_anisotropy_percent": 2.0,
                "growth_direction_deg": 0.0,
                "displacement_median_um": 4.0,
                "displacement_p95_um": 12.0,
                "displacement_max_um": 16.8,
                "geodesics": {"p50": 1e-5, "p95": 1e-4, "largest": 1e-3, "used": 100, "dropped": 0},
            },
        },
    }
    sheet = {
        "name": "volume",
        "kind": "sheet",
        "headline": "coating_top" if coated else "thickness",
        "sheet": facts,
        "source": {
            "name": "sheet.tif",
            "shape": [100, 90, 140],
            "dtype": "uint8",
            "bytes": 1_260_000,
            "sha256": "ab" * 32,
            "size_um": [6.0, 6.0, 6.0],
            "size_source": "ImageJ metadata",
        },
    }
    results = {
        "planish": "0.2.0",
        "versions": {"numpy": "2.4.6"},
        "layers": [sheet],
        "checks": [
            {
                "name": "coverage",
                "value": 0.9,
                "limit": 0.5,
                "state": "pass",
                "figures": ["properties"],
                "sentence": "90 % of the columns are measured.",
            }
        ],
        "parameters": {
            "volume": {
                "voxel_um": [6.0, 6.0, 6.0],
                "through": "z",
                "top": top,
                "override_size": False,
            },
            "holes": {"hole_um": [120.0, 320.0]},
            "correlate": {"point_um": 100.0, "thin_um": 5.0},
        },
    }
    if not linked:
        return {"groups": groups, "marks": {}, "results": results}
    headline = "coating_top" if coated else "thickness"
    image = 1000 + relation * (coating - 20) + rng.normal(0, 40, coating.shape)
    linked = properties | {
        "image": image,
        "expected_error": 0.6 + 0.001 * np.hypot(y[:, None] - 260, x - 400),
    }
    groups["linked"] = xr.Dataset(planes(linked), {"y": y, "x": x}).astype(np.float32)
    groups["linked"] = groups["linked"].assign(u=flat["u"], valid=(("y", "x"), ~hole))
    fixed = np.array([[100.0, 100.0], [700.0, 120.0], [420.0, 480.0]])
    residual = np.array([[0.3, -0.2], [-0.4, 0.1], [0.1, 0.1]])
    marks = marks_of(fixed, residual, ["hole 1", "hole 2", "hole 3"])
    marks["leave_one_out"] = ("mark", np.array([0.6, np.nan, 0.4]))
    row = {
        "n": 11_000,
        "r": 0.9,
        "r2": 0.81,
        "slope": 40.0,
        "intercept": 200.0,
        "n_eff": 300.0,
        "p": 1e-9,
        "interval": [0.888, 0.911],
    }
    large = {
        "n": 40,
        "r": 0.8,
        "r2": 0.64,
        "slope": 41.0,
        "intercept": 180.0,
        "n_eff": 31.2,
        "p": 2e-5,
        "interval": [0.63, 0.9],
        "slope_x_on_y": 0.016,
        "mean_a": 20.0,
        "mean_b": 1000.0,
    }
    image_layer = {
        "name": "image",
        "kind": "image",
        "headline": "image",
        "source": {
            "name": "image.png",
            "shape": [90, 140],
            "dtype": "uint16",
            "bytes": 25_000,
            "sha256": "cd" * 32,
            "size_um": [6.0, 6.0],
            "size_source": "given",
        },
    }
    sheet["registration"] = registration_of("volume", "image") | {
        "match_sentence": "3 of 3 marks match to 0.3 um.",
        "warnings": ["few marks"],
        "lag": lag_of(
            lag_um=[0.6, -0.3], sentence="lag 0.7 ± 0.3 um, expected error 0.9 um: agrees"
        ),
        "orientation": (
            ORIENTATION
            | {
                "md_deg_moving": 20.0,
                "md_deg_fixed_from_moving": 20.0,
                "sentence": "The machine direction lies at 20 deg in the image.",
            }
        ),
    }
    results |= {
        "layers": [sheet, image_layer],
        "comparison": [
            row
            | {
                "registration": name,
                "property": headline,
                "marks_rms_um": 9.0,
                "r2": r2,
                "point_um": at,
            }
            for name, r2 in zip(ROWS, (0.11, 0.22, 0.81), strict=True)
            for at in (6.0, 100.0)
        ],
        "correlations": [
            IMAGE_PAIR | pair | {"a_map": k, "point_um": at} | correlation
            for k in facts["properties"]
            for pair, at in ((row, 6.0), (large, 100.0))
        ],
        "linked": {
            "pixels": 12_600,
            "share_on_sheet": 1.0,
            "share_valid": 0.8,
            "share_valid_of_sheet": 0.81,
            "share_valid_away_from_holes": 0.99,
        },
    }
    return {"groups": groups, "marks": {"volume": marks}, "results": results}


ORIENTATION = {
    "image_side": "top",
    "side_given": True,
    "mirrored_volume": False,
    "md_deg_moving": None,
    "md_deg_fixed": None,
    "md_deg_fixed_from_moving": None,
    "sentence": "",
}


def registration_of(moving, to, *, path=None):
    """Return what the results hold of a registration."""
    return {
        "to": to,
        "path": path or (moving, to),
        "source": "found",
        "found_moving": 5,
        "found_fixed": 6,
        "matched": 3,
        "second_best": 0,
        "match_sentence": f"3 marks of {moving} agree to 0.9 um.",
        "model": "similarity",
        "model_sentence": "similarity chosen from 3 marks: 0.5 um.",
        "warnings": [],
        "rms_um": 0.33,
        "leave_one_out_rms_um": 0.51,
        "expected_error": {"median_um": 1.4, "largest_um": 2.6},
        "scale": 1.0059,
        "rotation_deg": 0.0,
        "shift_um": [1.0, -2.0],
        "mirrored": False,
        "orientation": ORIENTATION,
    }


def lag_of(**values):
    """Return what the results hold of a lag."""
    return {
        "property": "coating_top",
        "lag_um": [0.5, -0.2],
        "se_um": [0.3, 0.2],
        "length_um": 0.67,
        "length_se_um": 0.3,
        "r": 0.5,
        "r_at_zero": 0.4,
        "limit_r": 0.2,
        "n": 5000,
        "reach_um": 100.0,
        "agrees": True,
        "reason": None,
        "expected_um": 0.9,
        "sentence": "lag 0.5 ± 0.3 um: agrees",
        "pixel_um": [6.0, 6.0],
        "tile_um": 300.0,
        "light": 0.1,
        "tiles": [
            {"x": 200.0, "y": 150.0, "lag_um": [0.6, -0.3], "distinct": True},
            {"x": 500.0, "y": 150.0, "lag_um": None, "distinct": False},
        ],
    } | values


def results_of(run):
    """Return the results of a run, which are a dict."""
    return Results.model_validate(run["results"])


def page_of(run):
    """Return the page of a run."""
    return page.render_report(run["groups"], run["marks"], results_of(run))[0]


def text_of(run):
    """Return what can be read on its page."""
    return Page(page_of(run)).text()
