"""Curves of brightness over coat weight: intervals that hold the truth, words that are right, and the screen left.

``python -m benchmarks optics [fields [seed]]``

Fields of 60 x 80 points of 100 um. The coating weighs 17 +- 4.5 g/m2 and has a 1/e correlation length; the rest of the
brightness has one of its own, and the line carries a quarter of the variance. Independent points are those of
``independent_points``; in the second table those of ``correlate`` for the coating and the brightness, one number for
slope, bend and level, which is the simple way.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from planish.analyze import (
    correlate,
    fit_kubelka_munk,
    independent_points,
    pile,
    reflectance,
    straight_or_curved,
    without_screen,
)

Array = NDArray[np.float64]

_SHAPE, _POINT_UM = (60, 80), 100.0
_WEIGHT, _SPREAD = 17.0, 4.5  # g/m2
_S, _RATIO, _SLOPE, _NOISE = 0.15, 0.002, 0.00225, 0.0175  # S in m2/g, K/S, of a line per g/m2, of the rest
_COVERS = (0.90, 0.985)
_LENGTHS_UM = ((150.0, 150.0), (200.0, 200.0), (300.0, 300.0), (150.0, 600.0), (300.0, 100.0))
_WORDS = {"curved, saturating": "saturating", "curved, growing": "growing"}


def field(rng: np.random.Generator, length_um: float) -> Array:
    """A Gaussian map of variance 1 whose correlation falls as exp(-h / length), by embedding in a larger torus."""
    size = [fft.next_fast_len(2 * n) for n in _SHAPE]
    lags = [np.abs(fft.fftfreq(n, 1 / n)) * _POINT_UM / length_um for n in size]
    power = np.maximum(fft.fft2(np.exp(-np.hypot(lags[0][:, None], lags[1]))).real, 0.0)
    noise = rng.normal(size=size) + 1j * rng.normal(size=size)
    return fft.fft2(np.sqrt(power / power.size) * noise)[: _SHAPE[0], : _SHAPE[1]].real


def base() -> float:
    """Reflectance of a pile of uncoated base."""
    return float(pile(scattering=45.0, absorption=1.2))


def layer(weight: Array) -> Array:
    """Reflectance of the coating over the base."""
    return reflectance(weight, scattering=_S, absorption=_S * _RATIO, backing=base())


def cover(fields: int, seed: int, lengths_um: tuple[float, float], *, of_rest: bool = True) -> tuple[list[float], str]:
    """Shares of fields whose interval holds S, the base, and the slope and straightness of a line; and a row."""
    rng, held, n_effs, widths, seconds = np.random.default_rng(seed), [], [], [], 0.0
    words = {"saturating": 0, "growing": 0}
    for _ in range(fields):
        x = np.maximum(_WEIGHT + _SPREAD * field(rng, lengths_um[0]), 0.0)
        noise = _NOISE * field(rng, lengths_um[1])
        bent, line = layer(x) + noise, 0.82 + _SLOPE * x + noise
        if of_rest:
            points = independent_points(x, line, pixel_um=_POINT_UM)
            n_eff, squares, level = points.n_eff, points.n_eff_square, points.n_eff_level
        else:
            n_eff, squares, level = correlate(x, line, pixel_um=_POINT_UM).n_eff, None, None
        begun = time.perf_counter()
        fit = fit_kubelka_munk(x, bent, n_eff=n_eff, n_eff_level=level, absorption_over_scattering=_RATIO)
        seconds += time.perf_counter() - begun
        straight = straight_or_curved(x, line, n_eff=n_eff, n_eff_square=squares)
        held.append([
            low <= truth <= high
            for truth, (low, high) in (
                (_S, fit.scattering_interval), (base(), fit.backing_interval),
                (_SLOPE, straight.slope_interval), (0.0, straight.interval),
            )
        ])  # fmt: skip
        said = _WORDS.get(straight_or_curved(x, bent, n_eff=n_eff, n_eff_square=squares).words)
        if said:
            words[said] += 1
        n_effs.append(n_eff)
        widths.append((fit.scattering_interval[1] - fit.scattering_interval[0]) / 2 / _S)
    shares = [float(v) for v in np.mean(held, axis=0)]
    row = (
        f"{lengths_um[0]:5.0f} {lengths_um[1]:5.0f}{np.median(n_effs):8.0f}"
        + "".join(f"{v:9.3f}" for v in shares)
        + f"{100 * np.median(widths):9.0f} %{words['saturating'] / fields:10.2f}{words['growing'] / fields:9.2f}"
        + f"{1000 * seconds / fields:9.0f} ms"
    )
    return shares, row


def screen() -> int:
    """Print what is left of a drawn screen of dots; the number of angles that miss 3.1 %."""
    missed, pixel = 0, 10.0
    y, x = (np.arange(n) * pixel for n in (600, 640))
    k = 2 * np.pi * 60e-4
    print("screen of 60 lines/cm, sigma 70 um: amplitude left of drawn dots")
    for angle in (0.0, 15.0, 45.0, 75.0):
        c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
        u, v = k * (c * x + s * y[:, None]), k * (c * y[:, None] - s * x)
        image = (np.cos(u) + np.cos(v) > 0).astype(np.float64)
        inner = np.s_[25:-25, 25:-25]
        waves = [np.abs(np.mean((m - m.mean()) * np.exp(1j * u[inner])))
                 for m in (without_screen(image, pixel_um=pixel)[inner], image[inner])]  # fmt: skip
        left = float(waves[0] / waves[1])
        missed += abs(left - 0.031) > 0.004
        print(f"{angle:5.0f} deg {100 * left:7.2f} %")
    return missed


def straightness(seed: int) -> int:
    """Print the share of the variance of reflectance that a line carries; 1 where that is not nearly all."""
    x = np.random.default_rng(seed).normal(_WEIGHT, _SPREAD, 200_000)
    x = x[x > 0]
    found = straight_or_curved(x, layer(x), n_eff=x.size)
    print(
        f"17 +- 4.5 g/m2, no noise: a line carries {found.r2_line:.4f} of the variance of the curve, "
        f"a parabola {found.r2_parabola:.4f}"
    )
    return int(not 0.95 < found.r2_line < 0.99)


def main(fields: int = 200, seed: int = 0) -> int:
    """Print the tables; the number of limits that were missed."""
    missed = straightness(seed) + screen()
    title = (
        f"{'':24s}-- holds the truth of --\n"
        "  map  rest   n_eff        S     base    slope straight  width S saturating  growing      fit"
    )
    for of_rest in (True, False):
        print(f"{fields} fields, {'independent_points' if of_rest else 'n_eff of correlate for all'}\n{title}")
        for lengths in _LENGTHS_UM if of_rest else _LENGTHS_UM[1::2]:
            shares, row = cover(fields, seed, lengths, of_rest=of_rest)
            missed += of_rest and not all(_COVERS[0] <= v <= _COVERS[1] for v in shares)
            print(row, flush=True)
    return missed
