"""Make the pages of the Python interface.

A table of everything public in a package, then each with its docstring.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any

from fields import description_of
from public_names import about_constant, objects, packages, sources
from pydantic import BaseModel

_WHOLE = "The whole program: read, map, link, correlate, report, export."


def packages_table() -> str:
    """Return a table of the packages, each with its functions, and the tree of their pages."""
    rows = [
        f"| [`{name}`]({name}.md) | {_WHOLE if name == 'planish' else _about(name)} |"
        f" {_functions(name)} |"
        for name in packages()
    ]
    table = "| Package | What it holds | Functions |\n|---|---|---|\n" + "\n".join(rows)
    tree = "\n".join(packages())
    return f"{table}\n\n```{{toctree}}\n:hidden:\n\n{tree}\n```"


def write_sources(folder: Path) -> None:
    """Write the source of a page for each package, and remove those of packages that are gone."""
    wanted = {
        folder / f"{name}.md": f"# `{name}`\n\n```{{public}} {name}\n```\n" for name in packages()
    }
    for path in set(folder.glob("planish*.md")) - set(wanted):
        path.unlink()
    for path, text in wanted.items():
        # A page that stays as it is keeps its time, by which Sphinx knows what to read anew.
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8", newline="\n")


def package_page(package: str) -> str:
    """Return the Markdown of all that is public in a package."""
    shown = {} if package == "planish" else _shown_elsewhere(package)
    rows, entries = [], []
    for name, found in objects(package):
        anchor = shown.get(id(found), f"{package}.{name}")
        rows.append(f"| {{py:obj}}`{name} <{anchor}>` | {first_sentence(package, name, found)} |")
        if id(found) not in shown:
            entries.append(_entry(package, name, found))
    head = "| Name | What it is |\n|---|---|\n" + "\n".join(rows)
    return f"{_about(package)}\n\n{head}\n\n" + "\n\n".join(entries)


def is_constant(found: Any) -> bool:
    """Tell whether a public name is neither a function nor a class."""
    return not (inspect.isclass(found) or inspect.isroutine(found) or hasattr(found, "py_func"))


def first_sentence(package: str, name: str, found: Any) -> str:
    """Return what a public name is, in a sentence."""
    text = (
        about_constant(sources(package)[name], name)
        if is_constant(found)
        else inspect.getdoc(found) or ""
    )
    return _first_paragraph(text).replace("|", "\\|")


def fields_table(model: type[BaseModel]) -> str:
    """Return the fields of a model as a table: name, type, default, meaning."""
    rows = ["| Field | Type | Default | Meaning |", "|---|---|---|---|"]
    for name, field in model.model_fields.items():
        default = (
            "required"
            if field.is_required()
            else code(field.get_default(call_default_factory=True))
        )
        rows.append(
            f"| `{name}` | {code(words_of_type(field.annotation))} | {default} |"
            f" {description_of(model, name) or ''} |"
        )
    return "\n".join(rows)


def words_of_type(annotation: Any) -> str:
    """Return a type as a reader of Python writes it."""
    text = inspect.formatannotation(annotation)
    for prefix in ("typing.", "collections.abc.", "pathlib."):
        text = text.replace(prefix, "")
    text = re.sub(
        r"numpy\.ndarray\[tuple\[Any, \.\.\.\], numpy\.dtype\[numpy\.(\w+)\]\]",
        r"ndarray of \1",
        text,
    )
    return text.removesuffix(" | None")


def code(value: Any) -> str:
    """Return a value as code in a cell; nothing for None."""
    text = value if isinstance(value, str) else "" if value is None else repr(value)
    return f"`{text}`".replace("|", "\\|") if text else ""


def _shown_elsewhere(package: str) -> dict[int, str]:
    """Where to find what planish itself, or a package inside this one, shows already."""
    inner = [
        other
        for other in ("planish.marks.exchange", "planish.marks.regions")
        if other.startswith(f"{package}.")
    ]
    others = ["planish", *inner, *(["planish.register"] if package == "planish.run" else [])]
    return {
        id(found): f"{other}.{name}"
        for other in others
        for name, found in objects(other)
        if not is_constant(found)
    }


def _entry(package: str, name: str, found: Any) -> str:
    """One name under a heading of its own."""
    full = f"{package}.{name}"
    if is_constant(found):
        about = textwrap.indent(about_constant(sources(package)[name], name), "   ")
        directive = f".. py:data:: {full}\n\n{about}"
    elif inspect.isclass(found):
        own = {k: v for k, v in vars(found).items() if not k.startswith("_")}
        directive = f".. autoclass:: {full}"
        if issubclass(found, BaseModel):  # whose fields stand in the table
            methods = [
                k for k, v in own.items() if isinstance(v, (FunctionType, property)) and v.__doc__
            ]
            directive += f"\n   :members: {', '.join(methods)}" if methods else ""
        elif own and not issubclass(found, BaseException):
            directive += "\n   :members:"
    else:
        directive = f".. autofunction:: {full}"
    text = f"## {name}\n\n```{{eval-rst}}\n{directive}\n```"
    if inspect.isclass(found) and issubclass(found, BaseModel):
        text += "\n\n" + fields_table(found)
    return text


def _functions(package: str) -> str:
    """Links to the functions that a package shows itself, or all of ``planish``."""
    shown = {} if package == "planish" else _shown_elsewhere(package)
    return ", ".join(
        f"{{py:obj}}`{name} <{package}.{name}>`"
        for name, found in objects(package)
        if id(found) not in shown and not (is_constant(found) or inspect.isclass(found))
    )


def _about(package: str) -> str:
    return _first_paragraph(inspect.getdoc(import_module(package)) or "")


def _first_paragraph(text: str) -> str:
    return text.split("\n\n", 1)[0].rstrip(":").replace("\n", " ").replace("``", "`")
