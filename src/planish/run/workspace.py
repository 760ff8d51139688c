"""Where a run is made: what it may use, what is there already, and what outlives a refusal."""

import secrets
from collections.abc import Generator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from planish.core.errors import PlanishError
from planish.core.memory import KEPT_SHARE
from planish.core.threads import limit_threads
from planish.io import fingerprint
from planish.io.map_store import StoredMaps, stored_group
from planish.io.run_folder import new_folder, refuse_existing, refuse_inside, work_folder
from planish.marks.regions import Regions
from planish.run.cached_maps import CachedMaps, next_step, sheets_of
from planish.run.compute import Compute, Progress, return_memory, run_key
from planish.run.judging import judge_sheet
from planish.run.layers import Layers, MappedLayer
from planish.run.packages import check_packages, with_packages
from planish.run.preflight import check_request
from planish.run.run import MAPS, Run
from planish.run.save import save_run
from planish.run.sheet import map_layer
from planish.run.study import Study, changed, to_dict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Workspace:
    """What a run is made with; without ``out`` all stays in memory."""

    study: Study
    compute: Compute
    progress: Progress
    regions: Regions | None  # as they were declared
    out: Path | None = None
    folder: Path | None = None  # hidden, beside ``out``, until the run is whole
    store: StoredMaps = field(default_factory=StoredMaps)  # of linked maps
    # Sheets that are mapped: before, and of this run as they come.
    sheets: Layers = field(default_factory=Layers)
    # Of an old run: the same surface with other properties, flattening or corrections.
    similar_sheets: Mapping[str, MappedLayer] = field(default_factory=Layers)
    caches: Mapping[str, CachedMaps] = field(default_factory=dict[str, CachedMaps])

    def map_layers(self, layers: Mapping[str, MappedLayer]) -> list[MappedLayer]:
        """Map the volumes of the study that are not mapped yet; give all layers in its order.

        ``layers`` are those that were read. A run that was killed finds its tiles again.
        """
        for params in self.study.layers:
            name = params.name
            if params.kind == "volume" and name not in self.sheets:
                tile_dir = self.folder and self.folder / "tiles"
                if tile_dir is not None and self.study.is_link:
                    tile_dir /= name
                self.sheets[name] = map_layer(
                    params,
                    compute=self.compute,
                    progress=self.progress,
                    tile_dir=tile_dir,
                    old_sheet=self.similar_sheets.get(name),
                )
        mapped = {**self.sheets, **layers}
        return [mapped[params.name] for params in self.study.layers]

    def write(self, run: Run, *, figures: bool) -> Run:
        """Write a run to ``out``, whole or not at all; it comes back with what stands there now.

        Without ``out`` nothing is written.
        """
        if self.out is None or self.folder is None:
            return replace(run, unchanged={})
        self.progress("write", str(self.out))
        # About the bytes of its pages, and of its maps, which hold noise, with overviews.
        maps_bytes = sum(data.nbytes for data in run.groups.values())
        needed_bytes = 5_000_000 + maps_bytes * 4 // 3
        with new_folder(self.out, inside=self.folder, needed=needed_bytes) as folder:
            save_run(run, folder, home=self.out, store=self.store, figures=figures)
        stored_groups = {name: stored_group(self.out / MAPS, name) for name in self.store.stored}
        return replace(run, groups={**run.groups, **stored_groups}, unchanged={})

    @contextmanager
    def keeping_maps(self) -> Generator[None]:
        """Keep the maps of a link that is refused, and say so."""
        ready_names = {*self.sheets}
        try:
            yield
        except PlanishError as error:
            if not self.caches or self.folder is None or self.out is None:
                raise
            # A disk that is full now does not hide what was wrong before.
            with suppress(PlanishError, OSError):
                for name, cache in self.caches.items():
                    if cache.path.exists():
                        cache.note(cache.path, self.study)
                    elif name in self.sheets and name not in ready_names:
                        self._keep(self.sheets[name], cache, self.folder)
            if advice_text := next_step(error, self.caches, self.study, self.out):
                raise type(error)(f"{error.text} {advice_text}") from error
            raise

    def _keep(self, sheet: MappedLayer, cache: CachedMaps, folder: Path) -> None:
        run = judge_sheet(Study(layers=(sheet.params,)), sheet)
        with new_folder(cache.path, inside=folder) as cache_folder:
            save_run(run, cache_folder, home=cache.path)
            cache.note(cache_folder, self.study)


@contextmanager
def open_workspace(
    study: Study, out: str | Path | None, compute: Compute, progress: Progress, old: Path | None
) -> Generator[Workspace]:
    """Refuse what cannot work, and open the place where a run is made.

    ``old`` is a run of which stages are taken whose volume and parameters are the same.
    """
    check_packages(study)
    study = with_packages(study)
    # What is free changes while a run works, and the width of its columns must not.
    fixed_compute = changed(compute, memory_bytes=compute.memory)
    return_memory(fixed_compute)
    with limit_threads(compute.threads):
        if out is None:
            regions = check_request(study, compute, held=True)
            yield Workspace(study=study, compute=fixed_compute, progress=progress, regions=regions)
            return
        out = Path(out)
        refuse_existing(out)
        refuse_inside(out, [layer.path for layer in study.layers])
        regions = check_request(study, compute)
        hashes = [hash_of_input(layer.path) for layer in study.layers]
        key = run_key(to_dict(study), hashes)
        with work_folder(out, key) as folder:
            store_folder = folder / f".{secrets.token_hex(4)}.partial" if study.is_link else None
            store = StoredMaps(store_folder, keep_bytes=int(fixed_compute.memory * KEPT_SHARE))
            caches = CachedMaps.of_link(study, hashes, out, compute)
            cached = {name: cache.read() for name, cache in caches.items()}
            sheets = {name: sheet for name, sheet in cached.items() if sheet is not None}
            similar_sheets: Layers = {}
            if old is not None:
                ready_sheets, similar_sheets = sheets_of(old, study, hashes)
                sheets |= ready_sheets
            for name in sheets:
                progress("read", f"{name}, mapped before")
            yield Workspace(
                study=study,
                compute=fixed_compute,
                progress=progress,
                regions=regions,
                out=out,
                folder=folder,
                store=store,
                sheets=sheets,
                similar_sheets=similar_sheets,
                caches=caches,
            )


def hash_of_input(path: str | Path) -> str:
    """Hash of a file, a folder or a run, which its results stand for.

    What is wrong with it is said by its reader.
    """
    results = Path(path) / "results.json"
    try:
        return fingerprint(results if results.is_file() else Path(path))
    except PlanishError:
        return ""
