"""Why a column, or the ray through it, has no value, and how a flattening ended.

Each with its sentence.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, IntEnum


class Status(IntEnum):
    """Codes of ``status`` in surfaces and maps.

    The names in lower case are the ``flag_meanings``.
    """

    sentence: str

    def __new__(cls, value: int, sentence: str) -> Status:
        """Keep the sentence beside the number."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.sentence = sentence
        return member

    MEASURED = 0, "measured"
    NO_SHEET = 1, "no sheet, or a hole"
    RIM = 2, "left out: rim of a hole or an edge"
    FACE_NOT_FOUND = 3, "a face was not found"
    NORMAL_LEAVES_SHEET = 4, "the normal does not meet both faces"
    TOUCHING = 5, "the sheet touches another one or itself"
    LEAVES_VOLUME = 6, "the sheet leaves the volume"
    PARTICLE = 7, "a particle sticks to the sheet"
    LOW_CONTRAST = 8, "low contrast along the ray"
    RAY_LEAVES_VOLUME = 9, "the ray leaves the volume"

    @property
    def label(self) -> str:
        """Name as it stands in files."""
        return self.name.lower()


FIRST_OWN = 10  # a property's own reasons for a missing value count from here


def status_flags(
    title: str = "Status", *, last: Status = Status.PARTICLE, reasons: Sequence[str] = ()
) -> dict[str, object]:
    """Attributes of a map of status codes.

    The codes up to ``last``, and a property's own reasons.
    """
    values = [*range(last + 1), *range(FIRST_OWN, FIRST_OWN + len(reasons))]
    meanings = [*(status.label for status in Status if status <= last), *reasons]
    return {"long_name": title, "flag_values": values, "flag_meanings": " ".join(meanings)}


class Outcome(Enum):
    """End of a flattening; only ``RESTED`` is a result without reservation."""

    RESTED = "The mesh came to rest."
    OUT_OF_STEPS = (
        "The mesh had not come to rest when the steps ran out: raise the number of steps."
    )
    HELD_OPEN = (
        "At rest but for places where the springs would fold cells over: these are held open and"
        " marked invalid; smooth the centre surface more."
    )
    FOLDED = (
        "Cells of the mesh are folded over: they are marked invalid; smooth the centre surface"
        " more."
    )
    NOT_FINITE = "The mesh left the finite numbers: the centre surface has jumps; look at its map."
