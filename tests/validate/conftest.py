"""A certificate of recorded figures for the tests of its tables and pages; the scenario itself for
the studies."""

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from planish.report import Canvas, draw
from planish.validate import certify, in_order, read_scenario


@pytest.fixture(scope="session")
def small():
    return read_scenario("small")


@pytest.fixture(scope="session")
def certificate(small):
    """A certificate of three specimens with the recorded figures, and made-up pictures."""
    recorded = tomllib.loads(Path(__file__).with_name("recorded.toml").read_text())["figures"]
    entries = [
        certify.Entry(
            seed=seed, values=in_order({k: f["mean"] + off * f["sd"] for k, f in recorded.items()})
        )
        for seed, off in enumerate((0.0, -1.0, 1.0))
    ]
    canvas = Canvas(draw.HALF, 300)
    pictures = tuple(canvas.picture(title=f"Map {k}", caption="") for k in range(4))
    return certify.Certificate(
        scenario=small, entries=(replace(entries[0], pictures=pictures), *entries[1:])
    )


@pytest.fixture(scope="session")
def whole_certificate(small):
    """The small scenario run with the seeds of its record."""
    return certify.run_scenario(small)
