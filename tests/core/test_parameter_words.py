"""Texts name parameters by key; each reader gets the words that this one types."""

import ast
import json
import re
from pathlib import Path

import click
import pytest

import planish
from planish.cli import planish as group
from planish.cli.show import finish
from planish.core.parameter_words import in_python_words, in_terminal_words
from planish.report.notebook import results_html
from planish.run import in_study_words, open_run

SOURCE = Path(planish.__file__).parent
# Of files, and of functions that descriptions of results name.
NAMES = {
    *("active", "compare", "corners", "evidence", "fixed", "history", "index", "moving", "notes"),
    *("pairs", "point", "selected", "titles", "units", "x_um", "y_um"),
}
SHOWS = {"cli", "app", "report", "series", "validate", "exports", "run"}


@pytest.mark.parametrize(
    ("text", "flags", "keywords"),
    [
        (
            "Give it with `voxel_um=SIZE` (or Z,Y,X), in um.",
            "Give it with --voxel-um SIZE (or Z,Y,X), in um.",
            "Give it with voxel_um=SIZE (or Z,Y,X), in um.",
        ),
        (
            "By `seed_um=Z,Y,X`, or crop.",
            "By --seed-um Z,Y,X, or crop.",
            "By seed_um=(Z, Y, X), or crop.",
        ),
        ("Add `override_size=True`.", "Add --override-size.", "Add override_size=True."),
        ("Give `memory=4.5GB`.", "Give --memory 4.5GB.", 'Give memory="4.5GB".'),
        ("Check `through` and `top`.", "Check --through and --top.", "Check through= and top=."),
        ("try `through=y`.", "try --through y.", 'try through="y".'),
        (
            "`beside=coat, base`: no map.",
            "--beside coat, base: no map.",
            'beside=("coat", "base"): no map.',
        ),
        ("`cutoff_um`: too long.", "--cutoff-um: too long.", "cutoff_um: too long."),
    ],
)
def test_a_parameter_is_an_option_on_the_terminal_and_a_keyword_in_python(text, flags, keywords):
    assert in_terminal_words(text) == flags
    assert in_python_words(text) == keywords


@pytest.mark.parametrize(
    "text",
    [
        "a`b`.tif and `b`.tif are no volumes.",
        "`No such column`: x.csv",
        "it`s one, and no more",
        "planish import a.tif --through y --out a.zarr.",
        "Missing values (--, n/a) are no numbers.",
        "``x`` and ` y` and `9`",
    ],
)
def test_other_texts_stay(text):
    assert in_terminal_words(text) == in_python_words(text) == in_study_words(text) == text


def test_a_lone_backtick_hides_no_parameter():
    assert in_terminal_words("it`s.tif: give `top=low`.") == "it`s.tif: give --top low."


def test_a_study_has_keys_and_options_where_it_has_none():
    text = "Give `voxel_um=SIZE` or `image_side`, and `out`."
    assert in_study_words(text) == "Give volume.voxel_um SIZE or image.side, and --out."


def strings(path, sought):
    """Texts of a module that holds what is sought, but docstrings; ``{}`` stands for a value."""
    source = path.read_text(encoding="utf-8")
    if not re.search(sought, source):
        return
    tree = ast.parse(source)
    docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    parts = {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.JoinedStr)
        for part in ast.walk(node)
        if part is not node
    }
    for node in ast.walk(tree):
        if id(node) in docs | parts:
            continue
        if isinstance(node, ast.JoinedStr):
            values = (getattr(part, "value", "{}") for part in node.values)
            yield "".join(value if isinstance(value, str) else "{}" for value in values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def test_no_text_below_the_report_names_an_option():
    found = [
        f"{path.name}: {text}"
        for path in SOURCE.glob("*/**/*.py")
        if path.relative_to(SOURCE).parts[0] not in SHOWS
        for text in strings(path, r"[\s(\"]--[a-z]")
        # Alone it declares an option, or is one of another program.
        if re.search(r"(^|[\s(])--[a-z]", text)
        and not re.fullmatch(r"--[a-z-]+(=\w+)?(\{\})?", text)
    ]
    assert not found


def options_of(command):
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            yield from options_of(command.get_command(context, name))
    for param in command.params:
        yield from (flag for flag in param.opts if flag.startswith("--"))


@pytest.mark.ci
def test_every_parameter_that_a_text_names_is_an_option():
    flags = set(options_of(group))
    for path in SOURCE.rglob("*.py"):
        for text in strings(path, "[^`]`[a-z]"):
            for word in re.findall(r"(?<![\w`])`([a-z][a-z0-9_]*)(?:=[^`\n]*)?`(?![\w`])", text):
                is_option = f"--{word.replace('_', '-')}" in flags
                assert is_option or word in NAMES, f"{path.name}: {text}"


def texts_of(data, name=""):
    """Texts of a JSON file but what is to be set, and what was."""
    if isinstance(data, dict):
        for key, value in data.items():
            if key not in ("remedy", "parameters"):
                yield from texts_of(value, key)
    elif isinstance(data, list):
        for value in data:
            yield from texts_of(value, name)
    elif isinstance(data, str):
        yield data


@pytest.mark.ci
def test_what_a_run_shows_names_options_for_the_operator_alone(linked_run, capsys):
    for text in texts_of(json.loads((linked_run / "results.json").read_text(encoding="utf-8"))):
        assert not re.search(r"`|(^|[\s(])--[a-z]", text), text
    page = (linked_run / "report.html").read_text(encoding="utf-8")
    shown = re.sub(r"<style.*?</style>|<script.*?</script>|<[^>]*>", "", page, flags=re.DOTALL)
    readers, operator = shown.split("For the operator: ")
    assert "`" not in shown
    assert not re.search(r"(?<![\w-])--[a-z]", readers)
    assert "--image-side" in operator
    run = open_run(linked_run)
    assert not re.search(r"`|(^|[\s(])--[a-z]", results_html(run.results))
    finish(run, linked_run, as_json=False)
    out, err = capsys.readouterr()
    assert "`" not in out + err
    assert "--image-side" in out
