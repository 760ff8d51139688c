"""How planish measures paper of fibres and pores: drawn specimens of each kind against their truth.

    python -m benchmarks paper [KIND ...] [--count 10] [--first 0]

The sheets are laid fibre by fibre (``planish.synthetic.fibres``); grades, greys, blur, noise, bends and what lies
beside the sheet are drawn. A coating's truth is the layer itself; the face of a sheet without one is the outermost
place at which the wall under the stated blur reaches half of its own grey, loose fibres left out. Per specimen: mean
error of each thickness and how many of its stated errors that is, standard deviation of a column's error over the
stated one, coverage, and the mean error in classes of the true coating.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
import xarray as xr
from scipy import ndimage

from planish.core.errors import PlanishError
from planish.core.typing import Bools, Floats
from planish.measure import measure_properties
from planish.run.facts import property_facts
from planish.surface import find_surfaces
from planish.synthetic import (
    BurnParams,
    FibreParams,
    FilmParams,
    PaperParams,
    ScannerParams,
    Specimen,
    SpecimenParams,
    Warp,
    make_specimen,
)
from planish.synthetic.sheet import PITCH_UM

_CLASSES_UM = (0.0, 3.0, 6.0, 10.0, 15.0, math.inf)
_CLEAR_UM = 130.0  # from the rim of a hole
_SIZE_UM = (1500.0, 1100.0)


@dataclass(frozen=True, kw_only=True)
class Sized:
    """A thickness of a specimen: its name, errors over the columns that show it, and the share of these."""

    name: str
    true: Floats
    error: Floats
    stated: Floats  # standard error of each column
    mean_stated: float
    coverage: float

    def line(self) -> str:
        """Numbers of a row of the table."""
        mean, spread = float(self.error.mean()), float(self.error.std())
        stated = float(np.sqrt(np.nanmean(self.stated**2)))
        words = (
            f"{self.name:14s} true {self.true.mean():6.2f}  off {mean:+6.2f} ({abs(mean) / self.mean_stated:4.1f} "
            f"stated)  sd {spread:5.2f} ({spread / stated:4.2f} stated)  coverage {self.coverage:.3f}"
        )
        if not self.name.startswith("coating"):
            return words
        classes: list[str] = []
        for low, high in pairwise(_CLASSES_UM):
            inside = (self.true >= low) & (self.true < high)
            classes.append(f"{self.error[inside].mean():+5.2f}" if inside.mean() > 0.005 else "    -")
        return f"{words}  by class {' '.join(classes)}"


class Kind(NamedTuple):
    """A kind of specimens: how one is drawn, and which thicknesses are judged."""

    draw: Callable[[np.random.Generator], SpecimenParams]
    names: tuple[str, ...]


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _specimen(rng: np.random.Generator, paper: PaperParams, *, slope: float = 0.4, **scan: Any) -> SpecimenParams:
    wall, coating = _between(rng, 95.0, 120.0), _between(rng, 170.0, 200.0)
    scanner = ScannerParams(**{
        "voxel_um": _between(rng, 2.5, 3.2), "fwhm_um": 4.0, "noise": _between(rng, 0.06, 0.1),
        "noise_px": float(rng.choice([0.0, 2.0])), "fringe": float(rng.choice([0.0, _between(rng, 0.02, 0.12)])),
        "cupping": _between(rng, 0.0, 0.04), "rings": int(rng.integers(0, 4)), "streak": _between(rng, 0.0, 0.03),
        "grey": (40.0, wall, coating), **scan,
    })  # fmt: skip
    warp = Warp(
        slope=_between(rng, 0.0, slope), wavelength_um=_between(rng, 2000.0, 6000.0), tilt_deg=_between(rng, -5.0, 5.0),
        ruling_deg=_between(rng, -90.0, 90.0), phase_rad=_between(rng, 0.0, 6.28),
    )  # fmt: skip
    return SpecimenParams(
        size_um=_SIZE_UM, paper=paper, holes=BurnParams(pattern="irregular", count=3), warp=warp, scanner=scanner,
        seed=int(rng.integers(1 << 30)),
    )  # fmt: skip


def _coated_paper(rng: np.random.Generator, low: float = 8.0, high: float = 17.0) -> PaperParams:
    base = _between(rng, 45.0, 60.0)
    return PaperParams(
        base_um=base, coating_top_um=_between(rng, low, high), coating_bottom_um=_between(rng, low, high),
        coating_sd_um=_between(rng, 3.0, 5.0), roughness_um=_between(rng, 2.5, 4.5), filler=_between(rng, 0.05, 0.15),
        levelling_um=_between(rng, 150.0, 350.0), least_coating_um=_between(rng, 0.3, 1.0),
        fibres=FibreParams(g_per_m2=base * _between(rng, 0.62, 0.75), flexibility=(0.12, 0.2)),
    )  # fmt: skip


def _coated(rng: np.random.Generator) -> SpecimenParams:
    return _specimen(rng, _coated_paper(rng))


def _coarse(rng: np.random.Generator) -> SpecimenParams:
    return _specimen(rng, _coated_paper(rng), fwhm_um=7.0, noise=0.15)


def _on_film(rng: np.random.Generator) -> SpecimenParams:
    film = FilmParams(
        film_um=_between(rng, 15.0, 60.0), gap_um=_between(rng, 15.0, 60.0), grey=_between(rng, 0.5, 1.0),
        share=float(rng.choice([1.0, _between(rng, 0.3, 0.8)])),
    )  # fmt: skip
    return replace(_specimen(rng, _coated_paper(rng)), film=film)


def _on_tape(rng: np.random.Generator) -> SpecimenParams:
    film = FilmParams(film_um=_between(rng, 25.0, 60.0), grey=_between(rng, 0.5, 1.0), is_tape=True)
    return replace(_specimen(rng, _coated_paper(rng)), film=film)


def _calendered(rng: np.random.Generator) -> SpecimenParams:
    base = _between(rng, 40.0, 48.0)
    paper = PaperParams(
        base_um=base, coating_top_um=0.0, coating_bottom_um=0.0, coating_sd_um=0.0, roughness_um=2.0,
        filler=_between(rng, 0.15, 0.3), base_g_per_cm3=1.15,
        fibres=FibreParams(g_per_m2=base * 0.85, fuzz_per_mm2=_between(rng, 2.0, 6.0)),
    )  # fmt: skip
    return _specimen(rng, paper)


def _bulky(rng: np.random.Generator, voxel_um: float) -> SpecimenParams:
    base = _between(rng, 100.0, 125.0)
    paper = PaperParams(
        base_um=base, coating_top_um=0.0, coating_bottom_um=0.0, coating_sd_um=0.0, filler=_between(rng, 0.03, 0.1),
        roughness_um=_between(rng, 5.0, 8.0), base_g_per_cm3=0.7,
        fibres=FibreParams(g_per_m2=base * 0.72, lumen_um=(0.0, 10.0), fuzz_per_mm2=_between(rng, 6.0, 10.0)),
    )  # fmt: skip
    return _specimen(rng, paper, voxel_um=voxel_um)


def _in_resin(rng: np.random.Generator) -> SpecimenParams:
    resin = _between(rng, 100.0, 130.0)
    grey = (resin, resin + _between(rng, 22.0, 30.0), _between(rng, 200.0, 225.0))
    return _specimen(rng, _coated_paper(rng), grey=grey, section_gain=0.03)


def _fringed(rng: np.random.Generator) -> SpecimenParams:
    params = _calendered(rng)
    return replace(params, scanner=replace(params.scanner, fringe=0.5))


_COATED = ("coating_top", "coating_bottom", "thickness")
KINDS: dict[str, Kind] = {
    "coated": Kind(_coated, _COATED),
    "coarse": Kind(_coarse, _COATED),
    "film": Kind(_on_film, _COATED),
    "tape": Kind(_on_tape, _COATED),
    "calendered": Kind(_calendered, ("thickness",)),
    "bulky": Kind(lambda rng: _bulky(rng, 3.0), ("thickness",)),
    "bulky fine": Kind(lambda rng: _bulky(rng, 1.5), ("thickness",)),
    "resin": Kind(_in_resin, _COATED),
    "fringed": Kind(_fringed, ("thickness",)),
}


def main(*arguments: str | int) -> int:
    """Draw, measure and print; 0 in any case: the limits stand in docs/accuracy.md."""
    parser = argparse.ArgumentParser(prog="paper")
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args([str(a) for a in arguments])
    for name in asked.kinds or KINDS:
        for k in range(asked.first, asked.first + asked.count):
            start = time.perf_counter()
            specimen = drawn(name, k)
            try:
                rows = [sized.line() for sized in measured(specimen, KINDS[name].names)]
            except PlanishError as error:
                rows = [f"{type(error).__name__}: {error}"]
            print(f"{name} {k} ({time.perf_counter() - start:.0f} s)", *rows, sep="\n    ", flush=True)
    return 0


def drawn(name: str, number: int) -> Specimen:
    """Draw a specimen of a kind."""
    return make_specimen(KINDS[name].draw(np.random.default_rng([crc32(name.encode()), number])))


def measured(specimen: Specimen, names: tuple[str, ...]) -> list[Sized]:
    """Measure a specimen and compare it with the truth, column by column."""
    surfaces = find_surfaces(specimen.volume)
    properties = measure_properties(surfaces, volume=specimen.volume)
    facts = property_facts(properties)
    true, is_clear = truth(specimen, properties)
    sized: list[Sized] = []
    for name in names:
        values = properties[name].values.astype(np.float64)
        has_value = is_clear & np.isfinite(values) & np.isfinite(true[name])
        stated = facts[name].mean_standard_error if name in facts else None
        sized.append(Sized(
            name=name, true=true[name][has_value], error=(values - true[name])[has_value],
            stated=properties[f"{name}_se"].values[has_value], mean_stated=stated or math.nan,
            coverage=float(has_value.sum() / is_clear.sum()),
        ))  # fmt: skip
    return sized


def truth(specimen: Specimen, columns: xr.Dataset) -> tuple[dict[str, Floats], Bools]:
    """True thicknesses at each column, and which columns are clear of holes."""
    voxel = specimen.params.scanner.voxel_um
    rows, cols = (np.rint(columns[axis].values / voxel).astype(int) for axis in ("y", "x"))
    under, sheet = specimen.columns, specimen.sheet
    u, v = (under[name].values[np.ix_(rows, cols)] for name in ("u", "v"))
    if specimen.params.paper.coating_top_um:
        scan = specimen.params.scanner
        blur, box = scan.fwhm_um / math.sqrt(8.0 * math.log(2.0)) / PITCH_UM, max(round(voxel / PITCH_UM), 1)
        top, inner_top, inner_bottom, bottom = (
            sheet.at(ndimage.uniform_filter(ndimage.gaussian_filter(face, blur), box), u, v) for face in sheet.faces
        )
    else:
        paper = specimen.params.paper
        assert paper.fibres is not None
        bare = replace(specimen.params, paper=replace(paper, fibres=replace(paper.fibres, fuzz_per_mm2=0.0)), film=None)
        structure = make_specimen(bare).sheet.structure
        assert structure is not None
        blur = specimen.params.scanner.fwhm_um
        top, bottom = (sheet.at(structure.face(blur, PITCH_UM, top=side), u, v) for side in (True, False))
        inner_top, inner_bottom = top, bottom
    true = {"coating_top": top - inner_top, "coating_bottom": inner_bottom - bottom, "thickness": top - bottom}
    return true, sheet.at(sheet.rim_um[0], u, v) > _CLEAR_UM


if __name__ == "__main__":
    main()
