"""What the statistics of correlations promise, on random maps whose covariance is known.

``python -m benchmarks evidence [PAIRS] [RUN]``

Gaussian maps of 150 x 200 pixels unless said; lengths are the 1/e lengths of the correlation, as
shares of the shorter side. ``RUN`` is the folder of a link, whose maps are then compared with drawn
images that have nothing to do with it.
"""

from __future__ import annotations

import math
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import xarray as xr
import zarr
from scipy import fft, ndimage, optimize, stats

from benchmarks.shared import in_parts, memory
from planish.analyze import coherence, correlate, paired_difference, size_curve, without_screen
from planish.analyze.compare import correlate_layers
from planish.texture.covariance import Lags

SHAPE, SIDE = (150, 200), 150


def field(rng, shape, length, kind):
    """Two unrelated maps of variance 1 and correlation exp(-h / length), or exp(-(h / length)^2),
    by embedding."""
    down, across = length if isinstance(length, tuple) else (length, length)
    size = [fft.next_fast_len(2 * n) for n in shape]
    lags = [np.abs(fft.fftfreq(n, 1 / n)) for n in size]
    h = np.hypot(lags[0][:, None] / down, lags[1] / across)
    power = np.maximum(
        np.asarray(fft.fft2(np.exp(-h) if kind == "exp" else np.exp(-h * h))).real, 0.0
    )
    noise = rng.normal(size=size) + 1j * rng.normal(size=size)
    both = np.asarray(fft.fft2(np.sqrt(power / power.size) * noise))[: shape[0], : shape[1]]
    return both.real.copy(), both.imag.copy()


def related(rng, r, length, noise=None, kind="exp", shape=SHAPE):
    """Two maps of correlation r; what the second does not share with the first has its own
    length."""
    a, rest = field(rng, shape, length, kind)
    if noise is not None:
        rest = field(rng, shape, noise, kind)[0]
    return a, r * a + math.sqrt(1 - r * r) * rest


def with_nugget(rng, r, length):
    """Maps of correlation r, 40 % of whose variance is noise of single pixels."""
    a, b = related(rng, r / 0.6, length)
    return tuple(math.sqrt(0.6) * m + math.sqrt(0.4) * rng.normal(size=SHAPE) for m in (a, b))


def lognormal(rng, r, length):
    """Exponentials of 0.6 times Gaussian maps, with the correlation r of the exponentials."""
    s = 0.36
    a, b = related(rng, math.log(1 + r * (math.exp(s) - 1)) / s, length)
    return np.exp(0.6 * a), np.exp(0.6 * b)


def with_holes(rng, r, length):
    """Maps with holes, their rims and a border missing."""
    a, b = related(rng, r, length)
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    for y in (20, 60, 110, 130):
        for x in (20, 80, 150, 180):
            a[np.hypot(rows - y, cols - x) < 12] = np.nan
    a[:6], b[:, -6:] = np.nan, np.nan
    return a, b


def exact_n_eff(length, kind="exp"):
    """Dutilleul's number by the true covariance at every lag."""
    known = np.ones(SHAPE, bool)
    lags = Lags(known, (1.0, 1.0))
    down, across = length if isinstance(length, tuple) else (length, length)
    size = [2 * n - 1 for n in SHAPE]
    at = [fft.fftfreq(n, 1 / n) for n in size]
    h = np.hypot(at[0][:, None] / down, at[1] / across)
    c = np.exp(-h) if kind == "exp" else np.exp(-h * h)
    pairs = np.outer(*(n - np.abs(k) for n, k in zip(SHAPE, at, strict=True)))
    rows = np.asarray(fft.ifft2(fft.fft2(c) * fft.fft2(known.astype(float), size))).real[
        : SHAPE[0], : SHAPE[1]
    ]
    n, whole = lags.n, float(np.sum(pairs * c))
    trace = n - whole / n
    return 1 + trace**2 / (
        float(np.sum(pairs * c * c)) - 2 * float(np.sum(rows**2)) / n + whole**2 / n**2
    )


def statements(make, r, seed, count):
    """For each pair: whether the interval holds r, p < .05, naive p < .05, n_eff, width, whether a
    sign is named.

    NaN where withheld.
    """
    rng, out = np.random.default_rng(seed), []
    for _ in range(count):
        found = correlate(*make(rng), pixel_um=1.0)
        low, high = found.interval
        t = abs(found.r) * math.sqrt((found.n - 2) / (1 - found.r**2))
        naive = 2 * stats.t.sf(t, found.n - 2)
        held = low <= r <= high if low == low else math.nan
        out.append((held, found.p < 0.05, naive < 0.05, found.n_eff, high - low, low * high > 0))
    return np.array(out, dtype=float)


def coherences(length, seed, count):
    """p of each octave of unrelated maps."""
    rng = np.random.default_rng(seed)
    return np.array(
        [
            [k.p for k in coherence(*related(rng, 0, length), pixel_um=1.0).bands]
            for _ in range(count)
        ]
    )


CURVE = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)


def curves(r, length, noise, seed, count):
    """Whether the band holds the whole true curve."""
    rng, out = np.random.default_rng(seed), []
    own, rest = ([_variance(k, s) for s in CURVE] for k in (length, noise))
    true = [
        r * math.sqrt(a) / math.sqrt(r * r * a + (1 - r * r) * b)
        for a, b in zip(own, rest, strict=True)
    ]
    for _ in range(count):
        band = [
            row.band
            for row in size_curve(*related(rng, r, length, noise), pixel_um=1.0, sizes_um=CURVE)
        ]
        out.append(
            all(low <= t <= high for (low, high), t in zip(band, true, strict=True) if low == low)
        )
    return np.array(out, dtype=float)


def _variance(length, size):
    """Variance of the mean over a point of a map of variance 1."""
    at = np.arange(1 - size, size)
    weight = np.outer(size - abs(at), size - abs(at)) / size**4
    return float(np.sum(weight * np.exp(-np.hypot(at[:, None], at) / length)))


def differences(length, seed, count):
    """Whether the paired interval holds the true difference; 3 x 2 mm at 12 um."""
    rng, out, shape = np.random.default_rng(seed), [], (166, 250)
    for _ in range(count):
        a, b = related(rng, 0.5, length, shape=shape)
        worse = 0.8 * a + 0.6 * field(rng, shape, length, "exp")[0]
        low, high = paired_difference((worse, b), (a, b), pixel_um=12.0).interval
        out.append(low <= 0.1 <= high if low == low else math.nan)
    return np.array(out, dtype=float)


def against(run, seed, count):
    """Of drawn images and a run's maps: whether a direction is named, and whether any p of the
    table is below .05."""
    linked = xr.open_zarr(run / "maps.zarr", group="linked", consolidated=False).load()
    pixel = float(linked["x"].values[1] - linked["x"].values[0])
    sheet, shape, rng, out = (
        linked.drop_vars("image"),
        linked["image"].shape,
        np.random.default_rng(seed),
        [],
    )
    for _ in range(count):
        length = (
            float(np.exp(rng.uniform(math.log(30.0), math.log(0.2 * min(shape) * pixel)))) / pixel
        )
        drawn = field(rng, (shape[0], shape[1]), length, "exp" if rng.random() < 0.5 else "gauss")[
            0
        ]
        image = linked[["image", "valid"]].assign(image=(("y", "x"), drawn))
        rows = [*correlate_layers("sheet", "image", {"sheet": sheet, "image": image}, 100.0)]
        lead = next(row for row in rows if row.a_map == "coating_top" and row.point_um == 100.0)
        out.append(
            (
                lead.direction != 0,
                any(row.p_of_table is not None and row.p_of_table < 0.05 for row in rows),
            )
        )
    return np.array(out, dtype=float)


FIELD, FIELD_UM = (300, 400), 20.0  # 8 x 6 mm
_THICK_SD_UM, _THICK_ERROR_UM, _PLACE_ERROR_UM = 4.5, 0.35, 1.5  # errors: docs/accuracy.md


def brightness(r2, seed, count):
    """Fields of 8 x 6 mm at points of 100 um: r, limits, n_eff, n.

    Thickness and places are measured with errors.
    """
    rng, out = np.random.default_rng(seed + round(1e6 * r2)), []
    for _ in range(count):
        a, b = related(rng, math.sqrt(r2), 150.0 / FIELD_UM, shape=FIELD)
        found = correlate(_measured(rng, a), b, pixel_um=FIELD_UM, point_um=100.0)
        out.append((found.r, *found.interval, found.n_eff, found.n))
    return np.array(out, dtype=float)


def _measured(rng, a):
    """A map of thickness as it is measured: with noise, and each pixel from a place that is a
    little wrong."""
    moves = [ndimage.gaussian_filter(rng.normal(size=a.shape), 20, mode="wrap") for _ in range(2)]
    size = _PLACE_ERROR_UM / FIELD_UM / math.sqrt(2)
    at = [k + m / m.std() * size for k, m in zip(np.indices(a.shape), moves, strict=True)]
    moved = ndimage.map_coordinates(a, at, order=1, mode="reflect")
    return _THICK_SD_UM * moved + _THICK_ERROR_UM * rng.normal(size=a.shape)


def prints(seed, count):
    """Prints with a screen of 60 lines/cm at 45 degrees: r² with it taken off, r² without any
    screen, n_eff, n."""
    rng, out, pixel = np.random.default_rng(seed), [], 12.0
    rows, cols = np.indices((500, 667)) * pixel
    along = 2 * math.pi * 60.0 / 1e4
    screen = np.cos(along * (rows + cols) / math.sqrt(2)) + np.cos(
        along * (rows - cols) / math.sqrt(2)
    )
    for _ in range(count):
        thickness, print_ = related(rng, math.sqrt(0.232), 150.0 / pixel, shape=(500, 667))
        found = [
            correlate(thickness, without_screen(m, pixel_um=pixel), pixel_um=pixel, point_um=100.0)
            for m in (print_ + 3 * screen, print_)
        ]
        out.append((found[0].r2, found[1].r2, found[0].n_eff, found[0].n))
    return np.array(out, dtype=float)


def stored(folder, rows, cols):
    """Write two maps and a mask, band by band, as a run stores them."""
    rng = np.random.default_rng(0)
    group = zarr.open_group(folder, mode="w")
    made = {
        k: group.create_array(
            k, shape=(rows, cols), chunks=(512, 512), dtype=t, dimension_names=("y", "x")
        )
        for k, t in (("a", "f4"), ("b", "f4"), ("mask", "?"))
    }
    for begin in range(0, rows, 512):
        many = min(512, rows - begin)
        a, b = (
            ndimage.uniform_filter(rng.normal(size=(many, cols)).astype(np.float32), 15)
            for _ in range(2)
        )
        made["a"][begin : begin + many], made["b"][begin : begin + many] = a, a + b
        made["mask"][begin : begin + many] = rng.random((many, cols)) > 0.1


def cost_of(folder, whole, what):
    """Correlate the stored maps, in a process of its own: processor time and what the memory grew
    by."""
    data = xr.open_zarr(folder, consolidated=False)
    data = data.load() if whole else data
    a, b, mask = (data[k] for k in ("a", "b", "mask"))
    before, start = memory(peak=True), time.process_time()
    if what == "correlate":
        n_eff = correlate(a, b, mask=mask, pixel_um=2.0).n_eff
    else:
        x, y = np.where(mask.values, a.values, np.nan), b.values
        size_curve(x, y, pixel_um=2.0, sizes_um=[2.0 * 2**k for k in range(9)])
        coherence(x, y, pixel_um=2.0)
        n_eff = math.nan
    spent, peak = time.process_time() - start, memory(peak=True)
    grown = f"{(peak - before) / 2**30:.2f} GiB more, peak {peak / 2**30:.2f} GiB"
    return f"{spent:.2f} s of processor time, {grown}; n_eff {n_eff:.0f}"


def large():
    """Cost at 4000 x 3000 pixels with a mask, and of 160 million pixels from a store."""
    for rows, cols, whole, what in (
        (3000, 4000, True, "correlate"),
        (3000, 4000, True, "scales"),
        (10_944, 14_592, False, "correlate"),
    ):
        with (
            tempfile.TemporaryDirectory() as name,
            ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        ):
            stored(Path(name), rows, cols)
            print(
                f"{rows} x {cols}, {what}:"
                f" {pool.submit(cost_of, Path(name), whole, what).result()}",
                flush=True,
            )


def _sizes(exact):
    return lambda found: (
        f"rejected at 5 %: {found[:, 1].mean():.3f}, naive {found[:, 2].mean():.3f}; "
        f"n_eff {np.nanmedian(found[:, 3]):.0f}, exact {exact:.0f}"
    )


def _covers(found):
    return (
        f"the interval holds r in {np.nanmean(found[:, 0]):.3f}, width"
        f" {np.nanmedian(found[:, 4]):.3f}, withheld in {np.mean(np.isnan(found[:, 0])):.2f}; a"
        f" direction is named in {found[:, 5].mean():.3f}"
    )


def _covers_population(r2, found):
    r = math.sqrt(r2)
    held = np.mean((found[:, 1] <= r) & (r <= found[:, 2]))
    return (
        f"mean r² {np.mean(found[:, 0] ** 2):.3f}, sd {np.std(found[:, 0] ** 2):.3f}; the interval"
        f" holds r in {held:.3f}; n_eff {np.median(found[:, 3]):.0f} of {found[0, 4]:.0f}"
    )


def _screened(found):
    off = np.abs(found[:, 0] - found[:, 1]).max()
    return (
        f"r² {found[:, 0].mean():.3f}, without any screen {found[:, 1].mean():.3f}, largest"
        f" difference {off:.4f}"
    )


def _octaves(found):
    together = 1 - (1 - np.nanmin(found, axis=1)) ** found.shape[1]
    each = ", ".join(f"{v:.3f}" for v in np.nanmean(found < 0.05, axis=0))
    return f"rejected at 5 %: {each}; any after correction {np.mean(together < 0.05):.3f}"


def _holds(found):
    return f"holds the truth in {np.nanmean(found):.3f}"


def _named(found):
    return (
        f"a direction is named in {found[:, 0].mean():.3f}, some property starred in"
        f" {found[:, 1].mean():.3f}"
    )


def _jobs():
    """Name, work by seed and count, and what is said of its rows."""
    lengths = {f"side/{part}": (SIDE / part, "exp") for part in (60, 30, 12, 8, 5)}
    lengths |= {"gauss side/15": (10.0, "gauss"), "5 x 20 pixels": ((5.0, 20.0), "exp")}
    for name, (length, kind) in lengths.items():
        make = partial(related, r=0.0, length=length, kind=kind)
        yield (
            f"unrelated, {name}",
            partial(statements, make, 0.0),
            _sizes(exact_n_eff(length, kind)),
        )
    long = optimize.brentq(lambda k: exact_n_eff(k) - 60, 5.0, 60.0)
    cases = {
        f"r {r}, side/{part}": (r, partial(related, r=r, length=SIDE / part))
        for r in (0.0, 0.5, 0.9)
        for part in (30, 12)
    } | {
        "r 0.5, lognormal": (0.5, partial(lognormal, r=0.5, length=8.0)),
        "r 0.5, nugget 40 %": (0.5, partial(with_nugget, r=0.5, length=8.0)),
        "r 0.5, 4:1": (0.5, partial(related, r=0.5, length=(3.0, 12.0))),
        "r 0.5, holes and rims": (0.5, partial(with_holes, r=0.5, length=8.0)),
        "r 0.5, side/60 under side/10": (0.5, partial(related, r=0.5, length=2.5, noise=15.0)),
        "r 0.5, side/5": (0.5, partial(related, r=0.5, length=30.0)),
        "r 0.5, n_eff 60": (0.5, partial(related, r=0.5, length=long)),
    }
    for name, (r, make) in cases.items():
        yield name, partial(statements, make, r), _covers
    for length in (4.0, 12.0):
        yield f"octaves, side/{SIDE / length:.0f}", partial(coherences, length), _octaves
    for r, length, noise in ((0.5, 8.0, 8.0), (0.5, 4.0, 12.0), (0.6, 12.0, 4.0)):
        yield (
            f"curve of sizes, r {r}, {length:g} under {noise:g}",
            partial(curves, r, length, noise),
            _holds,
        )
    for length in (100, 200, 300):
        yield (
            f"paired difference, {length} um on 3 x 2 mm",
            partial(differences, length / 12),
            _holds,
        )
    for r2 in _POPULATIONS:
        yield _FIELD_OF.format(r2), partial(brightness, r2), partial(_covers_population, r2)
    yield "print screen", prints, _screened


_POPULATIONS, _FIELD_OF = (0.21, 0.26), "8 x 6 mm, population r² {}"
_FEW = {**{_FIELD_OF.format(r2): 200 for r2 in _POPULATIONS}, "print screen": 20}
"""Large fields take longer, and fewer of them say enough."""


def main(pairs=1000, run=""):
    jobs = [*_jobs()]
    if run:
        jobs.append(("drawn images against a run", partial(against, Path(run)), _named))
    found = {}
    with ProcessPoolExecutor(2) as pool:
        for name, work, say in jobs:
            found[name] = in_parts(
                pool, work, min(int(pairs), _FEW.get(name, int(pairs))), chunk=25
            )
            print(f"{name}: {say(found[name])}", flush=True)
    one, two = (np.arctanh(found[_FIELD_OF.format(r2)][:, :3]) for r2 in _POPULATIONS)
    widths = [(k[:, 2] - k[:, 1]) / 2 for k in (one, two)]
    same = np.abs(two[:, 0] - one[:, 0]) < np.hypot(*widths)
    print(f"0.26 against 0.21, a field each: not distinguishable in {same.mean():.2f}")
    large()
    return 0
