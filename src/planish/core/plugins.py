"""What other installed packages add: properties, formats of volumes, exports.

A package names each of them in an entry point of a group of :data:`GROUPS`; its module is imported
where the name is used.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar

from planish.core.errors import InputError, PlanishError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")
Kind = Literal["property", "format", "export"]
GROUPS: dict[Kind, str] = {
    "property": "planish.properties",
    "format": "planish.formats",
    "export": "planish.exports",
}


class Plugin(NamedTuple):
    """One name that a package adds."""

    kind: Kind
    name: str
    package: str
    version: str
    entry: EntryPoint

    def __str__(self) -> str:
        """Return kind, name and owner, for messages."""
        return f"The {self.kind} {self.name!r} of the package {self.package} {self.version}"

    def load(self, expected: type[T]) -> T:
        """Import what the entry point names; InputError where that fails or is something else."""
        with faults_named(str(self), self.entry.module):
            loaded: Any = self.entry.load()
        if isinstance(loaded, expected):
            return loaded
        raise InputError(
            f"{self} is {type(loaded).__name__}, needed is {expected.__name__}. Tell those who make"
            " the package."
        )


@contextmanager
def faults_named(owner: str, module: str) -> Generator[None]:
    """Raise InputError that names the owner, where code of another package fails."""
    try:
        yield
    except (PlanishError, MemoryError, OSError):
        raise
    except Exception as error:
        if module.startswith("planish."):
            raise
        raise InputError(
            f"{owner} (module {module}) fails with {type(error).__name__}: {error}. Tell those who"
            " make it, or do without it."
        ) from error


@cache
def plugins(kind: Kind) -> tuple[Plugin, ...]:
    """What the installed packages add of one kind; nothing of theirs is imported."""
    from importlib.metadata import entry_points  # here, so that other commands wait for none of it

    plugins_of_group = [
        Plugin(kind, entry.name, entry.dist.name, entry.dist.version, entry)
        for entry in entry_points(group=GROUPS[kind])
        if entry.dist is not None
    ]
    return tuple(sorted(plugins_of_group, key=lambda plugin: plugin[:4]))


def find_plugin(kind: Kind, name: str) -> Plugin | None:
    """Return what a package adds under a name.

    InputError where two packages do.
    """
    matching = [plugin for plugin in plugins(kind) if plugin.name == name]
    if len(matching) > 1:
        owners = " and ".join(f"{plugin.package} {plugin.version}" for plugin in matching)
        raise InputError(
            f"The {kind} {name!r} is given by the packages {owners}. Uninstall one of them."
        )
    return matching[0] if matching else None
