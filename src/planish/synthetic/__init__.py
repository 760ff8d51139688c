"""A specimen whose every answer is known: it feeds the demo, the tests, the benchmarks and the calibration.

Everything is defined in material coordinates ``(u, v, s)`` of the flat sheet and carried into space by an
exact map, so the truth at any pixel or voxel is a formula and not a measurement.
"""

from planish.synthetic.draws import draw_params
from planish.synthetic.files import InstrumentFiles, write_image, write_instruments, write_nodes, write_truth
from planish.synthetic.nuisances import NUISANCES, amended, nuisances_of, with_only, without
from planish.synthetic.params import (
    SIZES_UM,
    CameraParams,
    HoleParams,
    PaperParams,
    PrintParams,
    ScannerParams,
    SectionsParams,
    SpecimenParams,
)
from planish.synthetic.presets import MICRO_CT, PRESETS, preset
from planish.synthetic.sheet import Sheet
from planish.synthetic.specimen import Specimen, make_specimen
from planish.synthetic.warp import Warp, slope_for

__all__ = [
    "MICRO_CT",
    "NUISANCES",
    "PRESETS",
    "SIZES_UM",
    "CameraParams",
    "HoleParams",
    "InstrumentFiles",
    "PaperParams",
    "PrintParams",
    "ScannerParams",
    "SectionsParams",
    "Sheet",
    "Specimen",
    "SpecimenParams",
    "Warp",
    "amended",
    "draw_params",
    "make_specimen",
    "nuisances_of",
    "preset",
    "slope_for",
    "with_only",
    "without",
    "write_image",
    "write_instruments",
    "write_nodes",
    "write_truth",
]
