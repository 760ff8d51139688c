"""What tests of several folders share: files that they write and compare, and calls that are
refused."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from filelock import FileLock


def bytes_of(folder: Path) -> dict[str, bytes]:
    """All files below a folder, by their path in it."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()
    }


def make_once(
    make: Callable[[Path], object], name: str, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A folder that is made once for all workers, and that no test may change."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    with FileLock(folder.with_suffix(".lock")):
        if not (folder / "done").exists():
            make(folder)
            (folder / "done").touch()
    return folder


def write_volume(
    path: Path, volume: np.ndarray, voxel_um: float = 4.0, across_um: float | None = None
) -> Path:
    """Write a volume that states its voxels, as ImageJ does: cubes, or of another size along y and
    x."""
    meta = {"spacing": voxel_um, "unit": "um", "axes": "ZYX"}
    tifffile.imwrite(
        path, volume, imagej=True, resolution=(1 / (across_um or voxel_um),) * 2, metadata=meta
    )
    return path


def write_image(path: Path, image: np.ndarray, pixel_um: float = 5.0) -> Path:
    """Write an image that states its pixels."""
    tifffile.imwrite(path, image, resolution=(1e4 / pixel_um,) * 2, resolutionunit="CENTIMETER")
    return path


def disc_image(holes=(), shape: tuple[int, int] = (220, 280), pixel_um: float = 5.0) -> np.ndarray:
    """A grey sheet with dark discs of 170 um in 16 bits; ``holes`` as x, y in um."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]] * pixel_um
    grey = 0.8 + 0.01 * np.random.default_rng(0).normal(size=shape)
    for hole_x, hole_y in holes:
        grey = np.where(np.hypot(x - hole_x, y - hole_y) < 85, 0.05, grey)
    return np.rint(grey * 60000).astype(np.uint16)


def refused(error, words: str, call: Callable[..., object], /, *args, **options) -> None:
    """The call ends with this error, whose message holds these words (a regular expression)."""
    with pytest.raises(error, match=words):
        call(*args, **options)


def chromium_path() -> str | None:
    """The Chromium of ``PLANISH_CHROMIUM``, or the one on the path."""
    named = os.environ.get("PLANISH_CHROMIUM")
    return named or next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
    )
