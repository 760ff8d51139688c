"""One linked run of each pose and kind, made once a run of the tests and shared by all workers.

``kinds("laid")`` gives the folder of a run, ``kinds.specimen("laid")`` what it was made from. No
test may change them.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cloudpickle
import numpy as np
import pytest
import tifffile

from folders import make_once, write_image
from planish.cli import main
from planish.synthetic import (
    DEMO,
    BurnParams,
    CameraParams,
    FibreParams,
    InstrumentFiles,
    PaperParams,
    ScannerParams,
    SectionsParams,
    Specimen,
    SpecimenParams,
    Warp,
    make_specimen,
    write_instruments,
)
from planish.synthetic.files import Instrument

#: The small specimen: 1.1 x 0.9 mm, five holes.
SMALL = SpecimenParams(
    size_um=(1300.0, 1000.0),
    holes=BurnParams(pattern="irregular", count=5),
    warp=Warp(slope=0.35, wavelength_um=1800.0),
    scanner=ScannerParams(voxel_um=4.0),
    camera=CameraParams(pixel_um=5.0, radial=0.0, stretch=0.0, shading=0.0, nuisance_sd=0.004),
    seed=5,
)

#: The same sheet, bent otherwise, under another scanner and another camera.
OTHER = replace(
    SMALL,
    warp=Warp(slope=0.25, wavelength_um=2300.0, phase_rad=2.0, ruling_deg=80.0),
    scanner=ScannerParams(voxel_um=3.5, fwhm_um=4.5),
    camera=replace(SMALL.camera, pixel_um=6.0, turn_deg=40.0),
    seed=6,
)

#: Laid fibre by fibre, once without coating in air, once coated in resin.
UNCOATED = replace(
    SMALL,
    size_um=(1000.0, 800.0),
    paper=PaperParams(
        base_um=80.0,
        coating_top_um=0.0,
        coating_bottom_um=0.0,
        coating_sd_um=0.0,
        fibres=FibreParams(g_per_m2=60.0, fuzz_per_mm2=3.0),
    ),
    scanner=ScannerParams(voxel_um=3.0, grey=(40.0, 110.0, 190.0)),
)
IN_RESIN = replace(
    SMALL,
    size_um=(1000.0, 800.0),
    paper=PaperParams(
        base_um=50.0,
        coating_top_um=12.0,
        coating_bottom_um=12.0,
        coating_sd_um=4.0,
        fibres=FibreParams(g_per_m2=35.0, flexibility=(0.12, 0.2)),
    ),
    scanner=ScannerParams(voxel_um=3.0, grey=(115.0, 140.0, 210.0), section_gain=0.03),
)


#: All of them by name.
SPECIMENS: dict[str, SpecimenParams] = {
    "small": SMALL,
    "other": OTHER,
    "sections": replace(
        SMALL,
        size_um=(1000.0, 760.0),
        sections=SectionsParams(pixel_um=3.0, section_um=4.0, missing=0.03),
    ),
    "scan": replace(SMALL, size_um=(1000.0, 760.0)),
    # Through a lens that darkens the corners.
    "no-holes": replace(
        DEMO,
        seed=5,
        size_um=(1500.0, 1200.0),
        scanner=replace(DEMO.scanner, voxel_um=3.0),
        holes=replace(DEMO.holes, count=0),
        warp=Warp(wavelength_um=2000.0),
        camera=replace(DEMO.camera, pixel_um=4.0, vignetting=0.04, turn_range_deg=180.0),
    ),
    "uncoated": UNCOATED,
    "resin": IN_RESIN,
    "demo": DEMO,
}

#: How a volume is written, where not as a stack.
INSTRUMENTS: dict[str, Instrument] = {"sections": "sections", "scan": "scanner"}

#: Poses of the small specimen.
POSES = ("upright", "laid", "bottom")


@dataclass(frozen=True)
class Files:
    """A specimen on disk: the paths, and what ``planish link`` has to be told about them."""

    volume: Path
    image: Path
    options: tuple[str, ...] = ()


class Kinds:
    """Runs by the names of :data:`RECIPES`, and the specimens and files behind them."""

    def __init__(self, tmp_path_factory: pytest.TempPathFactory) -> None:
        self._factory = tmp_path_factory

    def __call__(self, name: str) -> Path:
        """Folder of the run of this kind."""
        recipe = RECIPES[name]
        return make_once(lambda folder: recipe(self, folder), f"run-{name}", self._factory) / "run"

    def written(self, name: str) -> Path:
        """Folder with a specimen, pickled, and its files."""

        def make(folder: Path) -> None:
            sheet = self.specimen("small").sheet if name == "other" else None
            specimen = make_specimen(SPECIMENS[name], sheet=sheet)
            files = write_instruments(specimen, folder, volume=INSTRUMENTS.get(name, "stack"))
            # The way from a place in the volume to the material is a function within a function.
            (folder / "specimen.pickle").write_bytes(
                cloudpickle.dumps(replace(specimen, files=files))
            )

        return make_once(make, f"specimen-{name}", self._factory)

    def specimen(self, name: str) -> Specimen:
        """The specimen of this name or of the run of this kind, with its truth."""
        return _unpickled(self.written("small" if name in POSES else name) / "specimen.pickle")

    def files(self, name: str) -> InstrumentFiles:
        """Its files, which :func:`write_instruments` describes."""
        specimen = self.specimen(name)
        files = specimen.files
        assert files is not None
        if name != "laid":
            return files
        last_um = specimen.volume["y"].values[-1]

        def to_physical(points: np.ndarray, _sections: object = None) -> np.ndarray:
            x, y, z = np.moveaxis(points, -1, 0)
            return np.stack([x, last_um - z, y], axis=-1)

        laid = self.laid
        return replace(
            files, volume=laid.volume, image=laid.image, through="y", to_physical=to_physical
        )

    @property
    def small(self) -> InstrumentFiles:
        """Files of the small specimen."""
        return self.files("small")

    @property
    def other(self) -> InstrumentFiles:
        """Files of the same sheet by other instruments."""
        return self.files("other")

    @property
    def laid(self) -> Files:
        """The small specimen turned about x: its sheet through y; the side at the low end is called
        the top.

        That is the underside of the specimen: the image, of its upper side, shows the bottom.
        """

        def make(folder: Path) -> None:
            folder.mkdir()
            specimen = self.specimen("small")
            voxel_um = specimen.params.scanner.voxel_um
            volume = np.ascontiguousarray(specimen.volume.values[:, ::-1].transpose(1, 0, 2))
            meta = {"spacing": voxel_um, "unit": "um", "axes": "ZYX"}
            size = (1 / voxel_um, 1 / voxel_um)
            tifffile.imwrite(
                folder / "volume.tif", volume, imagej=True, resolution=size, metadata=meta
            )
            grey = np.rint(specimen.image.values * 60000).clip(0, 65535).astype(np.uint16)
            write_image(folder / "image.tif", grey, specimen.params.camera.pixel_um)

        folder = make_once(make, "specimen-laid", self._factory)
        options = ("--through", "y", "--top", "low", "--image-side", "bottom")
        return Files(folder / "volume.tif", folder / "image.tif", options)


@cache
def _unpickled(path: Path) -> Specimen:
    return pickle.loads(path.read_bytes())


# --- how each kind is made ------------------------------------------------------------------------


def _call(verb: str, folder: Path, *arguments: object) -> None:
    """Call the command line as a user would; a check may doubt the result.

    ``printed.txt`` keeps what it prints.
    """
    folder.mkdir(exist_ok=True)
    with (
        (folder / "printed.txt").open("w", encoding="utf-8") as printed,
        redirect_stdout(printed),
        redirect_stderr(printed),
        pytest.raises(SystemExit) as end,
    ):
        main([verb, *map(str, arguments), "--out", str(folder / "run")])
    assert end.value.code in (0, 4), (folder / "printed.txt").read_text(encoding="utf-8")


def _link(folder: Path, *layers_and_options: object) -> None:
    _call("link", folder, *layers_and_options)


def _upright(kinds: Kinds, folder: Path) -> None:
    """The sheet through z, whose image shows the top."""
    _link(folder, kinds.small.volume, kinds.small.image)


def _laid(kinds: Kinds, folder: Path) -> None:
    """The sheet through y, its top at the low end; the image shows the bottom."""
    _link(folder, kinds.laid.volume, kinds.laid.image, *kinds.laid.options)


def _bottom(kinds: Kinds, folder: Path) -> None:
    """The sheet through z, its top at the low end; the image shows the bottom."""
    _link(folder, kinds.small.volume, kinds.small.image, "--top", "low", "--image-side", "bottom")


def _sections(kinds: Kinds, folder: Path) -> None:
    """Serial sections and an image."""
    files = kinds.files("sections")
    _link(folder, files.volume, files.image, "--through", files.through)


def _scan(kinds: Kinds, folder: Path) -> None:
    """Slices across the axis of rotation, as NRecon writes them, and an image."""
    files = kinds.files("scan")
    _link(folder, files.volume, files.image, "--through", files.through)


def _other_map(kinds: Kinds, folder: Path) -> None:
    """The maps of the sheet under the other scanner, without a link."""
    _call("map", folder, kinds.other.volume)


def _volumes(kinds: Kinds, folder: Path) -> None:
    """Two scans of the sheet, each mapped before."""
    _link(folder, f"first={kinds('upright')}", f"second={kinds('other-map')}")


def _images(kinds: Kinds, folder: Path) -> None:
    """Two images by two cameras, `white` on the pixels of `uv`."""
    _link(folder, f"white={kinds.small.image}", f"uv={kinds.other.image}")


def _chain(kinds: Kinds, folder: Path) -> None:
    """The sheet to its own image to the image of the other camera."""
    layers = (f"ct={kinds('upright')}", f"near={kinds.small.image}", f"far={kinds.other.image}")
    _link(folder, *layers, "--chain")


def _no_holes(kinds: Kinds, folder: Path) -> None:
    """A sheet without holes, turned by any angle under the camera, found by its texture."""
    files = kinds.files("no-holes")
    _link(folder, files.volume, files.image)


def _uncoated(kinds: Kinds, folder: Path) -> None:
    """A sheet of fibres without coating."""
    files = kinds.files("uncoated")
    _link(folder, files.volume, files.image)


def _resin(kinds: Kinds, folder: Path) -> None:
    """A coated sheet of fibres in resin."""
    files = kinds.files("resin")
    _link(folder, files.volume, files.image)


def _demo(kinds: Kinds, folder: Path) -> None:
    """What ``planish demo`` links: six holes."""
    files = kinds.files("demo")
    _link(folder, files.volume, files.image)


RECIPES: dict[str, Callable[[Kinds, Path], None]] = {
    "upright": _upright,
    "laid": _laid,
    "bottom": _bottom,
    "sections": _sections,
    "scan": _scan,
    "other-map": _other_map,
    "volumes": _volumes,
    "images": _images,
    "chain": _chain,
    "no-holes": _no_holes,
    "uncoated": _uncoated,
    "resin": _resin,
    "demo": _demo,
}
