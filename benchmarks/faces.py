"""Faces, coatings and base of flat sheets whose surfaces are formulas, found without any option.

``python -m benchmarks faces [part of a case's name]``, or ``thin`` for the table of thin layers alone.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from tests.surface.sheets import Sheet

from planish.core.errors import PlanishError
from planish.core.frame import Frame
from planish.surface import SurfaceParams, find_surfaces

Array = NDArray[np.float64]

_MOST_RMS = 0.5  # voxel
_MOST_BIAS_UM = 0.5  # of a coating of 3 um or more
_LEAST_SHARE = 0.98
_FACES = ("top", "bottom")


@dataclass(frozen=True, slots=True)
class Figures:
    """What was found of one case.

    Attributes
    ----------
    faces : top, bottom
        Bias and rms of the distance from the true plane, um.
    layers : coating of the top, of the bottom, base
        Bias and rms of the thickness along the normal, um; NaN where there is none.
    share : float
        Of the columns that were measured.
    coated : bool
        Whether both sides were rightly recognised as coated or not.
    """

    faces: tuple[tuple[float, float], ...]
    layers: tuple[tuple[float, float], ...]
    share: float
    coated: bool

    def missed(self, sheet: Sheet) -> list[str]:
        """Names of the limits that were missed."""
        out: list[str] = []
        if not all(rms <= _MOST_RMS * sheet.voxel for _, rms in self.faces):
            out.append("face")
        coats = sheet.coats if sheet.top == "high" else sheet.coats[::-1]
        if any(
            coat >= 3 and not abs(bias) <= _MOST_BIAS_UM for coat, (bias, _) in zip(coats, self.layers[:2], strict=True)
        ):
            out.append("coating")
        if self.share < _LEAST_SHARE:
            out.append("share")
        if not self.coated:
            out.append("coated")
        return out


def cases() -> dict[str, Sheet]:
    """Every case by its name."""
    plain = Sheet()
    out = {"plain": plain}
    for dtype in ("uint8", "uint16", "float32"):
        for inverted in (False, True):
            out[f"{dtype}{' inverted' if inverted else ''}"] = replace(plain, dtype=dtype, inverted=inverted)
    for through in "zyx":
        for top in ("high", "low"):
            out[f"through {through}, top {top}"] = replace(
                plain, through=through, top=top, coats=(15.0, 8.0), tilt=(10.0, -5.0)
            )
    for tilt in ((5, 0), (15, 0), (30, 0), (45, 0), (0, 15), (0, 30), (0, 45), (20, 20), (30, -30), (45, 45)):
        out[f"tilt {tilt[0]} {tilt[1]}"] = replace(plain, tilt=(float(tilt[0]), float(tilt[1])))
    sides = {"both": (15.0, 15.0), "top": (15.0, 0.0), "bottom": (0.0, 15.0), "none": (0.0, 0.0)}
    for name, coats in sides.items():
        for angle in (0.0, 45.0):
            for texture in (0.0, 0.2):
                kind = "textured" if texture else "smooth"
                out[f"coated {name}, {kind} base, tilt {angle:.0f}"] = replace(
                    plain, coats=coats, texture=texture, tilt=(0.0, angle)
                )
    for name in ("top", "none"):
        out[f"coated {name}, inverted float32, tilt 45"] = replace(
            plain, coats=sides[name], tilt=(45.0, 0.0), inverted=True, dtype="float32"
        )
    for voxel in (1.4, 3.0):
        for thickness in (40.0, 100.0, 400.0):
            for angle in (0.0, 30.0, 45.0):
                out[f"{thickness:.0f} um at voxel {voxel}, tilt {angle:.0f}"] = replace(
                    plain, voxel=voxel, thickness=thickness, coats=(10.0, 10.0), tilt=(0.0, angle)
                )
    for thickness in (40.0, 400.0):
        out[f"{thickness:.0f} um at voxel 3.0, one side, tilt 45"] = replace(
            plain, voxel=3.0, thickness=thickness, coats=(0.0, 12.0), tilt=(45.0, 0.0)
        )
        out[f"{thickness:.0f} um at voxel 3.0, one material"] = replace(
            plain, voxel=3.0, thickness=thickness, coats=(0.0, 0.0)
        )
    for noise in (0.02, 0.05, 0.1):
        for fwhm in (2.0, 4.0, 6.0):
            out[f"noise {100 * noise:.0f} %, blur {fwhm:.0f} um"] = replace(plain, noise=noise, fwhm=fwhm)
    for voxel in (1.4, 3.0):
        for name in ("both", "top", "none"):
            out[f"noise 10 %, blur 6 um, voxel {voxel}, coated {name}, tilt 45"] = replace(
                plain, noise=0.1, fwhm=6.0, voxel=voxel, coats=sides[name], tilt=(0.0, 45.0), texture=0.1
            )
    for coat in (3.0, 5.0, 8.0):
        out[f"coating {coat:.0f} um"] = replace(plain, coats=(coat, 15.0))
        out[f"coating {coat:.0f} um on both sides"] = replace(plain, coats=(coat, coat))
    out["thin margin, tilt 45"] = replace(plain, margin=12.0, tilt=(45.0, 0.0))
    for greys in ((40.0, 65.0, 210.0), (40.0, 150.0, 200.0)):
        for name in ("both", "top"):
            kind = "dim" if greys[1] < 100 else "bright"
            out[f"{kind} base, coated {name}, noise 10 %"] = replace(plain, greys=greys, coats=sides[name], noise=0.1)
    out["5 um of air beside it"] = replace(plain, margin=5.0)
    out["small"] = replace(plain, lateral=(40, 45))
    out["wide, tilt 45"] = replace(plain, lateral=(200, 200), tilt=(0.0, 45.0), thickness=60.0)
    out["wide, tilt 45 about both"] = replace(plain, lateral=(200, 200), tilt=(35.0, 35.0), thickness=60.0)
    return out


def judge(found: xr.Dataset, sheet: Sheet) -> Figures:
    """Compare what was found with the planes."""
    truth, cosine = sheet.surfaces(), sheet.cosine
    ok = found["status"].values == 0

    def figures(error: Array) -> tuple[float, float]:
        error = error[ok & np.isfinite(error)] * cosine
        return (float(error.mean()), float(np.sqrt(np.mean(error**2)))) if error.size else (np.nan, np.nan)

    height: dict[str, Array] = {k: found[k].values for k in truth}
    faces = tuple(figures(height[k] - truth[k]) for k in _FACES)
    up = Frame(top=sheet.top).sign  # type: ignore[arg-type]
    layers = [
        figures(up * s * ((height[k] - height[f"interface_{k}"]) - (truth[k] - truth[f"interface_{k}"])))
        for k, s in (("top", 1), ("bottom", -1))
    ]

    def inner(surfaces: dict[str, Array], k: str) -> Array:
        return surfaces[k] if np.isnan(truth[f"interface_{k}"]).all() else surfaces[f"interface_{k}"]

    layers.append(
        figures(
            up * ((inner(height, "top") - inner(height, "bottom")) - (inner(truth, "top") - inner(truth, "bottom")))
        )
    )
    right = all(np.isnan(truth[f"interface_{k}"]).all() == np.isnan(height[f"interface_{k}"]).all() for k in _FACES)
    return Figures(faces=faces, layers=tuple(layers), share=float(ok.mean()), coated=right)


def main(*only: Any) -> int:
    """Print the table; return the number of cases that missed a limit."""
    part = " ".join(str(word) for word in only)
    print("bias and rms in um: faces along the normal, layers' thickness; share of columns measured")
    head = ("top", "bottom", "coating top", "coating bottom", "base")
    print(f"{'case':52s}" + "".join(f"{name:>15s}" for name in head) + f"{'share':>8s}{'s':>6s}")
    failed = 0
    for name, sheet in cases().items():
        if part not in name:
            continue
        grey = sheet.volume()
        begin = time.perf_counter()
        try:
            found = find_surfaces(grey, frame=Frame(through=sheet.through, top=sheet.top))  # type: ignore[arg-type]
        except PlanishError as error:
            failed += 1
            print(f"{name:52s} {type(error).__name__}: {error}")
            continue
        took = time.perf_counter() - begin
        figures = judge(found, sheet)
        missed = figures.missed(sheet)
        failed += bool(missed)
        cells = "".join(
            f"{bias:8.2f} {rms:6.2f}" if np.isfinite(bias) else f"{'-':>15s}"
            for bias, rms in (*figures.faces, *figures.layers)
        )
        print(f"{name:52s}{cells}{figures.share:8.3f}{took:6.1f}  {', '.join(missed)}", flush=True)
    print(f"{failed} cases missed a limit")
    if not part or part == "thin":
        thin_layers()
    return failed


def wedge(most: float, voxel: float, seed: int = 0) -> tuple[xr.DataArray, Array]:
    """A sheet whose top coating grows from 0 to ``most`` um along the columns, and its thickness per column."""
    count = 160
    thickness = np.linspace(0.0, most, count)
    parts = [
        Sheet(voxel=voxel, lateral=(60, 2), coats=(float(t), 15.0), thickness=60.0, margin=20.0, seed=seed + k).volume()
        for k, t in enumerate(thickness)
    ]
    shape = Sheet(voxel=voxel, lateral=(60, count), thickness=60.0, margin=20.0).volume()
    return shape.copy(data=np.concatenate([p.values[:, :, :1] for p in parts], axis=2)), thickness


def thin_layers() -> None:
    """Print true against found thickness of layers thinner than the blur: 4 um of blur, voxels of 1.37 um."""
    print("found thickness in um of thin coatings, blur 4 um, voxel 1.37 um, noise 5 %")
    print(f"{'true':>6s}{'even':>14s}{'other side 15':>16s}{'grey given':>12s}{'in a wedge':>13s}")
    grey, truth = wedge(12.0, 1.37)
    found = find_surfaces(grey)
    along: Array = np.nanmean((found["top"] - found["interface_top"]).values, axis=0)
    for t in (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0):
        cells: list[str] = []
        for coats, given in (((t, t), None), ((t, 15.0), None), ((t, t), 210.0)):
            sheet = Sheet(voxel=1.37, coats=coats, thickness=60.0, margin=20.0)
            one = find_surfaces(sheet.volume(), params=SurfaceParams(coating_grey=given))
            value = (
                float(np.nanmean((one["top"] - one["interface_top"]).values))
                if np.isfinite(one["interface_top"].values).any()
                else np.nan
            )
            cells.append(f"{value:.2f}" if np.isfinite(value) else "not found")
        near = np.abs(truth - t) < 0.3
        cells.append(f"{t + float(np.mean(along[near] - truth[near])):.2f}")
        print(f"{t:6.1f}{cells[0]:>14s}{cells[1]:>16s}{cells[2]:>12s}{cells[3]:>13s}", flush=True)
