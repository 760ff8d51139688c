"""Which side an image shows, whether it is the specimen, and where it lies: rates over drawn
sheets.

``python -m benchmarks sides [SHEETS]``: sheets of a generator of its own, as maps (coating, base,
light from one side, grain, print, uneven light, burnt rims at the same places in every specimen).
Each is judged as it is, with its faces exchanged, and with the image of another specimen that was
burnt by the same program.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy import fft

from benchmarks.shared import rms
from planish.analyze.sides import texture_of
from planish.core.facts import is_known


@dataclass
class Drawn:
    """A sheet and its image on one grid, and how far the image is moved."""

    sheet: xr.Dataset
    image: xr.Dataset
    shift_um: tuple[float, float]


class _Fields:
    """Periodic random fields of one grid."""

    def __init__(self, rng, shape, pixel_um):
        self.rng, self.shape, self.pixel_um = rng, shape, pixel_um
        self._f = [
            fft.fftfreq(n, pixel_um)[:, None] if k == 0 else fft.fftfreq(n, pixel_um)[None]
            for k, n in enumerate(shape)
        ]

    def draw(self):
        """A field of sd 1: Gaussian, exponential, power law or fibrous, of some length and
        direction."""
        kind, length = (
            self.rng.integers(4),
            float(np.exp(self.rng.uniform(np.log(8.0), np.log(60.0)))),
        )
        angle, stretch = self.rng.uniform(0, np.pi), self.rng.uniform(1.0, 2.0)
        along = (self._f[1] * np.cos(angle) + self._f[0] * np.sin(angle)) * stretch
        across = (self._f[0] * np.cos(angle) - self._f[1] * np.sin(angle)) / stretch
        k2 = (2 * np.pi * length) ** 2 * (along**2 + across**2)
        power = (
            np.exp(-k2 / 4),
            (1 + k2) ** -1.5,
            (0.05 + k2) ** -self.rng.uniform(0.7, 1.3),
            (1 + k2) ** -2.5,
        )[kind]
        return self.filtered(self.rng.standard_normal(self.shape), np.sqrt(power), unit=True)

    def filtered(self, values, gain, *, unit=False):
        out = fft.ifft2(fft.fft2(values) * gain).real
        return (out - out.mean()) / out.std() if unit else out

    def blurred(self, values, sigma_um):
        return self.filtered(
            values, np.exp(-2 * (np.pi * sigma_um) ** 2 * (self._f[0] ** 2 + self._f[1] ** 2))
        )

    def moved(self, values, shift_um):
        return self.filtered(
            values, np.exp(-2j * np.pi * (self._f[1] * shift_um[0] + self._f[0] * shift_um[1]))
        )

    def slopes(self, values):
        return [np.asarray(np.gradient(values, self.pixel_um, axis=axis)) for axis in (1, 0)]


def draw_sheet(seed, *, program=None):
    """Draw a sheet with its image; field, pixel and holes are drawn by ``program``, all else by the
    seed."""
    frame, rng = (
        np.random.default_rng([7, seed if program is None else program]),
        np.random.default_rng([8, seed]),
    )
    pixel = float(np.exp(frame.uniform(np.log(3.0), np.log(20.0))))
    least = 900.0 if pixel < 10 else 1500.0
    size = frame.uniform(least, 2000.0), frame.uniform(least, 2400.0)
    factor = max(1.0, np.sqrt(size[0] * size[1] / pixel**2 / 90_000))
    shape = (
        fft.next_fast_len(int(size[0] / factor / pixel)),
        fft.next_fast_len(int(size[1] / factor / pixel)),
    )
    fields = _Fields(rng, shape, pixel)
    y, x = (np.arange(n) * pixel for n in shape)
    holes = frame.uniform((0, 0, 40), (x[-1], y[-1], 120), (int(frame.integers(4, 12)), 3))
    rim = np.min([np.hypot(x[None] - cx, y[:, None] - cy) - r for cx, cy, r in holes], axis=0)
    burnt = np.exp(-np.maximum(rim, 0) / rng.uniform(10, 50))
    # The sheet: faces of the base, coatings that level them in part.
    coupled = rng.uniform(0, 0.7)
    base = [rng.uniform(1, 4) * fields.draw() for _ in range(2)]
    coatings = []
    for face in base:
        made = np.sqrt(1 - coupled**2) * fields.draw() - coupled * face / face.std()
        mean = rng.uniform(8, 20)
        made = (
            mean * np.exp(0.3 * made)
            if rng.random() < 0.5
            else np.maximum(mean + rng.uniform(1.5, 5) * made, 0.3)
        )
        coatings.append(made * (1 - 0.3 * burnt))
    heights = [b + c for b, c in zip(base, coatings, strict=True)]
    maps = {
        "coating_top": coatings[0],
        "coating_bottom": coatings[1],
        "topography_top": heights[0],
        "topography_bottom": heights[1],
        "thickness": heights[0] + heights[1] + 50,
    }
    blur, noise = rng.uniform(1.5, 5), rng.uniform(0.3, 1.5)
    valid = rim > frame.uniform(40, 100)
    measured = {
        k: np.where(
            valid,
            fields.blurred(m, blur) + noise * fields.blurred(rng.standard_normal(shape), pixel),
            np.nan,
        )
        for k, m in maps.items()
    }
    shift = rng.normal(0, 2.0), rng.normal(0, 2.0)
    image = fields.moved(_photograph(fields, coatings[0], heights[0]), shift) * (1 - 0.5 * burnt)
    image *= (
        1
        + rng.uniform(0, 2) * (x[None] / x[-1])
        + rng.uniform(-0.3, 0.3) * (y[:, None] / y[-1]) ** 2
    )
    coords = {"y": y, "x": x}
    both = {"valid": (("y", "x"), valid)}
    error = (("y", "x"), np.full(shape, 3.0))
    sheet = xr.Dataset(
        {k: (("y", "x"), m) for k, m in measured.items()} | both | {"expected_error": error}, coords
    )
    shown = np.rint(255 * np.clip(image / np.quantile(image, 0.999), 0, 1.2))
    return Drawn(sheet, xr.Dataset({"image": (("y", "x"), shown)} | both, coords), shift)


def _photograph(fields, coating, height):
    """The image of a face: its coating on some scale and with either sign, light, grain, print and
    noise."""
    rng = fields.rng
    tone = (coating, 1 - np.exp(-coating / rng.uniform(5, 20)), np.sqrt(coating))[rng.integers(3)]
    unit = [(m - m.mean()) / m.std() for m in (tone, *fields.slopes(height), height, fields.draw())]
    angle, sign = rng.uniform(0, 2 * np.pi), rng.choice([-1.0, 1.0])
    light = rng.uniform(0, 1.2)
    out = (
        sign * unit[0]
        + light * (np.cos(angle) * unit[1] + np.sin(angle) * unit[2])
        + rng.uniform(0, 0.3) * unit[3]
    )
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


def _exchanged(sheet):
    names = {
        f"{k}_{a}": f"{k}_{b}"
        for k in ("coating", "topography")
        for a, b in (("top", "bottom"), ("bottom", "top"))
    }
    return sheet.rename({a: b for a, b in names.items() if a in sheet and b in sheet})


def _judged(sheet, image):
    found = texture_of(sheet, image, ("sheet", "image"))
    return found.checks[0], found.checks[1] if len(found.checks) > 1 else None, found.lag


def _told(check):
    """What the check says: the stated side, the other one, or neither."""
    if check.state == "pass":
        return "stated"
    return "other" if check.state == "fail" or "none is seen on the" in check.sentence else "none"


def main(sheets=100):
    """Judge each as it is, exchanged, and with a foreign image; 1 on a wrong answer, or few
    answers."""
    told = {k: Counter() for k in ("stated", "other", "none")}  # by what should be told
    positions, errors = Counter(), []
    false_lags = 0
    start = time.process_time()
    for seed in range(sheets):
        one, foreign = draw_sheet(seed), draw_sheet(1000 + seed, program=seed)
        check, position, lag = _judged(one.sheet, one.image)
        told["stated"][_told(check)] += 1
        if _told(check) != "stated":
            print(f"  {check.state}: {check.sentence}")
        positions["none" if position is None else position.state] += 1
        if lag is not None and is_known(lag.lag_um):
            errors.append((np.subtract(lag.lag_um, one.shift_um), lag.se_um))
        told["other"][_told(_judged(_exchanged(one.sheet), one.image)[0])] += 1
        check, _, lag = _judged(one.sheet, foreign.image)
        told["none"][_told(check)] += 1
        false_lags += lag is not None and is_known(lag.lag_um)
    seconds = (time.process_time() - start) / max(3 * sheets, 1)
    for right, name in (("stated", "right"), ("other", "exchanged"), ("none", "foreign")):
        print(f"{name:9s}: {told[right][right]} of {sheets} told rightly, {dict(told[right])}")
    off, se = (np.array([e[k] for e in errors]).reshape(-1, 2) for k in (0, 1))
    ratio = np.abs(off / se)
    print(
        f"lag: answered in {len(errors)} of {sheets} ({dict(positions)}), error {rms(off):.2f} um"
        f" rms, over standard error {rms(ratio):.2f}, within 2 se {np.mean(ratio < 2):.2f};"
        f" unrelated images with a lag: {false_lags}; {seconds:.2f} s CPU a judgement"
    )
    wrong = (
        told["stated"]["other"]
        + told["other"]["stated"]
        + told["none"]["stated"]
        + told["none"]["other"]
    )
    print(f"{wrong} wrong answers")
    return int(wrong > 0 or min(told["stated"]["stated"], len(errors)) < 0.8 * sheets)
