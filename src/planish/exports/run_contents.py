"""Give what an export takes from a run.

Groups of maps, the straightened volume, registrations and history.
"""

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import tomli_w
import xarray as xr

from planish import __version__
from planish.core.bands import thinned
from planish.core.errors import FileError, InputError
from planish.core.grid import Grid
from planish.core.text import likely
from planish.core.transform import Affine, Similarity
from planish.core.typing import Pair, pair_of
from planish.exports.content import ExportHistory
from planish.exports.transforms import DirectedTransform, TransformPair
from planish.io import VolumeParams, find_place, fingerprint
from planish.io.map_store import map_folder, overviews_of
from planish.marks.exchange import LayerPixels
from planish.measure import straightened
from planish.report.colours import Scale, colours_of, partner_of
from planish.resample import image_attrs, resample_image
from planish.results import LayerFacts
from planish.run.compute import Compute, Progress
from planish.run.run import MAPS, Run, open_run
from planish.run.study import RUN_TOML, GivenLayer, read_study, to_dict
from planish.run.volume import read_sheet_volume

IMAGE = "image"
"""Name of the image on the flat sheet among the maps, and of the image itself among linked maps."""

STRAIGHTENED = "straightened"
"""The group that is worked out: the volume along the normals."""


def history_of(run: Run) -> ExportHistory:
    """Versions, study and inputs of a run."""
    if run.folder is not None:
        study_bytes = (run.folder / RUN_TOML).read_bytes()
    else:
        # As run.toml would have it if the run had been saved.
        study = {"planish": run.results.planish} | to_dict(run.study)
        study_bytes = tomli_w.dumps(study).encode()
    inputs = [
        {"layer": layer.name, "name": layer.source.name, "sha256": layer.source.sha256}
        for layer in run.results.layers
    ]
    return ExportHistory(
        planish=run.results.planish,
        exported_by=__version__,
        study_sha256=hashlib.sha256(study_bytes).hexdigest(),
        inputs=tuple(inputs),
    )


def map_group(run: Run, name: str | None) -> str:
    """Choose the group of maps: as named, or the linked maps, or those of the sheet.

    InputError where the run has no such group, or, without a name, the maps of several layers.
    """
    usual = ("linked", "maps", "refined", "surfaces", "flat")
    map_groups = [group for group in usual if group in run.groups]
    map_groups += [group for group in run.groups if re.fullmatch("layers/[^/]*", group)]
    group = name or next(filter(map_groups.__contains__, usual[:2]), None)
    if group is None:
        raise InputError(
            "The run holds the maps of several layers. Choose one with `group`:"
            f" {', '.join(map_groups)}."
        )
    if group not in map_groups:
        suggestion = likely(group, [*map_groups, STRAIGHTENED])
        raise InputError(
            f"The run has no group {group!r}; it holds {', '.join(map_groups)}.{suggestion}"
        )
    return group


def map_names(run: Run, group: str, requested: Sequence[str]) -> list[str]:
    """Choose the maps of a group: all where none is named, and the image on the flat sheet."""
    variables = run.groups[group].data_vars
    names = [str(name) for name in variables if variables[name].ndim == 2]
    if group == "maps" and "linked" in run.groups and len(run.results.moving) == 1:
        names.append(IMAGE)
    return checked_names(requested, names, f"group {group}") or names


def maps_of(run: Run, group: str, names: Sequence[str]) -> xr.Dataset:
    """Give the maps of a group in the order of ``names``.

    Among those of a sheet may be the image, which is brought onto the flat sheet here.
    """
    maps = run.groups[group]
    # Means over areas where the image is finer, placed by the registration.
    if IMAGE in names and IMAGE not in maps:
        image = run.groups["linked"][IMAGE].compute()
        # resample_image carries a moving layer over to a fixed one, by the inverse of their fit.
        # Here the image is the fixed layer: turned around, that inverse is the fit itself.
        (sheet,) = run.results.moving
        reversed_fit = SimpleNamespace(inverse=run.registrations[sheet.name].fit)
        image = image.assign_attrs(pixel_um=Grid.of(image).pixel_um)
        resampled = resample_image(image, Grid.of(maps), reversed_fit)
        grey = resampled[IMAGE].values.astype(np.float32)
        attrs = image_attrs(image) | {"long_name": "Grey value of the image"}
        maps = maps.assign({IMAGE: (("v", "u"), grey, attrs)})
    return maps[list(names)]


def map_levels(store: Path | None, group: str, name: str) -> list[Path]:
    """Folders of a map and its overviews in the store of a run, the finest first.

    Empty where it is not stored, as of a run in memory, which has no ``store``.
    """
    if store is None:
        return []
    groups = (group, *overviews_of(store, group))
    folders = (map_folder(store, level_group, name) for level_group in groups)
    return [*filter(None, folders)]


def scale_of(maps: xr.Dataset, name: str) -> Scale:
    """Give limits and colours of a map, those of the page: both sides of the sheet share theirs.

    Those of an image are of its valid pixels, where ``maps`` say which these are.
    """
    pooled = [name]
    other_side = partner_of(name, [str(key) for key in maps.data_vars])
    if other_side is not None:
        pooled.append(other_side)
    # The holes of an image would take most of the colours.
    is_masked = name == IMAGE and "valid" in maps
    if is_masked:
        pooled.append("valid")
    _, samples = thinned(*(maps[key] for key in pooled))  # every n-th pixel of each, in memory
    if is_masked:
        grey, valid = samples
        samples = [np.where(valid, grey, np.nan)]
    finite = [sample[np.isfinite(sample)] for sample in samples]
    limit_values = np.concatenate(finite).astype(np.float64)
    return colours_of(maps[name].rename(name), limit_values)


def sheet_facts(run: Run) -> LayerFacts | None:
    """The layer whose surfaces a run holds; None where it holds none."""
    if "surfaces" not in run.groups:
        return None
    return next((layer for layer in run.results.layers if layer.sheet is not None), None)


def straightened_volume(
    run: Run, depth_um: Pair | None, compute: Compute, progress: Progress
) -> xr.DataArray:
    """Volume along the normals on the flat maps' pixels.

    InputError without a sheet, FileError if the file is gone.
    """
    facts = sheet_facts(run)
    if facts is None or "maps" not in run.groups:
        raise InputError(
            "The straightened volume needs the surfaces of one sheet, and this run holds none. Give"
            " the run of the volume itself, in layers/NAME where several were linked."
        )
    volume, _ = read_sheet_volume(volume_params(run, facts, progress), compute, progress)
    volume_coords = run.groups["maps"][[f"volume_{axis}" for axis in "xyz"]]
    params = _mapped_layer(run, facts.name).properties
    surfaces = run.groups["surfaces"]
    straightened_grey = straightened(
        volume, surfaces, volume_coords, params=params, depth_um=depth_um
    )
    return straightened_grey.assign_attrs(
        group=STRAIGHTENED,
        file_name=facts.source.name,
        normal="z, up to the top",
        flat="y is v, x is u",
    )


def volume_params(run: Run, facts: LayerFacts, progress: Progress) -> VolumeParams:
    """Give the place of the sheet's volume, and how it is read.

    FileError where it is gone, or another one is there.
    """
    params = _mapped_layer(run, facts.name).volume
    assert params is not None
    path = find_place(params.path).path
    if not path.exists():
        raise FileError(
            f"The volume {facts.source.name} of this run is needed, and {path} is not there. Put it"
            " back, or write where it is now into run.toml, under [layers.volume], as path."
        )
    progress("read", facts.source.name)
    if fingerprint(params.path) != facts.source.sha256:
        raise FileError(
            f"{path} is another file than the one that was mapped: its SHA-256 is not that in"
            " results.json. Put the volume of this run there."
        )
    return params


def sheet_run(run: Run, name: str) -> Run | None:
    """Open the run that holds the surfaces of a sheet.

    It is this one, one in ``layers/NAME``, or a given one; None where none of them is there.
    """
    facts = sheet_facts(run)
    if facts is not None and facts.name == name:
        return run
    folders: list[Path] = []
    if run.folder is not None:
        folders.append(run.folder / "layers" / name)
    given_runs = [layer.run for layer in run.study.layers if layer.name == name and layer.run]
    folders += map(Path, given_runs)
    for folder in folders:
        if (folder / MAPS / "zarr.json").is_file():
            other = open_run(folder)
            if sheet_facts(other) is not None:
                return other
    return None


def _mapped_layer(run: Run, name: str) -> GivenLayer:
    """A layer of the study with its volume; of a layer that is a run, that of the run's study."""
    layer = next(layer for layer in run.study.layers if layer.name == name)
    if layer.run is None:
        return layer
    path = Path(layer.run) / RUN_TOML
    if not path.is_file():
        raise FileError(
            f"The volume of this run stands in the run {layer.run}, which is not there. Put it"
            " back."
        )
    return next(layer for layer in read_study(path).layers if layer.volume is not None)


def registered_layers(run: Run, group: str | None) -> list[LayerFacts]:
    """Choose the moving layers with a registration: all, or the one of a name.

    ``group``: NAME or layers/NAME; None or linked for all. InputError where there is none.
    """
    moving = list(run.results.moving)
    if not moving:
        raise InputError(
            "The run is that of one sheet: nothing is registered. Give a run of 'planish link'."
        )
    names = [layer.name for layer in moving]
    moving_name = None
    if group is not None and group != "linked":
        moving_name = group.removeprefix("layers/")
    if moving_name is not None and moving_name not in names:
        raise InputError(
            f"No layer {moving_name!r} is registered; there are"
            f" {', '.join(names)}.{likely(moving_name, names)}"
        )
    return [layer for layer in moving if moving_name in (None, layer.name)]


def transforms_of(run: Run, layer: LayerFacts) -> TransformPair:
    """Give a moving layer's registration in both directions, with the pixels of both layers.

    Where the pixels of a layer are not known, a grid around its marks stands for them. The affine
    map is all of a similarity or affine fit, and of others the part that is closest at the middle
    of the marks.
    """
    assert layer.registration is not None
    target = layer.registration.to
    fit = run.registrations[layer.name].fit
    transform = fit.transform
    # The point of the moving layer around which the affine map turns: the middle of the marks,
    # and the origin of a similarity, which has none of its own.
    centre = np.zeros(2)
    if not isinstance(transform, Similarity):
        centre = np.array(transform.source)
    (a, b), (c, d) = transform.matrix().tolist()
    source_um = pair_of(centre)
    target_um = pair_of(transform(centre))
    affine = Affine(linear=((a, b), (c, d)), source=source_um, target=target_um)
    is_affine = isinstance(transform, Similarity | Affine)
    moving = grid_of(run, layer.name) or _grid_around(fit.moving)
    fixed = grid_of(run, target) or _grid_around(fit.fixed)
    forward = DirectedTransform(layer.name, target, fit, moving, affine, is_affine)
    back = DirectedTransform(target, layer.name, fit.inverse, fixed, affine.inverse, is_affine)
    return TransformPair(forward, back, fit.model)


def landmarks(run: Run, layer: LayerFacts) -> xr.Dataset:
    """Give the marks of a moving layer with the first pixels of both layers in their attributes.

    Other programs count from the middles of these pixels.
    """
    assert layer.registration is not None
    marks = run.registrations[layer.name].marks
    layers = {side: dict(layer_attrs) for side, layer_attrs in marks.attrs["layers"].items()}
    names = {"moving": layer.name, "fixed": layer.registration.to}
    for side, name in names.items():
        grid = grid_of(run, name)
        if grid is not None:
            layers[side] |= LayerPixels(origin_um=grid.origin_um).about()
    return marks.assign_attrs(layers=layers)


def grid_of(run: Run, name: str) -> Grid | None:
    """Pixels of a layer: of an image, or of the flat maps of a sheet.

    None where the run does not hold them.
    """
    layer = run.results.layer(name)
    if layer.kind == "image":
        rows, cols = layer.source.shape[:2]
        dy_um, dx_um = layer.source.size_um[-2:]
        return Grid.regular((rows, cols), (dy_um, dx_um))
    if f"layers/{name}" in run.groups and name == run.results.reference.name:
        return Grid.of(run.groups[f"layers/{name}"])
    mapped_run = sheet_run(run, name)
    if mapped_run is None:
        return None
    return Grid.of(mapped_run.groups["maps"])


def checked_names(requested: Sequence[str], names: Sequence[str], place_text: str) -> list[str]:
    """Give the wanted maps, each once; none where none was asked for.

    ``names`` are those that are there, in ``place_text``. InputError names the one that is not
    there, the likely one, and all.
    """
    for name in requested:
        if name not in names:
            raise InputError(
                f"There is no map {name!r} in the {place_text}.{likely(name, names)} It holds"
                f" {', '.join(names)}."
            )
    return list(dict.fromkeys(requested))


def _grid_around(marks: np.ndarray) -> Grid:
    """A grid that covers marks (n, 2), (x, y) in um, and a margin, where pixels are not known."""
    low_um = marks.min(axis=0)
    high_um = marks.max(axis=0)
    extent_um = float((high_um - low_um).max())
    # How far a layer whose pixels are not known may reach beyond its marks.
    margin_um = 0.3 * extent_um
    pixel_um = max(extent_um / 2000, 1e-6)
    size_um = high_um - low_um + 2 * margin_um
    counts = np.ceil(size_um / pixel_um).astype(int) + 1
    cols, rows = counts.tolist()
    return Grid.regular((rows, cols), pixel_um, pair_of(low_um - margin_um))
