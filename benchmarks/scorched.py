"""Holes with scorched rims: two edges around a hole, and which of them is taken for the rim.

Beside ``benchmarks.hole_scenes``: looks of a burnt rim, drawn with other levels, widths, light and
noise for each image.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from benchmarks.hole_scenes import Scene, around, fine_window, gauss, make_hole, polar, shrunk
from planish.marks import find_holes

ANGLES = np.arange(720) * np.pi / 360

LOOKS = (
    "ring",  # char of one level, to 60 um wide
    "gradient",  # char that fades outwards
    "one-sided",  # wide on one side, none on the other
    "patch",  # on a part of the rim only
    "soot",  # a ring darker than what the hole shows
    "bright ring",
    "bright one-sided",
    "bright gradient",  # lit from behind
    "printed",  # bars of ink over a part of the hole
    "flap",  # a tongue of paper over a part of the hole
)


def _char(rng, look, width, towards, strength):
    """Width of the char at each angle, um."""
    char = width * (1 + around(rng, 0.15, 60.0, 550.0))
    if look == "one-sided":
        char *= np.maximum(0.0, 1 + strength * np.cos(ANGLES - towards - rng.normal(0, 0.4)))
    if look == "patch":
        char *= np.cos(ANGLES - rng.uniform(0, 2 * np.pi)) > rng.uniform(-0.5, 0.5)
    return np.maximum(char, 0.01)


def make_scorched(seed, name):
    """Twelve holes of one look; its levels, widths, pixel, blur, light and noise are drawn."""
    rng = np.random.default_rng([seed, LOOKS.index(name)])
    bright, look = name.startswith("bright"), name.removeprefix("bright ")
    pixel = float(rng.choice([2.5, 4.0, 6.0, 9.0]))
    shape = (int(2200 / pixel), int(2900 / pixel))
    image = 1 + gauss(
        rng, shape, rng.uniform(40, 150), pixel, float(rng.choice([0.01, 0.03, 0.06]))
    )
    floor = (
        rng.uniform(1.6, 3.0)
        if bright
        else rng.uniform(0.4, 0.65)
        if look == "soot"
        else rng.uniform(0.03, 0.2)
    )
    # Char that is hardly lighter than the hole shows no rim.
    level = (
        rng.uniform(0.08, 0.25)
        if look == "soot"
        else rng.uniform(0.15 if bright else floor + 0.2, 0.75)
    )
    width, taper, uneven = rng.uniform(10, 60), rng.uniform(0, 0.15), rng.uniform(0, 0.08)
    towards, strength, rough = (
        rng.uniform(0, 2 * np.pi),
        rng.uniform(0.5, 1.5),
        float(rng.choice([1.5, 3.0, 4.0])),
    )
    holes = []
    for row in range(3):
        for column in range(4):
            x, y = np.array([400 + 650 * column, 400 + 650 * row]) + rng.uniform(-60, 60, 2)
            hole = make_hole(rng, float(x), float(y), rough)
            holes.append(hole)
            char = _char(rng, look, width, towards, strength)
            burnt = np.clip(level + around(rng, uneven, 80.0, 550.0), 0.05, 0.9)
            box, v, u, sub = fine_window(hole, pixel, shape, 2 * char.max() + 3 * pixel)
            r, k = polar(v, u)
            under = np.repeat(np.repeat(image[box], sub, 0), sub, 1)
            past, part = r - hole.outline[k], np.maximum(r - hole.outline[k], 0) / char[k]
            fade = 1 - (1 - burnt[k]) * np.exp(-1.5 * part)
            values = under * (fade if look == "gradient" else np.where(part < 1, burnt[k], 1.0))
            if look == "printed":
                values[
                    np.abs(u * np.cos(towards) + v * np.sin(towards) - rng.uniform(60, 130)) < 30
                ] *= 0.6
            depth = np.clip(-past / (max(taper, 1e-6) * hole.outline[k]), 0, 1)
            wall = burnt[k] + (floor - burnt[k]) * (0.3 + 0.7 * depth)
            values = np.where(
                past < 0, np.where(r < (1 - taper) * hole.outline[k], floor, wall), values
            )
            if look == "flap":
                turn = rng.uniform(0, 2 * np.pi)
                out, side = u * np.cos(turn) + v * np.sin(turn), v * np.cos(turn) - u * np.sin(turn)
                values = np.where(
                    (out > rng.uniform(20, 60)) & (np.abs(side) < 25) & (past < 0), under, values
                )
            image[box] = shrunk(values, sub)
    down, across = np.linspace(-1, 1, shape[0])[:, None], np.linspace(-1, 1, shape[1])[None]
    image *= 1 + rng.uniform(0, 0.3) * across - rng.uniform(0, 0.2) * down
    image = ndimage.gaussian_filter(image, rng.uniform(1.5, 6.0) / pixel)
    image += rng.normal(0, rng.choice([0.005, 0.02, 0.04]), shape)
    return Scene(image=image.astype(np.float32), pixel=pixel, holes=holes)


def beyond(scene):
    """Errors of the centres (n, 2) in um and in stated ones (n,) against the outlines cut; how many
    holes are false."""
    found = find_holes(scene.image, pixel_um=scene.pixel)
    at = np.stack([found["x"].values, found["y"].values], axis=1)
    centres = np.array([hole.centroid for hole in scene.holes])
    away = np.linalg.norm(at[:, None] - centres[None], axis=2)
    hit = away.min(axis=1) < 60 if len(at) else np.zeros(0, bool)
    error = (at - centres[away.argmin(axis=1)])[hit]
    xx, yy, xy = (found[f"cov_{k}"].values[hit] for k in ("xx", "yy", "xy"))
    x, y = error.T
    return (
        error,
        np.sqrt((yy * x**2 - 2 * xy * x * y + xx * y**2) / (xx * yy - xy**2)),
        int(np.count_nonzero(~hit)),
    )


def main(seeds=3):
    """Print a table; 1 if a centre is beyond three times its stated error, or something false was
    found."""
    print(
        f"scorched rims\n{'':>16} found missed false  rms um  max um  largest in stated errors,"
        " beyond 3"
    )
    failed = total = far = 0
    for look in LOOKS:
        parts = [beyond(make_scorched(seed, look)) for seed in range(seeds)]
        error, stated = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        false, count = sum(part[2] for part in parts), int(np.count_nonzero(stated > 3))
        total, far, failed = total + len(stated), far + count, failed + (count + false > 0)
        print(
            f"{look:>16} {len(error):5d} {12 * seeds - len(error):6d} {false:5d}"
            f" {np.sqrt(np.mean(error**2)):7.2f} {np.hypot(*error.T).max():7.2f}"
            f" {stated.max():7.2f} {count:4d}"
        )
    print(f"{far} of {total} centres beyond three times their stated error")
    return int(failed > 0)
