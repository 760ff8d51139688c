"""Make synthetic specimens for the studies, with known answers.

The papers and instruments are the same as in the paper.

Each function gives the specimens of one study by name: parameters, and the instruments that look at
them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import tifffile

from planish.synthetic import (
    FIBRE_CT,
    MICRO_CT,
    PRESETS,
    SIZES_UM,
    BurnParams,
    CameraParams,
    PrintParams,
    SectionsParams,
    Specimen,
    SpecimenParams,
    Warp,
    make_specimen,
    vignette,
    write_image,
    write_instruments,
)

Size = Literal["small", "full"]
Instruments = Literal["stack", "print", "two volumes"]

DIFFUSE = CameraParams(shading=0.003)
"""The microscope with diffuse light; the usual one of planish's specimens has light from one side,
too."""

WHITE_GREY, WHITE_NOISE = 62_000.0, 0.01
"""Picture of a white sheet: grey in the middle, and noise as a share of it."""

LIGHT_VARIES = 0.05
"""Standard deviation of Fisher's z between sheets that the images are made with."""


ARTEFACTS = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {
                "name": "web",
                "reason": "an example: nothing is wrong here",
                "author": "planish",
            },
            "geometry": {
                "type": "Polygon",
                "coordinates": [[[500, 400], [800, 400], [800, 600], [500, 600], [500, 400]]],
            },
        }
    ],
}
"""A region that does not count, in um of the reference: GeoJSON."""


@dataclass(frozen=True, kw_only=True)
class Made:
    """One specimen and what is written of it."""

    name: str
    params: SpecimenParams
    instruments: Instruments = "stack"


def base(
    paper: str, seed: int, size: Size, full_um: tuple[float, float], voxel_um: float = 6.0
) -> SpecimenParams:
    """A paper in diffuse light.

    Small: 1.5 x 1.1 mm with seven holes, for a first look and for tests.
    """
    if size == "small":
        camera, scanner = (
            replace(DIFFUSE, pixel_um=6.0),
            replace(MICRO_CT, voxel_um=8.0, noise_px=0.7),
        )
        field_um, holes = (1500.0, 1100.0), BurnParams(pattern="irregular", count=7)
    else:
        camera, scanner, field_um, holes = (
            DIFFUSE,
            replace(MICRO_CT, voxel_um=voxel_um),
            full_um,
            BurnParams(),
        )
    return SpecimenParams(
        size_um=field_um,
        paper=PRESETS[paper][1].as_slab(),
        holes=holes,
        camera=camera,
        scanner=scanner,
        seed=seed,
    )


def fig_06(size: Size) -> list[Made]:
    """One field of a lightly coated paper, finely scanned."""
    return [Made(name="field", params=base("wfc90", 6, size, SIZES_UM["T1"], voxel_um=3.0))]


def fig_07(size: Size) -> list[Made]:
    """Make three sheets, each before and after calendering.

    Fibres, holes and bend are the same, the surface is another.
    """
    found: list[Made] = []
    for sheet, shift in (("1", -1.0), ("2", 0.0), ("3", 1.0)):
        for state, paper, r2 in (
            ("uncalendered", "wfc135", 0.26),
            ("calendered", "wfc135-calendered", 0.21),
        ):
            params = base(paper, 70 + int(sheet), size, SIZES_UM["T2"])
            # So much else in the image that the true maps have the r² of the paper, higher and
            # lower by the sheet.
            target = (r2**0.5 + shift * LIGHT_VARIES * (1 - r2)) ** 2
            camera = replace(params.camera, oracle_r2=round(target, 4))
            found.append(Made(name=f"sheet-{sheet}-{state}", params=replace(params, camera=camera)))
    return found


def fig_09(size: Size) -> list[Made]:
    """Make one field of an offset print, lighter where the coating is thicker.

    It is 40 % black at 60 lines per cm.
    """
    params = base("wfc118", 9, size, (5000.0, 4000.0))
    if size == "small":  # around holes, 310 um are left out where a screen was taken off
        params = replace(
            params, size_um=(2300.0, 1700.0), holes=BurnParams(pattern="irregular", count=5)
        )
    camera = replace(DIFFUSE, screen=PrintParams(gain_sd=0.04))
    return [Made(name="print", params=replace(params, camera=camera), instruments="print")]


def fig_11(size: Size) -> list[Made]:
    """One field, first scanned, then cut and photographed."""
    params = base("wfc90", 11, size, (1800.0, 1300.0), voxel_um=3.0)
    sections = (
        SectionsParams(pixel_um=4.0, section_um=8.0)
        if size == "small"
        else SectionsParams(pixel_um=1.62)
    )
    params = replace(params, sections=sections, holes=BurnParams(pattern="irregular", count=7))
    return [Made(name="field", params=params, instruments="two volumes")]


def flattening(size: Size) -> list[Made]:
    """Make three bent sheets, or one at the small size.

    They are bent so much that they are some 250 um longer than their projection.
    """
    found: list[Made] = []
    for sheet in ("1", "2", "3") if size == "full" else ("1",):
        params = base("wfc118", 190 + int(sheet), size, SIZES_UM["T1"])
        warp = Warp(
            slope=0.7,
            wavelength_um=2600.0,
            phase_rad=0.6 + 2.0 * int(sheet),
            ruling_deg=20.0 + 40 * int(sheet),
        )
        found.append(Made(name=f"sheet-{sheet}", params=replace(params, warp=warp)))
    return found


def no_holes(size: Size) -> list[Made]:
    """Make three sheets of fibres, or two at the small size, each with holes and without.

    Fibres, bend and camera are the same with and without.
    """
    found: list[Made] = []
    for sheet in ("1", "2", "3") if size == "full" else ("1", "2"):
        params = base("wfc135", 200 + int(sheet), size, SIZES_UM["T1"], voxel_um=3.0)
        scanner, size_um = replace(params.scanner, grey=FIBRE_CT.grey), params.size_um
        if size == "small":  # on less than this, too few tiles show by themselves where they lie
            scanner, size_um = replace(scanner, voxel_um=5.0), (1800.0, 1400.0)
        # Both are turned by the same angle: another one would draw another sheet, and share no
        # pixels with this one.
        camera = replace(params.camera, turn_range_deg=180.0)
        params = replace(
            params, size_um=size_um, paper=PRESETS["wfc135"][1], scanner=scanner, camera=camera
        )
        bare = replace(params, holes=replace(params.holes, pattern="irregular", count=0))
        found += [
            Made(name=f"sheet-{sheet}-with-holes", params=params),
            Made(name=f"sheet-{sheet}-no-holes", params=bare),
        ]
    return found


STUDIES: dict[str, Callable[[Size], list[Made]]] = {
    "fig-06": fig_06,
    "fig-07": fig_07,
    "fig-09": fig_09,
    "fig-11": fig_11,
    "flattening": flattening,
    "no-holes": no_holes,
}
"""Studies that have specimens of their own."""


def write_truth(specimen: Specimen, folder: Path) -> None:
    """Write the true coating on the pixels of the image, and the share of the light of each."""
    folder.mkdir()
    light = vignette(specimen.image_shape, specimen.params.camera.vignetting)
    tifffile.imwrite(folder / "light.tif", light)
    coating = specimen.truth["coating_top"].values.astype(np.float32)
    tifffile.imwrite(folder / "coating_top.tif", coating)


def write_white(specimen: Specimen, path: Path) -> None:
    """Write the picture of a white sheet under the same lens; without light the grey is 0."""
    light = vignette(specimen.image_shape, specimen.params.camera.vignetting)
    noise = np.random.default_rng([specimen.params.seed, 0]).standard_normal(light.shape)
    grey = WHITE_GREY * light * (1.0 + WHITE_NOISE * noise)
    tifffile.imwrite(path, np.clip(np.rint(grey), 0, 65535).astype(np.uint16))


def make(study: str, size: Size, folder: Path) -> None:
    """Write the specimens of a study that are not there yet, each into a folder of its own."""
    if study == "fig-11":
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "artefacts.geojson").write_text(json.dumps(ARTEFACTS, indent=2), encoding="utf-8")
    for one in STUDIES[study](size):
        place = folder / one.name
        if place.exists():
            continue
        specimen = make_specimen(one.params)
        unready = place.with_name(f"{one.name}-unready")
        write_instruments(
            specimen,
            unready,
            image=one.instruments == "stack",
            volume=("scanner" if one.instruments == "two volumes" else "stack"),
        )
        if one.instruments == "two volumes":
            write_instruments(specimen, unready, volume="sections", image=False)
        if one.instruments == "print":
            write_image(specimen, unready / "printed.tif", printed=True)
        if study == "fig-07":
            write_white(specimen, unready / "white.tif")
        write_truth(specimen, unready / "truth")
        unready.rename(place)
