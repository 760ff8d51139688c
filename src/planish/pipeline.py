"""The whole line, from files to linked maps; the only place where stages meet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish import __version__
from planish.analyze import correlate, correlate_at
from planish.compute import Compute, by_name, column_step, engine, run_key
from planish.core.errors import CannotRegister, InputError, MarkError, PlanishError, ResourceError, VolumeError
from planish.core.frame import Frame
from planish.flatten import Flattened, FlattenParams, flatten_sheet
from planish.io import find_place, fingerprint, read_image, read_volume
from planish.io.run_folder import new_folder, refuse_existing, work_folder, write_json, write_tree
from planish.io.sections import is_section_folder, read_section_stack
from planish.marks import find_holes, write_marks
from planish.marks.files import read_pairs
from planish.measure import PROPERTIES, measure_properties
from planish.properties import further_maps, further_results, measure_more, number_results, with_angles
from planish.register import FittedTransform, Model, Transform, fit_transform, match_marks
from planish.report import write_report
from planish.resample import covering_grid, find_places, resample, resample_dataset
from planish.results import (
    Gate,
    flatten_results,
    input_results,
    link_gates,
    linked_results,
    map_gates,
    mark_results,
    marks_table,
    parameter_results,
    property_results,
    section_results,
    surface_results,
)
from planish.sections import align_sections, find_band, fixed_places, normalise_sections, regular_volume
from planish.study import Study, VolumeSection, write_study
from planish.surface import SurfaceParams, find_surfaces, surfaces_from_labels

Array = NDArray[np.float64]
Progress = Callable[[str, str], None]

_THICKNESS_UM = (2.0, 5000.0)  # from a thin tissue to a thick board, with room on both sides
_LEAST_SHARE = 0.15  # of the columns: with less there is no map
_SLICES = 3


def _silent(_stage: str, _detail: str) -> None:
    """Say nothing: what a program that calls a run wants unless it asks."""


MODEL_WORDS = {
    "rigid": "rigid", "similarity": "similarity", "affine": "affine", "projective": "projective", "tps": "spline"
}  # fmt: skip
ROWS = ("projection, no scale", "projection, similarity", "flattened, similarity")


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """All that a run gives.

    Attributes
    ----------
    study : Study
        The parameters, resolved.
    groups : dict of Dataset
        ``surfaces`` and ``flat`` (y, x), ``strain`` (row, col), ``maps`` (v, u), ``slices``, and after a link
        ``linked`` (y, x of the image).
    marks : Dataset (mark) or None
    results : dict
        Numbers only, ready for JSON.
    gates : tuple of Gate
    """

    study: Study
    groups: dict[str, xr.Dataset]
    marks: xr.Dataset | None
    results: dict[str, Any]
    gates: tuple[Gate, ...]

    @property
    def passed(self) -> bool:
        """Whether every quality gate was passed."""
        return all(gate.passed for gate in self.gates)


def run_study(study: Study, out: Path, *, progress: Progress | None = None, compute: Compute | None = None) -> Run:
    """Do what a study says and write the run folder ``out``.

    A run that was killed goes on where it stood when it is started again.

    Raises
    ------
    PlanishError
        Any of the tree in :mod:`planish.core.errors`; nothing is left at ``out`` then.
    """
    refuse_existing(out)
    tell = progress or _silent
    key = run_key(study.model_dump(mode="json"), _fingerprints(study))
    with work_folder(out, key) as work:
        how: dict[str, Any] = {"progress": tell, "compute": compute, "kept": work / "tiles"}
        run = link_sheet(study, **how) if study.image is not None else map_sheet(study, **how)
        tell("write", str(out))
        with new_folder(out, inside=work) as folder:
            save_run(run, folder, home=out)
    return run


def _fingerprints(study: Study) -> list[str]:
    """Hashes of the inputs; whatever is wrong with them is said by their own readers."""
    paths = [study.volume.path, *([study.image.path] if study.image is not None else [])]
    found: list[str] = []
    for path in paths:
        try:
            found.append(fingerprint(Path(path)))
        except PlanishError:
            found.append("")
    return found


def save_run(run: Run, folder: Path, *, home: Path) -> None:
    """Write all files of a run into ``folder``, which will stand at ``home``."""
    marks = {} if run.marks is None else {"marks": run.marks}
    write_tree(folder / "maps.zarr", run.groups | marks)
    if run.marks is not None:
        write_marks(run.marks, folder / "marks.csv")
    write_json(folder / "results.json", run.results)
    write_study(run.study, folder, home=home, version=__version__)
    write_report(folder / "report.html", groups=run.groups, marks=run.marks, results=run.results)


def map_sheet(
    study: Study, *, progress: Progress | None = None, compute: Compute | None = None, kept: Path | None = None
) -> Run:
    """Go from a volume to flattened maps of its properties.

    Parameters
    ----------
    study : Study
    progress : callable, optional
        Called with the name of a stage and a few words.
    compute : Compute, optional
        What the run may use.
    kept : Path, optional
        Folder for the results of single tiles, where a run that was killed finds them again.
    """
    tell = progress or _silent
    tell("read", find_place(study.volume.path).path.name)
    compute = compute or Compute()
    volume, sections = _volume(study.volume, compute, tell)
    voxel = tuple(float(v) for v in volume.attrs["voxel_um"])
    frame = Frame(through=study.volume.through, top=study.volume.top)
    step = column_step(volume, frame, study.volume.column_um, compute)
    if step > 1 and study.surface.labels is not None:
        raise InputError(
            f"The labels of {step} x {step} voxels have no mean: labels need columns of one voxel, and more memory "
            "(--memory), or a cropped volume."
        )
    wide = f", columns of {step} x {step}" if step > 1 else ""
    tell("surface", " x ".join(map(str, volume.shape)) + " voxels" + wide)
    s = study.surface
    params = SurfaceParams(
        sheet_grey=s.sheet_grey, seed_um=s.seed_um, coating_grey=s.coating_grey, fringe=s.fringe,
        envelope_um=s.envelope_um, method=s.method, cutoff_um=s.cutoff_um, rim_um=s.rim_um, step=step,
    )  # fmt: skip
    with engine(compute, kept=None if kept is None else kept / str(step)) as tiles:
        if s.labels is None:
            surfaces = find_surfaces(volume, frame=frame, params=params, engine=tiles)
        else:
            meaning = s.labels.model_dump()
            surfaces = surfaces_from_labels(volume, frame=frame, meaning=meaning, params=params, engine=tiles)
    _check_thickness(surfaces)
    tell("measure", f"{surfaces.sizes['y'] * surfaces.sizes['x']} columns")
    found, properties = surfaces, measure_properties(surfaces)
    surfaces = surfaces.drop_vars("status").merge(properties, combine_attrs="override")
    if s.labels is None:
        further = measure_more(volume, surfaces, study.properties, compute, tell).drop_vars("status")
        surfaces = surfaces.merge(further, compat="override", combine_attrs="override")
    elif study.properties.maps:
        raise InputError("Further maps are measured in grey values; a volume of labels has none. Leave --property out.")
    numbers = number_results(volume, surfaces, study.properties)
    tell("flatten", "eight-spring mesh")
    f = study.flatten
    # A column whose normal meets no face still has its place in the sheet.
    flattened = flatten_sheet(found, params=FlattenParams(mesh_um=f.mesh_um, method=f.method, rest=f.rest))
    pitch = _pitch(surfaces)
    # Where single columns of voxels were measured without being asked for, nothing has to be repeated.
    column_um = study.volume.column_um or (float(np.sqrt(pitch[0] * pitch[1])) if step > 1 else None)
    map_um = study.flatten.map_um or float(np.sqrt(pitch[0] * pitch[1]))
    tell("resample", f"{map_um:.3g} um pixels")
    study = study.model_copy(
        update={
            "volume": study.volume.model_copy(update={"voxel_um": voxel, "column_um": column_um}),
            "flatten": study.flatten.model_copy(update={"mesh_um": flattened.mesh_um, "map_um": map_um}),
        }
    )
    maps = _flat_maps(surfaces, flattened, map_um)
    groups = {
        "surfaces": surfaces,
        "flat": flattened.flat,
        "strain": flattened.strain,
        "maps": maps,
        "slices": _slices(volume, frame, step),
    }
    results: dict[str, Any] = {
        "planish": __version__,
        "versions": {name: version(name) for name in ("numpy", "scipy", "numba", "xarray", "zarr", "tifffile")},
        "inputs": {"volume": input_results(volume, Path(study.volume.path), voxel_um=list(voxel))},
        "surfaces": surface_results(surfaces),
        "properties": property_results(surfaces),
        "further": further_results(surfaces),
        "numbers": numbers,
        "flatten": flatten_results(flattened),
    }
    if sections is not None:
        groups["sections"] = sections
        results["sections"] = section_results(sections)
    gates = map_gates(results)
    results["quality"] = [asdict(gate) for gate in gates]
    results["parameters"] = parameter_results(study)
    return Run(study=study, groups=groups, marks=None, results=results, gates=gates)


def _volume(section: VolumeSection, compute: Compute, tell: Progress) -> tuple[xr.DataArray, xr.Dataset | None]:
    """Read a volume; serial sections are aligned and joined, and come with what was done to each of them."""
    path = find_place(section.path).path
    size: dict[str, Any] = {
        "voxel_um": section.voxel_um,
        "channel": section.channel,
        "override_size": section.override_size,
    }
    if is_section_folder(path):
        if compute.scheduler is not None:
            raise InputError(f"{path.name} holds sections, which --scheduler cannot work on. Import them first.")
        volume, sections = join_sections(section, compute, tell)
        _in_parts(volume, path, compute, f" --through {section.through}")
        return volume, sections
    if section.fixed_rows is not None or section.fixed_cols is not None:
        raise InputError(f"--fixed-rows and --fixed-cols are for serial sections; {path.name} is a volume.")
    how: dict[str, Any] = size | {"memory_limit_bytes": compute.volume_bytes}
    volume = read_volume(section.path, **how)
    _in_parts(volume, path, compute)
    return (volume if compute.scheduler is None else by_name(volume, section.path, how)), None


def read_whole(section: VolumeSection, compute: Compute, tell: Progress) -> xr.DataArray:
    """Read a volume, or join serial sections to one, of any size: what does not fit into memory is worked out in parts.

    What was done to sections is in the attributes, in short.
    """
    if not is_section_folder(section.path):
        return read_volume(
            section.path, voxel_um=section.voxel_um, channel=section.channel, override_size=section.override_size,
            memory_limit_bytes=compute.volume_bytes,
        )  # fmt: skip
    volume, sections = join_sections(section, compute, tell)
    return volume.assign_attrs(sections=section_results(sections))


def _in_parts(volume: xr.DataArray, path: Path, compute: Compute, options: str = "") -> None:
    """Refuse a volume that is neither in memory nor can be read in parts."""
    if volume.encoding.get("whole_slices"):
        raise ResourceError(
            f"{path.name} has {volume.size * volume.dtype.itemsize / 1e9:.1f} GB, of the memory "
            f"{compute.volume_bytes / 1e9:.1f} GB may hold a volume, and its slices can only be decoded whole. Bring "
            f"it into a store first: planish import {path.name}{options} --out {path.stem}.zarr"
        )


def join_sections(section: VolumeSection, compute: Compute, tell: Progress) -> tuple[xr.DataArray, xr.Dataset]:
    """Align serial sections and join them to a volume; return it with what was done to each section.

    Raises
    ------
    VolumeError
        If the axis through the sheet is not given, or the sections do not fit together.
    """
    path = Path(section.path)
    if section.through == "z":
        raise VolumeError(
            f"{path.name} holds sections, which show the sheet edge on: its normal cannot run from section to section. "
            "Give --through y where it runs along the rows of the photographs, x where along their columns."
        )
    stack = read_section_stack(
        path, voxel_um=section.voxel_um, channel=section.channel, override_size=section.override_size,
        # The photographs and the volume made from them are in memory at the same time.
        memory_limit_bytes=compute.volume_bytes // 2,
    )  # fmt: skip
    tell("align", f"{len(stack.values)} sections")
    where = (stack.values, stack.positions_um, stack.pixel_um)
    band = find_band(stack.values, np.abs(stack.positions_um - stack.positions_um[0]), stack.pixel_um)
    fixed = None
    if section.fixed_rows is not None or section.fixed_cols is not None:
        fixed = fixed_places(stack.values, stack.pixel_um, rows=section.fixed_rows, cols=section.fixed_cols)
    found = align_sections(*where, band=band, fixed=fixed)
    gains = normalise_sections(*where, band=band)
    volume = regular_volume(*where, alignment=found, gains=gains, attrs=stack.attrs)
    um = {"units": "um"}
    first = float(volume.attrs["first_position_um"])
    sections = xr.Dataset(
        {
            "position": ("section", stack.positions_um - first, um | {"long_name": "Place along the volume"}),
            "shift_row": ("section", found.shift_um[:, 0], um | {"long_name": "Shift taken off, rows"}),
            "shift_col": ("section", found.shift_um[:, 1], um | {"long_name": "Shift taken off, columns"}),
            "rotation": ("section", found.rotation_rad, {"units": "rad", "long_name": "Rotation taken off"}),
            "aligned": ("section", found.aligned, {"long_name": "Aligned; others count as missing"}),
            "gain": ("section", gains.gain, {"units": "1", "long_name": "Gain put on the grey"}),
        },
        attrs={
            "kind": stack.kind,
            "first_position_um": first,
            "cutoff_um": found.cutoff_um,
            "missing": int(volume.attrs["sections_missing"]),
            "jitter_left_um": [float(v) for v in found.jitter_left_um],
            "pairs_used": found.pairs_used,
            "pairs_refused": found.pairs_refused,
            "fixed": [name for name, held in zip(("row", "col", "rotation"), found.fixed, strict=True) if held],
        },
    )
    return volume, sections


def link_sheet(
    study: Study, *, progress: Progress | None = None, compute: Compute | None = None, kept: Path | None = None
) -> Run:
    """Go from a volume and an image to maps on the image's own pixels, and their correlation."""
    tell = progress or _silent
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
    tell("marks", "holes of the image")
    given = read_pairs(r.marks, fixed_um=pixel, fixed_shape=image.shape) if r.marks else None
    fixed = None if given is not None else find_holes(image.values, pixel_um=pixel, diameter_um=r.hole_um)
    if fixed is not None:
        _enough(fixed, "image", r.hole_um)
    run = map_sheet(study, progress=progress, compute=compute, kept=kept)
    tell(
        "register",
        "holes of the sheet" if given is None else f"{given.sizes['mark']} pairs from {Path(r.marks or '').name}",
    )
    maps, surfaces, flat = run.groups["maps"], run.groups["surfaces"], run.groups["flat"]
    seen: dict[str, Any] = {"source": "file" if given is not None else "found"}
    if given is None:
        assert fixed is not None
        moving = _holes_of_map(maps, r.hole_um)
        _enough(moving, "volume", r.hole_um)
        a, b = (np.stack([d["x"].values, d["y"].values], axis=1) for d in (moving, fixed))
        matched = match_marks(
            a,
            b,
            scale_tolerance=r.scale_tolerance,
            tolerance_um=r.tolerance_um,
            mirror=r.mirror,
            names=("volume", "image"),
        )
        pairs, mirrored = matched.pairs, matched.mirrored
        moving_um, fixed_um = a[pairs[:, 0]], b[pairs[:, 1]]
        diameters = np.maximum(moving["diameter"].values[pairs[:, 0]], fixed["diameter"].values[pairs[:, 1]])
        labels = [f"hole {k + 1}" for k in range(len(pairs))]
        # Every hole is kept out of the correlation, also one that has no partner.
        spare = [k for k in range(len(b)) if k not in set(pairs[:, 1].tolist())]
        blocked = np.concatenate([fixed_um, b[spare]])
        blocked_d = np.concatenate([diameters, fixed["diameter"].values[spare]])
        seen |= {"found_volume": len(a), "found_image": len(b), "sentence": matched.sentence,
                 "rival_inliers": matched.rival_inliers}  # fmt: skip
    else:
        moving_um, fixed_um, mirrored = _given_pairs(given, flat, surfaces, mirror=r.mirror)
        labels = [str(v) for v in given["label"].values]
        blocked, blocked_d = fixed_um, np.full(len(fixed_um), float(np.mean(r.hole_um)))
    fit = fit_transform(moving_um, fixed_um, model=r.model, mirrored=mirrored, lowest="similarity")
    projected_um = _at_flat(maps, ("projected_u", "projected_v"), moving_um)
    scale_off = abs(fit.transform.scale - 1)
    if scale_off > r.scale_tolerance:
        raise CannotRegister(
            f"The marks ask for a scale of {fit.transform.scale:.4f}, which is {100 * scale_off:.1f} % off "
            f"the calibration; "
            f"{100 * r.scale_tolerance:.0f} % are allowed. Check --voxel-um and --pixel-um, and the marks."
        )
    tell("link", f"{image.shape[0]} x {image.shape[1]} pixels")
    shape = (int(image.shape[0]), int(image.shape[1]))
    away = _outside(shape, pixel, blocked, 0.5 * blocked_d + study.surface.rim_um)
    linked = _linked(surfaces, flat, fit.transform, image, pixel, away)
    linked["expected_error"] = _expected_error(fit, linked)
    headline = "coating_top" if np.isfinite(linked["coating_top"]).any() else "thickness"
    tell("correlate", headline)
    # Least squares of all marks, as in the paper: marks that do not fit are what shows that a way is wrong.
    kinds: tuple[tuple[str, tuple[str, str], Array, Model], ...] = (
        (ROWS[0], ("projected_u", "projected_v"), projected_um, "rigid"),
        (ROWS[1], ("projected_u", "projected_v"), projected_um, "similarity"),
        (ROWS[2], ("u", "v"), moving_um, "similarity"),
    )
    ways: list[tuple[str, tuple[str, str], FittedTransform]] = [
        (name, uv, fit_transform(marks, fixed_um, model=model, mirrored=mirrored, robust=False))
        for name, uv, marks, model in kinds
    ]
    if fit.model != "similarity":
        ways.append((f"flattened, {MODEL_WORDS[fit.model]}", ("u", "v"), fit))
    table = [
        row
        for name, uv, way in ways
        for row in _table_rows(
            name, surfaces, flat, uv, way, image, pixel, away, headline, study.correlate.point_um
        )
    ]  # fmt: skip
    study = run.study.model_copy(
        update={"image": study.image.model_copy(update={"pixel_um": pixel}), "registration": r}
    )
    results = run.results
    results["inputs"]["image"] = (
        input_results(image, Path(study.image.path), pixel_um=list(pixel)) if study.image else None
    )
    results["marks"] = seen | mark_results(fit, linked)
    results["headline"] = headline
    results["table"] = table
    results["correlation"] = _correlations(linked, pixel, study.correlate.point_um)
    results["linked"] = linked_results(linked, away)
    gates = (*map_gates(results), *link_gates(results))
    results["quality"] = [asdict(gate) for gate in gates]
    results["parameters"] = parameter_results(study)
    groups = run.groups | {"linked": linked}
    return Run(
        study=study, groups=groups, marks=marks_table(labels, moving_um, fixed_um, fit), results=results, gates=gates
    )


def _enough(holes: xr.Dataset, where: str, hole_um: tuple[float, float]) -> None:
    """Stop early when there cannot be a match."""
    count = holes.sizes["mark"]
    if count < 3:
        what = (
            "No hole was"
            if count == 0
            else f"Only {count} hole{'s' if count > 1 else ''} {'were' if count > 1 else 'was'}"
        )
        at = "".join(f" ({x:.0f}, {y:.0f}) um" for x, y in zip(holes["x"].values, holes["y"].values, strict=True))
        raise CannotRegister(
            f"{what} found in the {where}{' at' + at if at else ''}; at least 3 are needed, and 4 to "
            f"notice a wrong match. Looked "
            f"for round holes of {hole_um[0]:g} to {hole_um[1]:g} um (--hole-um). Check the "
            f"{'pixel' if where == 'image' else 'voxel'}"
            " size, or give pairs of points with --marks."
        )


def _check_thickness(surfaces: xr.Dataset) -> None:
    thickness = float(surfaces.attrs["thickness_um"])
    low, high = _THICKNESS_UM
    if not low <= thickness <= high:
        voxel = ", ".join(f"{v:g}" for v in surfaces.attrs["voxel_um"])
        raise VolumeError(
            f"The sheet would be {thickness:.3g} um thick; paper and board have {low:g} to {high:g} um. "
            f"The voxel size of "
            f"{voxel} um (z, y, x) is probably in another unit. Give the right one with --voxel-um and --override-size."
        )
    measured = float((surfaces["status"].values == 0).mean())
    if measured < _LEAST_SHARE:
        raise VolumeError(
            f"Both faces of the sheet were found in {100 * measured:.1f} % of the columns only; "
            f"{100 * _LEAST_SHARE:.0f} % are "
            "needed for a map. Check --through and --sheet-grey, and that the sheet does not leave the volume."
        )


def _pitch(data: xr.Dataset) -> tuple[float, float]:
    y, x = data["y"].values, data["x"].values
    return float(y[1] - y[0]), float(x[1] - x[0])


def _uv(flat: xr.Dataset, names: tuple[str, str] = ("u", "v")) -> Array:
    return np.stack([flat[n].values for n in names], axis=-1)


def _on_mesh(surfaces: xr.Dataset, flat: xr.Dataset) -> xr.Dataset:
    """Variables that travel to maps: properties, where in the volume, and where in the projection."""
    frame = Frame.of(surfaces)
    lateral = {frame.rows: surfaces["y"].values[:, None], frame.cols: surfaces["x"].values[None, :]}
    shape = surfaces["centre"].shape
    data = surfaces[[*PROPERTIES, *further_maps(surfaces)]].assign(
        {k: flat[k] for k in ("u", "v", "projected_u", "projected_v")}
    )
    for axis in "xyz":
        values = surfaces["centre"].values if axis == frame.through else np.broadcast_to(lateral[axis], shape)
        values = np.where(np.isfinite(flat["u"].values), values, np.nan)
        title = f"Centre surface, {axis} in the volume"
        data[f"volume_{axis}"] = (("y", "x"), values, {"units": "um", "long_name": title})
    return data


def _single(data: xr.Dataset) -> xr.Dataset:
    """Properties in single precision, as they are stored; geometry stays double."""
    names = (*PROPERTIES, *further_maps(data), "presence")
    return data.assign({k: data[k].astype(np.float32) for k in names if k in data})


def _flat_maps(surfaces: xr.Dataset, flattened: Flattened, map_um: float) -> xr.Dataset:
    uv = _uv(flattened.flat)
    shape, origin = covering_grid(uv, map_um)
    places = find_places(uv, shape=shape, pixel_um=(map_um, map_um), origin_um=origin, least_um=min(_pitch(surfaces)))
    coords = {"v": origin[1] + map_um * np.arange(shape[0]), "u": origin[0] + map_um * np.arange(shape[1])}
    source = _on_mesh(surfaces, flattened.flat).drop_vars(["u", "v"])
    source["presence"] = surfaces["presence"]
    maps = with_angles(resample_dataset(source, places, dims=("v", "u"), coords=coords))
    maps["valid"] = (("v", "u"), np.isfinite(maps["thickness"].values), {"long_name": "Measured"})
    maps.attrs = {"overlaps": places.overlaps}
    return _single(maps)


def _holes_of_map(maps: xr.Dataset, hole_um: tuple[float, float]) -> xr.Dataset:
    """Holes of the flattened sheet, in (u, v)."""
    step = float(maps["u"].values[1] - maps["u"].values[0])
    holes = find_holes(maps["presence"].values, pixel_um=step, diameter_um=hole_um, polarity="dark")
    return holes.assign(x=holes["x"] + float(maps["u"].values[0]), y=holes["y"] + float(maps["v"].values[0]))


def _given_pairs(
    given: xr.Dataset, flat: xr.Dataset, surfaces: xr.Dataset, *, mirror: bool
) -> tuple[Array, Array, bool]:
    """Pairs from a table: in the flat map as they are, in the volume by the column they lie in."""
    fixed = np.stack([given["fixed_x"].values, given["fixed_y"].values], axis=1)
    if "moving_x" in given:
        moving = np.stack([given["moving_x"].values, given["moving_y"].values], axis=1)
    else:
        frame = Frame.of(surfaces)
        row = (given[f"volume_{frame.rows}"].values - surfaces["y"].values[0]) / _pitch(surfaces)[0]
        col = (given[f"volume_{frame.cols}"].values - surfaces["x"].values[0]) / _pitch(surfaces)[1]
        moving = np.stack([_bilinear(flat[k].values, row, col) for k in ("u", "v")], axis=1)
        lost = [str(n) for n, p in zip(given["label"].values, moving, strict=True) if not np.isfinite(p).all()]
        if lost:
            raise MarkError(
                f"The marks {', '.join(lost)} do not lie on the sheet. Check the axes and the unit (um) of the table."
            )
    if len(fixed) < 3:
        raise MarkError(
            f"{len(fixed)} control points given, a similarity needs 3 to say how good it is. Add more, far apart."
        )
    return moving, fixed, fit_transform(moving, fixed, mirrored=None if mirror else False).mirrored


def _bilinear(field: Array, row: Array, col: Array) -> Array:
    """Value of a field at fractional rows and columns; NaN outside."""
    rows, cols = field.shape
    inside = (row >= 0) & (row <= rows - 1) & (col >= 0) & (col <= cols - 1)
    i = np.clip(np.floor(np.where(inside, row, 0)).astype(int), 0, rows - 2)
    j = np.clip(np.floor(np.where(inside, col, 0)).astype(int), 0, cols - 2)
    fr, fc = row - i, col - j
    value = (field[i, j] * (1 - fc) + field[i, j + 1] * fc) * (1 - fr)
    value += (field[i + 1, j] * (1 - fc) + field[i + 1, j + 1] * fc) * fr
    return np.where(inside, value, np.nan)


def _at_flat(maps: xr.Dataset, names: tuple[str, str], points: Array) -> Array:
    """Values of two maps at points (n, 2) of the flat sheet."""
    u, v = maps["u"].values, maps["v"].values
    row, col = (points[:, 1] - v[0]) / (v[1] - v[0]), (points[:, 0] - u[0]) / (u[1] - u[0])
    found = np.stack([_bilinear(maps[n].values, row, col) for n in names], axis=1)
    if not np.isfinite(found).all():
        raise MarkError("A mark lies outside the flattened sheet. Remove it from the table of marks.")
    return found


def _outside(shape: tuple[int, int], pixel: tuple[float, float], centres: Array, radii: Array) -> NDArray[np.bool_]:
    """Pixels that are away from every hole and its rim."""
    away = np.ones(shape, dtype=bool)
    for (x, y), radius in zip(centres, radii, strict=True):
        i0, i1 = max(int((y - radius) / pixel[0]), 0), min(int((y + radius) / pixel[0]) + 2, shape[0])
        j0, j1 = max(int((x - radius) / pixel[1]), 0), min(int((x + radius) / pixel[1]) + 2, shape[1])
        if i1 <= i0 or j1 <= j0:
            continue
        dy = np.arange(i0, i1)[:, None] * pixel[0] - y
        dx = np.arange(j0, j1)[None, :] * pixel[1] - x
        away[i0:i1, j0:j1] &= np.hypot(dx, dy) > radius
    return away


def _linked(
    surfaces: xr.Dataset, flat: xr.Dataset, transform: Transform, image: xr.DataArray, pixel: tuple[float, float],
    away: NDArray[np.bool_],
) -> xr.Dataset:  # fmt: skip
    """All maps on the image's pixel grid, in one step from the mesh: nothing is resampled twice."""
    shape = (int(image.shape[0]), int(image.shape[1]))
    scale = transform.scale
    places = find_places(transform(_uv(flat)), shape=shape, pixel_um=pixel, least_um=min(_pitch(surfaces)) * scale)
    coords = {"y": image["y"].values, "x": image["x"].values}
    source = _on_mesh(surfaces, flat).drop_vars(["projected_u", "projected_v"])
    linked = with_angles(resample_dataset(source, places, dims=("y", "x"), coords=coords))
    attrs = {"long_name": str(image.attrs.get("long_name", "Image")), "units": "1"}
    linked["image"] = (("y", "x"), image.values, attrs)
    valid = np.isfinite(linked["thickness"].values) & np.isfinite(image.values) & away
    linked["valid"] = (("y", "x"), valid, {"long_name": "Measured, and away from holes and their rims"})
    return _single(linked)


def _expected_error(fit: FittedTransform, linked: xr.Dataset) -> xr.DataArray:
    """How far each pixel that shows the sheet may be off, in um of the image.

    It varies over millimetres: it is worked out on a lattice of at most some 200 x 200 places and interpolated between.
    """
    at = [np.linspace(v[0], v[-1], min(v.size, 200)) for v in (linked["y"].values, linked["x"].values)]
    places = np.stack(np.meshgrid(at[1], at[0]), axis=-1)
    coarse = xr.DataArray(fit.expected_error_um(fit.inverse(places)), dims=("y", "x"), coords={"y": at[0], "x": at[1]})
    fine = coarse.interp(y=linked["y"], x=linked["x"]).values
    shown = np.where(np.isfinite(linked["u"].values), fine, np.nan).astype(np.float32)
    return xr.DataArray(shown, dims=("y", "x"), attrs={"long_name": "Expected error of the place, rms", "units": "um"})


def _table_rows(
    name: str, surfaces: xr.Dataset, flat: xr.Dataset, uv: tuple[str, str], fit: FittedTransform, image: xr.DataArray,
    pixel: tuple[float, float], away: NDArray[np.bool_], headline: str, point_um: float,
) -> list[dict[str, Any]]:  # fmt: skip
    """Correlation of the headline property with one way of bringing it to the image."""
    places = find_places(
        fit.transform(_uv(flat, uv)), shape=(int(image.shape[0]), int(image.shape[1])), pixel_um=pixel,
        least_um=min(_pitch(surfaces)),
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


def _slices(volume: xr.DataArray, frame: Frame, step: int) -> xr.Dataset:
    """A few slices through the sheet, to draw its surfaces on; ``row`` is the row of columns that each lies in."""
    rows = volume.sizes[frame.rows] // step * step
    at = np.unique(np.linspace(0, rows - 1, _SLICES + 2).astype(int)[1:-1])
    parts = [frame.columns(volume.isel({frame.rows: slice(k, k + 1)}).load()).values[0] for k in at]
    values = np.stack([np.ascontiguousarray(part.T) for part in parts])
    coords = {
        "slice": volume.coords[frame.rows].values[at],
        "height": volume.coords[frame.through].values,
        "x": volume.coords[frame.cols].values,
    }
    data = xr.Dataset(
        {"grey": (("slice", "height", "x"), values, {"long_name": "Grey value", "units": "1"})},
        coords={k: ((k,), v, {"units": "um"}) for k, v in coords.items()},
        attrs=frame.attrs(),
    )
    return data.assign(row=("slice", at // step))
