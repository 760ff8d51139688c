"""Every error a user can meet, by what they can do about it.

::

    PlanishError                     exit code 1
    ├── InputError                   exit code 3: what was given cannot be used as it is
    │   ├── FileError                a file or folder cannot be read or written
    │   ├── SizeError                a voxel or pixel size is missing, contradictory or impossible
    │   ├── VolumeError              the volume does not show one sheet
    │   ├── StudyError               parameters do not fit together, or not to these files
    │   ├── SurfaceError             a surface is missing or out of order
    │   └── MarkError                marks are missing, malformed or unusable
    ├── CannotMeasure                exit code 3: no property can be measured on this surface
    ├── CannotFlatten                exit code 3: the mesh has no sensible flat state
    ├── CannotRegister               exit code 3: the marks do not fix one transformation
    │   └── WrongHand                they would if one side were mirrored
    └── ResourceError                exit code 5: memory or disk is used up

A message says what was found, what is needed, and what to do next. ``error.text`` names
parameters as :mod:`planish.core.parameter_words` has it; the terminal, the app and a series word it
for those who read them. Python shows ``str(error)``, with the words of a call. A message that
contains another one takes its ``text``. The class alone decides the exit code of the command line.
"""

from planish.core.parameter_words import in_python_words
from planish.core.text import plain_numbers


class PlanishError(Exception):
    """Root of all errors that planish raises on purpose."""

    exit_code = 1

    @property
    def text(self) -> str:
        """The message, with parameters by key in backticks."""
        return plain_numbers(super().__str__())

    def __str__(self) -> str:
        """Return the message with the words of a Python call."""
        return in_python_words(self.text)


class InputError(PlanishError):
    """What was given cannot be used as it is."""

    exit_code = 3


class FileError(InputError):
    """A file or folder cannot be read or written."""


class SizeError(InputError):
    """A voxel or pixel size is missing, contradictory or impossible."""


class VolumeError(InputError):
    """The volume does not show one sheet."""


class StudyError(InputError):
    """Parameters that do not fit together, or mean nothing for these files.

    On the command line, wrong usage.
    """


class SurfaceError(InputError):
    """A surface is missing or out of order."""


class MarkError(InputError):
    """Marks are missing, malformed or unusable."""


class CannotMeasure(PlanishError):
    """No property can be measured on this surface."""

    exit_code = 3


class CannotFlatten(PlanishError):
    """The mesh has no sensible flat state."""

    exit_code = 3


class CannotRegister(PlanishError):
    """The marks do not fix one transformation."""

    exit_code = 3


class WrongHand(CannotRegister):
    """The marks fix a transformation only if one side is mirrored."""


class ResourceError(PlanishError):
    """Memory or disk is used up."""

    exit_code = 5


def check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Raise InputError where a keyword has none of the words that are possible."""
    if isinstance(value, str) and value in choices:
        return
    choices_text = " or ".join(
        ", ".join(map(repr, group)) for group in (choices[:-1], choices[-1:]) if group
    )
    raise InputError(f"{name}={value!r} is not possible; needed is {choices_text}.")
