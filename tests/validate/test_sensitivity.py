"""Which stage suffers under which nuisance, on made-up figures; the runs themselves are
replaced."""

import numpy as np
import pytest

from folders import refused
from planish.core.errors import InputError
from planish.validate import certify, render_page, scenario, table
from planish.validate import certify as module

BASE = {"surfaces_rmse": 0.4, "column_coating_top_rmse": 0.5, "fle_pair": 0.3, "tre_rms": 0.6}


def test_errors_are_taken_apart_as_squares():
    assert (certify.added_error(0.5, 0.4), certify.added_error(0.3, 0.4)) == (
        pytest.approx(0.3),
        0.0,
    )
    assert certify.added_error(None, 0.4) is None


def test_the_first_stage_of_those_that_grow_alike_suffers():
    keys = {
        "surfaces": "surfaces_rmse",
        "thickness": "column_coating_top_rmse",
        "registration": "tre_rms",
    }
    quiet = {"surfaces": 0.4, "thickness": 0.5, "registration": 0.6}
    row = certify.make_row(
        "scan_blur",
        keys,
        quiet,
        {"surfaces_rmse": 0.8, "column_coating_top_rmse": 1.2, "tre_rms": 0.6},
        None,
    )
    assert row.suffers == "surfaces"
    row = certify.make_row("stretch", keys, quiet, BASE | {"tre_rms": 3.0}, None)
    assert row.suffers == "registration"
    row = certify.make_row("lens", keys, quiet, BASE | {"tre_rms": 0.601}, None)
    assert row.suffers is None
    assert "no stage notices" in table.row_sentence(row)
    # against a baseline of next to nothing, 0.01 um are no growth to speak of
    row = certify.make_row(
        "lens", {"registration": "tre_rms"}, {"registration": 1e-6}, {"tre_rms": 0.01}, None
    )
    assert row.suffers is None


def fake(monkeypatch, effect):
    """Replace the runs: ``effect`` gives the figures from the names of the nuisances that are
    on."""
    calls = []

    def run(_scenario, params, seed, **_):
        from planish.synthetic import nuisances_of

        on = frozenset(nuisances_of(params, "scanner"))
        calls.append(on)
        return certify.Entry(seed=seed, **effect(on))

    monkeypatch.setattr(module, "run_specimen", run)
    return calls


def test_independent_nuisances_sum_up(monkeypatch, small):
    adds = {
        "char": {"fle_pair": 1.0},
        "stage": {"tre_rms": 2.0},
        "scan_noise": {"surfaces_rmse": 0.5},
    }

    def effect(on):
        values = {k: v**2 for k, v in BASE.items()}
        for name in on & adds.keys():
            for key, value in adds[name].items():
                values[key] += value**2
        return {"values": {k: float(np.sqrt(v)) for k, v in values.items()}}

    calls = fake(monkeypatch, effect)
    found = certify.sensitivity(small)
    assert (len(calls), calls[0]) == (2 + len(small.active), frozenset())
    suffering = {row.nuisance: row.suffers for row in found.rows}
    assert {k: v for k, v in suffering.items() if v} == {
        "char": "holes",
        "stage": "registration",
        "scan_noise": "surfaces",
    }
    assert (found.ratio["holes"], found.ratio["thickness"], found.together) == (
        pytest.approx(1.0),
        None,
        {},
    )
    assert "act independently" in table.sum_sentence("holes", found)
    head, rows = table.sensitivity_rows(found)
    assert all(len(row) == len(head) for row in rows)


def test_an_interaction_is_named(monkeypatch, small):
    def effect(on):
        both = {"char", "scan_blur"} <= on
        return {"values": BASE | {"fle_pair": 3.0 if both else 0.3}}

    calls = fake(monkeypatch, effect)
    found = certify.sensitivity(small)
    assert (len(calls), found.ratio["holes"]) == (2 + 2 * len(small.active), pytest.approx(0.0))
    assert set(found.together["holes"]) == {"char", "scan_blur"}
    assert "burnt rims" in table.sum_sentence("holes", found)


def test_nuisances_that_cancel_or_are_missing_have_a_sentence(monkeypatch, small):
    def effect(on):
        return {"values": BASE | {"fle_pair": 3.0 if on == {"char"} else 0.3}}

    fake(monkeypatch, effect)
    found = certify.sensitivity(small)
    assert found.ratio["holes"] == float("inf")
    assert "add nothing, although single ones do" in table.sum_sentence("holes", found)
    refused(InputError, "no nuisances", certify.sensitivity, scenario.read_scenario("as-1"))
    refused(InputError, "No nuisance", certify.sensitivity, scenario.read_scenario("quiet"))
    fake(monkeypatch, lambda _on: {"values": {}, "refusal": "No sheet."})
    refused(InputError, "No sheet", certify.sensitivity, small)


def test_a_nuisance_that_stops_the_program(monkeypatch, small, certificate):
    def effect(on):
        if on == {"half_closed"}:
            return {"values": {}, "refusal": "Only 2 holes found."}
        return {"values": BASE}

    fake(monkeypatch, effect)
    found = certify.sensitivity(small)
    row = next(row for row in found.rows if row.nuisance == "half_closed")
    assert (row.refusal, row.suffers) == ("Only 2 holes found.", None)
    page = render_page(certificate, found)
    assert "no result" in page
    assert page.count('class="n') > 4 * len(found.rows)
    assert "refused" in table.markdown(certificate, found)
    assert len(table.as_json(certificate, found)["sensitivity"]["rows"]) == len(small.active)
