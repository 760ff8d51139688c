"""How an iteration ended, as a sentence with the next thing to try."""

from enum import Enum


class Outcome(Enum):
    """End of a flattening; only ``RESTED`` is a result without reservation."""

    RESTED = "The mesh came to rest."
    OUT_OF_STEPS = "The mesh had not come to rest when the steps ran out: raise the number of steps."
    HELD_OPEN = (
        "At rest but for places where the springs would fold cells over: these are held open and marked invalid; "
        "smooth the centre surface more."
    )
    FOLDED = "Cells of the mesh are folded over: they are marked invalid; smooth the centre surface more."
    NOT_FINITE = "The mesh left the finite numbers: the centre surface has jumps; look at its map."
