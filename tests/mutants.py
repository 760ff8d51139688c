"""Mutants of the code: small faults that the tests have to find.

``python -m tests.mutants`` copies the package to a temporary folder, puts in one fault at a time,
and runs the tests that must fail: the fast ones of their files, then those of ci, then the nightly
ones, up to the first tier that kills the mutant, whose name is printed. ``--only 12`` runs one,
``--only 1-20`` some, ``--jobs 2`` two side by side, each with its own copy; ``--list`` names all. A
mutant whose old text is not found exactly once is an error of this list: mend it here.
"""

from __future__ import annotations

import argparse
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
# Lowest first, with what selects it.
TIERS = {"fast": (), "ci": ("--ci",), "nightly": ("-m", "nightly")}
_ENOUGH_S = 900
# A fast test that is only too slow, because it has compiled the kernels anew, kills nothing.
_FAILED = re.compile(r"^(FAILED|ERROR) ", re.MULTILINE)


class Mutant(NamedTuple):
    """One fault: ``old`` in ``src/planish/file`` becomes ``new``, and ``tests`` (arguments of
    pytest) must fail."""

    file: str
    old: str
    new: str
    tests: str


MUTANTS = [
    # core: grids, areas, frames, transformations
    Mutant(
        "core/grid.py",
        "down = row - i\n    right = col - j",
        "down = col - j\n    right = row - i",
        "core/test_grid.py",
    ),
    Mutant("core/grid.py", "(row <= rows - 1)", "(row <= rows - 2)", "core/test_grid.py"),
    Mutant(
        "core/grid.py",
        "return float(self.x_um[0]), float(self.y_um[0])",
        "return float(self.y_um[0]), float(self.x_um[0])",
        "core/test_grid.py resample/test_maps.py marks/test_sheet_holes.py",
    ),
    Mutant(
        "core/area.py",
        "self._least_weight = least_share * factor[0]",
        "self._least_weight = 2 * least_share * factor[0]",
        "core/test_area.py",
    ),
    Mutant(
        "core/frame.py",
        '(self.through == "y") != (self.top == "low")',
        '(self.through == "y") == (self.top == "low")',
        "core/test_frame.py",
    ),
    Mutant(
        "core/frame.py",
        '1.0 if self.top == "high" else -1.0',
        "1.0",
        "core/test_frame.py measure/test_along_normals.py surface/test_any_sheet.py",
    ),
    Mutant(
        "core/transform.py",
        "np.array([[cos * flip, -sin], [sin * flip, cos]])",
        "np.array([[cos * flip, sin], [sin * flip, -cos]])",
        "core/test_transform.py register/test_models.py",
    ),
    Mutant(
        "core/transform.py",
        "pair_of(-linear @ np.asarray(self.shift_um))",
        "pair_of(linear @ np.asarray(self.shift_um))",
        "core/test_transform.py register/test_models.py",
    ),
    Mutant(
        "core/transform.py",
        "np.where(denominators > 0, denominators, np.nan)",
        "denominators",
        "core/test_transform.py register/test_models.py register/test_refusals.py",
    ),
    Mutant(
        "core/axial.py",
        "np.rad2deg(0.5 * np.arctan2(sine, cosine))",
        "np.rad2deg(np.arctan2(sine, cosine))",
        "core/test_axial.py resample/test_maps.py measure/test_orientation.py",
    ),
    Mutant(
        "core/area.py",
        "angle_of(m) if np.iscomplexobj(m) else m",
        "np.rad2deg(np.angle(m)) if np.iscomplexobj(m) else m",
        "core/test_axial.py",
    ),
    # io: sizes and files
    Mutant(
        "io/resolution.py",
        "pixel_um = unit_length / per_unit",
        "pixel_um = unit_length * per_unit",
        "io/test_sizes.py",
    ),
    Mutant(
        "core/numbers.py",
        "TOLERANCE * min(first, second)",
        "100 * TOLERANCE * min(first, second)",
        "io/test_sizes.py",
    ),
    Mutant(
        "io/resolution.py",
        "ROUNDING_DPI = 1.0",
        "ROUNDING_DPI = 0.0001",
        "io/test_sizes.py",
    ),
    Mutant(
        "io/scan_log.py",
        "log.count not in (None, len(log.numbers))",
        "log.count not in (None, len(log.numbers) - 1)",
        "io/test_formats.py",
    ),
    Mutant("io/sections.py", "if len(kinds) > 1:", "if len(kinds) > 2:", "io/test_sections.py"),
    # surface
    Mutant(
        "core/frame.py",
        'if from_high == (self.top == "high"):',
        "if from_high:",
        "surface/test_any_sheet.py surface/test_find.py",
    ),
    Mutant(
        "surface/assemble.py",
        "np.where(in_sheet & ~in_rim, middle",
        "np.where(in_sheet, middle",
        "surface/test_find.py surface/test_centre.py surface/test_presence.py",
    ),
    Mutant(
        "surface/assemble.py",
        "[Status.NO_SHEET, Status.RIM, Status.MEASURED,",
        "[Status.NO_SHEET, Status.MEASURED, Status.MEASURED,",
        "surface/test_find.py surface/test_presence.py",
    ),
    Mutant(
        "surface/centre.py",
        "coarse += regression(",
        "coarse -= regression(",
        "surface/test_centre.py",
    ),
    Mutant(
        "core/_envelope_kernels.py",
        "p * p / (2 * radius_um)",
        "p * p / radius_um",
        "surface/test_disturbed.py measure/test_maps_of_the_sheet.py",
    ),
    Mutant(
        "surface/_fit_kernels.py",
        "return _TABLE[i] + share * rise",
        "return _TABLE[i] - share * rise",
        "surface/test_fit.py",
    ),
    Mutant(
        "surface/_fit_kernels.py",
        "inside = face + p[1]",
        "inside = face - p[1]",
        "surface/test_fit.py",
    ),
    # measure
    Mutant(
        "measure/rays.py",
        "    return np.sqrt(1 + slope[..., 0] ** 2 + slope[..., 1] ** 2)",
        "    return np.sqrt(1 + slope[..., 0] ** 2)",
        "measure/test_along_normals.py",
    ),
    Mutant(
        "measure/registry.py",
        '"coating_bottom": ("interface_bottom", "bottom")',
        '"coating_bottom": ("bottom", "interface_bottom")',
        "measure/test_along_normals.py",
    ),
    Mutant(
        "measure/registry.py",
        "faces.get(upper_face, centre) - faces",
        "faces.get(upper_face, centre) + faces",
        "measure/test_along_normals.py",
    ),
    Mutant(
        "measure/properties.py",
        "            is_whole &= has_coating",
        "            is_whole |= has_coating",
        "measure/test_along_normals.py",
    ),
    Mutant(
        "measure/masses.py",
        "contrast = rays.greys.base - rays.greys.air",
        "contrast = rays.greys.base",
        "measure/test_maps_of_the_sheet.py measure/test_layers.py",
    ),
    Mutant(
        "measure/lengths.py",
        "return cutoff_um * 0.4697",
        "return cutoff_um * 0.6642",
        "measure/test_maps_of_the_sheet.py measure/test_layers.py",
    ),
    Mutant(
        "measure/form.py",
        'outwards = 1.0 if name.endswith("top") else -1.0',
        "outwards = 1.0",
        "measure/test_maps_of_the_sheet.py measure/test_layers.py",
    ),
    Mutant(
        "measure/structure.py",
        "a, b, d = 1 - shrinkage * p * p, -shrinkage * p * q, 1 - shrinkage * q * q",
        "a, b, d = 1 - shrinkage * q * q, -shrinkage * p * q, 1 - shrinkage * p * p",
        "measure/test_orientation.py",
    ),
    Mutant(
        "measure/_ray_kernels.py",
        "value = near * (1 - fr) + far * fr",
        "value = near * fr + far * (1 - fr)",
        "measure/test_rays.py",
    ),
    # flatten
    Mutant(
        "flatten/_kernels.py",
        "strain = 1.0 - rest * inverse",
        "strain = rest * inverse - 1.0",
        "flatten/test_kernels.py flatten/test_relax.py",
    ),
    Mutant(
        "flatten/_mesh_kernels.py",
        "o0[j] = nx * (rx + lx)",
        "o0[j] = nx * (rx - lx)",
        "flatten/test_kernels.py flatten/test_relax.py",
    ),
    Mutant(
        "flatten/distortion.py",
        "area = au * dv - av * du",
        "area = au * dv + av * du",
        "flatten/test_distortion.py",
    ),
    Mutant(
        "flatten/distortion.py",
        "np.sqrt(np.maximum(g22 - g12 * g12 / g11, 0.0))",
        "np.sqrt(np.maximum(g22, 0.0))",
        "flatten/test_distortion.py",
    ),
    Mutant(
        "flatten/curvature.py",
        "patch_um**2 / 16\n",
        "patch_um**2 / 8\n",
        "flatten/test_curvature.py",
    ),
    Mutant(
        "flatten/curvature.py",
        "angle_deficit = 2 * np.pi - angles",
        "angle_deficit = np.pi - angles",
        "flatten/test_curvature.py",
    ),
    Mutant(
        "flatten/_relaxation_kernels.py",
        "stretch = length - rest[j]",
        "stretch = rest[j] - length",
        "flatten/test_relaxation.py",
    ),
    # marks
    Mutant(
        "marks/hole_criteria.py",
        "x <= right - radius",
        "x <= right + radius",
        "marks/test_find.py",
    ),
    Mutant(
        "marks/hole_criteria.py",
        "return marks.outside - marks.inside",
        "return marks.inside - marks.outside",
        "marks/test_find.py",
    ),
    Mutant(
        "marks/sheet_holes.py",
        'to_face_um = (-face_share if side == "top" else face_share) * offset_um',
        "to_face_um = face_share * offset_um",
        "marks/test_sheet_holes.py",
    ),
    Mutant(
        "marks/sheet_holes.py",
        "if shares.size and np.median(shares) > MATERIAL:",
        "if True:",
        "marks/test_sheet_holes.py",
    ),
    Mutant(
        "core/grid.py",
        "np.searchsorted(places_um, middle_um - radius_um)",
        "np.searchsorted(places_um, middle_um - 0.5 * radius_um)",
        "marks/test_mask.py",
    ),
    Mutant(
        "marks/rims.py",
        "y += dy\n        radius = fit[0]",
        "y -= dy\n        radius = fit[0]",
        "marks/test_find.py",
    ),
    Mutant("marks/regions/_kernels.py", "if ya > yb:", "if ya > yb + 1e30:", "test_regions.py"),
    Mutant(
        "marks/regions/_kernels.py",
        "np.searchsorted(x, at)",
        "np.searchsorted(x, at, 'right')",
        "test_regions.py",
    ),
    Mutant(
        "marks/regions/model.py", "(ring - 0.5) * pixel_um", "ring * pixel_um", "test_regions.py"
    ),
    Mutant(
        "marks/regions/files.py",
        "ring_of(roi.coordinates() + _NUDGE)",
        "ring_of(roi.coordinates())",
        "test_regions.py",
    ),
    Mutant(
        "run/overlay.py", "is_allowed & ~self.regions.inside(part)", "is_allowed", "test_regions.py"
    ),
    # register
    Mutant(
        "register/similarity.py",
        "angle = float(np.angle(alpha))",
        "angle = -float(np.angle(alpha))",
        "register/test_models.py",
    ),
    Mutant(
        "register/similarity.py",
        "np.sum(share * zc.conj() * wc)",
        "np.sum(zc.conj() * wc) / len(z)",
        "register/test_models.py",
    ),
    Mutant(
        "register/pairs.py",
        "(-x if mirrored else x) + 1j * y",
        "x + 1j * y",
        "register/test_models.py",
    ),
    Mutant(
        "register/result.py",
        "np.sqrt(2.0 * self.field.mark_variance",
        "np.sqrt(self.field.mark_variance",
        "register/test_models.py",
    ),
    Mutant(
        "register/result.py",
        "square_errors = square_errors * stretch + fit.expected_error_um(points_um) ** 2",
        "square_errors = square_errors + fit.expected_error_um(points_um) ** 2",
        "register/test_chain.py",
    ),
    Mutant("register/result.py", "% 2 == 1", ">= 1", "register/test_chain.py"),
    Mutant(
        "register/spline.py",
        "0.5 * squares * np.log(squares)",
        "squares * np.log(squares)",
        "register/test_thin_plate.py",
    ),
    Mutant(
        "register/field.py",
        "np.log(_AFFINE[1:, None])",
        "0.5 * np.log(_AFFINE[1:, None])",
        "register/test_averaged.py",
    ),
    Mutant(
        "register/field.py",
        "form[6:, 6:] -= np.diag(explained_variance)",
        "form[6:, 6:] += np.diag(explained_variance)",
        "register/test_averaged.py",
    ),
    Mutant(
        "register/fit.py",
        "is_right[removed[:wrong_count]] = False",
        "is_right[removed] = False",
        "register/test_robust.py",
    ),
    # resample
    Mutant(
        "resample/maps.py",
        "vectors = vectors.conj()",
        "vectors = vectors.copy()",
        "resample/test_maps.py",
    ),
    Mutant(
        "resample/maps.py",
        "np.exp(2j * similarity.rotation_rad)",
        "np.exp(-2j * similarity.rotation_rad)",
        "resample/test_maps.py",
    ),
    Mutant(
        "resample/_kernels.py",
        "return (wb + wc, wb) if number & 1",
        "return (wb, wb + wc) if number & 1",
        "resample/test_quads.py",
    ),
    # analyze
    Mutant(
        "analyze/multiple_regression.py",
        "return min(1 + 1 / variance, float(lags.n))",
        "return float(lags.n)",
        "analyze/test_explain.py",
    ),
    Mutant(
        "analyze/shared_errors.py",
        "covariance = signs * variances @ signs.T",
        "covariance = abs(signs) * variances @ abs(signs).T",
        "analyze/test_explain.py",
    ),
    Mutant(
        "analyze/scales.py",
        "rest = total - noise_power",
        "rest = total",
        "analyze/test_scales.py",
    ),
    Mutant(
        "analyze/scales.py",
        "gain = sign * abs(cross_rest) / own_power",
        "gain = abs(cross_rest) / own_power",
        "analyze/test_scales.py",
    ),
    Mutant(
        "analyze/correlation.py",
        "        is_valid = np.isfinite(x) & np.isfinite(y)\n        n = ",
        "        is_valid = np.isfinite(x)\n        n = ",
        "analyze/test_correlate.py",
    ),
    Mutant(
        "analyze/correlation.py",
        "slope = product / self._square[0, 0]",
        "slope = product / self._square[1, 1]",
        "analyze/test_correlate.py",
    ),
    Mutant(
        "texture/ncc.py",
        "isfinite(r), r, -np.inf",
        "isfinite(r), np.abs(r), -np.inf",
        "analyze/test_lag.py",
    ),
    # sections, correct
    Mutant(
        "sections/volume.py",
        "weight = np.clip(passed_um / spacing_um, 0.0, 1.0)",
        "weight = np.clip((places_um[after] - planes_um) / spacing_um, 0.0, 1.0)",
        "sections/test_volume.py",
    ),
    Mutant(
        "sections/network.py",
        "_HALF = 1.0 / np.sqrt(0.5) - 1.0",
        "_HALF = 1.0",
        "sections/test_align.py sections/test_reference.py",
    ),
    Mutant(
        "sections/_kernels.py",
        "x = c + pose[1] - pose[3] * (r - middle_r)",
        "x = c + pose[1] + pose[3] * (r - middle_r)",
        "sections/test_volume.py sections/test_align.py",
    ),
    Mutant(
        "sections/pairs.py",
        "step[:, :2] /= np.clip(reached",
        "step[:, :2] *= np.clip(reached",
        "sections/test_fine.py",
    ),
    Mutant(
        "run/position_error.py",
        "sections_um2 += _sections_um2(reference",
        "sections_um2 = _sections_um2(reference",
        "flatten/test_neutral.py",
    ),
    Mutant(
        "correct/cupping.py",
        "100.0 * (1.0 - 1.0 / max(",
        "100.0 * (1.0 - max(",
        "correct/test_correct.py",
    ),
    # synthetic, validate
    Mutant(
        "synthetic/params.py",
        "rng.integers(limits[0], limits[1] + 1)",
        "rng.integers(limits[0], limits[1])",
        "synthetic/test_specimen.py -k drawn",
    ),
    Mutant(
        "synthetic/_kernels.py",
        "s = (dx * nx + dy * ny + dz * nz) / n",
        "s = dx * nx + dy * ny + dz * nz",
        "synthetic/test_specimen.py -k inverse",
    ),
    Mutant(
        "validate/errors.py",
        "100.0 * (1.0 / similar.transform.scale - 1.0)",
        "100.0 * (similar.transform.scale - 1.0)",
        "validate/test_ledger.py -k too_large",
    ),
    Mutant(
        "validate/truth.py",
        "return np.hypot(linked_u - u, linked_v - v)",
        "return np.abs(linked_u - u)",
        "validate/test_ledger.py -k shift_of",
    ),
]


def main(arguments: list[str]) -> int:
    """Run the mutants and return how many survived."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--only", help="number of a mutant, or first-last")
    parser.add_argument(
        "--list", action="store_true", help="name all mutants and whether their text is there"
    )
    parser.add_argument(
        "--jobs", type=int, default=1, help="mutants that run side by side, each in its own copy"
    )
    asked = parser.parse_args(arguments)
    first, last = 1, len(MUTANTS)
    if asked.only:
        first, _, end = asked.only.partition("-")
        first, last = int(first), int(end or first)
    chosen = list(enumerate(MUTANTS, 1))[first - 1 : last]
    stale = [f"{k}: {m.file}: found {n} times: {m.old}" for k, m in chosen if (n := _count(m)) != 1]
    print("".join(f"{line}\n" for line in stale), end="")
    if asked.list or stale:
        print(
            *(f"{k}: {m.file}: {m.old!r} -> {m.new!r}" for k, m in chosen if asked.list), sep="\n"
        )
        return len(stale)
    found = Counter(run_side_by_side(chosen, asked.jobs))
    killed = {tier: found[tier] for tier in TIERS}
    of_each = ", ".join(f"{count} by {tier}" for tier, count in killed.items())
    print(f"{sum(killed.values())} of {len(chosen)} killed: {of_each}")
    return len(chosen) - sum(killed.values())


def run_side_by_side(chosen: list[tuple[int, Mutant]], jobs: int) -> list[str]:
    """Run so many mutants at a time, print each when it is done, and return what :func:`run` says
    of each."""
    copies: queue.SimpleQueue[Path] = queue.SimpleQueue()

    def run_and_print(numbered: tuple[int, Mutant]) -> str:
        number, mutant = numbered
        folder, start = copies.get(), time.perf_counter()
        try:
            state = run(mutant, folder, number)
        finally:
            copies.put(folder)
        said = f"killed by {state}" if state in TIERS else state
        print(
            f"{number}: {said}, {time.perf_counter() - start:.0f} s: {mutant.file}: {mutant.new!r}",
            flush=True,
        )
        return state

    with (
        tempfile.TemporaryDirectory(prefix="planish-mutants-") as name,
        ThreadPoolExecutor(jobs) as workers,
    ):
        for k in range(jobs):
            shutil.copytree(ROOT / "src", Path(name, str(k), "src"))
            copies.put(Path(name, str(k)))
        return [*workers.map(run_and_print, chosen)]


def run(mutant: Mutant, folder: Path, number: int) -> str:
    """Put one mutant into a copy of the package: the tier that kills it, SURVIVED, or what else
    happened."""
    file = folder / "src" / "planish" / mutant.file
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace(mutant.old, mutant.new), encoding="utf-8")
    # The kernels of all mutants are the same, but for those whose own kernels are changed.
    kernels = folder / (f"kernels-{number}" if file.stem.endswith("kernels") else "kernels")
    environment = os.environ | {"PYTHONPATH": str(folder / "src"), "NUMBA_CACHE_DIR": str(kernels)}
    try:
        return first_tier_that_fails(mutant.tests, environment)
    except subprocess.TimeoutExpired:
        return f"ended after {_ENOUGH_S} s"
    finally:
        file.write_text(text, encoding="utf-8")


def first_tier_that_fails(tests: str, environment: dict[str, str]) -> str:
    """Run the tests of one tier after the other: the first that fails, SURVIVED, or what else
    happened."""
    files, _, keyword = tests.partition(" -k ")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-x",
        "-n",
        "0",
        "-p",
        "no:cacheprovider",
        "--no-header",
    ]
    command += [f"tests/{file}" for file in files.split()] + (["-k", keyword] if keyword else [])
    codes: set[int] = set()
    for tier, options in TIERS.items():
        done = subprocess.run(
            [*command, *options],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=_ENOUGH_S,
        )
        if done.returncode == pytest.ExitCode.TESTS_FAILED and _FAILED.search(done.stdout):
            return tier
        if (
            done.returncode > pytest.ExitCode.TESTS_FAILED
            and done.returncode != pytest.ExitCode.NO_TESTS_COLLECTED
        ):
            return f"{tier} ended with {done.returncode}:\n{done.stdout[-2000:]}"
        codes.add(done.returncode)
    return (
        "no test of it was found" if codes == {pytest.ExitCode.NO_TESTS_COLLECTED} else "SURVIVED"
    )


def _count(mutant: Mutant) -> int:
    path = ROOT / "src" / "planish" / mutant.file
    return path.read_text(encoding="utf-8").count(mutant.old) if path.is_file() else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
