"""A file for tests of marks, and a designed pattern."""

import pytest

from planish.design import DesignParams, design_pattern


@pytest.fixture
def put(tmp_path):
    """A function that writes a file of text or bytes, and gives its path."""

    def write(text, name="marks.txt"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
        return path

    return write


@pytest.fixture(scope="session")
def pattern():
    """A planned pattern, which keeps every rule; its origin lies on no step."""
    return design_pattern(
        DesignParams(field_um=(20_000.0, 15_000.0), origin_um=(1234.5678, 20.0), seed=3)
    )[0]
