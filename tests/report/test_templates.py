"""Templates are compiled once for all processes of one planish."""

import jinja2
import pytest

from planish.core.jit import cache_folder
from planish.report import text


def test_a_second_process_compiles_no_template(tmp_path, monkeypatch):
    """What the first one compiled lies in the folder of compiled functions."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    text.template.cache_clear()  # as in a new process
    first = text.template("planish.report", "parts.html.j2")
    assert str(tmp_path) in cache_folder(str(tmp_path))
    monkeypatch.setattr(jinja2.Environment, "_generate", None)
    text.template.cache_clear()
    second = text.template("planish.report", "parts.html.j2")
    assert second is not first
    with pytest.raises(TypeError):
        text.template("planish.report", "style.css")
    text.template.cache_clear()
