"""Links to images of 15 and of 160 million pixels: time a pixel, peak memory, size of the page.

    python -m benchmarks large_image [--memory 4GB] [--folder DIR] [--rows 3416,10944]

A specimen is made with a voxel of 5 um and a pixel of 1.37 um, so large that its image has so many rows and 4/3 as many
columns; ``planish link`` maps and links it in a process of its own. The specimen of 160 million pixels takes some nine
minutes and 10 GB to make.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import sys
import time
from pathlib import Path

import tifffile

from benchmarks.size import folder_for, timed
from planish.synthetic import BurnParams, CameraParams, ScannerParams, SpecimenParams, make_specimen, write_instruments

PIXEL_UM, VOXEL_UM = 1.37, 5.0
_FIELD = 1.2  # image over sheet: it reaches beyond it and is turned against it


def main(*arguments: str | int) -> int:
    parser = argparse.ArgumentParser(prog="large_image")
    parser.add_argument("--rows", default="3416,10944")
    parser.add_argument("--memory", default="4GB")
    parser.add_argument(
        "--folder", type=Path, default=None, help="where specimens are made, and kept for the next time"
    )
    asked = parser.parse_args([str(a) for a in arguments])
    with folder_for(asked.folder) as folder:
        for rows in map(int, asked.rows.split(",")):
            measure(rows, rows * 4 // 3, Path(folder), asked.memory)
    return 0


def measure(rows: int, cols: int, folder: Path, memory: str) -> None:
    """Make a specimen where it is not there yet, link it, and print what that took."""
    volume, image = specimen(rows, cols, folder / f"image-{rows}")
    out = folder / f"run-{rows}"
    shutil.rmtree(out, ignore_errors=True)
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-m", "planish", "link", volume, image, "--out", out, "--memory", memory]
    code, stages, said, peak = timed([str(part) for part in command])
    seconds, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    pixels = rows * cols
    print(f"{pixels / 1e6:.0f} Mpixel: exit code {code}, {seconds:.0f} s, {cpu:.0f} s of processor time, "
          f"{1e6 * cpu / pixels:.2f} us a pixel", flush=True)  # fmt: skip
    print("  " + ", ".join(f"{name} {seconds:.0f} s" for name, seconds in stages.items()))
    if code not in (0, 4):
        print(said)
        return
    print(f"  peak memory {peak / 1e9:.2f} GB")
    print(f"  page {(out / 'report.html').stat().st_size / 1e6:.1f} MB, maps "
          f"{sum(f.stat().st_size for f in (out / 'maps.zarr').rglob('*') if f.is_file()) / 1e9:.1f} GB")  # fmt: skip
    shutil.rmtree(out, ignore_errors=True)


def specimen(rows: int, cols: int, folder: Path) -> tuple[Path, Path]:
    """Volume and image of a specimen whose image has so many pixels."""
    volume, image = folder / "volume.tif", folder / "cut.tif"
    if image.exists():
        return volume, image
    height, width = rows * PIXEL_UM / _FIELD, cols * PIXEL_UM / _FIELD
    while True:
        made = make_specimen(
            SpecimenParams(
                size_um=(width, height), holes=BurnParams(count=21), camera=CameraParams(pixel_um=PIXEL_UM), seed=3,
                scanner=ScannerParams(voxel_um=VOXEL_UM, fwhm_um=8.0),
            )
        )  # fmt: skip
        if made.image_shape[0] >= rows and made.image_shape[1] >= cols:
            break
        height, width = 1.01 * height, 1.01 * width
    write_instruments(made, folder)
    values = tifffile.imread(folder / "image.tif")[:rows, :cols]
    per_cm = 1e4 / PIXEL_UM
    tifffile.imwrite(image, values, resolution=(per_cm, per_cm), resolutionunit="CENTIMETER")
    return volume, image


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
