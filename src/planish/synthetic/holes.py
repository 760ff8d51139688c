"""The laser's holes: where they are burnt, and the shape of each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planish.core.typing import Floats
from planish.synthetic.draws import generator
from planish.synthetic.fields import PITCH_UM
from planish.synthetic.params import HoleParams

_BORDER_UM = 260.0  # from the middle of a hole to the end of the field
_CORNER_UM = 520.0  # from one line to the first hole of the next
_APART_UM = 550.0
# Pitches of the lines in um, all different, and so are the sums of neighbours: distances identify any few holes.
_PITCHES_UM = ((500, 725, 590, 860, 650, 950), (545, 905, 620, 770, 510, 830), (695, 560, 815, 530, 935, 605))
_ROUGH_UM = 30.0  # correlation length along the rim
_ORDERS = np.arange(2, 25)  # of the waves around the rim, one after the other; order 1 would move the centre


def hole_pattern(params: HoleParams, low: Floats, high: Floats, seed: int) -> Floats:
    """Centres (n, 2) in um, in the flat rectangle from ``low`` to ``high`` (u, v), with the error of the laser's stage.

    ValueError if the field is too small for the pattern.
    """
    if params.count == 0:
        return np.zeros((0, 2))
    designed = _coded(params, low, high) if params.pattern == "coded" else _scattered(params, low, high, seed)
    return designed + params.stage_um * generator(seed, "stage").standard_normal(designed.shape)


def _coded(params: HoleParams, low: Floats, high: Floats) -> Floats:
    """Three lines: along the lower edge, and up the left and the right one."""
    per_line = -(-params.count // 3)
    corner, rise = low + _BORDER_UM, low[1] + (_BORDER_UM + _CORNER_UM)
    starts = (corner, (corner[0], rise), (high[0] - _BORDER_UM, rise))
    lines: list[Floats] = []
    for pitches, start, direction in zip(_PITCHES_UM, starts, (0, 1, 1), strict=True):
        line = np.tile(start, (per_line, 1))
        line[:, direction] += np.concatenate([[0.0], np.cumsum(pitches)])[:per_line]
        lines.append(line[np.all(line <= high - _BORDER_UM + 1e-6, axis=1)])
    holes = np.concatenate(lines)[: params.count]
    if len(holes) < 4:
        size = " x ".join(f"{v:.0f}" for v in high - low)
        raise ValueError(
            f"Only {len(holes)} coded holes fit into {size} um; 4 are the least. Take a larger field or "
            "pattern='irregular'."
        )
    return holes


def _scattered(params: HoleParams, low: Floats, high: Floats, seed: int) -> Floats:
    rng = generator(seed, "pattern")
    border = min(_BORDER_UM, 0.2 * float((high - low).min()))
    inner = np.maximum(high - low - 2 * border, 0.0)
    spacing_um = min(_APART_UM, 0.7 * float(np.sqrt(inner.prod() / params.count)))
    spacing_um = max(spacing_um, 1.4 * params.diameter_um)
    centres: list[Floats] = []
    for _ in range(20_000):
        if len(centres) == params.count:
            return np.array(centres)
        point = rng.uniform(low + border, high - border)
        if all(np.hypot(*(point - other)) > spacing_um for other in centres):
            centres.append(point)
    size = " x ".join(f"{v:.0f}" for v in high - low)
    raise ValueError(f"{params.count} holes of {params.diameter_um:g} um do not fit into {size} um.")


def burn(
    params: HoleParams, holes: Floats, shape: tuple[int, int], low: tuple[float, float], depth_um: float, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Burn the holes into a sheet of the mean thickness ``depth_um``: ``rim_um`` and ``char`` of a :class:`Sheet`."""
    rim = np.full((2, *shape), 1e4, dtype=np.float32)
    char = np.ones(shape, dtype=np.float32)
    reach = 2.0 * params.diameter_um + 4 * params.char_um
    for k, (u, v) in enumerate(holes):
        j0, j1 = (int((u - low[0] + d) / PITCH_UM) for d in (-reach, reach))
        i0, i1 = (int((v - low[1] + d) / PITCH_UM) for d in (-reach, reach))
        box = (slice(max(i0, 0), min(i1, shape[0])), slice(max(j0, 0), min(j1, shape[1])))
        y = low[1] + PITCH_UM * np.arange(shape[0])[box[0], None] - v
        x = low[0] + PITCH_UM * np.arange(shape[1])[None, box[1]] - u
        if x.size == 0 or y.size == 0:
            continue
        top, bottom, burnt_um = _hole(params, x, y, depth_um, generator(seed, "hole", str(k)))
        rim[0][box] = np.minimum(rim[0][box], top)
        rim[1][box] = np.minimum(rim[1][box], bottom)
        if burnt_um > 0:
            char[box] = np.minimum(char[box], 1 - 0.5 * np.exp(-np.maximum(top, 0) / (0.5 * burnt_um)))
    return rim, char


def _hole(
    params: HoleParams, x: Floats, y: Floats, depth_um: float, rng: np.random.Generator
) -> tuple[Floats, Floats, float]:
    """Distances to one hole's rim at both faces, around its centre at the top face; width of the burnt rim."""
    # Everything is drawn, also what is off: then one switch does not move the others.
    radius = 0.5 * (params.diameter_um + params.diameter_sd_um * rng.standard_normal())
    ratio = np.sqrt(1 + (params.axis_ratio - 1) * rng.random())
    turn, towards, side = rng.uniform(0, 2 * np.pi, 3)
    lean = np.tan(np.deg2rad(params.tilt_deg * rng.random())) * depth_um
    power = np.exp(-((_ORDERS * _ROUGH_UM / (2 * radius)) ** 2))
    waves = params.rim_um * np.sqrt(power / power.sum())[:, None] * rng.standard_normal((_ORDERS.size, 2))
    burnt_um = max(params.char_um + params.char_sd_um * rng.standard_normal(), 0.0)
    closed = rng.random() < params.half_closed

    def distance(x: Floats, y: Floats, radius: float) -> Floats:
        # cos(k angle) + i sin(k angle) from one order to the next, without a sine for each
        spin: NDArray[np.complex128] = np.exp(1j * np.arctan2(y, x))
        wave, rough = spin, np.zeros(spin.shape)
        for a, b in waves:
            wave = wave * spin
            rough += a * wave.real + b * wave.imag
        p = (x * np.cos(turn) + y * np.sin(turn)) / ratio
        q = (y * np.cos(turn) - x * np.sin(turn)) * ratio
        return np.hypot(p, q) - radius - rough

    top = distance(x, y, radius)
    x, y = x - lean * np.cos(towards), y - lean * np.sin(towards)
    bottom = distance(x, y, radius * (1 - params.taper))
    if closed:
        bottom = np.maximum(bottom, x * np.cos(side) + y * np.sin(side))
    return top, bottom, burnt_um
