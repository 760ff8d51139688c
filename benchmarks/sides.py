"""Which side an image shows, whether it is the specimen, and where it lies: rates over drawn sheets and over ours.

``python -m benchmarks sides [SHEETS [OURS]]``: sheets of a generator of its own, as maps (coating, base, light from one
side, grain, print, uneven light, burnt rims at the same places in every specimen), and small specimens of
planish.synthetic through the whole line. Each is judged as it is, with its faces exchanged, and with the image of
another specimen that was burnt by the same program.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

import planish as pl
from planish.analyze import LagNumbers
from planish.analyze.sides import texture_of
from planish.core.checks import Check
from planish.core.errors import PlanishError
from planish.core.facts import is_known
from planish.run.build import link
from planish.synthetic import PRESETS, BurnParams, SpecimenParams, Warp, draw_params

Array = NDArray[np.float64]

_COATED = ("wfc90", "wfc118", "wfc135", "wfc135-calendered", "board")


@dataclass
class Drawn:
    """A sheet and its image on one grid, and how far the image is moved."""

    sheet: xr.Dataset
    image: xr.Dataset
    shift_um: tuple[float, float]


class _Fields:
    """Periodic random fields of one grid."""

    def __init__(self, rng: np.random.Generator, shape: tuple[int, int], pixel_um: float) -> None:
        self.rng, self.shape, self.pixel_um = rng, shape, pixel_um
        self._f = [fft.fftfreq(n, pixel_um)[:, None] if k == 0 else fft.fftfreq(n, pixel_um)[None] for k, n in
                   enumerate(shape)]  # fmt: skip

    def draw(self) -> Array:
        """A field of sd 1: Gaussian, exponential, power law or fibrous, of some length and direction."""
        kind, length = self.rng.integers(4), float(np.exp(self.rng.uniform(np.log(8.0), np.log(60.0))))
        angle, stretch = self.rng.uniform(0, np.pi), self.rng.uniform(1.0, 2.0)
        along = (self._f[1] * np.cos(angle) + self._f[0] * np.sin(angle)) * stretch
        across = (self._f[0] * np.cos(angle) - self._f[1] * np.sin(angle)) / stretch
        k2 = (2 * np.pi * length) ** 2 * (along**2 + across**2)
        power = (np.exp(-k2 / 4), (1 + k2) ** -1.5, (0.05 + k2) ** -self.rng.uniform(0.7, 1.3), (1 + k2) ** -2.5)[kind]
        return self.filtered(self.rng.standard_normal(self.shape), np.sqrt(power), unit=True)

    def filtered(self, values: Array, gain: Array, *, unit: bool = False) -> Array:
        out = fft.ifft2(fft.fft2(values) * gain).real
        return (out - out.mean()) / out.std() if unit else out

    def blurred(self, values: Array, sigma_um: float) -> Array:
        return self.filtered(values, np.exp(-2 * (np.pi * sigma_um) ** 2 * (self._f[0] ** 2 + self._f[1] ** 2)))

    def moved(self, values: Array, shift_um: tuple[float, float]) -> Array:
        return self.filtered(values, np.exp(-2j * np.pi * (self._f[1] * shift_um[0] + self._f[0] * shift_um[1])))

    def slopes(self, values: Array) -> list[Array]:
        return [np.asarray(np.gradient(values, self.pixel_um, axis=axis)) for axis in (1, 0)]


def draw_sheet(seed: int, *, program: int | None = None) -> Drawn:
    """Draw a sheet with its image; field, pixel and holes are drawn by ``program``, all else by the seed."""
    frame, rng = np.random.default_rng([7, seed if program is None else program]), np.random.default_rng([8, seed])
    pixel = float(np.exp(frame.uniform(np.log(3.0), np.log(20.0))))
    least = 900.0 if pixel < 10 else 1500.0
    size = frame.uniform(least, 2000.0), frame.uniform(least, 2400.0)
    factor = max(1.0, np.sqrt(size[0] * size[1] / pixel**2 / 90_000))
    shape = fft.next_fast_len(int(size[0] / factor / pixel)), fft.next_fast_len(int(size[1] / factor / pixel))
    fields = _Fields(rng, shape, pixel)
    y, x = (np.arange(n) * pixel for n in shape)
    holes = frame.uniform((0, 0, 40), (x[-1], y[-1], 120), (int(frame.integers(4, 12)), 3))
    rim = np.min([np.hypot(x[None] - cx, y[:, None] - cy) - r for cx, cy, r in holes], axis=0)
    burnt = np.exp(-np.maximum(rim, 0) / rng.uniform(10, 50))
    # The sheet: faces of the base, coatings that level them in part.
    coupled = rng.uniform(0, 0.7)
    base = [rng.uniform(1, 4) * fields.draw() for _ in range(2)]
    coatings = list[Array]()
    for face in base:
        made = np.sqrt(1 - coupled**2) * fields.draw() - coupled * face / face.std()
        mean = rng.uniform(8, 20)
        made = mean * np.exp(0.3 * made) if rng.random() < 0.5 else np.maximum(mean + rng.uniform(1.5, 5) * made, 0.3)
        coatings.append(made * (1 - 0.3 * burnt))
    heights = [b + c for b, c in zip(base, coatings, strict=True)]
    maps = {
        "coating_top": coatings[0], "coating_bottom": coatings[1], "topography_top": heights[0],
        "topography_bottom": heights[1], "thickness": heights[0] + heights[1] + 50,
    }  # fmt: skip
    blur, noise = rng.uniform(1.5, 5), rng.uniform(0.3, 1.5)
    valid = rim > frame.uniform(40, 100)
    measured = {
        k: np.where(valid, fields.blurred(m, blur) + noise * fields.blurred(rng.standard_normal(shape), pixel), np.nan)
        for k, m in maps.items()
    }
    shift = float(rng.normal(0, 2.0)), float(rng.normal(0, 2.0))
    image = fields.moved(_photograph(fields, coatings[0], heights[0]), shift) * (1 - 0.5 * burnt)
    image *= 1 + rng.uniform(0, 2) * (x[None] / x[-1]) + rng.uniform(-0.3, 0.3) * (y[:, None] / y[-1]) ** 2
    coords = {"y": y, "x": x}
    both = {"valid": (("y", "x"), valid)}
    error = (("y", "x"), np.full(shape, 3.0))
    sheet = xr.Dataset({k: (("y", "x"), m) for k, m in measured.items()} | both | {"expected_error": error}, coords)
    shown = np.rint(255 * np.clip(image / np.quantile(image, 0.999), 0, 1.2))
    return Drawn(sheet, xr.Dataset({"image": (("y", "x"), shown)} | both, coords), shift)


def _photograph(fields: _Fields, coating: Array, height: Array) -> Array:
    """The image of a face: its coating on some scale and with either sign, light, grain, print and noise."""
    rng = fields.rng
    tone = (coating, 1 - np.exp(-coating / rng.uniform(5, 20)), np.sqrt(coating))[rng.integers(3)]
    unit = [(m - m.mean()) / m.std() for m in (tone, *fields.slopes(height), height, fields.draw())]
    angle, sign = rng.uniform(0, 2 * np.pi), rng.choice([-1.0, 1.0])
    light = rng.uniform(0, 1.2)
    out = sign * unit[0] + light * (np.cos(angle) * unit[1] + np.sin(angle) * unit[2]) + rng.uniform(0, 0.3) * unit[3]
    out += rng.uniform(0.3, 2.0) * unit[4]
    if rng.random() < 0.2:
        period, turn = rng.uniform(100, 200), rng.uniform(0, np.pi)
        y, x = (fields.pixel_um * np.arange(n) for n in out.shape)
        u, v = (
            (x[None] * np.cos(turn) + y[:, None] * np.sin(turn)),
            (y[:, None] * np.cos(turn) - x[None] * np.sin(turn)),
        )
        out -= 1.5 * (np.cos(2 * np.pi * u / period) + np.cos(2 * np.pi * v / period) > 1.0)
    out = fields.blurred(out, rng.uniform(0.5, 1.2) * fields.pixel_um)
    out += rng.uniform(0.05, 0.5) * rng.standard_normal(out.shape)
    return 1 + rng.uniform(0.01, 0.08) * out


def our_sheets(count: int) -> Iterator[Drawn]:
    """Small specimens of planish.synthetic, drawn, through the whole line."""
    for seed in range(count):
        params = SpecimenParams(
            size_um=(1100.0, 900.0), holes=BurnParams(pattern="irregular", count=5), seed=seed,
            warp=Warp(slope=0.2, wavelength_um=2000.0),
        )  # fmt: skip
        params = draw_params(params)
        pixel = float(np.exp(np.random.default_rng(seed).uniform(np.log(3.0), np.log(12.0))))
        params = replace(
            params, paper=PRESETS[_COATED[seed % len(_COATED)]][1].as_slab(),
            scanner=replace(params.scanner, voxel_um=4.0),
            camera=replace(params.camera, pixel_um=pixel, turn_deg=0.0, oracle_r2=None),
        )  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            files = pl.make_specimen(params, Path(folder) / "sheet").files
            assert files is not None
            assert files.volume is not None
            assert files.image is not None
            try:
                linked = link(files.volume, files.image).linked
            except PlanishError as error:
                print(f"  specimen {seed}: {error}")
                continue
        yield Drawn(linked.drop_vars("image"), linked[["image", "valid"]], (0.0, 0.0))


def _exchanged(sheet: xr.Dataset) -> xr.Dataset:
    names = {
        f"{k}_{a}": f"{k}_{b}" for k in ("coating", "topography") for a, b in (("top", "bottom"), ("bottom", "top"))
    }
    return sheet.rename({a: b for a, b in names.items() if a in sheet and b in sheet})


def _other(image: xr.Dataset, onto: xr.Dataset) -> xr.Dataset | None:
    """The image of another specimen on the pixels of this one; None where they do not fit."""
    shape = tuple(min(image.sizes[k], onto.sizes[k]) for k in ("y", "x"))
    if shape != (onto.sizes["y"], onto.sizes["x"]):
        return None
    cut = image.isel(y=slice(0, shape[0]), x=slice(0, shape[1]))
    return cut.assign_coords(onto.coords)


def _judged(sheet: xr.Dataset, image: xr.Dataset) -> tuple[Check, Check | None, LagNumbers | None]:
    found = texture_of(sheet, image, ("sheet", "image"))
    return found.checks[0], found.checks[1] if len(found.checks) > 1 else None, found.lag


def _told(check: Check) -> str:
    """What the check says: the stated side, the other one, or neither."""
    if check.state == "pass":
        return "stated"
    return "other" if check.state == "fail" or "none is seen on the" in check.sentence else "none"


def _report(name: str, cases: list[tuple[Drawn, xr.Dataset | None]], show: bool) -> int:
    """Judge each case as it is, exchanged, and with the image of another one; print the rates."""
    told: dict[str, Counter[str]] = {k: Counter() for k in ("right", "exchanged", "foreign")}
    positions, errors = Counter[str](), list[Any]()
    false_lags = 0
    start = time.process_time()
    for one, foreign in cases:
        check, position, lag = _judged(one.sheet, one.image)
        told["right"][_told(check)] += 1
        if show and _told(check) != "stated":
            print(f"  {check.state}: {check.sentence}")
        positions["none" if position is None else position.state] += 1
        if lag is not None and is_known(lag.lag_um):
            errors.append((np.subtract(lag.lag_um, one.shift_um), lag.se_um))
        told["exchanged"][_told(_judged(_exchanged(one.sheet), one.image)[0])] += 1
        if foreign is not None:
            check, _, lag = _judged(one.sheet, foreign)
            told["foreign"][_told(check)] += 1
            false_lags += lag is not None and is_known(lag.lag_um)
    seconds = (time.process_time() - start) / max(3 * len(cases), 1)
    for kind, right in (("right", "stated"), ("exchanged", "other"), ("foreign", "none")):
        found = told[kind]
        print(f"{name}, {kind:9s}: {found[right]} of {found.total()} told rightly, {dict(found)}")
    off, se = (np.array([e[k] for e in errors]).reshape(-1, 2) for k in (0, 1))
    ratio = np.abs(off / se)
    print(
        f"{name}, lag: answered in {len(errors)} of {len(cases)} ({dict(positions)}), error rms "
        f"{np.sqrt(np.mean(off**2)):.2f} um, over standard error {np.sqrt(np.mean(ratio**2)):.2f}, within 2 se "
        f"{np.mean(ratio < 2):.2f}; unrelated images with a lag: {false_lags}; {seconds:.2f} s CPU a judgement"
    )
    wrong = told["right"]["other"] + told["exchanged"]["stated"] + told["foreign"]["stated"] + told["foreign"]["other"]
    print(f"{name}: {wrong} wrong answers")
    few = told["right"]["stated"] < 0.8 * len(cases) or len(errors) < 0.8 * len(cases)
    return int(wrong > 0 or few)


def main(sheets: int = 100, ours: int = 10) -> int:
    """Print all rates; 1 where a wrong answer was given, or an answer in less than 80 %."""
    drawn = [draw_sheet(seed) for seed in range(sheets)]
    failed = _report(
        "drawn", [(one, draw_sheet(1000 + k, program=k).image) for k, one in enumerate(drawn)], show=True
    )  # fmt: skip
    made = list(our_sheets(ours))
    pairs = [(one, _other(made[k - 1].image, one.image)) for k, one in enumerate(made)]
    return failed + _report("ours", pairs, show=True)
