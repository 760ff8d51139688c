"""How a run says what it does at the moment."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, str], None]
"""Called with the name of a stage and a few words."""


def silent(_stage: str, _detail: str) -> None:
    """Say nothing: what a program that calls a run wants unless it asks."""
