"""Field size and hole size -> a pattern of laser holes, checked, drawn, and as a program for the stage."""

from planish.marks.design.dxf import pattern_dxf
from planish.marks.design.gcode import Stage, stage_program
from planish.marks.design.pattern import Burn, Pattern, own_pattern, read_text
from planish.marks.design.plan import design_pattern
from planish.marks.design.predict import Imaging, Predicted, hole_error_um, predict
from planish.marks.design.route import short_route, way_um
from planish.marks.design.rules import Rule, check_pattern, refuse_broken
from planish.marks.design.simulate import DryRun, Limits, dry_run
from planish.marks.design.tables import holes_csv, read_pattern

__all__ = [
    "Burn",
    "DryRun",
    "Imaging",
    "Limits",
    "Pattern",
    "Predicted",
    "Rule",
    "Stage",
    "check_pattern",
    "design_pattern",
    "dry_run",
    "hole_error_um",
    "holes_csv",
    "own_pattern",
    "pattern_dxf",
    "predict",
    "read_pattern",
    "read_text",
    "refuse_broken",
    "short_route",
    "stage_program",
    "way_um",
]
