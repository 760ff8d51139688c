"""Examples in docstrings give what they say."""

import doctest
import importlib
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import planish

SOURCE = Path(planish.__file__).parent
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def modules_with_examples():
    """Names of the modules whose docstrings hold lines of Python."""
    for path in SOURCE.rglob("*.py"):
        if ">>> " in path.read_text(encoding="utf-8"):
            yield ".".join(path.relative_to(SOURCE.parent).with_suffix("").parts)


def examples_of(module):
    """The examples of a module, which find its names, numpy and xarray."""
    names = {"np": np, "xr": xr}
    return [
        test for test in doctest.DocTestFinder().find(module, extraglobs=names) if test.examples
    ]


@pytest.mark.parametrize("name", sorted(modules_with_examples()))
def test_examples_give_what_they_say(name):
    for test in examples_of(importlib.import_module(name)):
        printed = []
        doctest.DocTestRunner(optionflags=FLAGS, verbose=False).run(test, out=printed.append)
        assert not printed, "".join(printed)


def test_an_example_that_gives_something_else_fails():
    wrong = doctest.DocTestParser().get_doctest(">>> 1 + 1\n3\n", {}, "wrong", None, None)
    assert doctest.DocTestRunner(verbose=False).run(wrong, out=str).failed == 1
