"""``pl.explain``: a model of a run, of a Dataset, or of a series pooled over its sheets."""

from collections.abc import Sequence
from pathlib import Path

import xarray as xr

from planish import __version__
from planish.analyze.explain import Explained
from planish.analyze.explain_sheets import ExplainedSeries, explained_over_sheets
from planish.analyze.params import ExplainParams
from planish.core.arrays import check_path
from planish.core.errors import CannotMeasure, PlanishError
from planish.core.options import params_of
from planish.report import explain_page, tables_of
from planish.run.answers import write_answer
from planish.run.explain import explain_dataset, explain_run
from planish.run.run import Run, is_run, open_run
from planish.series.pages import RESULTS
from planish.series_results import SeriesResults


def explain(
    data: Run | xr.Dataset | str | Path,
    *,
    response: str,
    of: Sequence[str],
    cell_um: float = 100.0,
    corrected: bool = False,
    factors: str | Path | None = None,
) -> Explained | ExplainedSeries:
    """State how much of a map each of several others explains, on cells of a stated size.

    Parameters
    ----------
    data : Run, Dataset or path
        A run, its folder or that of a series; or maps on one grid with coordinates in um: missing
        is NaN, ``valid`` says which pixels count if it is there, and ``NAME_se`` is the standard
        error of map NAME (of surfaces, such as ``interface_top_se``, as well).
    response : str
        Map that is explained; ``LAYER.MAP`` where several layers have one of that name.
    of : sequence of str
        Maps that explain it. A map of truth values or labels is a factor.
    cell_um : float
        Edge of the cells over which all maps are averaged first.
    corrected : bool
        Take the stated errors of the maps off (:func:`planish.analyze.covariance_of_errors`).
    factors : path, optional
        Named regions, whose share of a cell is a predictor.

    Returns
    -------
    Explained or ExplainedSeries
        ``coefficients[name]`` with ``standardised``, ``interval`` (95 %), ``plain`` and ``vif``;
        ``r2``, ``r2_out``, ``n``, ``n_eff``. Of a series pooled over sheets.

    Raises
    ------
    InputError, SizeError, CannotMeasure
        If a map is missing, angles of an axis, or a sum of others; a cell smaller than a pixel; or
        the field holds fewer than 10 independent cells for each coefficient.

    Examples
    --------
    >>> model = planish.explain(run, response="image", of=["coating_top"])  # doctest: +SKIP
    >>> model.coefficients["coating_top"].interval  # doctest: +SKIP
    """
    options = {
        "response": response,
        "of": tuple(of),
        "cell_um": cell_um,
        "corrected": corrected,
        "factors": None if factors is None else str(factors),
    }
    params = params_of(ExplainParams, options, "pl.explain")
    if isinstance(data, xr.Dataset):
        return explain_dataset(data, params)
    if isinstance(data, Run):
        return explain_run(data, params)
    call = 'pl.explain("run", response=..., of=[...])'
    return explain_folder(check_path(data, "a run", "pl.explain", call), params)


def explain_folder(folder: Path, params: ExplainParams) -> Explained | ExplainedSeries:
    """The model of a run folder, or of that of a series; errors as of :func:`explain`."""
    if (folder / RESULTS).is_file() and not is_run(folder):
        return explain_series(SeriesResults.read(folder / RESULTS), folder, params)
    return explain_run(open_run(folder), params)


def declared_model(folder: Path) -> ExplainParams:
    """The model that the study of a run, or of the first run of a series, declares; maybe none."""
    if is_run(folder):
        return open_run(folder).study.explain
    for specimen in SeriesResults.read(folder / RESULTS).specimens:
        if home := specimen.member.folder(folder):
            return open_run(home).study.explain
    return ExplainParams()


def explain_series(results: SeriesResults, home: Path, params: ExplainParams) -> ExplainedSeries:
    """Explain a map in each specimen of a series, and pool over sheets.

    A specimen without a run, without such a model, or with one that a check doubts is left out, and
    the result says why. ``home``: folder of the series, to which runs are relative.

    Raises
    ------
    CannotMeasure
        If there is a model of no specimen; the message says why of the first.
    """
    models: dict[str, Explained] = {}
    left_out: dict[str, str] = {}
    for specimen in results.specimens:
        folder = specimen.member.folder(home)
        if folder is None:
            left_out[specimen.name] = specimen.member.message or "There is no run."
            continue
        try:
            model = explain_run(open_run(folder), params)
        except PlanishError as fault:
            left_out[specimen.name] = fault.text
            continue
        if model.trust == "ok":
            models[specimen.name] = model
        else:
            left_out[specimen.name] = f"A check leaves its figures {model.trust}."
    if not models:
        raise CannotMeasure(
            f"No specimen of {len(left_out)} has such a model. {next(iter(left_out.values()), '')}"
        )
    sheets = {specimen.name: specimen.sheet for specimen in results.specimens}
    return explained_over_sheets(models, sheets, left_out)


def write_explained(model: Explained | ExplainedSeries, out: Path, *, source: str) -> None:
    """Write the page of a model, ``explain.json`` and its tables into a new folder.

    ``source``: name of the run or series.
    """
    page, _ = explain_page(model, source=source, version=__version__)
    write_answer(out, "explain", page=page, facts=model, tables=tables_of(model))
