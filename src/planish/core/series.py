"""Specimens of a series: what each of them is, and what became of it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from planish.core.facts import Facts

MemberState = Literal["whole", "withheld", "refused", "damaged", "open"]
"""``whole``: linked, no check failed. ``withheld``: linked, and a check failed. ``refused``: its input cannot be used.
``damaged``: a fault of the machine or of planish: memory, disk, a process that ended. ``open``: not done yet."""

FACTORS = ("paper", "sheet", "field", "treatment", "side")
"""Factors that planish knows the meaning of; a table may have others, by which it only sorts."""


class Member(Facts):
    """One specimen of a series."""

    name: str = Field(description="Name of the specimen; its run has this name, too.")
    factors: dict[str, str] = Field(default_factory=dict, description="Factors, such as paper, sheet and treatment.")
    state: MemberState = Field(default="open", description="whole, withheld, refused, damaged or open.")
    message: str = Field(default="", description="Why there is no run, or what a check refuted, and what to do.")
    seconds: float | None = Field(default=None, description="Time that the link took.")
    run: str | None = Field(default=None, description="Folder of its run, relative to that of the series.")

    def folder(self, home: Path) -> Path | None:
        """Folder of its run."""
        return None if self.run is None else home / self.run
