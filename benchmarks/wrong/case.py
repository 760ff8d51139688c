"""One input as an instrument leaves it: what is in the files, what is said of them, where each
voxel came from."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from benchmarks.wrong.truth import Right
from planish.run.build import link
from planish.run.compute import Compute
from planish.synthetic import InstrumentFiles, write_instruments

Array = NDArray[np.float64]
Places = Callable[[Array], Array]


@dataclass(kw_only=True)
class Case:
    """A right specimen, and what a kind of input changes of it.

    ``back`` takes voxels (n, 3) of the file, (z, y, x) as numbers, to those of the right volume;
    ``image_back`` pixels (n, 2), (y, x). ``by_nature`` names figures that are wrong whatever they
    are: the place of a pixel in another sheet.
    """

    right: Right
    volume: NDArray[Any]
    voxel_um: tuple[float, float, float]
    image: Array
    pixel_um: tuple[float, float]
    options: dict[str, dict[str, Any]] = field(default_factory=dict)
    back: list[Places] = field(default_factory=list)
    image_back: list[Places] = field(default_factory=list)
    by_nature: tuple[str, ...] = ()
    side: str = "top"
    shown: Right | None = None  # the specimen of the image, where it is another
    pairs: Array | None = None  # marks by hand: volume x, y, z and image x, y, in um
    note: str = ""
    instrument: str = "stack"  # or "scanner", "sections": of a specimen by planish, as it is
    files: InstrumentFiles | None = None  # of such an instrument

    @classmethod
    def of(cls, right):
        """The right input itself."""
        return cls(
            right=right,
            volume=right.volume,
            voxel_um=(right.voxel_um,) * 3,
            image=right.image,
            pixel_um=(right.pixel_um,) * 2,
        )

    def option(self, group, **values):
        """Say something on the command line."""
        self.options[group] = self.options.get(group, {}) | values

    def store(self, values):
        """Take other greys for the volume, as 8 bits hold them."""
        self.volume = eight_bits(values)

    def air(self, shape, rng):
        """What a scan shows beside the sheet."""
        return eight_bits(self.right.grey[0] + self.right.noise * rng.standard_normal(shape))

    def run(self):
        """Write the files and link them."""
        with tempfile.TemporaryDirectory(prefix="wrong-") as name:
            folder = Path(name)
            volume = self._write(folder)
            image = folder / "image.tif"
            _write_image(image, self.image, self.pixel_um)
            sections = {k: dict(v) for k, v in self.options.items()}
            if self.files is not None:
                sections["volume"] = sections.get("volume", {}) | {"through": self.files.through}
            if self.pairs is not None:
                path = folder / "marks.csv"
                head = "volume_x_um,volume_y_um,volume_z_um,fixed_x_um,fixed_y_um"
                labels = [
                    f"{k + 1},{','.join(f'{v:.3f}' for v in row)}"
                    for k, row in enumerate(self.pairs)
                ]
                path.write_text("\n".join([f"label,{head}", *labels]) + "\n", encoding="utf-8")
                sections["registration"] = sections.get("registration", {}) | {"marks": str(path)}
            return link(str(volume), str(image), compute=Compute(threads=1), **sections)

    def _write(self, folder):
        if self.instrument != "stack":
            made = self.right.made["specimen"]
            self.files = write_instruments(
                made, folder / "files", volume=self.instrument, image=False
            )
            return self.files.volume
        path = folder / "volume.tif"
        z, y, x = self.voxel_um
        tifffile.imwrite(
            path,
            np.ascontiguousarray(self.volume),
            imagej=True,
            resolution=(1 / x, 1 / y),
            metadata={"spacing": z, "unit": "um", "axes": "ZYX"},
        )
        return path


def eight_bits(values):
    """Round to 0 to 255."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _write_image(path, image, pixel_um):
    grey = np.clip(np.rint(image * 65535), 0, 65535).astype(np.uint16)
    size = (1e4 / pixel_um[1], 1e4 / pixel_um[0])
    tifffile.imwrite(path, grey, resolution=size, resolutionunit="CENTIMETER")


def traced(steps, places):
    """Follow places of the last file back to the right one."""
    for step in reversed(steps):
        places = step(places)
    return places
