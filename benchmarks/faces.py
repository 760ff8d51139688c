"""Faces, coatings and base of flat sheets whose surfaces are formulas, found without any option.

``python -m benchmarks faces [part of a case's name]``, or ``thin`` for the table of thin layers
alone.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from tests.surface.sheets import Sheet

from planish.core.errors import PlanishError
from planish.core.frame import Frame
from planish.surface import SurfaceParams, find_surfaces

_MOST_RMS = 0.5  # voxel
_MOST_BIAS_UM = 0.5  # of a coating of 3 um or more
_LEAST_SHARE = 0.98
_FACES = ("top", "bottom")


_SIDES = {"both": (15.0, 15.0), "top": (15.0, 0.0), "bottom": (0.0, 15.0), "none": (0.0, 0.0)}
_TILTS = (
    (5, 0),
    (15, 0),
    (30, 0),
    (45, 0),
    (0, 15),
    (0, 30),
    (0, 45),
    (20, 20),
    (30, -30),
    (45, 45),
)


def _families():  # noqa: C901
    """Name of each case, and how its sheet differs from the plain one."""
    yield "plain", {}
    for dtype, inverted in product(("uint8", "uint16", "float32"), (False, True)):
        yield f"{dtype}{' inverted' if inverted else ''}", {"dtype": dtype, "inverted": inverted}
    for through, top in product("zyx", ("high", "low")):
        laid = {"through": through, "top": top, "coats": (15.0, 8.0), "tilt": (10.0, -5.0)}
        yield f"through {through}, top {top}", laid
    for y, x in _TILTS:
        yield f"tilt {y} {x}", {"tilt": (float(y), float(x))}
    for (name, coats), angle, texture in product(_SIDES.items(), (0.0, 45.0), (0.0, 0.2)):
        kind = "textured" if texture else "smooth"
        changes = {"coats": coats, "texture": texture, "tilt": (0.0, angle)}
        yield f"coated {name}, {kind} base, tilt {angle:.0f}", changes
    for name in ("top", "none"):
        changes = {"coats": _SIDES[name], "tilt": (45.0, 0.0), "inverted": True, "dtype": "float32"}
        yield f"coated {name}, inverted float32, tilt 45", changes
    for voxel, thickness, angle in product((1.4, 3.0), (40.0, 100.0, 400.0), (0.0, 30.0, 45.0)):
        changes = {
            "voxel": voxel,
            "thickness": thickness,
            "coats": (10.0, 10.0),
            "tilt": (0.0, angle),
        }
        yield f"{thickness:.0f} um at voxel {voxel}, tilt {angle:.0f}", changes
    for thickness in (40.0, 400.0):
        size = {"voxel": 3.0, "thickness": thickness}
        yield (
            f"{thickness:.0f} um at voxel 3.0, one side, tilt 45",
            size | {"coats": (0.0, 12.0), "tilt": (45.0, 0.0)},
        )
        yield f"{thickness:.0f} um at voxel 3.0, one material", size | {"coats": (0.0, 0.0)}
    for noise, fwhm in product((0.02, 0.05, 0.1), (2.0, 4.0, 6.0)):
        yield f"noise {100 * noise:.0f} %, blur {fwhm:.0f} um", {"noise": noise, "fwhm": fwhm}
    poor = {"noise": 0.1, "fwhm": 6.0, "tilt": (0.0, 45.0), "texture": 0.1}
    for voxel, name in product((1.4, 3.0), ("both", "top", "none")):
        changes = poor | {"voxel": voxel, "coats": _SIDES[name]}
        yield f"noise 10 %, blur 6 um, voxel {voxel}, coated {name}, tilt 45", changes
    for coat in (3.0, 5.0, 8.0):
        yield f"coating {coat:.0f} um", {"coats": (coat, 15.0)}
        yield f"coating {coat:.0f} um on both sides", {"coats": (coat, coat)}
    yield "thin margin, tilt 45", {"margin": 12.0, "tilt": (45.0, 0.0)}
    for (kind, greys), name in product(
        (("dim", (40.0, 65.0, 210.0)), ("bright", (40.0, 150.0, 200.0))), ("both", "top")
    ):
        yield (
            f"{kind} base, coated {name}, noise 10 %",
            {"greys": greys, "coats": _SIDES[name], "noise": 0.1},
        )
    yield "5 um of air beside it", {"margin": 5.0}
    yield "small", {"lateral": (40, 45)}
    wide = {"lateral": (200, 200), "thickness": 60.0}
    yield "wide, tilt 45", wide | {"tilt": (0.0, 45.0)}
    yield "wide, tilt 45 about both", wide | {"tilt": (35.0, 35.0)}


def cases():
    """Every case by its name."""
    return {name: replace(Sheet(), **changes) for name, changes in _families()}


@dataclass(frozen=True, slots=True)
class Figures:
    """Bias and rms in um, of faces (top, bottom) and layers (coatings, base; NaN where there is
    none).

    ``share`` is that of the columns that were measured; ``coated`` whether both sides were rightly
    recognised.
    """

    faces: list[tuple[float, float]]
    layers: list[tuple[float, float]]
    share: float
    coated: bool

    def missed(self, sheet):
        """Names of the limits that were missed."""
        coats = sheet.coats if sheet.top == "high" else sheet.coats[::-1]
        bias = [abs(layer[0]) for layer, coat in zip(self.layers, coats, strict=False) if coat >= 3]
        kept = {
            "face": all(rms <= _MOST_RMS * sheet.voxel for _, rms in self.faces),
            "coating": all(off <= _MOST_BIAS_UM for off in bias),
            "share": self.share >= _LEAST_SHARE,
            "coated": self.coated,
        }
        return [name for name, is_kept in kept.items() if not is_kept]


def judge(found, sheet):
    """Compare what was found with the planes."""
    truth, up = sheet.surfaces(), Frame(top=sheet.top).sign
    heights = {name: found[name].values for name in truth}
    ok = found["status"].values == 0

    def figures(upper, lower=""):
        """Error of a face, or of the distance of two."""
        error = heights[upper] - truth[upper]
        if lower:
            error = up * (error - (heights[lower] - truth[lower]))
        error = error[ok & np.isfinite(error)] * sheet.cosine
        return (
            (float(error.mean()), float(np.sqrt(np.mean(error**2))))
            if error.size
            else (np.nan, np.nan)
        )

    inner = {face: f"interface_{face}" for face in _FACES}
    is_bare = {face: bool(np.isnan(truth[inner[face]]).all()) for face in _FACES}
    base = [face if is_bare[face] else inner[face] for face in _FACES]
    return Figures(
        faces=[figures(face) for face in _FACES],
        layers=[figures("top", inner["top"]), figures(inner["bottom"], "bottom"), figures(*base)],
        share=float(ok.mean()),
        coated=all(is_bare[face] == np.isnan(heights[inner[face]]).all() for face in _FACES),
    )


def main(*only):
    """Print the table; return the number of cases that missed a limit."""
    part = " ".join(str(word) for word in only)
    print(
        "bias and rms in um: faces along the normal, layers' thickness; share of columns measured"
    )
    head = ("top", "bottom", "coating top", "coating bottom", "base")
    print(f"{'case':52s}" + "".join(f"{name:>15s}" for name in head) + f"{'share':>8s}{'s':>6s}")
    failed = 0
    for name, sheet in cases().items():
        if part not in name:
            continue
        grey = sheet.volume()
        begin = time.perf_counter()
        try:
            found = find_surfaces(grey, frame=Frame(through=sheet.through, top=sheet.top))
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


def wedge(most, voxel, seed=0):
    """A sheet whose top coating grows from 0 to ``most`` um along the columns, and its thickness
    per column."""
    count = 160
    thickness = np.linspace(0.0, most, count)
    parts = [
        Sheet(
            voxel=voxel,
            lateral=(60, 2),
            coats=(float(t), 15.0),
            thickness=60.0,
            margin=20.0,
            seed=seed + k,
        ).volume()
        for k, t in enumerate(thickness)
    ]
    shape = Sheet(voxel=voxel, lateral=(60, count), thickness=60.0, margin=20.0).volume()
    return shape.copy(data=np.concatenate([p.values[:, :, :1] for p in parts], axis=2)), thickness


def thin_layers():
    """Print true against found thickness of layers thinner than the blur: 4 um of blur, voxels of
    1.37 um."""
    print("found thickness in um of thin coatings, blur 4 um, voxel 1.37 um, noise 5 %")
    print(f"{'true':>6s}{'even':>14s}{'other side 15':>16s}{'grey given':>12s}{'in a wedge':>13s}")
    grey, truth = wedge(12.0, 1.37)
    found = find_surfaces(grey)
    along = np.nanmean((found["top"] - found["interface_top"]).values, axis=0)
    for t in (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0):
        cells = []
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
