"""A message is put together of texts that name parameters by key; Python shows its own words."""

import ast
import pickle
from pathlib import Path

import pytest

import planish.app.changes
import planish.core.files  # noqa: F401  their errors, too, are in the tree
from planish.core import errors
from planish.core.errors import PlanishError, SizeError

SOURCE = Path(errors.__file__).parents[1]


def test_an_error_keeps_its_text_and_shows_the_words_of_a_call():
    error = SizeError("Give `voxel_um=SIZE`, a power of 1e+02.")
    assert str(error) == "Give voxel_um=SIZE, a power of 100."
    # As from a process of a cluster.
    text = pickle.loads(pickle.dumps(error)).text
    assert text == error.text == "Give `voxel_um=SIZE`, a power of 100."


def errors_by_name(kind=PlanishError):
    return {kind.__name__}.union(*(errors_by_name(sub) for sub in kind.__subclasses__()))


@pytest.mark.ci
def test_no_message_is_put_together_of_python_words():
    """What shows or stores a message, or adds to it, takes its ``text``; ``str`` is for who calls
    planish in Python."""
    names, found = errors_by_name(), []
    for path in SOURCE.rglob("*.py"):
        for handler in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                not isinstance(handler, ast.ExceptHandler)
                or handler.name is None
                or handler.type is None
            ):
                continue
            if not names & set(ast.unparse(handler.type).strip("()").split(", ")):
                continue
            said = {f"str({handler.name})", f"{{{handler.name}}}"}
            inside = [
                ast.unparse(node)
                for node in ast.walk(handler)
                if isinstance(node, ast.Call | ast.JoinedStr)
            ]
            found += [
                f"{path.name}:{handler.lineno}"
                for text in inside
                if any(word in text for word in said)
            ]
    assert not found
