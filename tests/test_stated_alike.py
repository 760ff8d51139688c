"""A figure is the same wherever it is stated: page, terminal, JSON, table, function."""

import csv
import html
import io
import re
from dataclasses import replace

import numpy as np
import pytest

import planish as pl
from planish.analyze import holm
from planish.analyze.compare import CELLS
from planish.app.exploring import page as exploring
from planish.app.exploring.maps import maps_of
from planish.checks import apply_checks
from planish.cli.show import finish
from planish.core.checks import Check
from planish.core.numbers import in_ascii
from planish.report.page import render_report
from planish.report.relation import largest
from planish.report.statement import p_text
from planish.report.summary import check_summary, lead_pair
from planish.results import Results
from planish.run import open_run
from planish.run.facts import figures_text

SIZES_UM = (5.0, 100.0)


def numbers_of_page(text):
    """Give each line of the page's table of correlations: name -> point size -> its numbers."""
    table = re.search(r'aria-label="Correlations: Property".*?</table>', text, flags=re.DOTALL)[0]
    lines = {}
    for row in re.findall(r"<tr[^>]*><th scope.*?</tr>", table, flags=re.DOTALL):
        name = re.search(r"<th[^>]*>(.*?)</th>", row)[1]
        cells = [
            cell.replace("\u202f", "").replace("−", "-").split("\n")
            for cell in re.findall(r"<td[^>]*>(.*?)</td>", row, flags=re.DOTALL)
        ]
        half = len(cells) // 2
        for size_um, (points, r, squares, p, _) in zip(
            SIZES_UM, (cells[:half], cells[half:]), strict=True
        ):
            lines[name, size_um] = {
                "n_eff": points[1],
                "r": r[0],
                "interval": r[1],
                "r2": squares[0],
                "rho": squares[1],
                "p": p[0].replace("&lt;", "<"),
            }
    return lines


def numbers_of_terminal(out):
    """Give each line of the terminal's table."""
    lines = {}
    for line in out.splitlines()[2:]:
        name, size_um, _, n_eff, r, interval, rho, r2, p, _ = re.split(r"\s{2,}", line.strip())
        lines[name, float(size_um)] = {
            "n_eff": n_eff,
            "r": r,
            "interval": interval,
            "r2": r2,
            "rho": rho,
            "p": p,
        }
    return lines


def rows_of_figures(folder):
    with (folder / "figures.csv").open(encoding="utf-8", newline="") as file:
        return {(row["figure"], row["statistic"]): row for row in csv.DictReader(file)}


def lead_of(page):
    """Give the sentence that a page leads with, in the letters of a terminal."""
    return in_ascii(html.unescape(re.search(r'<p class="lead">(.*?)</p>', page)[1]))


def states_alike(run, page, printed, figures):
    """Whether page, terminal, `explore`, JSON and table give the figure that leads, and its
    trust."""
    lead = lead_of(page)
    explored = exploring.render(run.results, maps_of(run), (), ("Maps.",))
    checks = check_summary(run.results)
    row = largest(lead_pair(run.results))
    lines = printed.splitlines()
    start = lines.index(lead)
    assert lead_of(explored) == lead
    assert lines[-1] == checks
    assert checks in page
    assert len(lines[start:]) == 5, "the sentence, three numbers, the checks, and nothing behind"
    stated = figures[f"r of {row.a_map} and {row.b_map}", f"points of {row.point_um:g} um"]
    assert (stated["trust"], int(stated["n"])) == (row.trust, row.n)
    found = re.search(
        r"r = (\S+) with a 95 % interval of (\S+) to (\S+), over ([\d ]+) points of .*?,"
        r" ([\d ]+) of them independent",
        lead,
    )
    if row.trust != "ok":
        states = {check.name: check.state for check in run.results.checks}
        state = "fail" if row.trust == "withheld" else "look"
        names = [name for name in stated["checks"].split("; ") if states[name] == state]
        assert found is None
        assert f" is {row.trust} ({', '.join(names)})" in lead
        return
    r, low, high, n, n_eff = (float(text.replace(" ", "")) for text in found.groups())
    decimals = len(found[1].partition(".")[2])
    limits = [
        float(figures[stated["figure"], f"{stated['statistic']}, {side} 95 % limit"]["value"])
        for side in ("lower", "upper")
    ]
    assert (r, low, high) == tuple(round(v, decimals) for v in (row.r, *row.interval))
    assert (float(stated["value"]), *limits) == (row.r, *row.interval)
    assert (n, n_eff) == (row.n, round(row.n_eff))
    numbers = next(line for line in lines[start:] if line.startswith("r, points of"))
    assert numbers.startswith(f"r, points of {row.point_um:g} um: {found[1]} (95 %: {found[2]} to")
    assert f"{found[5]} independent points of {found[4]};" in numbers


@pytest.mark.ci
@pytest.mark.parametrize(
    "kind",
    [
        *("upright", "laid", "bottom", "sections", "scan", "no-holes", "uncoated", "resin"),
        *("demo", "volumes", "images"),
    ],
)
def test_the_terminal_ends_with_the_answer_of_page_json_explore_and_table(kinds, kind):
    folder = kinds(kind)
    page = (folder / "report.html").read_text(encoding="utf-8")
    printed = folder.with_name("printed.txt").read_text(encoding="utf-8")
    states_alike(open_run(folder), page, printed, rows_of_figures(folder))


@pytest.mark.ci
@pytest.mark.parametrize("state", ["look", "fail"])
def test_what_a_check_doubts_or_withholds_is_so_everywhere(kinds, state, capsys):
    run = open_run(kinds("upright"))
    check = Check(name="place", state=state, sentence="It is off.", figures=("position",))
    judged = apply_checks(run.results.model_copy(update={"checks": (*run.results.checks, check)}))
    run = replace(run, results=judged)
    finish(run, kinds("upright"), as_json=False)
    page = render_report(run.groups, {}, judged)[0]
    rows = csv.DictReader(io.StringIO(figures_text(judged)))
    figures = {(row["figure"], row["statistic"]): row for row in rows}
    states_alike(run, page, capsys.readouterr().out, figures)


@pytest.mark.ci
def test_page_terminal_json_table_and_function_state_the_same(kinds, passes):
    folder = kinds("demo")
    results, linked = Results.read(folder / "results.json"), open_run(folder).linked.load()
    page = numbers_of_page((folder / "report.html").read_text(encoding="utf-8"))
    terminal = numbers_of_terminal(passes("correlate", folder)[0])
    figures = rows_of_figures(folder)
    assert len(results.correlations) == len(page) == len(terminal) > 12
    for size_um in SIZES_UM:
        rows = [row for row in results.correlations if row.point_um == size_um]
        found = {
            row.a_map: pl.correlate(
                linked[row.a_map],
                linked["image"],
                mask=linked["valid"],
                point_um=None if size_um == SIZES_UM[0] else size_um,
                most_cells=CELLS,
            )
            for row in rows
        }
        properties = [row for row in rows if not row.negative_control]
        assert [row.a_map for row in rows if row.negative_control] == ["tilt", "warp"]
        for row, p in zip(
            properties, holm([found[row.a_map].p for row in properties]), strict=True
        ):
            assert row.p_of_table == pytest.approx(p)
        for row in rows:
            twin, name = found[row.a_map], row.a_map
            stated = (row.n, row.n_eff, row.r, row.rho, row.p, *row.interval)
            assert stated == pytest.approx(
                (twin.n, twin.n_eff, twin.r, twin.rho, twin.p, *twin.interval), rel=1e-5
            )
            title, figure = linked[name].attrs["long_name"], f"r of {name} and image"
            if row.negative_control:
                assert row.p_of_table == row.p
                title, name = f"{title} (negative control)", f"{name} (negative control)"
                figure += ", negative control"
            assert float(figures[figure, f"points of {size_um:g} um"]["value"]) == row.r
            for line in (page[title, size_um], terminal[name, size_um]):
                assert line["n_eff"] == f"{row.n_eff:.0f}"
                ends = line["interval"].split(" to ")
                assert [len(end.partition(".")[2]) for end in ends] == [2, 2]
                # As numbers: 0.00 is -0.00.
                assert [float(end) for end in ends] == [round(end, 2) for end in row.interval]
                assert line["p"] == p_text(row.p_of_table)
                for key in ("r", "r2", "rho"):
                    decimals = len(line[key].partition(".")[2])
                    assert decimals >= 2
                    assert float(line[key]) == round(getattr(row, key), decimals)


@pytest.mark.ci
def test_evenness_uncovered_area_and_grams_are_stated_alike(passes, specimen_files, tmp_path):
    folder = tmp_path / "run"
    command = ("map", specimen_files[0], "--coating-density", 1.6, "--out", folder)
    out = passes(*command, codes=(0, 4))[0]
    run, figures = open_run(folder), rows_of_figures(folder)
    page = (folder / "report.html").read_text(encoding="utf-8")
    sheet, measured = run.results.layers[0].sheet, run.groups["surfaces"].load()
    lines = [re.split(r"\s{2,}", line.strip()) for line in out.splitlines()]
    terminal = {line[0]: line[1:] for line in lines if len(line) == 8}
    for name, facts in sheet.properties.items():
        values = measured[name].values[np.isfinite(measured[name].values)].astype(np.float64)
        row = re.search(
            rf">{re.escape(measured[name].attrs['long_name'])}[^<]*</th>(.*?)</tr>", page
        )
        cov = row[1].split("</td>")[3].partition(">")[2]
        assert (facts.trust, figures[name, "sd"]["trust"]) == ("ok", "ok")
        if name in ("warp", "tilt") or name.startswith(("topography", "base_surface")):
            assert facts.coefficient_of_variation is None
            assert (cov, terminal[name][3]) == ("–", "-")
            assert (name, "coefficient of variation") not in figures
            continue
        share = values.std() / values.mean()
        assert facts.coefficient_of_variation == pytest.approx(share)
        stated = figures[name, "coefficient of variation"]
        assert (float(stated["value"]), stated["units"]) == (pytest.approx(share), "1")
        assert float(cov) == pytest.approx(100 * share, rel=0.006)
        assert terminal[name][3] == f"{100 * share:.1f}"
    for side in ("top", "bottom"):
        name = f"coating_{side}"
        coating = measured[name].values[np.isfinite(measured[name].values)]
        share, error = sheet.uncovered_areas[name]
        assert share == pytest.approx(np.mean(coating <= 0))
        stated = figures[name, "uncovered area ratio"]
        assert float(stated["value"]) == share
        assert stated["standard_error"] == ("" if error is None else str(error))
        assert f"Uncovered area ratio, {side} side / %" in page
        assert f"uncovered area ratio of {name}: {100 * share:.3g}" in out
        grams = sheet.properties[f"coat_weight_{side}"]
        assert (grams.units, terminal[f"coat_weight_{side}"][0]) == ("g/m2", "g/m2")
        assert grams.mean == pytest.approx(1.6 * sheet.properties[name].mean, rel=1e-5)
        assert figures[f"coat_weight_{side}", "mean"]["units"] == "g/m2"
        assert f"Coat weight, {side} side / g/m²" in page
