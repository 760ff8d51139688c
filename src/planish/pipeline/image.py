"""From a sheet's maps to an image: all properties on the image's own pixels, and their correlation."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import correlate, correlate_at
from planish.compute import Compute
from planish.core.grid import Grid, pitch
from planish.gates import link_gates, map_gates
from planish.io import read_image
from planish.marks import HoleParams, find_holes, find_sheet_holes, hole_mask
from planish.marks.files import LayerFacts, read_pairs
from planish.measure import PROPERTIES, further_maps
from planish.pipeline.grid import agreement, headline_of
from planish.pipeline.holes import at_flat, in_flat
from planish.pipeline.marking import Plane, check_enough, join_found, join_given, read_design
from planish.pipeline.orientation import orientation_results
from planish.pipeline.refinement import refine_link
from planish.pipeline.run import Array, Progress, Run, silent
from planish.pipeline.sheet import map_sheet, uv
from planish.register import Chain, FittedTransform, fit_transform
from planish.register.models import MODELS
from planish.resample import expected_error, find_places, image_attrs, resample, resample_maps
from planish.results import input_results, linked_results, mark_results, marks_table, parameter_results
from planish.study import Study

ROWS = ("projection, no scale", "projection, similarity", "flattened, similarity")


def link_sheet(
    study: Study, *, progress: Progress | None = None, compute: Compute | None = None, kept: Path | None = None,
    sheet: Run | None = None,
) -> Run:  # fmt: skip
    """Go from a volume and an image to maps on the image's own pixels, and their correlation.

    Parameters
    ----------
    study, progress, compute, kept
        As for :func:`planish.pipeline.map_sheet`.
    sheet : Run, optional
        The volume's maps, where it was mapped before.
    """
    tell = progress or silent
    assert study.image is not None
    # The image first: it is quick, and a missing pixel size should not cost the time of the volume.
    tell("read", Path(study.image.path).name)
    image = read_image(
        Path(study.image.path),
        pixel_um=study.image.pixel_um,
        channel=study.image.channel,
        override_size=study.image.override_size,
    )
    pixel = (float(image.attrs["pixel_um"][0]), float(image.attrs["pixel_um"][1]))
    r = study.registration
    read_design(r.design)  # what is wrong with it should not cost the time of the volume either
    tell("marks", "holes of the image")
    given = read_pairs(r.marks, fixed=LayerFacts(pixel, shape=image.shape)) if r.marks else None
    found = None if given is not None else find_holes(image.values, pixel_um=pixel, diameter_um=r.hole_um)
    fixed = Plane(name="image", holes=found, side=study.image.side, md_deg=study.image.md_deg)
    check_enough(fixed, r.hole_um)
    run = sheet or map_sheet(study, progress=progress, compute=compute, kept=kept)
    maps, surfaces, flat = run.groups["maps"], run.groups["surfaces"], run.groups["flat"]
    holes = None
    if given is None:
        tell("register", "holes of the sheet")
        holes = find_sheet_holes(maps, params=HoleParams(hole_um=r.hole_um), side=fixed.faces)
    else:
        tell("register", f"{given.sizes['mark']} pairs from {Path(r.marks or '').name}")
    moving = Plane(name="volume", holes=holes, sheet=True, md_deg=study.volume.md_deg)
    if given is None:
        joined = join_found(moving, fixed, r, read_design(r.design))
    else:
        joined = join_given(given, in_flat(given, flat, surfaces), moving, fixed, r)
    fit = joined.fit
    projected_um = at_flat(maps, ("projected_u", "projected_v"), fit.moving)
    tell("link", f"{image.shape[0]} x {image.shape[1]} pixels")
    radii = 0.5 * joined.blocked_diameter_um + study.surface.rim_um
    grid = Grid.of(image)
    away = ~hole_mask(grid, joined.blocked_um, radii)
    linked = _linked(surfaces, flat, Chain(fits=(fit,)), image, grid, away)
    headline = headline_of(linked, fixed.faces)
    tell("correlate", headline)
    # Least squares of all marks, as in the paper: marks that do not fit are what shows that a way is wrong.
    kinds: tuple[tuple[str, tuple[str, str], Array, str], ...] = (
        (ROWS[0], ("projected_u", "projected_v"), projected_um, "rigid"),
        (ROWS[1], ("projected_u", "projected_v"), projected_um, "similarity"),
        (ROWS[2], ("u", "v"), fit.moving, "similarity"),
    )
    table: list[dict[str, Any]] = []
    for name, names, marks, model in kinds if fit.model != "similarity" else kinds[:2]:
        way = fit_transform(marks, fit.fixed, model=model, mirrored=fit.mirrored, robust=False)
        table += _table_rows(
            name, surfaces, flat, names, way, image, pixel, away, headline, study.correlate.point_um
        )  # fmt: skip
    correlation = _correlations(linked, pixel, study.correlate.point_um)
    # The run's own way: the numbers that stand everywhere else, too.
    own = {"registration": f"flattened, {MODELS[fit.model].words}", "property": headline, "marks_rms_um": fit.rms_um}
    table += [own | row for row in correlation if row["property"] == headline]
    study = run.study.model_copy(
        update={
            "image": study.image.model_copy(update={"pixel_um": pixel}),
            "registration": r,
            "correlate": study.correlate,
        }
    )
    assert study.image is not None
    # What judges the whole comes at the end, also where the sheet was judged alone before.
    results = {k: v for k, v in run.results.items() if k not in ("quality", "parameters")}
    seen = input_results(image, Path(study.image.path), pixel_um=list(pixel))
    results["inputs"] = results["inputs"] | {"image": seen}
    results["marks"] = joined.seen | mark_results(fit, linked)
    results["orientation"] = orientation_results(moving, fixed, fit)
    results["headline"] = headline
    results["table"] = table
    results["correlation"] = correlation
    results["lag"] = agreement(
        linked[headline].values, linked["image"].values, linked["valid"].values, pixel,
        linked["expected_error"].values, headline,
    )  # fmt: skip
    results["linked"] = linked_results(linked, away)
    groups = run.groups | {"linked": linked}
    if r.refine is not None:
        tell("refine", r.refine)
        way, results["refinement"] = refine_link(linked, headline, grid, fit, r.refine)
        # Beside the marks' own: nothing that the page correlates has been fitted to what it is correlated with.
        groups["refined"] = resample_maps(surfaces, flat, onto=grid, transform=way)
    gates = (*map_gates(results), *link_gates(results))
    results["quality"] = [asdict(gate) for gate in gates]
    results["parameters"] = parameter_results(study)
    return Run(study=study, groups=groups, marks=marks_table(joined.labels, fit), results=results, gates=gates)


def _linked(
    surfaces: xr.Dataset, flat: xr.Dataset, way: Chain, image: xr.DataArray, grid: Grid, away: NDArray[np.bool_]
) -> xr.Dataset:
    """All maps and the image on the image's pixels."""
    linked = resample_maps(surfaces, flat, onto=grid, transform=way)
    linked["image"] = (("y", "x"), image.values, image_attrs(image))
    valid = np.isfinite(linked["thickness"].values) & np.isfinite(image.values) & away
    linked["valid"] = (("y", "x"), valid, {"long_name": "Measured, and away from holes and their rims"})
    linked["expected_error"] = expected_error(way, grid, linked["u"].values)
    return linked


def _table_rows(
    name: str, surfaces: xr.Dataset, flat: xr.Dataset, names: tuple[str, str], fit: FittedTransform,
    image: xr.DataArray, pixel: tuple[float, float], away: NDArray[np.bool_], headline: str, point_um: float,
) -> list[dict[str, Any]]:  # fmt: skip
    """Correlation of the headline property with one way of bringing it to the image."""
    places = find_places(
        fit.transform(uv(flat, names)), Grid.regular((int(image.shape[0]), int(image.shape[1])), pixel),
        least_um=min(pitch(surfaces)),
    )  # fmt: skip
    prop = np.where(away, resample(surfaces[headline].values, places), np.nan)
    brightness = np.asarray(image.values, dtype=np.float64)
    rows = [correlate(prop, brightness, point_um=float(np.sqrt(pixel[0] * pixel[1])))]
    rows.append(correlate_at(prop, brightness, pixel_um=pixel, point_um=point_um)[0])
    return [{"registration": name, "property": headline, "marks_rms_um": fit.rms_um, **row.to_dict()} for row in rows]


def _correlations(linked: xr.Dataset, pixel: tuple[float, float], point_um: float) -> list[dict[str, Any]]:
    valid = linked["valid"].values
    brightness = linked["image"].values.astype(np.float64)
    out: list[dict[str, Any]] = []
    angles = {str(k) for k, v in linked.data_vars.items() if v.attrs.get("units") == "deg"}
    further = [k for k in further_maps(linked) if not k.endswith("_se") and k not in angles]
    for name in (*PROPERTIES, *further):
        values = np.where(valid, linked[name].values.astype(np.float64), np.nan)
        if not np.isfinite(values).any():
            continue
        pairs = (
            correlate(values, brightness, point_um=float(np.sqrt(pixel[0] * pixel[1]))),
            correlate_at(values, brightness, pixel_um=pixel, point_um=point_um)[0],
        )
        out += [{"property": name, **pair.to_dict()} for pair in pairs]
    return out
