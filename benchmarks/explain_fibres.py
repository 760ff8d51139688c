"""Whether known weights of coating and base surface come back from scans and images of fibre paper.

``python -m benchmarks explain_fibres [SPECIMENS [FIRST]]``

Sheets are laid fibre by fibre and scanned; the image is drawn from the true coating, the true
surface of the base and a texture of its own, with known weights, and linked by its holes. Then the
image is explained by coating, base surface and the thickness of the bottom coating, which has no
part in it. Both weights have to lie within two stated errors in 19 of 20, and a coefficient other
than 0 may be named for the bottom coating in 1 of 20 at most. 1 where more are missed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import planish as pl
from benchmarks.hole_scenes import gauss
from benchmarks.paper import KINDS
from planish.measure.form import above_form
from planish.synthetic import BurnParams, make_specimen

_SIZE_UM, _HOLES, _RIM_UM = (2400.0, 1800.0), 6, 60.0
_GREY, _PER_UM, _TEXTURE = 2000.0, {"coating_top": 25.0, "base_surface_top": 20.0}, 60.0
_FORM_UM = 800.0  # of a run with the usual cut-off


def base_surface(specimen):
    """Height of the true interface above its form, on the image's pixels."""
    truth, sheet = specimen.truth, specimen.sheet
    pixel = specimen.params.camera.pixel_um
    face, interface = (
        sheet.at(field, truth["u"].values, truth["v"].values) for field in sheet.faces[:2]
    )
    is_known = np.isfinite(truth["coating_top"].values)
    heights = above_form(
        {"top": face, "interface_top": interface},
        np.zeros(face.shape),
        is_known,
        (pixel, pixel),
        names=("base_surface_top",),
        nesting_um=_FORM_UM,
    )
    return heights["base_surface_top"]


def drawn_run(number):
    """A run of one specimen whose image has known weights."""
    rng = np.random.default_rng([number, 54])
    params = KINDS["coated"].draw(rng)
    holes = BurnParams(pattern="irregular", count=_HOLES)
    specimen = make_specimen(replace(params, size_um=_SIZE_UM, holes=holes))
    truth, pixel = specimen.truth, specimen.params.camera.pixel_um
    weights = {name: per_um * rng.uniform(0.5, 1.5) for name, per_um in _PER_UM.items()}
    texture = gauss(rng, truth["rim"].shape, rng.uniform(30.0, 80.0), pixel, 1.0)
    maps = {"coating_top": truth["coating_top"].values, "base_surface_top": base_surface(specimen)}
    is_paper = truth["rim"].values > _RIM_UM
    drawn = _GREY + _TEXTURE * texture
    for name, weight in weights.items():
        values = maps[name]
        drawn = drawn + weight * (values - np.nanmean(values[is_paper]))
    seen = specimen.image.values.astype(np.float64)
    is_drawn = is_paper & np.isfinite(drawn)
    seen = seen * (_GREY / np.median(seen[is_paper]))
    image = np.where(is_drawn, drawn, seen)
    volume = pl.volume(specimen.volume.values, voxel_um=specimen.params.scanner.voxel_um)
    run = pl.link(
        volume, pl.image(image.astype(np.float32), pixel_um=pixel), through="z", image_side="top"
    )
    return run, weights


def main(specimens=10, first=0):
    """Print weights, coefficients and their errors; 1 where too many are missed."""
    missed = named = count = 0
    for number in range(first, first + specimens):
        run, weights = drawn_run(number)
        model = pl.explain(
            run, response="image", of=[*weights, "coating_bottom"], cell_um=100.0, corrected=True
        )
        words = []
        for name, weight in weights.items():
            c = model.coefficients[name]
            error = c.plain / c.standardised * c.standard_error
            off = (c.plain - weight) / error
            missed += abs(off) > 2
            count += 1
            words.append(f"{name} {c.plain:.1f} ± {error:.1f} (drawn {weight:.1f}, {off:+.1f})")
        bottom = model.coefficients["coating_bottom"]
        named += bottom.direction != 0
        print(
            f"{number}: {', '.join(words)}; coating_bottom {bottom.standardised:+.2f}"
            f" {'named' if bottom.direction else 'not named'}; R2 {model.r2:.2f}, {model.n_eff:.0f}"
            f" of {model.n} cells",
            flush=True,
        )
    print(
        f"{missed} of {count} weights beyond two stated errors; a map without effect named in"
        f" {named} of {specimens}"
    )
    return int(missed > max(count / 20, 1) or named > max(specimens / 20, 1))
