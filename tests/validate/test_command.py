"""The command around it: what it prints and writes, and how it ends."""

import json
from dataclasses import replace

import pytest

from folders import refused
from planish.cli.validate import validate
from planish.core.errors import FileError
from planish.validate import Limit, certify


@pytest.fixture
def call(capsys, monkeypatch, certificate):
    """Call the command with the runs replaced by the certificate of the small scenario."""

    def run(scenario, _seeds, **_):
        return replace(certificate, scenario=scenario)

    monkeypatch.setattr(certify, "run_scenario", run)

    def do(*arguments):
        # The names of the help option are the group's; click keeps the option once a command has
        # made it.
        code = validate.main(
            [str(a) for a in arguments],
            prog_name="planish validate",
            standalone_mode=False,
            help_option_names=["-h", "--help"],
        )
        out, err = capsys.readouterr()
        return code, out, err

    return do


def test_the_table_with_its_verdict_and_the_list(call):
    code, out, _ = call()
    assert code == 0
    assert "Registration" in out
    assert "a point of the map is off by" in out
    assert "All 8 limits are met" in out
    code, out, _ = call("--list")
    assert code == 0
    assert all(name in out for name in ("as-1", "as-2", "ct", "quiet", "small"))
    code, out, _ = call("--list", "--json")
    assert {"name", "title", "seeds"} == set(json.loads(out)[0])
    with pytest.raises(FileError, match="There is no scenario") as error:
        call("--scenario", "smal")
    assert error.value.exit_code == 3


@pytest.mark.ci
def test_files_and_folders_of_scenarios(call, tmp_path):
    code, _, err = call("--out", tmp_path / "out")
    assert code == 0
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "certificate.html",
        "certificate.json",
        "certificate.md",
    }
    assert json.loads((tmp_path / "out" / "certificate.json").read_text())["passed"]
    assert "certificate" in err
    refused(FileError, "exists already", call, "--out", tmp_path / "out")
    code, out, _ = call(
        "--scenario", "small", "--scenario", "quiet", "--out", tmp_path / "both", "--json"
    )
    assert code in (0, 4)
    assert [found["scenario"]["name"] for found in json.loads(out)] == ["small", "quiet"]
    assert {p.name for p in (tmp_path / "both").iterdir()} == {"small", "quiet"}


def test_a_missed_limit_ends_with_4(call, monkeypatch, certificate):
    strict = certificate.scenario.model_copy(
        update={"limits": {"tre_p95": Limit(limit=1e-6, source="a dream")}}
    )
    monkeypatch.setattr(
        certify, "run_scenario", lambda *_, **__: replace(certificate, scenario=strict)
    )
    code, out, err = call()
    assert code == 4
    assert "MISSED" in out
    assert "missed" in err


def test_specimens_like_a_run(call, linked_run):
    code, out, err = call("--like", linked_run, "--json")
    assert code in (0, 4)
    found = json.loads(out)
    assert any(note.startswith("Taken: ") for note in found["notes"])
    assert "Assumed: " in err
    assert found["scenario"]["name"] == "small-like"
