"""The run that an export takes its contents from: groups of maps, surfaces, the volume, registrations, history."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
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
from planish.exports.content import ExportHistory
from planish.exports.transforms import DirectedTransform, TransformPair
from planish.io import VolumeParams, find_place, fingerprint
from planish.io.map_store import overviews_of
from planish.io.run_folder import group_names, read_group
from planish.marks.exchange import LayerPixels
from planish.measure import straightened
from planish.report.colours import Scale, colours_of, partner_of
from planish.resample import image_attrs, resample_image
from planish.results import LayerFacts, Results
from planish.run.compute import Compute, Progress
from planish.run.registration import Registration
from planish.run.run import MAPS, Run, marks_file, open_results
from planish.run.study import RUN_TOML, LayerParams, Study, read_study, to_dict
from planish.run.volume import read_sheet_volume

IMAGE = "image"
"""Name of the image on the flat sheet among the maps, and of the image itself among linked maps."""

STRAIGHTENED = "straightened"
"""The group that is worked out: the volume along the normals."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExportSource:
    """A run of which only what is asked for is read.

    Attributes
    ----------
    results, study : Results, Study
    folder : Path or None
        Where it stands; None for one that is in memory only.
    datasets : dict of Dataset
        Groups that are in memory already, or were read.
    registrations : dict of Registration
        Registrations that were read.
    store : Path or None
        Store with the other groups; None where all are in memory.
    """

    results: Results
    study: Study
    folder: Path | None
    datasets: dict[str, xr.Dataset] = field(default_factory=dict[str, xr.Dataset])
    registrations: dict[str, Registration] = field(default_factory=dict[str, Registration])
    store: Path | None = None

    @classmethod
    def of(cls, run: Run | str | Path) -> ExportSource:
        """Open a run folder without its maps, or take a run that is in memory."""
        if isinstance(run, Run):
            return cls(
                results=run.results,
                study=run.study,
                folder=run.folder,
                datasets=dict(run.groups),
                registrations=dict(run.registrations),
            )
        folder = Path(run)
        results = open_results(folder)
        return cls(results=results, study=read_study(folder / RUN_TOML), folder=folder, store=folder / MAPS)

    @cached_property
    def history(self) -> ExportHistory:
        """Versions, study and inputs of the run."""
        if self.folder is not None:
            text = (self.folder / RUN_TOML).read_bytes()
        else:
            text = tomli_w.dumps({"planish": self.results.planish} | to_dict(self.study)).encode()
        sources = [(layer.name, layer.source) for layer in self.results.layers]
        return ExportHistory(
            planish=self.results.planish,
            exported_by=__version__,
            study_sha256=hashlib.sha256(text).hexdigest(),
            inputs=tuple({"layer": layer, "name": s.name, "sha256": s.sha256} for layer, s in sources),
        )

    @cached_property
    def groups(self) -> list[str]:
        """Names of the groups."""
        if self.store is None:
            return sorted(name for name in self.datasets if not name.startswith("overviews/"))
        return group_names(self.store)

    def group(self, name: str, variables: Sequence[str] | None = None) -> xr.Dataset:
        """Read a group, or some of its variables."""
        if name not in self.datasets and self.store is not None:
            if variables is not None:
                return read_group(self.store, name, variables)
            if name in self.groups:
                self.datasets[name] = read_group(self.store, name)
        return self.datasets[name] if variables is None else self.datasets[name][list(variables)]

    def map_group(self, name: str | None) -> str:
        """Choose the group of maps: as named, or the linked maps, or those of the sheet.

        Raises
        ------
        InputError
            If there is none of that name.
        """
        layers = [group for group in self.groups if group.startswith("layers/") and group.count("/") == 1]
        groups = [k for k in ("linked", "maps", "refined", "surfaces", "flat") if k in self.groups] + layers
        wanted = name or next((group for group in ("linked", "maps") if group in groups), None)
        if wanted is None:
            raise InputError(f"The run holds the maps of several layers. Choose one with --group: {', '.join(groups)}.")
        if wanted not in groups:
            suggestion = likely(wanted, [*groups, STRAIGHTENED])
            raise InputError(f"The run has no group {wanted!r}; it holds {', '.join(groups)}.{suggestion}")
        return wanted

    def map_names(self, group: str, wanted: Sequence[str]) -> list[str]:
        """Choose the maps of a group: all where none is named, and the image on the flat sheet.

        Raises
        ------
        InputError
            If there is no map of a name.
        """
        names = [str(name) for name, variable in self.group(group).data_vars.items() if variable.ndim == 2]
        if group == "maps" and "linked" in self.groups and len(self.results.moving) == 1:
            names.append(IMAGE)
        return checked_names(wanted, names, f"group {group}") or names

    def maps(self, group: str, names: Sequence[str]) -> xr.Dataset:
        """Maps of a group in the order of their names, the image on the flat sheet among those of the sheet."""
        maps = self.group(group)
        if IMAGE in names and IMAGE not in maps:  # means over areas where it is finer, through the marks
            image = self.group("linked", [IMAGE])[IMAGE].load()
            # Seen from its fixed layer, a fit takes an image there back to the moving one.
            back = SimpleNamespace(inverse=self.registration(self.results.moving[0].name).fit)
            image = image.assign_attrs(pixel_um=Grid.of(image).pixel_um)
            grey = resample_image(image, Grid.of(maps), back)[IMAGE].values.astype(np.float32)
            attrs = image_attrs(image) | {"long_name": "Grey value of the image"}
            maps = maps.assign({IMAGE: (("v", "u"), grey, attrs)})
        return maps[list(names)]

    def levels(self, group: str, name: str) -> list[Path]:
        """Folders of a map and its overviews in the store of the run, the finest first; none where it has no store."""
        if self.store is None:
            return []
        levels = [self.store / level / name for level in (group, *overviews_of(self.store, group, name))]
        return levels if levels[0].is_dir() else []

    def scale_of(self, maps: xr.Dataset, name: str) -> Scale:
        """Give limits and colours of a map, those of the page: both sides of the sheet share theirs."""
        partner = partner_of(name, [str(key) for key in maps.data_vars])
        pooled = [maps[name]] if partner is None else [maps[name], maps[partner]]
        masked = name == IMAGE and "valid" in maps  # the holes of an image would take most of the colours
        _, parts = thinned(*pooled, *([maps["valid"]] if masked else []))
        if masked:
            parts = [np.where(parts[1], parts[0], np.nan)]
        measured = np.concatenate([part[np.isfinite(part)] for part in parts]).astype(np.float64)
        return colours_of(maps[name].rename(name), measured)

    @property
    def sheet(self) -> LayerFacts | None:
        """The layer whose surfaces the run holds."""
        if "surfaces" not in self.groups:
            return None
        return next((layer for layer in self.results.layers if layer.sheet is not None), None)

    def straightened(self, depth_um: tuple[float, float] | None, compute: Compute, progress: Progress) -> xr.DataArray:
        """The volume along the normals, on the pixels of the flat maps; worked out where it is asked for.

        Raises
        ------
        InputError
            If the run holds no sheet of its own.
        FileError
            If the volume is gone, or another file has its place.
        """
        facts = self.sheet
        if facts is None or "maps" not in self.groups:
            raise InputError(
                "The straightened volume needs the surfaces of one sheet, and this run holds none. Give the run of "
                "the volume itself, in layers/NAME where several were linked."
            )
        volume, _ = read_sheet_volume(self.volume_of(facts, progress), compute, progress)
        places = self.group("maps", [f"volume_{axis}" for axis in "xyz"])
        params = self._layer_of(facts.name).properties
        flat = straightened(volume, self.group("surfaces"), places, params=params, depth_um=depth_um)
        return flat.assign_attrs(
            group=STRAIGHTENED, file_name=facts.source.name, normal="z, up to the top", flat="y is v, x is u"
        )

    def volume_of(self, facts: LayerFacts, progress: Progress) -> VolumeParams:
        """Give the place of the sheet's volume, and how it is read.

        Raises
        ------
        FileError
            If it is gone, or another file has its place.
        """
        params = self._layer_of(facts.name).volume
        assert params is not None
        path = find_place(params.path).path
        if not path.exists():
            raise FileError(
                f"The volume {facts.source.name} of this run is needed, and {path} is not there. Put it back, or write "
                "where it is now into run.toml, under [layers.volume], as path."
            )
        progress("read", facts.source.name)
        if fingerprint(params.path) != facts.source.sha256:
            raise FileError(
                f"{path} is another file than the one that was mapped: its SHA-256 is not that in results.json. Put "
                "the volume of this run there."
            )
        return params

    def sheet_run(self, name: str) -> ExportSource | None:
        """Open the run that holds the surfaces of a sheet: this one, one in ``layers/NAME``, or a given one."""
        if self.sheet is not None and self.sheet.name == name:
            return self
        folders = [self.folder / "layers" / name] if self.folder is not None else []
        folders += [Path(layer.run) for layer in self.study.layers if layer.name == name and layer.run is not None]
        runs = (ExportSource.of(folder) for folder in folders if (folder / MAPS / "zarr.json").is_file())
        return next((run for run in runs if run.sheet is not None), None)

    def _layer_of(self, name: str) -> LayerParams:
        """Parameters of a layer that was read from a volume, in this run or in the one that it was taken from."""
        layer = next(layer for layer in self.study.layers if layer.name == name)
        if layer.run is None:
            return layer
        path = Path(layer.run) / RUN_TOML
        if not path.is_file():
            raise FileError(f"The volume of this run stands in the run {layer.run}, which is not there. Put it back.")
        return next(layer for layer in read_study(path).layers if layer.volume is not None)

    def registration(self, name: str) -> Registration:
        """Read the registration of a moving layer."""
        if name not in self.registrations and self.folder is not None:
            self.registrations[name] = Registration.read(self.folder / marks_file(self.results, name))
        return self.registrations[name]

    def registered(self, group: str | None) -> list[LayerFacts]:
        """Choose the moving layers with a registration: all of them, or the one of a name.

        Raises
        ------
        InputError
            If nothing is registered, or no layer of that name is.
        """
        moving = list(self.results.moving)
        if not moving:
            raise InputError("The run is that of one sheet: nothing is registered. Give a run of 'planish link'.")
        names = [layer.name for layer in moving]
        wanted = None if group in (None, "linked") else str(group).removeprefix("layers/")
        if wanted is not None and wanted not in names:
            raise InputError(f"No layer {wanted!r} is registered; there are {', '.join(names)}.{likely(wanted, names)}")
        return [layer for layer in moving if wanted in (None, layer.name)]

    def transforms(self, layer: LayerFacts) -> TransformPair:
        """Give the registration of a moving layer in both directions, with the pixels of both layers."""
        assert layer.registration is not None
        fit, target = self.registration(layer.name).fit, layer.registration.to
        transform = fit.transform
        middle = np.zeros(2) if isinstance(transform, Similarity) else np.array(transform.source)
        (a, b), (c, d) = transform.matrix().tolist()
        (x, y), (x1, y1) = middle.tolist(), transform(middle).tolist()
        affine = Affine(linear=((a, b), (c, d)), source=(x, y), target=(x1, y1))
        exact = isinstance(transform, Similarity | Affine)
        moving, fixed = (
            self.grid_of(name) or _grid_around(marks) for name, marks in ((layer.name, fit.moving), (target, fit.fixed))
        )
        return TransformPair(
            DirectedTransform(layer.name, target, fit, moving, affine, exact),
            DirectedTransform(target, layer.name, fit.inverse, fixed, affine.inverse, exact),
            fit.model,
        )

    def landmarks(self, layer: LayerFacts) -> xr.Dataset:
        """Give the marks of a moving layer with the first pixels of both layers, from which other programs count."""
        assert layer.registration is not None
        marks = self.registration(layer.name).marks
        layers = {side: dict(about) for side, about in marks.attrs["layers"].items()}
        for side, name in (("moving", layer.name), ("fixed", layer.registration.to)):
            if (grid := self.grid_of(name)) is not None:
                layers[side] |= LayerPixels(origin_um=grid.origin_um).about()
        return marks.assign_attrs(layers=layers)

    def grid_of(self, name: str) -> Grid | None:
        """Pixels of a layer: of an image, or of the flat maps of a sheet; None where the run does not hold them."""
        layer = self.results.layer(name)
        if layer.kind == "image":
            rows, cols = layer.source.shape[:2]
            down, across = layer.source.size_um[-2:]
            return Grid.regular((rows, cols), (down, across))
        if f"layers/{name}" in self.groups and name == self.results.reference.name:
            return Grid.of(self.group(f"layers/{name}", ["thickness"]))
        run = self.sheet_run(name)
        return None if run is None else Grid.of(run.group("maps", ["thickness"]))


def checked_names(wanted: Sequence[str], names: Sequence[str], where: str) -> list[str]:
    """Give the wanted maps, each once; InputError names the one that is not there, the likely one, and all."""
    for name in wanted:
        if name not in names:
            raise InputError(
                f"There is no map {name!r} in the {where}.{likely(name, names)} It holds {', '.join(names)}."
            )
    return list(dict.fromkeys(wanted))


def _grid_around(marks: np.ndarray) -> Grid:
    """Pixels of a layer of which only the marks are known."""
    low, high = marks.min(axis=0), marks.max(axis=0)
    extent = float((high - low).max())
    around = 0.3 * extent  # of the marks' extent: what a layer whose pixels are not known is taken to reach beyond them
    pixel = max(extent / 2000, 1e-6)
    cols, rows = (int(n) for n in np.ceil((high - low + 2 * around) / pixel).astype(int) + 1)
    return Grid.regular((rows, cols), pixel, (float(low[0] - around), float(low[1] - around)))
