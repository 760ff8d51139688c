"""Map a sheet from photographs of serial sections: a folder of pictures with ``sections.csv``.

``planish map sections --through y`` does the same.
``python examples/08_serial_sections.py [FOLDER]`` writes ``08_serial_sections.png``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import planish as pl
from planish.run import run_study
from planish.run.study import as_study
from planish.synthetic import BurnParams, SectionsParams, SpecimenParams, write_instruments

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)

# The microtome cuts across the sheet every 4 um; each photograph is shifted, turned, and exposed a
# little differently.
params = SpecimenParams(
    size_um=(800.0, 600.0),
    holes=BurnParams(pattern="irregular", count=1),
    sections=SectionsParams(pixel_um=3.0, section_um=4.0),
    seed=3,
)
with tempfile.TemporaryDirectory() as folder:
    specimen = pl.make_specimen(params)
    files = write_instruments(specimen, Path(folder), volume="sections", image=False)
    print((files.volume / "sections.csv").read_text().splitlines()[:4])

    # The rows of a photograph run through the sheet: the axis is y. Sections are aligned, made
    # equally bright, and joined to a volume first. A study holds every parameter of a run, as its
    # file run.toml does.
    run = run_study(as_study({"volume": {"path": str(files.volume), "through": "y"}}))

facts = run.results.layers[0].sheet.sections
print(
    f"{facts.count} sections, {facts.missing} missing, {facts.not_aligned} not aligned; shifts "
    f"{facts.shift_row_rms_um:.2f} um (row), {facts.shift_col_rms_um:.2f} um (column) rms corrected"
)
print(f"coating of the top side {float(run.maps.coating_top.mean()):.1f} um on average")

sections = run.groups["sections"]
figure, axes = plt.subplots(2, 1, figsize=(7, 7), layout="constrained")
axes[0].plot(sections.position, sections.shift_row, label="through the sheet")
axes[0].plot(sections.position, sections.shift_col, label="along the sheet")
axes[0].set(
    xlabel="position of the section / um",
    ylabel="shift / um",
    title="What each section was shifted by",
)
axes[0].legend()
run.maps.coating_top.plot(ax=axes[1], robust=True, yincrease=False)
axes[1].set_aspect("equal")
figure.savefig(out / "08_serial_sections.png", dpi=100)
