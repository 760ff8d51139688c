"""What all tests share: where measured data lie, and repeatable property tests."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parents[1]

# The same cases on every run, and no time limit on a case: the first one compiles the kernels.
settings.register_profile("planish", derandomize=True, deadline=None)
settings.load_profile("planish")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test that asks for measured data as ``realdata``."""
    for item in items:
        if "shared_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.realdata)


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Return a function from the name of a data set to its folder; it skips the test where the data are absent."""
    folder = Path(os.environ.get("PLANISH_DATA") or ROOT.parent / "shared" / "data")

    def find(name: str) -> Path:
        path = folder / name
        if not path.exists():
            pytest.skip(f"measured data '{name}' not found; set PLANISH_DATA to the folder that holds it")
        return path

    return find
