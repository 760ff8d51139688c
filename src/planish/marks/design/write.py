"""Files of a designed pattern: text files as bytes, and pictures."""

from __future__ import annotations

from pathlib import Path

from planish.marks.design.draw import drawing_page, error_page, path_page
from planish.marks.design.gcode import pattern_dxf, stage_program
from planish.marks.design.params import ImagingParams, StageParams
from planish.marks.design.pattern import Pattern, holes_csv
from planish.marks.design.predict import Predicted, predict
from planish.marks.design.rules import Rule
from planish.marks.design.sheet import encode, house_style
from planish.marks.design.simulate import DryRun, dry_run


def write_design(
    pattern: Pattern,
    rules: tuple[Rule, ...],
    folder: str | Path,
    *,
    stage: StageParams | None = None,
    imaging: ImagingParams | None = None,
) -> tuple[tuple[str, ...], DryRun, Predicted]:
    """Write a pattern into a folder that exists: JSON, two tables, DXF, stage program, drawings.

    Parameters
    ----------
    pattern : Pattern
    rules : tuple of Rule
        As checked, for the drawing.
    folder : str or Path
    stage, imaging : optional
        What the program asks of the stage and its range, and where the predicted error comes from.

    Returns
    -------
    files : tuple of str
        Names in the folder.
    run : DryRun
        Of the stage program, read back from its text.
    predicted : Predicted

    Raises
    ------
    MarkError
        If the dry run refuses the program, such as one that leaves the stage's range.
    OSError
        If a file cannot be written.
    """
    stage, imaging = stage or StageParams(), imaging or ImagingParams()
    program = stage_program(pattern, stage)
    # The pulse that is asked for here is meant; a program from elsewhere is held to the usual length.
    run, predicted = dry_run(program, stage, pulse_s=max(0.05, pattern.pulse_s)), predict(pattern, imaging)
    files: dict[str, bytes] = {
        "pattern.json": pattern.to_json().encode(),
        "holes.csv": holes_csv(pattern).encode(),
        "holes_as_imaged.csv": holes_csv(pattern, imaged=True).encode(),
        "pattern.dxf": pattern_dxf(pattern).encode("ascii"),
        "program.gcode": program.encode("ascii"),
    }
    with house_style():
        pages = [drawing_page(pattern), error_page(pattern, predicted, imaging, rules), path_page(run)]
        files["drawing.svg"] = encode(pages, "svg")
        for name, page in zip(("drawing", "predicted_error", "path"), pages, strict=True):
            files[f"{name}.png"] = encode([page], "png")
        files["drawing.pdf"] = encode(pages, "pdf", f"Laser holes: {pattern.name}")
    for name, content in files.items():
        (Path(folder) / name).write_bytes(content)
    return tuple(files), run, predicted


def path_picture(run: DryRun, kind: str, *, title: str = "Path of the stage") -> bytes:
    """Draw the path of a dry run as ``png``, ``svg`` or ``pdf``."""
    with house_style():
        return encode([path_page(run, title=title)], kind, title)
