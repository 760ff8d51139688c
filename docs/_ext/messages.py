"""Collect every message that planish ends with from its source.

The text has ``…`` where a value stands, and names options as the terminal does.

A message is what an error is raised with: an error of ``core/errors.py``, a ``click.UsageError``,
the ``ValueError`` of a validator that a study file meets, or the reason given to a function that
makes such an error (``damaged``).
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from public_names import PACKAGE

from planish.core.parameter_words import in_terminal_words

GAP = "…"
_ERRORS = PACKAGE / "core" / "errors.py"
# What makes an error of a reason: the position of the reason among the arguments.
_MAKERS = {"damaged": 1, "Damaged": 0, "_damaged": 1, "error": 0, "error_type": 0}
# Modules whose ValueErrors a user meets.
_STUDY = ("study.py", "params.py", "options.py", "presets.py", "draws.py")
_NAMELESS = re.compile(rf"`{GAP}(?:=[^`]*)?`")
_FAULTS = re.compile(r"fault|problem|wrong|clash")  # reasons that are put into a message


@dataclass(frozen=True, slots=True)
class Message:
    """One message: the module and line that raises it, the kind of error, and its text."""

    module: str
    line: int
    kind: str
    text: str


@cache
def messages() -> tuple[Message, ...]:
    """Every message, in the order of modules and lines."""
    found: list[Message] = []
    for path, tree in _trees().items():
        module, constants = path.relative_to(PACKAGE).as_posix(), _constants(tree)
        found += [
            Message(module, line, kind, text)
            for line, kind, text in _of(tree, path, constants)
            if _says(text)
        ]
    return tuple(sorted(found, key=lambda m: (m.module, m.line)))


@cache
def kinds() -> frozenset[str]:
    """Return the names of the errors that a user can meet.

    Those of ``core/errors.py``, and what is made of them elsewhere.
    """
    known = {"UsageError", "BadParameter"}
    known |= {node.name for node in _trees()[_ERRORS].body if isinstance(node, ast.ClassDef)}
    for tree in _trees().values():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and known & {_name(base) for base in node.bases}:
                known.add(node.name)
    return frozenset(known)


@cache
def _trees() -> dict[Path, ast.Module]:
    return {
        path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))
    }


def _of(tree: ast.Module, path: Path, constants: dict[str, str]) -> Iterator[tuple[int, str, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = _name(node.func)
            if name in kinds() or (name == "ValueError" and path.name in _STUDY):
                yield from ((node.lineno, name, text) for text in _texts(node.args[:1], constants))
            if name in _MAKERS and len(node.args) > _MAKERS[name]:
                yield from (
                    (node.lineno, name, text)
                    for text in _texts([node.args[_MAKERS[name]]], constants)
                )
            listed = (
                isinstance(node.func, ast.Attribute) and node.func.attr == "append" and node.args
            )
            if listed and _FAULTS.search(_name(node.func.value)):
                yield from (
                    (node.lineno, "one of several", text) for text in _texts(node.args, constants)
                )
        if isinstance(node, ast.FunctionDef) and _FAULTS.search(node.name):
            for part in ast.walk(node):
                if isinstance(part, ast.Yield) and part.value is not None:
                    texts = _texts([part.value], constants)
                    yield from ((part.lineno, "one of several", text) for text in texts)
        if isinstance(node, ast.Assign) and _FAULTS.search(_name(node.targets[0])):
            yield from (
                (node.lineno, "one of several", text) for text in _texts([node.value], constants)
            )


def _texts(arguments: list[ast.expr], constants: dict[str, str]) -> list[str]:
    """The texts that an expression may have; both where a condition chooses."""
    if not arguments:
        return []
    [node] = arguments
    if isinstance(node, ast.IfExp):
        return _texts([node.body], constants) + _texts([node.orelse], constants)
    text = re.sub(rf"{GAP}(\s*{GAP})+", GAP, _text(node, constants)).strip()
    # A parameter whose name is a value has none to word.
    return [in_terminal_words(_NAMELESS.sub(GAP, text))]


def _text(node: ast.expr, constants: dict[str, str]) -> str:
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else GAP
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(part, constants) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        inner = node.value
        return constants.get(inner.id, GAP) if isinstance(inner, ast.Name) else GAP
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _text(node.left, constants) + _text(node.right, constants)
    if isinstance(node, ast.Name):
        return constants.get(node.id, GAP)
    return GAP


def _constants(tree: ast.Module) -> dict[str, str]:
    """Texts that have a name of their own, such as a remedy that several messages end with.

    Not those told anew.
    """
    found: dict[str, list[str]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            found.setdefault(node.targets[0].id, []).append(_text(node.value, {}))
    return {name: texts[0] for name, texts in found.items() if len(texts) == 1 and _says(texts[0])}


def _name(node: ast.expr) -> str:
    return (
        node.id
        if isinstance(node, ast.Name)
        else node.attr
        if isinstance(node, ast.Attribute)
        else ""
    )


def _says(text: str) -> bool:
    """Tell whether a text has fixed words: at least two letters beside its gaps."""
    return bool(re.search(r"[A-Za-z]{2}", text.replace(GAP, " ")))
