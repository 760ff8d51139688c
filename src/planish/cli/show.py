"""What a terminal shows: stages as they pass, tables, and what the checks say."""

from __future__ import annotations

import json
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click
from rich import progress as rich

from planish.cli.console import animated, console, duration, letters, sentence, shown, table, warn
from planish.core.durations import slowness
from planish.core.facts import is_known
from planish.core.memory import enough_gb
from planish.core.numbers import NONE, in_ascii
from planish.core.older_names import FORMAT
from planish.core.text import quoted
from planish.core.tiles import tiles_told
from planish.core.typing import Entries, Texts

if TYPE_CHECKING:
    from planish.cli.time_left import TimeLeft
    from planish.core.checks import State
    from planish.results import ComparisonRow, CorrelationRow, LayerFacts, Results
    from planish.run import Run
    from planish.run.compute import Progress as Tell


class _LeftColumn(rich.ProgressColumn):
    """The time that is left, for a bar behind it that shows the share of the time."""

    def __init__(self, time_left: TimeLeft) -> None:
        super().__init__()
        self.time_left = time_left

    def render(self, task: rich.Task) -> str:
        """Write it roughly."""
        task.completed = self.time_left.share * (task.total or 1)
        return f"about {duration(self.time_left.seconds)} left"


@contextmanager
def stages(total: int, time_left: TimeLeft | None = None) -> Generator[Tell]:
    """Show a progress bar on a terminal, one line a stage otherwise; always on standard error.

    ``total`` stages count alike, unless ``time_left`` knows their times. What has the name ``look``
    is no stage: it stays.
    """
    if not animated():
        yield lambda stage, detail: click.echo(f"{stage}: {shown(detail)}", err=True)
        return
    spinner = "dots" if letters() else "line"
    amount = rich.MofNCompleteColumn() if time_left is None else _LeftColumn(time_left)
    name = rich.TextColumn("{task.description}", markup=False)
    columns = (
        rich.SpinnerColumn(spinner),
        name,
        amount,
        rich.BarColumn(),
        rich.TimeElapsedColumn(),
    )
    with rich.Progress(*columns, console=console(err=True), transient=True) as bar:
        task = bar.add_task("start", total=total)

        def tell(stage: str, detail: str) -> None:
            if stage == "look":
                bar.console.print(f"look: {shown(detail)}")
                return
            if time_left is not None:
                time_left.enter(stage)
            bar.update(task, advance=1, description=f"{stage}: {shown(detail)}")

        with nullcontext() if time_left is None else tiles_told(time_left.enter):
            yield tell


def number(value: float | None, digits: int = 3) -> str:
    """Write a number, or a dash where there is none."""
    if value is None or not is_known(value):
        return "-"
    return f"{round(value, digits) + 0.0:.{digits}f}"


def finish(run: Run, out: Path, *, as_json: bool, strict: bool = False) -> int:
    """Print the outcome of a run.

    The exit code is 4 when a check failed or, with ``strict``, asks for a look.
    """
    results = run.results
    if as_json:
        click.echo(results.to_json(), nl=False)
    else:
        for layer in results.layers:
            _properties(layer)
        for layer in results.moving:
            _registration(layer)
        _given_others(results)
        _all_correlations(results)
        click.echo(f"report: {out / 'report.html'}")
        if results.is_link:
            click.echo(f"check and correct it: planish view {quoted(str(out))}")
    has_several_layers = len(results.layers) > 2
    states: tuple[State, ...] = ("fail", "look", "unknown")
    for state in states:
        for check in results.checks_in(state):
            name = check.name
            if has_several_layers and check.layers:
                name += f" ({' and '.join(check.layers)})"
            warn(f"{state}: {name}: {check.text}")
    if not as_json:
        _answer(run)
    return exit_code(results, strict=strict)


def _all_correlations(results: Results) -> None:
    """Print the correlations of a run, or how they compare before and after flattening."""
    rows = results.comparison
    if not rows:
        pairs = [(f"{r.a} {r.a_map} / {r.b} {r.b_map}", r) for r in results.correlations if r.n]
        if results.correlations:
            correlations("Layers against each other", pairs)
        return
    if any(not row.n for row in rows):
        sentence("Points that are larger than what both show have no correlation and are left out.")
    n_registrations = len({row.registration for row in rows})
    title = (
        f"Effect of flattening: {results.reference.name} against {rows[0].property} by"
        f" {n_registrations} registrations, where all have values"
    )
    correlations(title, [(row.registration, row) for row in rows if row.n])


def _answer(run: Run) -> None:
    """Print what the page begins with: its sentence, its numbers, and what the checks say."""
    from planish.report.maps import RunMaps
    from planish.report.summary import check_summary, summarise

    lead, figures = summarise(run.results, RunMaps(run.results, run.groups).titles)
    numbers = [f"{f.label}: {f.value} {f.unit}".rstrip() + f" ({f.note})" for f in figures]
    for text in (lead, *numbers, check_summary(run.results)):
        sentence(in_ascii(text))


def exit_code(results: Results, *, strict: bool = False) -> int:
    """4 where a check failed or, with ``strict``, asks for a look."""
    if results.state == "fail" or (strict and results.checks_in("look")):
        return 4
    return 0


def _properties(layer: LayerFacts) -> None:
    """Print the distribution of each property, the uncovered areas, and how it was flattened.

    Nothing for a layer that is no sheet.
    """
    sheet = layer.sheet
    if sheet is None:
        return
    rows: list[Texts] = []
    labels: dict[str, str] = {}
    for key, p in sheet.properties.items():
        labels[key] = key if p.trust == "ok" else f"{key} ({p.trust})"
        cov = None if p.coefficient_of_variation is None else 100 * p.coefficient_of_variation
        figures = [number(figure, 2) for figure in (p.mean, p.sd)]
        percentiles = [number(figure, 2) for figure in (p.p5, p.p95)]
        rows.append((labels[key], p.units, *figures, number(cov, 1), *percentiles, str(p.n)))
    headings = ("", "unit", "mean", "sd", "cov %", "p5", "p95", "columns")
    table(f"Properties of the {layer.name} along its normals", headings, rows)
    for key, (share, error) in sheet.uncovered_areas.items():
        if share is not None and sheet.properties[key].trust != "withheld":
            error_text = "" if error is None else f" +- {100 * error:.2g}"
            sentence(f"uncovered area ratio of {labels[key]}: {100 * share:.3g}{error_text} %")
    f = sheet.flatten
    sentence(
        f"flattened: {f.sentence} Edge strain {100 * (f.edge_strain_p95 or 0):.3f} % (p95); points"
        f" moved by up to {number(f.largest_move_um, 0)} um."
    )


def _registration(layer: LayerFacts) -> None:
    """Print how a layer lies on another one, how well that is known, and what is odd about it."""
    r = layer.registration
    if r is None:
        return
    error_text = ""
    notes = [*r.warnings]
    expected = r.expected_error
    if expected is not None:
        trust = "" if expected.trust == "ok" else f", {expected.trust}"
        error_text = f", expected error {number(expected.median_um, 2)} um (median{trust})"
        notes += [] if expected.shares is None else [expected.shares.sentence]
    sentence(
        f"{layer.name} to {r.to}: {r.matched} marks used, residual {r.rms_um:.2f} um rms,"
        f" leave-one-out {number(r.leave_one_out_rms_um, 2)} um{error_text}; {r.model}, scale"
        f" {r.scale:.4f}, rotation {r.rotation_deg:.2f} deg{', mirrored' if r.mirrored else ''}"
    )
    if r.source != "found" and r.match_sentence:
        notes.insert(0, r.match_sentence)
    if r.held_out is not None:
        notes.append(r.held_out.sentence)
    for note in (*notes, f"{r.orientation.sentence} {r.orientation.remedy}".rstrip()):
        sentence(f"  {note}")


def _given_others(results: Results) -> None:
    """Print r given the maps that stand beside, where the study names some."""
    from planish.report.sentences.partial import say_partial
    from planish.report.sentences.wording import Wording

    for evidence in results.evidence:
        if evidence.partial is not None:
            for text in say_partial(evidence.partial, evidence, Wording()):
                sentence(text.replace("\u202fµm", " um"))


def correlations(title: str, rows: Sequence[tuple[str, CorrelationRow | ComparisonRow]]) -> None:
    """Print correlations, each under its name; p is that of the page, which tests no difference."""
    from planish.report.statement import p_of, p_text

    has_marks = any(getattr(row, "marks_rms_um", None) for _, row in rows)
    is_tested = not any(getattr(row, "same_quantity", True) for _, row in rows)
    headings = ["", "point um", "n", "n_eff", "r", "95 %", "rho", "r2"]
    headings += ["p (Holm)"] * is_tested + ["slope"] + ["marks um"] * has_marks
    # Rows of a comparison of registrations have their marks' residual as well, and no p.
    cells: list[list[str]] = []
    for name, row in rows:
        label = name + " (negative control)" * getattr(row, "negative_control", False)
        if row.trust != "ok":
            label += f" ({row.trust})"
        low, high = row.interval
        digits = 2 if high - low >= 0.02 else 4  # of a narrow one more: two decimals hide it
        interval = f"{low:.{digits}f} to {high:.{digits}f}" if is_known(row.interval) else "-"
        figures = [label, f"{row.point_um:g}", str(row.n), number(row.n_eff, 0)]
        figures += [number(row.r), interval, number(row.rho), number(row.r2)]
        if is_tested:
            figures.append(p_text(p_of(row)).replace(NONE, "-"))
        figures.append(f"{row.slope:.4g}" if is_known(row.slope) else "-")
        if has_marks:
            figures.append(number(getattr(row, "marks_rms_um", None), 1))
        cells.append(figures)
    table(title, headings, cells)


def run_facts(path: Path) -> Entries | None:
    """Read the facts of a run folder; None where it is none, or damaged."""
    if not (path / "run.toml").is_file():
        return None
    try:
        results = json.loads((path / "results.json").read_text(encoding="utf-8"))
        return _facts_of(results, path.absolute().name)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None


def _facts_of(results: Entries, file_name: str) -> Entries:
    """Facts of the results of a run, also of one by planish 0.1.0.

    Besides its name, its files and its versions: how many checks there are, the names of those that
    failed or ask for a look, and a warning where its results are of an older format.
    """
    version = str(results["planish"])
    repeat_text = "'planish run' repeats it with this version."
    warning = None
    if version.startswith("0.1."):
        warning = (
            "made by planish 0.1.0: the errors stated in it are about 1.5 times too small;"
            f" {repeat_text}"
        )
    elif results.get("format", 0) < FORMAT:
        warning = f"made by planish {version}: its results have an older format; {repeat_text}"
    # As versions 0.1 called them.
    checks_key = next((key for key in ("gates", "quality") if key in results), "checks")
    checks: list[Entries] = results[checks_key]
    names: dict[str, list[str]] = {"fail": [], "look": []}
    for check in checks:
        state = "fail" if check.get("passed") is False else check.get("state")
        if state in names:
            names[state].append(str(check["name"]))
    inputs = _inputs_of(results)
    return {
        "kind": "run of one volume" if len(inputs) == 1 else f"run of {len(inputs)} layers",
        "file_name": file_name,
        "inputs": inputs,
        "checks": len(checks),
        **names,
        "planish": version,
        "code": str(results.get("code", "")),
        "warning": warning,
    }


def _inputs_of(results: Entries) -> dict[str, str]:
    """Names of the files of a run, by layer; planish 0.1 lists them by themselves."""
    if "layers" in results:
        return {str(layer["name"]): str(layer["source"]["name"]) for layer in results["layers"]}
    return {str(name): str(source["name"]) for name, source in results["inputs"].items()}


def run_lines(facts: Entries) -> list[str]:
    """Write the facts of a run for a reader."""
    lines = [f"{facts['file_name']}: {facts['kind']}, planish {facts['planish']}"]
    if facts["warning"]:
        lines.append(facts["warning"])
    lines += [f"{name}: {file}" for name, file in facts["inputs"].items()]
    states = [f"; {k}: {', '.join(facts[k])}" for k in ("fail", "look") if facts[k]]
    return [*lines, f"checks: {facts['checks']}{''.join(states)}"]


def fact_lines(facts: Entries) -> list[str]:
    """Write the facts of ``planish info`` for a reader."""
    axes = ", ".join(facts["dims"])
    shape = " x ".join(map(str, facts["shape"]))
    size = f"{facts['bytes'] / 1e6:.1f} MB"
    lines = [f"{facts['file_name']}: {facts['kind']}, {shape} ({axes}), {facts['dtype']}, {size}"]
    if "stored" in facts:
        lines.append(f"format: {facts['format']}, {facts['stored']}")
    lines += _size_lines(facts, axes)
    lines += _grey_lines(facts)
    if facts.get("through"):
        option = "" if facts["through"] == "z" else f": planish map --through {facts['through']}"
        lines.append(f"sheet: across {facts['through']}, along which the grey changes most{option}")
    lines += _needs(facts)
    for name, value in (facts.get("metadata") or {}).items():
        text = value
        if isinstance(value, dict):
            text = ", ".join(f"{k} {v}" for k, v in cast("Entries", value).items())
        lines.append(f"{name}: {text}")
    lines += [f"note: {note}" for note in facts.get("notes", ())]
    return lines + [f"look: {warning}" for warning in facts["warnings"]]


def _size_lines(facts: Entries, axes: str) -> Iterator[str]:
    element = "pixel" if facts["kind"] == "image" else "voxel"
    if not facts["size_um"]:
        yield f"{element} size: not stated"
        return
    size, extent = (
        " x ".join(map("{:.6g}".format, facts[name])) for name in ("size_um", "extent_um")
    )
    yield f"{element} size: {size} um ({axes}), from {facts['size_source']}"
    yield f"extent: {extent} um"


def _grey_lines(facts: Entries) -> Iterator[str]:
    if facts["min"] is not None:
        percentiles = ", ".join(f"{level:.5g} ({k} %)" for k, level in facts["percentiles"].items())
        yield f"grey: {facts['min']:.5g} to {facts['max']:.5g}; percentiles {percentiles}"
    if facts["nan_share"]:
        yield f"missing: {100 * facts['nan_share']:.2f} % of the values are NaN or infinite"
    if facts["saturated_share"]:
        share = f"{100 * facts['saturated_share']:.2f} %"
        yield f"saturated: {share} of the values are the largest the type can store"
    if facts.get("sampled"):
        yield f"grey values: of {facts['sampled']}"


def _needs(facts: Entries) -> Iterator[str]:
    """Memory and time that linking or mapping a file takes."""
    pace = slowness()
    if "link_bytes" in facts:
        yield (
            f"planish link: about {enough_gb(facts['link_bytes'])} GB of memory, and"
            f" {duration(pace * facts['link_seconds'])} after the volume was mapped"
        )
    if "run_bytes" in facts:
        yield (
            f"planish map: {enough_gb(facts['run_bytes'])} GB of memory, or less with wider"
            f" columns; about {duration(pace * facts['run_seconds'])}, and some minutes more the"
            " first time, to compile"
        )
