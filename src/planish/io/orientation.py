"""How a volume or an image lies in space by its file: its hand, and which way its axes run.

Values stay as they are stored. planish takes x to the right, y downwards and the slices as they are
numbered; a file that makes this a left-handed system holds a mirror image of the specimen.
"""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from planish.core.text import and_join
from planish.core.typing import Floats, Texts

LEAST_VOLUME = 1e-3  # of the cell of three unit vectors; below, they lie in one plane
# Where a step along x and one along y of the stored picture lead, to the right and downwards, in
# the picture as viewers show it (TIFF 6.0, tag 274).
TAG_STEPS = {
    2: ((-1, 0), (0, 1)),
    3: ((-1, 0), (0, -1)),
    4: ((1, 0), (0, -1)),
    5: ((0, 1), (1, 0)),
    6: ((0, 1), (-1, 0)),
    7: ((0, -1), (-1, 0)),
    8: ((0, -1), (1, 0)),
}
# Where anatomical words point in a right-handed system: left, posterior, superior.
ANATOMICAL = {
    "left": (1.0, 0.0, 0.0),
    "right": (-1.0, 0.0, 0.0),
    "posterior": (0.0, 1.0, 0.0),
    "anterior": (0.0, -1.0, 0.0),
    "superior": (0.0, 0.0, 1.0),
    "inferior": (0.0, 0.0, -1.0),
}


SENTENCES = {
    ("volume", "hand"): (
        "The axes of the volume make a left-handed system ({}): its slices and maps are a mirror"
        " image of the specimen."
    ),
    ("volume", "turned"): (
        "The axes of the volume run another way than usual ({}). It is read as it is stored, turned"
        " and not mirrored."
    ),
    ("image", "hand"): (
        "The image is stored as a mirror image ({}); viewers mirror it back, planish reads it as it"
        " is stored."
    ),
    ("image", "turned"): (
        "The image is stored turned ({}); viewers turn it back, planish reads it as it is stored."
    ),
}


class Orientation(NamedTuple):
    """Where the axes z, y, x of an array run in a right-handed space, as one source states it."""

    source: str  # for example "its affine"
    directions: Floats  # (3, 3): along z, y, x; each (x, y, z) in space

    @property
    def volume(self) -> float:
        """Volume of the cell of unit vectors along x, y, z; below 0 where it is left-handed."""
        lengths = np.linalg.norm(self.directions, axis=1)
        if not np.all(np.isfinite(lengths)) or not np.all(lengths > 0):
            return 0.0
        along_xyz = self.directions[::-1]
        return float(np.linalg.det(along_xyz) / lengths.prod())

    @property
    def is_left_handed(self) -> bool:
        """True if the stack is a mirror image."""
        return self.volume < 0

    @property
    def is_flat(self) -> bool:
        """True if the directions lie in one plane, and so are none."""
        return abs(self.volume) < LEAST_VOLUME

    @property
    def is_usual(self) -> bool:
        """True if the axes run along those of the space, within 45 degrees."""
        lengths = np.linalg.norm(self.directions, axis=1)
        # Of z along z, y along y, x along x.
        cosines = np.diagonal(self.directions[:, ::-1]) / lengths
        return bool(np.all(cosines > np.sqrt(0.5)))


def orientation_by_steps(source: str, steps: Sequence[float | None]) -> list[Orientation]:
    """Orientation by the signs of the steps of coordinates along z, y, x.

    Empty where none falls.
    """
    signs = [-1.0 if step is not None and step < 0 else 1.0 for step in steps]
    if min(signs) > 0:
        return []
    return [Orientation(source, np.diag(signs)[:, ::-1])]


def orientation_by_words(source: str, words: Sequence[str]) -> list[Orientation]:
    """Orientation by where z, y and x run to: left, posterior, superior or their opposites.

    Empty where a word is another one.
    """
    if not ANATOMICAL.keys() >= {*words}:
        return []
    return [Orientation(source, np.array([ANATOMICAL[word] for word in words]))]


def tag_orientation(tag: object) -> list[Orientation]:
    """Orientation by the tag of a picture, or of the slices of a stack.

    Empty where it turns nothing.
    """
    if not isinstance(tag, int) or tag not in TAG_STEPS:
        return []
    x_step, y_step = TAG_STEPS[tag]
    along_y = (*y_step, 0)
    along_x = (*x_step, 0)
    directions = np.array([(0, 0, 1), along_y, along_x], np.float64)
    return [Orientation(f"the orientation tag {tag}", directions)]


def orientation_attrs(orientations: Sequence[Orientation]) -> Mapping[str, str]:
    """Attributes of a volume or an image.

    ``hand`` where it is left-handed by one source at least, ``turned`` where it is not, but its
    axes run another way than usual.
    """
    sources: dict[str, list[str]] = {"left": [], "right": [], "turned": []}
    for orientation in orientations:
        if orientation.is_flat:
            continue
        sources["left" if orientation.is_left_handed else "right"].append(orientation.source)
        if not orientation.is_usual:
            sources["turned"].append(orientation.source)
    if sources["left"]:
        right_text = f"; but right, by {and_join(sources['right'])}" if sources["right"] else ""
        return {"hand": f"left, by {and_join(sources['left'])}{right_text}"}
    if sources["turned"]:
        return {"turned": f"by {and_join(sources['turned'])}"}
    return {}


def orientation_notes(orientations: Sequence[Orientation]) -> Texts:
    """Say which sources give no directions at all."""
    return tuple(
        f"The directions of {o.source} lie in one plane: they say nothing about the hand."
        for o in orientations
        if o.is_flat
    )


def hand_sentence(attrs: Mapping[str, object], subject: Literal["volume", "image"]) -> str:
    """Say how a volume or an image lies by its attributes; empty where it is as usual."""
    for key in ("hand", "turned"):
        if key in attrs:
            return SENTENCES[subject, key].format(attrs[key])
    return ""
