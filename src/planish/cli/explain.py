"""The command that explains a map by others."""

from pathlib import Path
from typing import Any

from planish.analyze.params import ExplainParams
from planish.cli.answers import show_answer
from planish.cli.options import build_params, existing, json_option, options, page_option, verb


@verb(
    "planish explain run --of coating_top --of base_thickness --out explained",
    "planish explain run --response image --of coating_top,base_surface_top --cell-um 50 --json",
    "planish explain series --of coating_top,base_thickness --out pooled",
)
@existing("run")
@options(ExplainParams, "Model")
@page_option
@json_option
def explain(run: Path, out: Path | None, as_json: bool, **values: Any) -> int:
    """State how much of a map of RUN each of several others explains, on cells of a stated size.

    Without options the model is the one that the study of RUN declares ([explain]). Coefficients
    have intervals that rest on independent cells, not on pixels. RUN may be the folder of a series:
    its sheets are pooled. OUT gets explain.html, explain.json and the tables as CSV.
    """
    from planish.core.errors import InputError
    from planish.report.explain import coefficient_tables
    from planish.report.sentences.explain import say_answer, say_surer
    from planish.series.explain import declared_model, explain_folder, write_explained

    is_given = any(values[name] for name in ExplainParams.model_fields)
    params = build_params(ExplainParams, values)
    if not is_given:
        params = declared_model(run)
        if not params.is_declared:
            raise InputError(
                f"{run} declares no model. Name the maps that explain the image with `of`, or"
                " declare them in the study: [explain] with of = [...]."
            )
    elif params.factors is not None:
        params = params.model_copy(update={"factors": str(Path(params.factors).absolute())})
    model = explain_folder(run, params)
    if out is not None:
        write_explained(model, out, source=run.resolve().name)
    sentences = [say_answer(model), *say_surer(model)]
    page = out and out / "explain.html"
    show_answer(model, coefficient_tables(model), sentences, page=page, as_json=as_json)
    return 0
