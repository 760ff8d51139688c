"""Every option, public name, group, variable, results key, exit code and message occurs in the
reference."""

import inspect
import re
from pathlib import Path

import api_pages
import click
import fields
import from_code
import message_pages
import messages
import public_names
import pytest
import xarray as xr

from planish.checks import CHECKS
from planish.cli import planish as group
from planish.core import errors
from planish.core.options import options_of
from planish.measure import registered
from planish.results import Results
from planish.run import GivenLayer, Study, open_run

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def page(name):
    """A page as the site shows it."""
    return from_code.expand((DOCS / name).read_text(encoding="utf-8"))


def commands(command=group, name="planish"):
    yield name, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for key in command.list_commands(context):
            yield from commands(command.get_command(context, key), f"{name} {key}")


# --- the command line and the study file ----------------------------------------------------------
def test_every_command_stands_with_its_options_and_examples():
    sections = dict(
        re.findall(
            r"^## (planish[\w -]*)\n\n```\n(.*?)^```$", page("cli.md"), re.MULTILINE | re.DOTALL
        )
    )
    missing = []
    for name, command in commands():
        shown = [p for p in command.params if isinstance(p, click.Option) and not p.hidden]
        wanted = [flag for option in shown for flag in option.opts]
        if getattr(command, "examples", ()):
            wanted.append(f"\nExamples:\n  {name}")
        missing += [f"{name}: {part}" for part in wanted if part not in sections[name]]
    assert missing == []


def test_every_key_of_a_study_has_type_and_meaning():
    text = page("reference/study.md")
    for _title, model in [("", Study), ("", GivenLayer), *nested(GivenLayer), *nested(Study)]:
        for name, field in model.model_fields.items():
            if not any(True for _ in fields.models_of(field.annotation)):
                [row] = set(
                    re.findall(rf"^\| `{name}` \|.*$", fields.study_table(model), re.MULTILINE)
                )
                assert row in text
                assert all(row.split("|")[k].strip() for k in (2, 5)), f"{model.__name__}.{name}"
        for name, _, shown in options_of(model):
            assert f"| `{name}` |" in text
            assert f"`{shown.flags[0]}`" in text


def nested(model):
    for name, inner in fields.sections_of(model):
        yield name, inner
        yield from nested(inner)


# --- what a run holds -----------------------------------------------------------------------------
def test_every_key_of_the_results_has_its_meaning():
    text = page("reference/results.md")
    models = fields.results_models()
    assert Results in models
    keys = 0
    for model in models:
        assert fields.results_table(model) in text
        for name, field in model.model_fields.items():
            described = fields.description_of(model, name)
            assert described, f"{model.__name__}.{name} has no description"
            assert fields.type_words(field.annotation), f"{model.__name__}.{name}"
            keys += 1
    assert keys > 300


def variables(text):
    """Groups of maps.zarr with their variables and units, from the tables of the page."""
    tables = {}
    for title, body in re.findall(
        r"^## ([^\n]*`)\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL
    ):
        rows = re.findall(r"^\| (`[^|]*`) \|([^|]*)\|", body, re.MULTILINE)
        found = {
            name: unit.strip() for names, unit in rows for name in re.findall(r"`([^`]+)`", names)
        }
        for group_name in re.findall(r"`([^`]+)`", title):
            tables[group_name] = found
    return tables


def check_variables(path):
    text = page("reference/maps.md")
    tables, more = variables(text), registered()
    missing = []
    with xr.open_datatree(path, engine="zarr") as tree:
        for node in tree.subtree:
            name = re.sub(r"^layers/.*", "layers/NAME", node.path.strip("/"))
            if name == "" or name.startswith("overviews") or not node.to_dataset().variables:
                continue
            for key, data in node.to_dataset().variables.items():
                base = re.sub(r"_(se|status)$", "", key)
                if base != key and (base in tables[name] or base in more):
                    assert "`NAME_se`" in text
                    assert "`NAME_status`" in text
                    continue
                unit = tables[name].get(
                    key, more[key].units if key in more and "further maps" in text else None
                )
                if unit is None or ("units" in data.attrs and data.attrs["units"] != unit):
                    missing.append(f"{name}/{key} in {data.attrs.get('units')}, documented: {unit}")
    assert missing == []


def test_every_file_check_and_variable_of_a_run_is_explained(linked_run):
    check_variables(linked_run / "maps.zarr")
    text = page("reference/run-folder.md")
    assert [path.name for path in linked_run.iterdir() if f"`{path.name}`" not in text] == []
    text = page("checks.md")
    rows = {light.name: light for light in CHECKS}
    assert [name for name in rows if f"`{name}`" not in text] == []
    checks = open_run(linked_run).results.checks
    assert len(checks) > 20
    for check in checks:
        light = rows[re.sub(r"^holes in .*", "holes in NAME", check.name)]
        assert {*check.figures} <= {*light.figures, "properties"}, check.name


@pytest.mark.nightly
def test_every_variable_of_other_runs_stands_with_its_unit(passes, tmp_path):
    passes(
        "specimen",
        "--size",
        "T0",
        "--seed",
        "8",
        "--instrument",
        "sections",
        "--out",
        tmp_path / "sheet",
    )
    further = ("porosity", "fibre_angle", "mean_curvature", "coating_difference")
    options = ["--through", "y", "--column-um", "9", "--envelope-um", "250"]
    options += [part for name in further for part in ("--property", name)]
    passes(
        "map", tmp_path / "sheet" / "sections", *options, "--out", tmp_path / "run", codes=(0, 4)
    )
    check_variables(tmp_path / "run" / "maps.zarr")


@pytest.mark.ci
def test_every_map_package_exit_code_and_message_is_collected():
    text = page("reference/maps.md")
    for name, known in registered().items():
        assert f"| `{name}` | {known.units} |" in text
    text = page("reference/api/index.md")
    assert [name for name in public_names.packages() if f"[`{name}`]({name}.md)" not in text] == []
    kinds = [found for _, found in inspect.getmembers(errors, inspect.isclass)]
    used = {found.exit_code for found in kinds} | {0, 2, 4, 130}
    assert {int(code) for code in re.findall(r"^\| (\d+) \|", page("cli.md"), re.MULTILINE)} == used
    texts = {message.text for message in messages.messages()}
    assert "Labels are integers; this volume holds …. Give the label volume, not the grey." in texts
    assert any("The disk is full while writing …" in text for text in texts)


# --- Python ---------------------------------------------------------------------------------------
@pytest.mark.ci
def test_every_public_name_stands_with_a_sentence():
    missing = []
    for package in public_names.packages():
        text = api_pages.package_page(package)
        for name, found in public_names.objects(package):
            has_row = re.search(
                rf"^\| {{py:obj}}`{name} <planish[\w.]*{name}>` \|", text, re.MULTILINE
            )
            if not (has_row and len(api_pages.first_sentence(package, name, found)) > 10):
                missing.append(f"{package}.{name}")
    assert missing == [], "without a row, or without a docstring"


# --- exit codes and messages ----------------------------------------------------------------------
@pytest.mark.ci
def test_every_message_has_its_entry():
    covered = {
        message.text
        for _, patterns in message_pages.families()
        for message in message_pages.of(patterns)
    }
    every = messages.messages()
    assert len(every) > 600
    missing = [f"{m.module}:{m.line}: {m.text}" for m in every if m.text not in covered]
    assert missing == [], "write cause and cure into a page of docs/reference/messages"


@pytest.mark.ci
def test_every_entry_has_messages_a_cause_and_a_cure():
    for path in sorted(message_pages.FOLDER.glob("*.md")):
        text = path.read_text(encoding="utf-8")
        for entry in re.split(r"^### ", text, flags=re.MULTILINE)[1:]:
            lacking = [
                part for part in ("**Cause.**", "**Cure.**", "```{messages}") if part not in entry
            ]
            assert lacking == [], f"{path.name}: {entry.splitlines()[0]}"
        for patterns in (block for page_, block in message_pages.families() if page_ == path):
            for line in filter(None, map(str.strip, patterns.splitlines())):
                there = any(
                    m.module.startswith(line.partition(": ")[0]) for m in messages.messages()
                )
                assert message_pages.of(line) or not there, f"{path.name}: no message fits {line!r}"
