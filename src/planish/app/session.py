"""A session: a run as it was, and what a person changed since.

Every change is saved before it counts.
"""

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Self

import numpy as np
import xarray as xr

from planish.app.changes import (
    Change,
    ChangeError,
    DrawnRegion,
    End,
    Mark,
    Marks,
    State,
    applied,
    change_of,
    corrections_of,
    numbered,
)
from planish.app.journal import InUse, Journal
from planish.app.picture import PLANES, WHERE, Plane
from planish.app.pictures import Pictures
from planish.core.errors import FileError, InputError, PlanishError
from planish.core.facts import Side
from planish.core.typing import Floats, Pair, Texts
from planish.io import fingerprint
from planish.io.light import read_corrected
from planish.io.map_groups import read_group
from planish.io.params import ImageParams
from planish.marks.exchange import MarkPlaces, holes_of, make_marks, model
from planish.marks.exchange.model import EXTRAS
from planish.marks.regions import Regions
from planish.results import Results
from planish.run import Registration, find_holes
from planish.run.cached_maps import noted_study
from planish.run.overlay import measured_holes
from planish.run.run import MAPS, open_run
from planish.run.study import EDITS, Study, with_paths

_UNDO = b'{"do": "undo"}'
_REDO = b'{"do": "redo"}'


class Stale(InputError):
    """A change of something that was changed meanwhile."""


@dataclass(eq=False)
class Session:
    """What one server serves."""

    folder: Path  #: the run; a map where ``image_params`` is given
    study: Study
    results: Results
    registrations: dict[str, Registration]  #: by the moving layer; empty where none was ever linked
    image_params: ImageParams | None  #: of a link that was refused at the marks
    journal: Journal
    reason: str  #: why nothing can be changed; empty where it can
    version: int = 0  #: lines of the journal, and all since that a window has to show
    changed_at: int = 0  #: version of the last change: what was asked for before is stale
    _states: list[State] = field(default_factory=list[State])
    _position: int = 0
    _lock: threading.RLock = field(default_factory=threading.RLock)
    _listeners: set[Callable[[], None]] = field(default_factory=set[Callable[[], None]])

    @classmethod
    def open(cls, run: Path, image: ImageParams | None = None, *, read_only: bool = False) -> Self:
        """Open a run, or the maps of a refused link with the image, with all changes made to it.

        Raises
        ------
        FileError
            If it is no run, is damaged, is open elsewhere, or needs an image.
        SizeError
            If the pixel size of the image is not known.
        """
        opened = open_run(run)
        params = _image_params(run, image, opened.results)
        subject = fingerprint(run / "results.json")
        journal_name = "journal.jsonl"
        if params is not None:
            key = image_key(params)
            subject += f" {key}"
            journal_name = f"journal-{sha256(key.encode()).hexdigest()[:12]}.jsonl"
        registrations = dict(opened.registrations)
        journal_path = run / EDITS / journal_name
        reason = "It was opened with --read-only." if read_only else ""
        try:
            journal = Journal(journal_path, subject=subject, write=not read_only)
        except InUse:
            raise
        except PlanishError as error:
            journal = Journal(journal_path, subject=subject, write=False)
            reason = f"The run cannot be written, so nothing can be changed. {error.text}"
        session = cls(
            folder=run,
            study=opened.study,
            results=opened.results,
            registrations=registrations,
            image_params=params,
            journal=journal,
            reason=reason,
        )
        try:
            session._replay(opened.regions)
        except BaseException:
            session.close()
            raise
        return session

    @property
    def read_only(self) -> bool:
        """Whether nothing can be changed."""
        return bool(self.reason)

    @property
    def layers(self) -> Texts:
        """Names of the moving layers, each with a registration."""
        return tuple(self.registrations) or (self.results.layers[0].name,)

    def target(self, layer: str) -> str:
        """Name of the layer that a moving one is registered to."""
        facts = self.results.layer(layer).registration
        return "image" if facts is None else facts.to

    def shown_by(self, layer: str, plane: Plane) -> tuple[Plane, str]:
        """Plane and layer of the pictures on which ends of a layer's marks lie.

        In a chain, the next layer's own.
        """
        if plane == "moving":
            return "moving", layer
        target_layer = self.target(layer)
        return ("moving" if target_layer in self.layers else "fixed"), target_layer

    def view_names(self, layer: str) -> dict[Plane, str]:
        """What a person calls both planes.

        A sheet and its image are called by what they are, all others by their layers.
        """
        target = self.target(layer)
        kinds = {facts.name: facts.kind for facts in self.results.layers}
        # The image of a refused link is no layer of the run.
        if kinds[layer] == "sheet" and kinds.get(target, "image") == "image":
            return {"moving": "Volume side", "fixed": "Image side"}
        return {"moving": layer, "fixed": target}

    def where(self, layer: str) -> dict[Plane, str]:
        """Words for both planes in a sentence."""
        names = self.view_names(layer)
        if names["moving"] == "Volume side":
            return WHERE
        return {plane: f"in {name}" for plane, name in names.items()}

    def mirrored(self, layer: str) -> bool | None:
        """Whether the fixed plane shows the other side of the sheet.

        None where either hand may fit.
        """
        if self.study.registration.mirror:
            return None
        return self.side_of(layer) != self.side_of(self.target(layer))

    def to_face_um(self, layer: str) -> Pair:
        """What the link added to the holes of a layer's maps to have them at the face.

        These holes run at an angle.
        """
        if layer not in self.registrations:
            return tuple(self._detected_holes["moving"].attrs["to_face_um"])
        facts = self.results.layer(layer).registration
        if facts is None or facts.tilt is None:
            return 0.0, 0.0
        return facts.tilt.to_face_um

    def side_of(self, layer: str) -> Side:
        """Side of the sheet that a layer shows.

        The top for flat maps, and for an image where nothing is given.
        """
        images = {params.name: params.image for params in self.study.layers}
        if self.image_params is not None:
            images["image"] = self.image_params
        image = images.get(layer)
        return "top" if image is None else image.side or "top"

    @cached_property
    def pictures(self) -> Pictures:
        """All pictures of the run, and of the image that it shall be linked to."""
        return Pictures.of(self.folder, self.image_params)

    @cached_property
    def image(self) -> xr.DataArray | None:
        """The image of a link that was refused, as the link reads it; None for a run."""
        return self.image_params and read_corrected(self.image_params)[0]

    def holes(self, layer: str) -> dict[Plane, xr.Dataset]:
        """All holes that were found in both planes, matched or not.

        ``x``, ``y``, ``diameter`` in um, covariances.
        """
        if layer not in self.registrations:
            return self._detected_holes
        marks = self.registrations[layer].marks
        return {plane: holes_of(measured_holes(marks, plane), plane) for plane in PLANES}

    @cached_property
    def _detected_holes(self) -> dict[Plane, xr.Dataset]:
        """All holes of a sheet's maps, and of the image of its refused link."""
        assert self.image is not None
        find = partial(find_holes, params=self.study.holes, side=self.side_of("image"))
        return {"moving": find(read_group(self.folder / MAPS, "maps")), "fixed": find(self.image)}

    @property
    def state(self) -> State:
        """What stands now."""
        return self._states[self._position]

    @property
    def first(self) -> State:
        """The run as it was."""
        return self._states[0]

    @property
    def can_undo(self) -> bool:
        """Whether there is a change to take back."""
        return self._position > 0

    @property
    def can_redo(self) -> bool:
        """Whether there is a change to make again."""
        return self._position + 1 < len(self._states)

    def change(self, change: Change, *, version: int | None = None) -> State:
        """Make a change: it is saved when this returns, or was not made.

        Raises
        ------
        Stale
            If something was changed after ``version``.
        ChangeError
            If it cannot be made of what stands now.
        FileError, ResourceError
            If it cannot be saved.
        """
        with self._lock:
            change = numbered(change, len(self.journal.lines) + 1)
            return self._save(change.model_dump_json(exclude_none=True).encode(), version)

    def undo(self, *, version: int | None = None) -> State:
        """Take the last change back; ChangeError where there is none."""
        return self._save(_UNDO, version)

    def redo(self, *, version: int | None = None) -> State:
        """Make the change that was taken back again; ChangeError where there is none."""
        return self._save(_REDO, version)

    def _save(self, journal_line: bytes, version: int | None) -> State:
        with self._lock:
            if version is not None and version < self.changed_at:
                raise Stale(
                    "Something was changed in another window meanwhile. The page shows it; do it"
                    " again."
                )
            self._step(journal_line, save=True)
            return self.state

    def _step(self, journal_line: bytes, *, save: bool) -> None:
        """Go to the state before or after, or to a new one; ChangeError where there is none.

        ``journal_line``: undo, redo, or a change; with ``save`` it is appended to the journal.
        """
        states = self._states
        position = self._position + 1
        if journal_line == _UNDO:
            position -= 2
            if position < 0:
                raise ChangeError("There is nothing to undo: the run stands as it was.")
        elif journal_line != _REDO:
            states = [*states[:position], applied(self.state, change_of(journal_line))]
        elif position == len(states):
            raise ChangeError("There is nothing to redo.")
        if save:
            self.journal.append(journal_line)
        self._states = states
        self._position = position
        self.publish()
        self.changed_at = self.version

    def _replay(self, regions: Regions | None) -> None:
        """Begin with the run as it was, and make all changes of the journal again.

        ``regions`` are those that the run declares; None where it declares none.
        """
        marks = {name: pairs_of(layer.marks) for name, layer in self.registrations.items()}
        first_layer = self.layers[0]
        original = State(
            marks=marks or {first_layer: ()},
            model=self.study.registration.model,
            regions=() if regions is None else _drawn_regions(regions),
            corrections=corrections_of(self.study),
            first_layer=first_layer,
        )
        self._states = [original]
        for k, line in enumerate(self.journal.lines, 1):
            try:
                self._step(line, save=False)
            except ChangeError as error:
                raise FileError(
                    f"{self.journal.path} is damaged: its change {k} cannot be made ({error.text})"
                    " Cut the file before that line to keep the changes that were made until then."
                ) from error

    def publish(self) -> None:
        """Count the version up, and call everybody who listens; from any thread."""
        with self._lock:
            self.version += 1
            listeners = tuple(self._listeners)
        for listener in listeners:
            with suppress(RuntimeError):  # a loop that was closed meanwhile
                listener()

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have a function called at each new version, in any thread; what is returned ends it."""
        with self._lock:
            self._listeners.add(listener)
        return lambda: self._listeners.discard(listener)

    def close(self) -> None:
        """Let others change the run; a change that is being saved is saved before."""
        with self._lock:
            self.journal.close()


def image_key(params: ImageParams) -> str:
    """What tells the image of a refused link from others, wherever its files lie.

    Without white image and curve it is that of versions which knew neither.
    """
    files = filter(None, (params.path, params.white, params.dark))
    left_out = {"path", "white", "dark"}
    left_out |= {name for name in ("white_exposure", "gamma") if getattr(params, name) is None}
    options = params.model_dump_json(exclude=left_out)
    return " ".join([*map(fingerprint, files), options])


def _image_params(run: Path, image: ImageParams | None, results: Results) -> ImageParams | None:
    """Give the options of the image of a refused link; None for a run that is linked.

    They are as it is asked for, as it was then, or by its own metadata. FileError where an image is
    given with a link, or not given with a map.
    """
    if results.is_link:
        if image is None:
            return None
        name = Path(image.path).name
        raise FileError(
            f"{run} is linked to an image already. Leave {name} out: planish view {run}"
        )
    if image is None:
        raise FileError(
            f"{run} holds the map of one sheet. Give the image as well: planish view {run} IMAGE"
        )
    path = Path(image.path)
    if not path.is_file():
        raise FileError(f"{path} is not a file. Give the image of the sheet.")
    image = with_paths(image, lambda file: str(Path(file).resolve()))
    options = image.model_dump(exclude_unset=True)
    recorded = noted_study(run)
    layers = () if recorded is None else recorded.layers
    for layer in layers:
        if layer.image is not None and layer.image.path == image.path:
            return layer.image.model_copy(update=options)
    return ImageParams.model_validate(options)


def ends_of(marks: xr.Dataset, plane: str) -> list[End | None]:
    """Give the ends of a file's marks in a plane, with all that is known of them.

    None for a mark that is not in this plane.
    """
    places = model.places_of(marks, plane)
    x_um, y_um = places.um.T
    columns = {"x": x_um, "y": y_um, **places.extras}
    ends = list[End | None]()
    for k, source in enumerate(places.source):
        row = {name: float(um[k]) for name, um in columns.items()}
        end = {name: um for name, um in row.items() if math.isfinite(um)}
        is_placed = {"x", "y"} <= end.keys()
        ends.append(End.model_validate(end | {"source": source}) if is_placed else None)
    return ends


def pairs_of(
    marks: xr.Dataset,
    moving: str = "moving",
    fixed: str = "fixed",
    *,
    label: Callable[[Any], str] = str,
) -> Marks:
    """Give the marks of a file that lie in both planes, called ``moving`` and ``fixed`` there.

    ``label`` turns the label in the file into one of a session.
    """
    ends = zip(ends_of(marks, moving), ends_of(marks, fixed), strict=True)
    pairs: list[Mark] = []
    for k, (moving_end, fixed_end) in enumerate(ends):
        if moving_end is not None and fixed_end is not None:
            text = label(marks["label"].values[k])
            used = bool(marks["used"].values[k])
            pair = Mark(id=f"m0-{k + 1}", label=text, used=used, moving=moving_end, fixed=fixed_end)
            pairs.append(pair)
    return tuple(pairs)


def dataset_of(marks: Sequence[Mark], **options: Any) -> xr.Dataset:
    """Give marks of a session as files have them; ``options`` is for `make_marks`."""
    labels = [mark.label for mark in marks]
    used = [mark.used for mark in marks]
    places: dict[str, MarkPlaces] = {}
    for plane in PLANES:
        places[plane] = _places_of([getattr(mark, plane) for mark in marks])
    return make_marks(labels, places, used=used, **options)


def _places_of(ends: Sequence[End | None]) -> MarkPlaces:
    """Places of the ends of marks in one plane; NaN where one is missing."""
    columns: dict[str, Floats] = {}
    for name in ("x", "y", *EXTRAS):
        numbers = [getattr(end, name, None) for end in ends]
        columns[name] = np.array(numbers, np.float64)
    um = np.stack([columns.pop("x"), columns.pop("y")], axis=1)
    sources = [getattr(end, "source", "imported") for end in ends]
    return MarkPlaces(um=um, source=sources, extras=columns)


def _drawn_regions(declared: Regions) -> tuple[DrawnRegion, ...]:
    """The regions that a run declares: each polygon for itself, numbered."""
    regions: list[DrawnRegion] = []
    for region in declared.declared:
        for rings in region.polygons:
            polygon, *holes = map(_ring, rings)
            drawn = DrawnRegion(
                id=f"r0-{len(regions) + 1}",
                name=region.name,
                author=region.author,
                reason=region.reason,
                polygon=polygon,
                holes=tuple(holes),
            )
            regions.append(drawn)
    return tuple(regions)


def _ring(points: Any) -> tuple[Pair, ...]:
    return tuple((float(x), float(y)) for x, y in points)
