"""The public names of planish, from the ``__init__.pyi`` files that list them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src" / "planish"


def packages() -> list[str]:
    """Every package with a list of public names, ``planish`` first."""
    stubs = sorted(PACKAGE.rglob("__init__.pyi"), key=lambda path: (len(path.parts), path))
    return [".".join(path.parent.relative_to(PACKAGE.parent).parts) for path in stubs]


def sources(package: str) -> dict[str, str]:
    """The public names of a package, each with the module that it is imported from."""
    stub = PACKAGE.parent.joinpath(*package.split("."), "__init__.pyi")
    tree = ast.parse(stub.read_text(encoding="utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    found = {
        alias.asname or alias.name: f"{package}.{node.module}"
        for node in imports
        for alias in node.names
    }
    return dict(sorted(found.items()))


def objects(package: str) -> Iterator[tuple[str, Any]]:
    """Name and object of everything public in a package."""
    module = import_module(package)
    for name in sources(package):
        yield name, getattr(module, name)


def about_constant(module: str, name: str) -> str:
    """Return the string that stands below a constant in the source of a module.

    The module may also be one that it takes the constant from.
    """
    path = PACKAGE.parent.joinpath(*module.split("."))
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    body = ast.parse(path.read_text(encoding="utf-8")).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        targets = (
            node.targets
            if isinstance(node, ast.Assign)
            else [node.target]
            if isinstance(node, ast.AnnAssign)
            else []
        )
        if any(isinstance(target, ast.Name) and target.id == name for target in targets):
            value = after.value if isinstance(after, ast.Expr) else None
            return (
                value.value
                if isinstance(value, ast.Constant) and isinstance(value.value, str)
                else ""
            )
        if (
            isinstance(node, ast.ImportFrom)
            and node.module
            and name in [alias.asname or alias.name for alias in node.names]
        ):
            return about_constant(node.module, name)
    return ""
