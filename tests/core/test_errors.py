"""Messages speak of the options of the command line there, and of the keywords of a call in
Python."""

import ast
import pickle
from pathlib import Path

import pytest

import planish.app.changes
import planish.core.files  # noqa: F401  their errors, too, are in the tree
from planish.analyze import CorrelateParams
from planish.core import errors
from planish.core.annotations import kinds_of
from planish.core.errors import SWITCHES, PlanishError, SizeError, in_python_words
from planish.core.options import options_of
from planish.exports import ExportParams
from planish.io import ImageParams, VolumeParams
from planish.marks import HoleParams
from planish.measure import MeasureParams
from planish.register import RegistrationParams
from planish.surface import SurfaceParams

SOURCE = Path(errors.__file__).parents[1]


@pytest.mark.parametrize(
    ("flags", "keywords"),
    [
        (
            "Give it with --voxel-um SIZE (or Z,Y,X), in um.",
            "Give it with voxel_um=SIZE (or Z,Y,X), in um.",
        ),
        ("Choose it by --seed-um Z,Y,X, or crop.", "Choose it by seed_um=(Z, Y, X), or crop."),
        (
            "Correct one, or add --override-size to take it.",
            "Correct one, or add override_size=True to take it.",
        ),
        ("Give --memory 4.5GB.", 'Give memory="4.5GB".'),
        ("Check --through and --sheet-grey, or crop.", "Check through= and sheet_grey=, or crop."),
        (
            "The grey changes most along y: try --through y.",
            'The grey changes most along y: try through="y".',
        ),
        ("--beside coat, base: no such map.", 'beside=("coat", "base"): no such map.'),
        ("Leave --corrections out.", "Leave corrections= out."),
        (
            "Ask for it with --property porosity as well.",
            'Ask for it with property="porosity" as well.',
        ),
        # A command stays a command, up to the end of its sentence or its quote.
        (
            "planish import a.tif --through y --out a.zarr. Try --top low.",
            'planish import a.tif --through y --out a.zarr. Try top="low".',
        ),
        (
            "Give --regions to 'planish link --chain' instead.",
            "Give regions= to 'planish link --chain' instead.",
        ),
        ("Missing values (--, n/a) are no numbers.", "Missing values (--, n/a) are no numbers."),
    ],
)
def test_python_is_told_the_keywords_of_a_call(flags, keywords):
    error = SizeError(flags)
    # What contains it may be turned once more.
    assert str(error) == keywords == in_python_words(keywords)
    # As from a process of a cluster.
    assert error.text == flags == pickle.loads(pickle.dumps(error)).text


def test_switches_are_the_options_without_a_value():
    models = (
        VolumeParams,
        ImageParams,
        SurfaceParams,
        MeasureParams,
        HoleParams,
        RegistrationParams,
        CorrelateParams,
        ExportParams,
    )
    switches = {
        flag.removeprefix("--")
        for model in models
        for _, field, shown in options_of(model)
        for flag in shown.flags
        if kinds_of(field.annotation) == [bool]
    }
    assert {*SWITCHES} == {*switches, "chain"}  # chain is an argument of link


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
