"""The command that describes maps by octaves of wavelength."""

from pathlib import Path
from typing import Any

from planish.analyze.params import ScalesParams
from planish.cli.answers import show_answer
from planish.cli.options import build_params, existing, json_option, options, page_option, verb


@verb(
    "planish scales run --out scales",
    "planish scales run --map coating_top --against base_surface_top --out levelling",
    "planish scales run --map image --json",
)
@existing("run")
@options(ScalesParams, "Octaves")
@page_option
@json_option
def scales(run: Path, out: Path | None, as_json: bool, **values: Any) -> None:
    """State how much each map of RUN varies by octaves of wavelength, without its noise.

    Without options the maps are those that the study of RUN declares ([scales]), or all of them.
    With --against also what they show of another map: gain, coherence and phase. OUT gets
    scales.html, scales.json and the octaves as CSV.
    """
    from planish.report.scales import band_tables
    from planish.report.sentences.scales import say_answer, say_notes, say_surer
    from planish.run.map_scales import scales_of_run, write_scales
    from planish.run.run import open_run

    params = build_params(ScalesParams, values)
    opened = open_run(run)
    if not params.is_declared:
        params = opened.study.scales
    octaves = scales_of_run(opened, params)
    if out is not None:
        write_scales(octaves, out, source=run.resolve().name)
    sentences = [say_answer(octaves), *say_surer(octaves), *say_notes(octaves)]
    page = out and out / "scales.html"
    show_answer(octaves, band_tables(octaves), sentences, page=page, as_json=as_json)
