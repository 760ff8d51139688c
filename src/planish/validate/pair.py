"""Two instruments on one sheet: their volumes linked through their maps, against the truth of the sheet.

The sheet is bent otherwise in the second instrument, as a specimen is that was embedded and cut after its scan.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.pipeline import Run
from planish.study import Study
from planish.synthetic import InstrumentFiles, Specimen, make_specimen, write_instruments
from planish.validate.scenario import Scenario
from planish.validate.truth import Comparison, Values, percentile, rms, true_thickness

Array = NDArray[np.float64]
Made = list[tuple[Specimen, InstrumentFiles]]
NAMES = ("first", "second")


def make_pair(scenario: Scenario, seed: int, folder: Path) -> Made:
    """Make the sheet as both instruments have it, and write their files."""
    assert scenario.second is not None
    first = make_specimen(scenario.params(seed))
    second = make_specimen(scenario.second_params(seed), sheet=first.sheet)
    instruments = (scenario.instrument, scenario.second.instrument)
    return [
        (specimen, write_instruments(specimen, folder / name, volume=instrument, image=False))
        for name, specimen, instrument in zip(NAMES, (first, second), instruments, strict=True)
    ]


def pair_study(scenario: Scenario, made: Made) -> Study:
    """The study that links the first volume to the second."""
    layers: list[dict[str, Any]] = []
    for name, (_, files) in zip(NAMES, made, strict=True):
        tables = {table: scenario.study.get(table, {}) for table in ("surface", "properties", "flatten")}
        layers.append({"name": name, "volume": {"path": str(files.volume), "through": files.through}, **tables})
    registration, correlate = scenario.study.get("registration", {}), {"point_um": scenario.point_um}
    return Study.model_validate({"layers": layers, "registration": registration, "correlate": correlate})


def pair_values(made: Made, run: Run) -> Values:
    """Figures of one pair; places and thicknesses against the truth of the sheet."""
    maps = [run.groups[f"layers/{name}"] for name in NAMES]
    valid = maps[0]["valid"].values & maps[1]["valid"].values
    values: Values = {}
    shown: list[Array] = []
    for name, (specimen, files), data in zip(NAMES, made, maps, strict=True):
        places = np.stack([data[f"volume_{axis}"].values[valid] for axis in ("x", "y", "z")], axis=-1)
        both = Comparison(specimen=specimen, files=files, groups=run.sheets[name].groups)
        shown.append(both.material_at(places.astype(np.float64)))
        true = true_thickness(specimen.sheet, "coating_top", shown[-1][..., 0], shown[-1][..., 1])
        values[f"pair_coating_{name}_bias"] = float(np.nanmean(data["coating_top"].values[valid] - true))
    off = np.hypot(*(shown[0] - shown[1])[..., :2].T)
    off = off[np.isfinite(off)]
    values["pair_median"], values["pair_p95"], values["pair_rms"] = percentile(off, 50), percentile(off, 95), rms(off)
    values["pair_predicted_rms"] = rms(maps[0]["expected_error"].values[valid].astype(np.float64))
    rows = [row for row in run.results.correlations if row.a_map == "coating_top"]
    if rows:
        values["pair_r"], values["pair_r_point"] = rows[0].r, rows[1].r
        values["pair_difference_sd"] = rows[0].difference_sd
    return values
