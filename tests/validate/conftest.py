"""A certificate of recorded figures for the tests of its tables and pages; the scenario itself for the studies."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from planish.pipeline import run_study
from planish.synthetic import make_specimen, write_instruments
from planish.validate.certify import Certificate, Entry, Example, run_scenario, scenario_study
from planish.validate.ledger import in_order
from planish.validate.scenario import read_scenario


@pytest.fixture(scope="session")
def small():
    return read_scenario("small")


@pytest.fixture(scope="session")
def certificate(small):
    """A certificate of three specimens with the recorded figures, and made-up maps."""
    recorded = tomllib.loads(Path(__file__).with_name("recorded.toml").read_text())["figures"]
    entries = [
        Entry(seed=seed, values=in_order({k: f["mean"] + off * f["sd"] for k, f in recorded.items()}), seconds=1.0)
        for seed, off in enumerate((0.0, -1.0, 1.0))
    ]
    y, x = np.mgrid[:40, :60] * 5.0
    found = np.where(np.hypot(x - 150, y - 100) < 40, np.nan, 17.0 + np.sin(x / 30))
    maps = Example(
        seed=0, pixel_um=(5.0, 5.0), image=0.7 + 0.01 * np.sin(x / 30), away_um=0.01 * x + 0 * found,
        name="coating_top", found_um=found, error_um=0.1 * np.cos(y / 40) + 0 * found,
    )  # fmt: skip
    return Certificate(scenario=small, entries=tuple(entries), example=maps)


@pytest.fixture(scope="session")
def whole_certificate(small):
    """The small scenario run with the seeds of its record."""
    return run_scenario(small)


@pytest.fixture(scope="session")
def measured(small, tmp_path_factory):
    """One small specimen, its files and what the program made of them."""
    folder = tmp_path_factory.mktemp("measured")
    specimen = make_specimen(small.params(1))
    made = write_instruments(specimen, folder / "specimen", volume="stack")
    run = run_study(scenario_study(small, made), folder / "run")
    return specimen, made, run
