"""Compare a run with the truth of the specimen that it was made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planish.pipeline import Run
from planish.synthetic import Specimen


@dataclass(frozen=True, slots=True, kw_only=True)
class Ledger:
    """Errors of one run; lengths in um.

    ``position_*`` is the distance in the sheet between the material that a pixel shows and the material at the place in
    the volume that the run gives for it.
    """

    holes: int
    found: int
    false: int
    position_median: float
    position_p95: float
    coating_bias: float
    coating_rmse: float
    base_bias: float
    base_rmse: float
    r2: float
    r2_true: float
    r2_projection_fixed: float
    r2_projection: float
    leave_one_out: float
    coverage: float


def ledger(specimen: Specimen, run: Run) -> Ledger:
    """Measure the errors of a run over all of its valid pixels."""
    linked, truth = run.groups["linked"], specimen.truth
    assert run.marks is not None
    ok = linked["valid"].values
    place = np.stack([linked[f"volume_{axis}"].values for axis in "xyz"], axis=-1)[ok]
    material = specimen.warp.material(place)
    distance = np.hypot(material[:, 0] - truth["u"].values[ok], material[:, 1] - truth["v"].values[ok])

    def error(name: str) -> np.ndarray:
        return linked[name].values[ok].astype(float) - truth[name].values[ok]

    def r2(values: np.ndarray) -> float:
        return float(np.corrcoef(values[ok], linked["image"].values[ok])[0, 1] ** 2)

    in_image = specimen.pose(specimen.sheet.holes)
    fixed = np.stack([run.marks["fixed_x"].values, run.marks["fixed_y"].values], axis=1)
    nearest = np.linalg.norm(fixed[:, None] - in_image[None], axis=-1)
    true = nearest.min(axis=1) < 20.0
    table = {(row["registration"], row["point_um"] < 50): row["r2"] for row in run.results["table"]}
    coating, base = error("coating_top"), error("base_thickness")
    return Ledger(
        holes=len(in_image),
        found=len(set(nearest.argmin(axis=1)[true].tolist())),
        false=int(np.count_nonzero(~true)),
        position_median=float(np.median(distance)),
        position_p95=float(np.percentile(distance, 95)),
        coating_bias=float(coating.mean()),
        coating_rmse=float(np.sqrt(np.mean(coating**2))),
        base_bias=float(base.mean()),
        base_rmse=float(np.sqrt(np.mean(base**2))),
        r2=r2(linked["coating_top"].values),
        r2_true=r2(truth["coating_top"].values),
        r2_projection_fixed=table["projection, no scale", True],
        r2_projection=table["projection, similarity", True],
        leave_one_out=float(run.results["marks"]["leave_one_out_rms_um"]),
        coverage=float(run.results["linked"]["share_valid_of_sheet"]),
    )
