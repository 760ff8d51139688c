"""Pages from templates: one place where they are read, and where values become text that cannot be markup."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from planish.report.draw import Picture


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of the page: its name in addresses, its title in the list of contents."""

    name: str
    title: str


def render(template: str, **values: Any) -> str:
    """Fill a template of this package; every value is escaped, and a missing one is an error."""
    environment = Environment(
        loader=PackageLoader("planish.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    return f"{environment.get_template(template).render(**values)}\n"


def numbered(pictures: dict[str, list[Picture]]) -> dict[str, list[tuple[int, Picture]]]:
    """Number the figures of a page through, in the order of its sections."""
    out: dict[str, list[tuple[int, Picture]]] = {}
    k = 0
    for name, group in pictures.items():
        out[name] = [(k + i + 1, picture) for i, picture in enumerate(group)]
        k += len(group)
    return out
