"""The scale through the sheet: how often a wrong voxel spacing is seen, and how often a right one
is doubted.

``python -m benchmarks through_scale [cases [seed]]``

Sheets are general cylinders and cones, whose development is exact, another one in each case; none
is made by the warp of ``planish.synthetic``. Marks are material points with an error, the sheet is
stretched by up to 0.2 % in any direction, and its thickness varies as paper's does. Fields: 600 x
500 columns of a scanner, 5 times as many sections'.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from scipy import ndimage

from benchmarks.shared import rms
from planish.checks import CHECKS, RegisteredSheet
from planish.checks.through_scale import estimate, judge_marks, scale_from_thickness
from planish.core.frame import Frame
from planish.flatten import flatten_sheet
from planish.register import fit_transform

_THICK_UM, _FORMATION, _GRAIN_UM = 90.0, 0.05, 150.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What is drawn of a sheet: tilt at the 95th percentile, marks, error of a mark in the plane,
    pitch of columns."""

    tilt_deg: float
    marks: int
    error_um: float
    pitch_um: float
    stated: float = 1.0  # spacing through the sheet over the true one
    cone: bool = False


def profile(rng, lengths):
    """Slopes along a line: three waves of about its length, of rms 1."""
    span = float(np.ptp(lengths))
    waves = [
        a * np.cos(2 * np.pi * lengths / (span * w) + p)
        for a, w, p in zip(
            rng.uniform(0.3, 1, 3),
            rng.uniform(0.4, 1.5, 3),
            rng.uniform(0, 2 * np.pi, 3),
            strict=True,
        )
    ]
    return np.sum(waves, axis=0)


def cylinder(rng, tilt, shape_um):
    """Heights and flat places of a general cylinder, by points (x, y)."""
    turn = rng.uniform(0, np.pi)
    half = np.hypot(*shape_um) / 2
    t = np.linspace(-half, half, 4001)
    slope = profile(rng, t)
    slope *= tilt / np.percentile(np.abs(slope), 95)

    def summed(values):
        return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])

    height, length = summed(slope), summed(np.sqrt(1 + slope**2))

    def at(x, y):
        across, along = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        u = np.interp(across, t, length)
        return (
            np.interp(across, t, height),
            u * np.cos(turn) - along * np.sin(turn),
            (u * np.sin(turn) + along * np.cos(turn)),
        )

    return at


def cone(rng, tilt, shape_um):
    """Heights and flat places of a general cone, its tip outside of the field."""
    far = np.hypot(*shape_um) * rng.uniform(1.0, 2.5)
    at_deg = rng.uniform(-np.pi, np.pi)
    tip = far * np.array([np.cos(at_deg), np.sin(at_deg)])
    half = 1.05 * np.arcsin(min(0.99, np.hypot(*shape_um) / 2 / far))
    angle = np.linspace(-half, half, 4001)
    change = profile(rng, angle)
    change *= tilt / np.percentile(np.abs(change), 95)
    height = np.concatenate([[0.0], np.cumsum(0.5 * (change[1:] + change[:-1]) * np.diff(angle))])
    height -= height.mean()
    spread = np.sqrt(1 + height**2 + change**2) / (1 + height**2)
    flat = np.concatenate([[0.0], np.cumsum(0.5 * (spread[1:] + spread[:-1]) * np.diff(angle))])

    def at(x, y):
        dx, dy = x - tip[0], y - tip[1]
        # The axis from the tip to the middle of the field has angle 0.
        away, turned = (
            np.hypot(dx, dy),
            np.arctan2(dx * tip[1] - dy * tip[0], -(dx * tip[0] + dy * tip[1])),
        )
        h, psi = np.interp(turned, angle, height), np.interp(turned, angle, flat)
        long = away * np.sqrt(1 + h**2)
        return away * h, long * np.cos(psi), long * np.sin(psi)

    return at


def examine(case, rng):
    """Draw a sheet, state its spacing wrongly, flatten, register and check it: the check, and the
    estimate."""
    rows, cols = 250, 300  # every second column of the scanner
    step = 2 * case.pitch_um
    shape_um = (cols * step, rows * step)
    at = (cone if case.cone else cylinder)(rng, float(np.tan(np.radians(case.tilt_deg))), shape_um)
    y, x = ((np.arange(n) - (n - 1) / 2) * step for n in (rows, cols))
    across, down = np.meshgrid(x, y)
    true, _, _ = at(across, down)
    height = case.stated * true
    seen = xr.Dataset(
        {
            "centre": (("y", "x"), height),
            "thickness": (("y", "x"), _thickness(rng, true, case.stated, step)),
            "status": (("y", "x"), np.zeros(true.shape, dtype=np.uint8)),
        },
        coords={"y": y, "x": x},
        attrs={
            **Frame().attrs(),
            "voxel_um": [case.stated * case.pitch_um, case.pitch_um, case.pitch_um],
        },
    )
    flat = flatten_sheet(seen).flat
    places = rng.uniform(-0.47, 0.47, (case.marks, 2)) * shape_um
    row, col = places[:, 1] / step + (rows - 1) / 2, places[:, 0] / step + (cols - 1) / 2
    moving = np.stack(
        [ndimage.map_coordinates(flat[k].values, [row, col], order=1) for k in "uv"], axis=1
    )
    _, u, v = at(places[:, 0], places[:, 1])
    fixed = np.stack([u, v], axis=1) @ _stretch(rng)
    fixed += rng.normal(0, case.error_um / np.sqrt(2), fixed.shape)
    fit = fit_transform(moving, fixed, model="auto", lowest="similarity")
    registered = RegisteredSheet(measured=seen, flat=flat, fit=fit)
    found = estimate(registered)
    light = next(light for light in CHECKS if light.stage is RegisteredSheet)
    return judge_marks(light, registered, found, scale_from_thickness(seen)), found


def _thickness(rng, height, stated, step):
    """Thickness along the normals as they are seen: the paper's own, by the relation of parallel
    surfaces."""
    square = np.sum(np.square(np.gradient(height, step)), axis=0)
    noise = ndimage.gaussian_filter(rng.normal(size=height.shape), _GRAIN_UM / step / 2)
    own = _THICK_UM * (1 + _FORMATION * noise / noise.std())
    return own * stated * np.sqrt((1 + square) / (1 + stated**2 * square))


def _stretch(rng):
    """A rotation, a scale as two calibrations differ, and a stretch by up to 0.2 % in any
    direction."""
    turn, along = rng.uniform(-np.pi, np.pi, 2)
    way = np.array([np.cos(along), np.sin(along)])
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return (
        rng.uniform(0.98, 1.02)
        * (np.eye(2) + rng.uniform(0, 0.002) * np.outer(way, way))
        @ rotation
    )


def draw(rng, *, tilts=(0.0, 60.0), marks=(4, 31), errors=(0.5, 5.0)):
    """A case of either instrument: a scanner's voxels of 1.5 to 5 um, photographs' of 4 to 10
    um."""
    low, high = (1.5, 5.0) if rng.random() < 0.5 else (4.0, 10.0)
    return Case(
        tilt_deg=rng.uniform(*tilts),
        marks=int(rng.integers(*marks)),
        cone=bool(rng.random() < 0.4),
        error_um=float(np.exp(rng.uniform(*np.log(errors)))),
        pitch_um=rng.uniform(low, high),
    )


# What is drawn, how, stated over true spacing, share of the cases, least share that is seen.
_LINES = (
    ("right", {}, (1.0,), 1, 0.0),
    ("50 % wrong, 17-60°, 7-30 marks", {"tilts": (17, 60), "marks": (7, 31)}, (1.5, 0.5), 2, 0.9),
    ("10 % wrong, 26-60°, 15-30 marks", {"tilts": (26, 60), "marks": (15, 31)}, (1.1, 0.9), 2, 0.9),
    ("50 % wrong, 17-18°, 7 marks", {"tilts": (17, 18), "marks": (7, 8)}, (1.5, 0.5), 4, 0.0),
    (
        "the same, marks to 1 um",
        {"tilts": (17, 18), "marks": (7, 8), "errors": (0.5, 1)},
        (1.5, 0.5),
        4,
        0.0,
    ),
    ("10 % wrong, 26-27°, 15 marks", {"tilts": (26, 27), "marks": (15, 16)}, (1.1, 0.9), 4, 0.0),
    (
        "the same, marks to 1 um",
        {"tilts": (26, 27), "marks": (15, 16), "errors": (0.5, 1)},
        (1.1, 0.9),
        4,
        0.0,
    ),
)


def main(cases=200, seed=1):
    """Print the table; 1 if a limit is missed."""
    rng = np.random.default_rng(seed)
    print(
        f"{'':34}{'cases':>7}{'seen %':>8}{'fail %':>8}{'unknown %':>11}"
        f"{'error of s':>12}{'z, rms':>8}{'s CPU':>8}"
    )
    missed = 0
    for words, drawn, stated, part, least in _LINES:
        began, count = time.process_time(), cases // part
        states, z, errors = [], [], []
        for k in range(count):
            case = replace(draw(rng, **drawn), stated=stated[k % len(stated)])
            check, found = examine(case, rng)
            states.append(check.state)
            if np.isfinite(found.error):
                z.append((found.scale - 1 / case.stated) / np.hypot(found.error, 0.01))
            errors.append(found.error)
        share = {state: states.count(state) / count for state in ("look", "fail", "unknown")}
        seen, seconds = share["look"] + share["fail"], (time.process_time() - began) / count
        print(
            f"{words:34}{count:>7}{100 * seen:>8.1f}"
            f"{100 * share['fail']:>8.1f}{100 * share['unknown']:>11.1f}"
            f"{np.median(errors):>12.3f}{rms(z):>8.2f}{seconds:>8.2f}",
            flush=True,
        )
        missed += seen < least or (stated == (1.0,) and seen > 0.01)
    return missed
