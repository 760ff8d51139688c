"""Two instruments on one sheet: their volumes linked through their maps, against the truth of the sheet.

The sheet is bent otherwise in the second instrument, as a specimen is that was embedded and cut after its scan.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.pipeline import Layers
from planish.study import LayersStudy
from planish.synthetic import InstrumentFiles, Specimen, make_specimen, write_instruments
from planish.validate.scenario import Scenario
from planish.validate.spread import Values, percentile, rms
from planish.validate.truth import material_at, true_thickness

Array = NDArray[np.float64]
NAMES = ("first", "second")


def make_pair(
    scenario: Scenario, seed: int, folder: Path
) -> list[tuple[Specimen, InstrumentFiles]]:  # fmt: skip
    """Make the sheet as both instruments have it, and write their files."""
    assert scenario.second is not None
    first = make_specimen(scenario.params(seed))
    second = make_specimen(scenario.second_params(seed), sheet=first.sheet)
    instruments = (scenario.instrument, scenario.second.instrument)
    return [
        (specimen, write_instruments(specimen, folder / name, volume=instrument, image=False))
        for name, specimen, instrument in zip(NAMES, (first, second), instruments, strict=True)
    ]


def pair_study(scenario: Scenario, made: list[tuple[Specimen, InstrumentFiles]]) -> LayersStudy:
    """The study that links the first volume to the second."""
    layers: list[dict[str, Any]] = []
    for name, (_, files) in zip(NAMES, made, strict=True):
        study: dict[str, Any] = {"volume": {"path": str(files.volume), "through": files.through}}
        for table in ("surface", "properties", "flatten"):
            study[table] = scenario.study.get(table, {})
        layers.append({"name": name, "map": study})
    return LayersStudy.model_validate(
        {
            "layers": layers,
            "registration": scenario.study.get("registration", {}),
            "correlate": {"point_um": scenario.point_um},
        }
    )


def pair_values(made: list[tuple[Specimen, InstrumentFiles]], run: Layers) -> Values:
    """Figures of one pair; places and thicknesses against the truth of the sheet."""
    maps = [run.groups[f"layers/{name}"] for name in NAMES]
    valid = maps[0]["valid"].values & maps[1]["valid"].values
    values: Values = {}
    shown: list[Array] = []
    for name, (specimen, files), data in zip(NAMES, made, maps, strict=True):
        sections = run.runs[name].groups.get("sections")
        shown.append(_material(specimen, files, data, valid, sections))
        true = true_thickness(specimen.sheet, "coating_top", shown[-1][..., 0], shown[-1][..., 1])
        values[f"pair_coating_{name}_bias"] = float(np.nanmean(data["coating_top"].values[valid] - true))
    off = np.hypot(*(shown[0] - shown[1])[..., :2].T)
    off = off[np.isfinite(off)]
    values["pair_median"], values["pair_p95"], values["pair_rms"] = percentile(off, 50), percentile(off, 95), rms(off)
    values["pair_predicted_rms"] = rms(maps[0]["expected_error"].values[valid].astype(np.float64))
    rows = [row for row in run.results["pairs"] if row["a_map"] == "coating_top"]
    if rows:
        values["pair_r"], values["pair_r_point"] = rows[0]["r"], rows[1]["r"]
        values["pair_difference_sd"] = rows[0]["difference_sd"]
    return values


def _material(
    specimen: Specimen, files: InstrumentFiles, data: xr.Dataset, valid: NDArray[np.bool_],
    sections: xr.Dataset | None,
) -> Array:  # fmt: skip
    """Material (n, 3) at the places in the volume that the run gives for valid pixels."""
    places = np.stack([data[f"volume_{axis}"].values[valid] for axis in ("x", "y", "z")], axis=-1)
    return material_at(specimen, files, places.astype(np.float64), sections)
