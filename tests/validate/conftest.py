"""The small scenario, run once for all tests of this folder."""

from __future__ import annotations

import pytest

from planish.pipeline import run_study
from planish.synthetic import make_specimen, write_instruments
from planish.validate.certify import run_scenario, scenario_study
from planish.validate.scenario import read_scenario


@pytest.fixture(scope="session")
def small():
    return read_scenario("small")


@pytest.fixture(scope="session")
def certificate(small):
    """The small scenario with the seeds of its record."""
    return run_scenario(small)


@pytest.fixture(scope="session")
def measured(small, tmp_path_factory):
    """One small specimen, its files and what the program made of them."""
    folder = tmp_path_factory.mktemp("measured")
    specimen = make_specimen(small.params(1))
    made = write_instruments(specimen, folder / "specimen", volume="stack")
    run = run_study(scenario_study(small, made), folder / "run")
    return specimen, made, run, folder / "run"
