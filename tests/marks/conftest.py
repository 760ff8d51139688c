"""A file for tests of marks."""

import pytest


@pytest.fixture
def put(tmp_path):
    """A function that writes a file of text or bytes, and gives its path."""

    def write(text, name="marks.txt"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
        return path

    return write
