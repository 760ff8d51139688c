"""How planish measures paper of fibres and pores: drawn specimens of each kind against their truth.

    python -m benchmarks paper [KIND ...] [--count 10]

The sheets are laid fibre by fibre (``planish.synthetic.fibres``); grades, greys, blur, noise, bends
and what lies beside the sheet are drawn. A coating's truth is the layer itself; the face of a sheet
without one is the outermost place at which the wall under the stated blur reaches half of its own
grey, loose fibres left out. Per specimen: mean error of each thickness and how many of its stated
errors that is; standard deviation of a column's error; rms of error less mean over the stated one,
with its robust twin; coverage. Of a coating also: the mean error in classes of the true one, r with
the image beside that of the true coating at the same columns, and how many of the places below 3 um
are found and how many named so are it. A sheet on film is measured again without it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple
from zlib import crc32

import numpy as np
from scipy import ndimage

from planish.core.errors import PlanishError
from planish.core.typing import Floats
from planish.measure import measure_properties
from planish.run import map_sheet
from planish.run.facts import property_facts
from planish.surface import find_surfaces
from planish.synthetic import (
    BurnParams,
    CameraParams,
    FibreParams,
    FilmParams,
    PaperParams,
    ScannerParams,
    SpecimenParams,
    Warp,
    make_specimen,
)
from planish.synthetic.sheet import PITCH_UM

_CLASSES_UM = (0.0, 3.0, 6.0, 10.0, 15.0, math.inf)
_THIN_UM = 3.0
_CLEAR_UM = 130.0  # from the rim of a hole
_SIZE_UM = (1500.0, 1100.0)


@dataclass(frozen=True, kw_only=True)
class Sized:
    """A thickness of a specimen: its name, errors over the columns that show it, and the share of
    these."""

    name: str
    true: Floats
    error: Floats
    stated: Floats  # standard error of each column
    mean_stated: float
    coverage: float
    image: Floats | None  # reflectance at these columns, where the property shows in it

    @property
    def mean(self):
        """Mean error."""
        return float(self.error.mean())

    @property
    def stated_off(self):
        """Mean error in stated errors of the mean."""
        return abs(self.mean) / self.mean_stated

    @property
    def ratios(self):
        """Rms of (error less its mean) over the stated error, and the same from the median
        deviation."""
        ratio = ((self.error - self.mean) / self.stated)[self.stated > 0]
        return float(np.sqrt(np.mean(ratio**2))), 1.4826 * float(np.median(np.abs(ratio)))

    @property
    def classes(self):
        """Mean error by class of the true value; NaN where fewer than 0.5 % of the columns are."""
        members = [(self.true >= low) & (self.true < high) for low, high in pairwise(_CLASSES_UM)]
        return [float(self.error[m].mean()) if m.mean() > 0.005 else math.nan for m in members]

    @property
    def thin(self):
        """Of the places truly below 3 um the share found, and of those named the share that are
        it."""
        is_thin, is_named = self.true < _THIN_UM, self.true + self.error < _THIN_UM
        if is_thin.mean() < 0.02:
            return None
        both = np.count_nonzero(is_thin & is_named)
        return both / np.count_nonzero(is_thin), both / max(np.count_nonzero(is_named), 1)

    @property
    def r(self):
        """Correlation of the measured and of the true values with the image."""
        if self.image is None:
            return None
        seen = np.isfinite(self.image)
        maps = (self.true + self.error, self.true)
        return tuple(float(np.corrcoef(m[seen], self.image[seen])[0, 1]) for m in maps)

    def line(self):
        """Numbers of a row of the table."""
        rms, robust = self.ratios
        words = [
            f"{self.name:14s} true {self.true.mean():6.2f}  off {self.mean:+6.2f}"
            f" ({self.stated_off:4.1f} stated)  sd {self.error.std():5.2f} ({rms:4.2f} stated,"
            f" {robust:4.2f} robust)  coverage {self.coverage:.3f}"
        ]
        if self.name.startswith("coating"):
            words.append(
                "by class "
                + " ".join(f"{c:+5.2f}" if np.isfinite(c) else "    -" for c in self.classes)
            )
        if self.thin:
            words.append("thin found {:.2f}, right {:.2f}".format(*self.thin))
        if self.r:
            words.append("r {:.3f} (true {:.3f})".format(*self.r))
        return "  ".join(words)


class Kind(NamedTuple):
    """A kind of specimens: how one is drawn, and which thicknesses are judged."""

    draw: Callable[[np.random.Generator], SpecimenParams]
    names: tuple[str, ...]


def _specimen(rng, paper, *, slope=0.4, **scan):
    wall, coating = rng.uniform(95.0, 120.0), rng.uniform(170.0, 200.0)
    scanner = ScannerParams(
        **{
            "voxel_um": rng.uniform(2.5, 3.2),
            "fwhm_um": 4.0,
            "noise": rng.uniform(0.06, 0.1),
            "noise_px": float(rng.choice([0.0, 2.0])),
            "fringe": float(rng.choice([0.0, rng.uniform(0.02, 0.12)])),
            "cupping": rng.uniform(0.0, 0.04),
            "rings": int(rng.integers(0, 4)),
            "streak": rng.uniform(0.0, 0.03),
            "grey": (40.0, wall, coating),
            **scan,
        }
    )
    warp = Warp(
        slope=rng.uniform(0.0, slope),
        wavelength_um=rng.uniform(2000.0, 6000.0),
        tilt_deg=rng.uniform(-5.0, 5.0),
        ruling_deg=rng.uniform(-90.0, 90.0),
        phase_rad=rng.uniform(0.0, 6.28),
    )
    return SpecimenParams(
        size_um=_SIZE_UM,
        paper=paper,
        holes=BurnParams(pattern="irregular", count=3),
        warp=warp,
        scanner=scanner,
        # Most of what the image shows is the coating.
        camera=CameraParams(shading=0.003, nuisance_sd=0.004),
        seed=int(rng.integers(1 << 30)),
    )


def _coated_paper(rng, low=8.0, high=17.0):
    base = rng.uniform(45.0, 60.0)
    return PaperParams(
        base_um=base,
        coating_top_um=rng.uniform(low, high),
        coating_bottom_um=rng.uniform(low, high),
        coating_sd_um=rng.uniform(3.0, 5.0),
        roughness_um=rng.uniform(2.5, 4.5),
        filler=rng.uniform(0.05, 0.15),
        levelling_um=rng.uniform(150.0, 350.0),
        least_coating_um=rng.uniform(0.3, 1.0),
        fibres=FibreParams(g_per_m2=base * rng.uniform(0.62, 0.75), flexibility=(0.12, 0.2)),
    )


def _coated(rng):
    return _specimen(rng, _coated_paper(rng))


def _coarse(rng):
    return _specimen(rng, _coated_paper(rng), fwhm_um=7.0, noise=0.15)


def _on_film(rng):
    film = FilmParams(
        film_um=rng.uniform(15.0, 60.0),
        gap_um=rng.uniform(15.0, 60.0),
        grey=rng.uniform(0.5, 1.0),
        share=float(rng.choice([1.0, rng.uniform(0.3, 0.8)])),
    )
    return replace(_specimen(rng, _coated_paper(rng)), film=film)


def _on_tape(rng):
    film = FilmParams(film_um=rng.uniform(25.0, 60.0), grey=rng.uniform(0.5, 1.0), is_tape=True)
    return replace(_specimen(rng, _coated_paper(rng)), film=film)


def _uncoated(base, **more):
    return PaperParams(
        base_um=base, coating_top_um=0.0, coating_bottom_um=0.0, coating_sd_um=0.0, **more
    )


def _calendered(rng):
    base = rng.uniform(40.0, 48.0)
    filler = rng.uniform(0.15, 0.3)
    fibres = FibreParams(g_per_m2=base * 0.85, fuzz_per_mm2=rng.uniform(2.0, 6.0))
    return _specimen(
        rng, _uncoated(base, roughness_um=2.0, filler=filler, base_g_per_cm3=1.15, fibres=fibres)
    )


def _bulky(rng, voxel_um):
    base = rng.uniform(100.0, 125.0)
    filler, roughness_um = rng.uniform(0.03, 0.1), rng.uniform(5.0, 8.0)
    fibres = FibreParams(
        g_per_m2=base * 0.72, lumen_um=(0.0, 10.0), fuzz_per_mm2=rng.uniform(6.0, 10.0)
    )
    paper = _uncoated(
        base, filler=filler, roughness_um=roughness_um, base_g_per_cm3=0.7, fibres=fibres
    )
    return _specimen(rng, paper, voxel_um=voxel_um)


def _in_resin(rng):
    resin = rng.uniform(100.0, 130.0)
    grey = (resin, resin + rng.uniform(22.0, 30.0), rng.uniform(200.0, 225.0))
    return _specimen(rng, _coated_paper(rng), grey=grey, section_gain=0.03)


def _fringed(rng):
    params = _calendered(rng)
    return replace(params, scanner=replace(params.scanner, fringe=0.5))


_COATED = ("coating_top", "coating_bottom", "thickness")
KINDS = {
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


def main(*arguments):
    """Draw, measure and print, and sum up each kind; 0 in any case: the limits stand in
    docs/accuracy.md."""
    parser = argparse.ArgumentParser(prog="paper")
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--count", type=int, default=10)
    asked = parser.parse_args([str(a) for a in arguments])
    for name in asked.kinds or KINDS:
        all_sized = []
        for k in range(asked.count):
            specimen = drawn(name, k)
            try:
                surfaces, sized = measured(specimen, KINDS[name].names)
                rows = [s.line() for s in sized]
                if film := specimen.params.film:
                    rows += (
                        _named(specimen)
                        if film.is_tape
                        else _beside_none(specimen, surfaces, sized)
                    )
                all_sized += sized
            except PlanishError as error:
                rows = [f"{type(error).__name__}: {error}"]
            print(f"{name} {k}", *rows, sep="\n    ", flush=True)
        for words in _summed_up(all_sized):
            print(f"  {name}: {words}", flush=True)
    return 0


def _named(specimen):
    """What the check says of a tape that touches the sheet."""
    said = [c for c in map_sheet(specimen.volume).results.checks if c.name == "film"]
    return [f"film: {check.state}: {check.sentence}" for check in said] or ["film: no check"]


def _beside_none(specimen, surfaces, sized):
    """Compare a sheet on film with the same one without: medians of what differs, and coverages."""
    alone = make_specimen(replace(specimen.params, film=None))
    other, others = measured(alone, tuple(s.name for s in sized))
    rows = []
    for face in ("top", "bottom"):
        # The volumes begin at different heights below the sheet, and each has noise of its own.
        here = surfaces[face].values - specimen.warp.shift_um[2]
        there = other[face].values - alone.warp.shift_um[2]
        apart = (here - there)[np.isfinite(here) & np.isfinite(there)]
        rows.append(
            f"{face:14s} beside none: median {np.median(apart):+.2f}, of the size"
            f" {np.median(np.abs(apart)):.2f} um"
        )
    for one, two in zip(sized, others, strict=True):
        share = one.coverage / two.coverage
        rows.append(
            f"{one.name:14s} beside none: mean {one.mean - two.mean:+.2f} um, coverage {share:.3f}"
        )
    return rows


def _summed_up(all_sized):
    """One line a thickness over all specimens of a kind."""
    rows = []
    for name in dict.fromkeys(s.name for s in all_sized):
        sized = [s for s in all_sized if s.name == name]
        means, sds = np.array([s.mean for s in sized]), [float(s.error.std()) for s in sized]
        ratios, within = [s.ratios[0] for s in sized], np.mean([s.stated_off <= 2.0 for s in sized])
        words = (
            f"{name:14s} {len(sized)} specimens: off {means.mean():+.2f} ({means.min():+.2f} to"
            f" {means.max():+.2f}), within 2 stated errors {within:.0%}; sd {np.median(sds):.2f}"
            f" (to {max(sds):.2f}); true over stated {np.median(ratios):.2f} ({min(ratios):.2f} to"
            f" {max(ratios):.2f}); coverage from {min(s.coverage for s in sized):.3f}"
        )
        if name.startswith("coating"):
            classes = np.array([s.classes for s in sized])
            pooled = [float(np.nanmean(c)) if np.isfinite(c).any() else math.nan for c in classes.T]
            words += "; by class " + " ".join(f"{c:+.2f}" for c in pooled)
        thin = np.array([s.thin for s in sized if s.thin])
        if len(thin):
            words += (
                f"; thin ({len(thin)}) found {thin[:, 0].mean():.2f}, right {thin[:, 1].mean():.2f}"
            )
        r = np.array([s.r for s in sized if s.r])
        if len(r):
            words += f"; r off by at most {np.abs(r[:, 0] - r[:, 1]).max():.3f}"
        rows.append(words)
    return rows


def drawn(name, number):
    """Draw a specimen of a kind."""
    return make_specimen(KINDS[name].draw(np.random.default_rng([crc32(name.encode()), number])))


def measured(specimen, names):
    """Measure a specimen, and compare it with the truth column by column."""
    surfaces = find_surfaces(specimen.volume)
    properties = measure_properties(surfaces, volume=specimen.volume)
    facts = property_facts(properties)
    true, is_clear = truth(specimen, properties)
    image = _image_at(specimen, properties)
    sized = []
    for name in names:
        if f"{name}_se" not in properties:  # a tape hides the coating below it
            continue
        values = properties[name].values.astype(np.float64)
        has_value = is_clear & np.isfinite(values) & np.isfinite(true[name])
        stated = facts[name].mean_standard_error if name in facts else None
        sized.append(
            Sized(
                name=name,
                true=true[name][has_value],
                error=(values - true[name])[has_value],
                stated=properties[f"{name}_se"].values[has_value],
                mean_stated=stated or math.nan,
                coverage=float(has_value.sum() / is_clear.sum()),
                image=image[has_value] if name == "coating_top" else None,
            )
        )
    return surfaces, sized


def _image_at(specimen, columns):
    """Reflectance of the top side at the true place of each column; NaN outside of the image."""
    u, v = _uv(specimen, columns)
    at, image = specimen.pose(np.stack([u, v], axis=-1)), specimen.image
    return ndimage.map_coordinates(
        image.values.astype(np.float64),
        [at[..., 1] / float(image.y[1]), at[..., 0] / float(image.x[1])],
        order=1,
        cval=math.nan,
    )


def _uv(specimen, columns):
    voxel = specimen.params.scanner.voxel_um
    rows, cols = (np.rint(columns[axis].values / voxel).astype(int) for axis in ("y", "x"))
    u, v = (specimen.columns[name].values[np.ix_(rows, cols)] for name in ("u", "v"))
    return u, v


def truth(specimen, columns):
    """True thicknesses at each column, and which columns are clear of holes."""
    voxel = specimen.params.scanner.voxel_um
    sheet = specimen.sheet
    u, v = _uv(specimen, columns)
    if specimen.params.paper.coating_top_um:
        scan = specimen.params.scanner
        blur, box = (
            scan.fwhm_um / math.sqrt(8.0 * math.log(2.0)) / PITCH_UM,
            max(round(voxel / PITCH_UM), 1),
        )
        top, inner_top, inner_bottom, bottom = (
            sheet.at(ndimage.uniform_filter(ndimage.gaussian_filter(face, blur), box), u, v)
            for face in sheet.faces
        )
    else:
        paper = specimen.params.paper
        bare = replace(
            specimen.params,
            paper=replace(paper, fibres=replace(paper.fibres, fuzz_per_mm2=0.0)),
            film=None,
        )
        structure = make_specimen(bare).sheet.structure
        blur = specimen.params.scanner.fwhm_um
        top, bottom = (
            sheet.at(structure.face(blur, PITCH_UM, top=side), u, v) for side in (True, False)
        )
        inner_top, inner_bottom = top, bottom
    true = {
        "coating_top": top - inner_top,
        "coating_bottom": inner_bottom - bottom,
        "thickness": top - bottom,
    }
    return true, sheet.at(sheet.rim_um[0], u, v) > _CLEAR_UM
