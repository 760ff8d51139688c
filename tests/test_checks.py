"""What checks mean for the figures of a run: doubtful, or withheld; a state is never greener than
it should be."""

import csv
import io
import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from tests.report.runs import a_run

from planish.checks import CHECKS, HolesOnSheet, apply_checks
from planish.cli import show
from planish.core.checks import Check, CheckRule
from planish.core.facts import HoleTiltFacts, SheetNumbers
from planish.results import Results
from planish.run import facts as run_facts

RULES = {rule.name: rule for rule in CHECKS}
ALL = ("coating_top", "coating_bottom", "base_thickness", "thickness")


def run_with(*checks):
    results = Results.model_validate(a_run()["results"])
    return apply_checks(results.model_copy(update={"checks": checks}))


def check(state, *figures, layers=()):
    return Check(name="x", state=state, sentence="x.", figures=figures, layers=layers)


def trusts(results):
    sheet = results.layers[0].sheet
    return {name: p.trust for name, p in sheet.properties.items()}


def test_a_look_marks_the_figures_that_it_concerns_and_leaves_their_numbers():
    before = Results.model_validate(a_run()["results"])
    found = run_with(check("look", "coating_top"))
    assert {name for name, trust in trusts(found).items() if trust != "ok"} == {"coating_top"}
    assert (
        found.layers[0].sheet.properties["coating_top"].mean
        == before.layers[0].sheet.properties["coating_top"].mean
    )
    assert found.passed
    for row, old in zip(found.correlations, before.correlations, strict=True):
        assert (row.trust, row.r) == (
            "doubtful" if "coating_top" in (row.a_map, row.b_map) else "ok",
            old.r,
        )


@pytest.mark.parametrize("figure", ["position", "correlation"])
def test_what_fails_is_withheld_from_all_that_rests_on_it(figure):
    found = run_with(check("fail", figure))
    assert not found.passed
    assert all(
        row.trust == "withheld" and math.isnan(row.r) and math.isnan(row.slope)
        for row in found.correlations
    )
    error = found.layers[0].registration.expected_error
    assert (error.median_um is None, set(trusts(found).values())) == (figure == "position", {"ok"})
    assert Results.model_validate_json(found.to_json()) == found


def test_a_failed_scan_withholds_its_properties_alone_and_other_states_change_nothing():
    found = run_with(check("fail", "properties", layers=("volume",)))
    assert set(trusts(found).values()) == {"withheld"}
    assert all(p.mean is None for p in found.layers[0].sheet.properties.values())
    assert found.layers[0].sheet.numbers is None
    assert set(trusts(run_with(check("fail", "properties", layers=("image",)))).values()) == {"ok"}
    assert set(
        trusts(run_with(check("unknown", "properties"), check("pass", "position"))).values()
    ) == {"ok"}
    assert run_with(check("unknown", "properties")).state == "unknown"


def test_the_table_of_figures_says_what_is_doubtful_and_why():
    found = run_with(check("look", "coating_top"), check("fail", "position"))
    rows = list(csv.DictReader(io.StringIO(run_facts.figures_text(found))))
    at = {(row["figure"], row["statistic"]): row for row in rows}
    assert (at["coating_top", "mean"]["trust"], at["coating_top", "mean"]["checks"]) == (
        "doubtful",
        "x",
    )
    assert (
        float(at["coating_top", "mean"]["value"])
        == found.layers[0].sheet.properties["coating_top"].mean
    )
    assert (at["thickness", "mean"]["trust"], at["thickness", "mean"]["checks"]) == ("ok", "")
    error = at["expected error of the position", "median"]
    assert (error["trust"], error["value"]) == ("withheld", "")
    assert {row["trust"] for row in rows if row["figure"].startswith("r of")} == {"withheld"}


def test_the_terminal_doubts_the_uncovered_area_where_it_doubts_the_coating(capsys):
    found = run_with(check("look", "coating_top"))
    layer = found.layers[0]
    thin = {"thinner_than_um": (0.0,), "share": (0.03,), "support_um": 3.0, "warning": None}
    numbers = {"thin": {"top": thin, "bottom": thin}, "two_sides": {}}
    sheet = layer.sheet.model_copy(update={"numbers": SheetNumbers.model_validate(numbers)})
    layers = (layer.model_copy(update={"sheet": sheet}), *found.layers[1:])
    run = SimpleNamespace(results=found.model_copy(update={"layers": layers}), groups={})
    show.finish(run, Path("run"), as_json=False)
    out = capsys.readouterr().out
    assert "uncovered area ratio of coating_top (doubtful): 3 %" in out
    assert "uncovered area ratio of coating_bottom: 3 %" in out


def test_results_of_format_2_are_read_with_their_gates_as_checks(tmp_path):
    (tmp_path / "run.toml").write_text("")
    file = tmp_path / "results.json"
    # Of the demo of planish 0.2.0.
    old = json.loads((Path(__file__).parent / "results_format_2.json").read_text())
    old["gates"][0]["passed"] = False
    file.write_text(json.dumps(old))
    results = Results.read(file)
    assert (results.format, results.planish, results.state) == (4, "0.2.0", "fail")
    assert [check.name for check in results.checks_in("fail")] == [old["gates"][0]["name"]]
    assert [check.name for check in results.checks_in("unknown")] == ["version"]
    assert results.correlations[0].r == old["correlations"][0]["r"]
    as_of_today = results.model_copy(update={"stored_format": 4})
    assert Results.model_validate_json(results.to_json()) == as_of_today
    facts = show.run_facts(tmp_path)
    assert facts["fail"] == [old["gates"][0]["name"]]
    assert "made by planish 0.2.0: its results have an older format" in " ".join(
        show.run_lines(facts)
    )


@pytest.mark.parametrize(
    ("value", "state"),
    [(0.5, "pass"), (1.0, "pass"), (1.1, "look"), (5.1, "fail"), (float("nan"), "look")],
)
def test_limits_belong_to_what_passes_and_nan_never_does(value, state):
    rule = CheckRule(
        "x", object, ("position",), lambda rule, value: rule.at_most(value, look=1.0, sentence="x.")
    )
    found = rule.at_most(value, look=1.0, fail=5.0, sentence="x.", advice="Do it.")
    assert (found.state, found.limit) == (state, 5.0 if state == "fail" else 1.0)
    assert bool(found.advice) == (state != "pass")
    assert (found.name, found.figures) == ("x", ("position",))
    assert rule(value).state == ("look" if state == "fail" else state)
    only_fails = rule.at_most(value, fail=1.0, sentence="x.")
    assert (only_fails.state, only_fails.limit) == ("fail" if value > 1 else state, 1.0)
    mirrored = rule.at_least(-value, look=-1.0, units="um", sentence="x.", advice="Do it.")
    assert (mirrored.state, mirrored.limit, mirrored.units) == (rule(value).state, -1.0, "um")
    assert mirrored.value == (None if math.isnan(value) else -value)


def test_rows_of_the_table_name_each_check_of_a_stage_once():
    rows = [(rule.stage, rule.name) for rule in CHECKS]
    assert len(rows) == len({*rows})
    assert all(rule.figures for rule in CHECKS)
    assert all(rule.stage.__doc__ for rule in CHECKS)


@pytest.mark.parametrize("origin", [0.0, -400.0])
@pytest.mark.parametrize(
    ("at", "state"), [((200.0, 300.0), "pass"), ((500.0, 100.0), "look"), ((850.0, 100.0), "pass")]
)
def test_a_hole_of_the_image_lies_where_the_sheet_is_whole(at, state, origin):
    """The sheet has holes at (200, 300) and (600, 500) and ends at x = 800 um; the second hole is
    paired."""
    y, x = np.arange(120) * 5.0, np.arange(200) * 5.0
    thick = np.full((120, 200), 80.0)
    for u, v in ((200, 300), (600, 500)):
        thick[np.hypot(y[:, None] - v, x - u) < 90] = np.nan
    thick[:, x > 800] = np.nan
    sheet = xr.Dataset(
        {"thickness": (("y", "x"), thick)}, coords={"y": y + origin, "x": x - origin}
    )
    pairs = {
        "label": ["hole 1", "fixed 2"],
        "moving_x": [1.0, np.nan],
        "fixed_x": [600.0 - origin, at[0] - origin],
        "fixed_y": [500.0 + origin, at[1] + origin],
        "fixed_diameter": [175.0, 175.0],
    }
    marks = xr.Dataset({k: ("mark", v) for k, v in pairs.items()})
    linked = HolesOnSheet(sheet=sheet, marks=marks, layer="sheet", reference="image")
    found = RULES["holes without partner"](linked)
    assert found.state == state
    assert ("fixed 2 of the image lies where the sheet has no hole" in found.sentence) == (
        state == "look"
    )


@pytest.mark.parametrize(
    ("degrees", "error_um", "count", "state"),
    [
        ((4.0, 3.0), 0.3, 7, "look"),
        ((0.4, 0.3), 0.05, 7, "pass"),
        ((4.0, 3.0), 4.0, 7, "pass"),
        ((4.0, 3.0), 0.3, 3, None),
    ],
)
def test_holes_that_all_lean_to_one_side(degrees, error_um, count, state):
    """Tilts of holes: 50 um from layer to layer; the error of the tilt is that of the offset."""
    offset = 50.0 * np.tan(np.deg2rad(degrees))
    facts = HoleTiltFacts(
        through=count,
        closed=0,
        unclear=0,
        other_side_only=0,
        offset_count=count,
        offset_um=tuple(offset),
        offset_spread_um=(1.0, 1.0),
        offset_error_um=(error_um, error_um),
        tilt_deg=degrees,
        side="top",
        sentence="x.",
    )
    found = RULES["tilt of the holes"](SimpleNamespace(facts=SimpleNamespace(tilt=facts)))
    assert (found and found.state) == state
    assert state is None or found.value == pytest.approx(np.hypot(*degrees))
    assert state != "look" or found.sentence.startswith(
        "The holes run through the sheet at 5 ± 0.3° from its normal"
    )
