"""The brightness study of Hirn et al. (2009), section 3.3.1, on two made specimens: before and after calendering.

``python -m benchmarks brightness [SIZE [SEED]]``

Scans by a micro-CT, 8 x 6 mm (T2) unless said, with all nuisances; the r² of the true maps at 100 um is drawn to .21
and .26, the figures of the paper. Each is mapped and linked as a user would, to an image taken in even light and to one
that is shaded by the topography and darker in its corners. Then the two are compared.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from resource import RUSAGE_SELF, getrusage

import planish as pl
from planish.analyze import correlate, difference_of
from planish.core.facts import is_known
from planish.synthetic import (
    MICRO_CT,
    PRESETS,
    SIZES_UM,
    SpecimenParams,
    make_specimen,
    without,
    write_image,
    write_instruments,
)

_CASES = (("before", "wfc135", 0.21), ("after", "wfc135-calendered", 0.26))
_LIGHTS = (("even light", ("shading", "vignetting")), ("uneven light", ()))


def main(size: str = "T2", seed: int | str = 1) -> int:
    found = {light: [] for light, _ in _LIGHTS}
    for name, preset, r2 in _CASES:
        params = SpecimenParams(
            size_um=SIZES_UM[size], paper=PRESETS[preset][1].as_slab(), seed=int(seed),
            scanner=replace(MICRO_CT, voxel_um=3.0),
        )  # fmt: skip
        params = replace(params, camera=replace(params.camera, oracle_r2=r2))
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            files = write_instruments(make_specimen(params), folder, volume="scanner", image=False)
            start, spent = time.perf_counter(), time.process_time()
            pl.map_sheet(files.volume, out=folder / "map", volume={"through": files.through})
            wall, cpu = time.perf_counter() - start, time.process_time() - spent
            print(f"{name}: mapped in {wall:.0f} s, {cpu:.0f} s of processor time", flush=True)
            for light, off in _LIGHTS:
                image = write_image(make_specimen(without(params, off)), folder / f"{light.split()[0]}.tif")
                start = time.perf_counter()
                run = pl.link(folder / "map", image, out=folder / light)
                found[light].append(_said(f"{name}, {light}", run, r2))
                page = (folder / light / "report.html").stat().st_size
                print(f"    linked in {time.perf_counter() - start:.0f} s, page {page / 1e6:.1f} MB", flush=True)
    for light, both in found.items():
        between = difference_of(*both)
        low, high = between.interval
        word = "distinguishable" if low * high > 0 else "not distinguishable"
        print(f"{light}: difference of r {between.difference:+.3f} ({low:+.3f} to {high:+.3f}), {word}")
    print(f"largest resident memory {getrusage(RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB")
    return 0


def _said(name, run, r2):
    linked = run.linked
    pixel = float(linked["x"].values[1] - linked["x"].values[0])
    maps = linked["coating_top"], linked["image"]
    one = correlate(*maps, mask=linked["valid"].values, pixel_um=pixel, point_um=100.0)
    low, high = one.interval
    print(
        f"    {name}, r² of the true maps {r2}: r {one.r:.3f} ({low:.3f} to {high:.3f}), r² {one.r2:.3f}, n_eff "
        f"{one.n_eff:.0f} of {one.n}; the true r {'lies' if low <= r2**0.5 <= high else 'does not lie'} in the interval"
    )
    rows = ", ".join(f"{row.registration} {row.r2:.3f}" for row in run.results.comparison if is_known(row.r2))
    print(f"    r² by registration: {rows}")
    for evidence in run.results.evidence:
        if evidence.short_waves is not None:
            print(f"    without long waves: r {evidence.short_waves.r:.3f} {evidence.short_waves.interval}")
        if evidence.ceiling is not None:
            print(f"    at most to be seen: r {evidence.ceiling:.3f}")
    return one
