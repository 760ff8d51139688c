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
    └── ResourceError                exit code 5: memory or disk is used up

A message says what was found, what is needed, and what to do next. It is written with the options
of the command line: ``error.text``, which the terminal, the app, series and results show. Python
shows ``str(error)``, the same with the words of a call: ``voxel_um=`` for ``--voxel-um``. So
nothing has to be set for either, in any thread or process; a message that contains another one
takes its ``text``. The class alone decides the exit code of the command line.
"""

import re

from planish.core.text import plain_numbers

# Options without a value, of those that a call in Python may be told to give.
SWITCHES = frozenset(
    {"as-seen", "chain", "mirror", "mottle", "override-size", "printed", "unusual-size"}
)
# Up to the end of its sentence, or its quote.
_COMMAND = r"\b(?:planish|pip|dask) [a-z](?:[^.;'\n]|\.(?=[^\s']))*"
# What follows a word that is a value and no part of the sentence.
_ENDS = r"(?=[.,;:)]|$| as well| is not possible)"
_WORD = (
    rf"[zyx]|top|bottom|high|low|[a-z]+(?:_[a-z]+)+|(?!out\b|instead\b|first\b)[a-z][a-z-]*{_ENDS}"
)
_VALUE = rf"\d[\d.,]*(?<=\d)[A-Z]*|[A-Z]+(?:,[A-Z]+)*|(?:{_WORD})(?:, (?:{_WORD}))*(?=:)|{_WORD}"
_BARE = re.compile(r"[A-Z]+|[\d.]+")  # a placeholder, a number: without quotes
_FLAG = re.compile(rf"{_COMMAND}|(?<![\w-])--([a-z][a-z0-9-]*)(?:[ =]({_VALUE})(?![\w-]))?(:?)")
_CHOICE = re.compile(r"\b(\w+): '(\w+)' is not possible")


def in_python_words(text: str) -> str:
    """Name the keywords of a Python call in a message that names options.

    Commands for a terminal stay as they are.

    >>> in_python_words("Give --voxel-um SIZE, or try --through y. For help: planish link --help.")
    'Give voxel_um=SIZE, or try through="y". For help: planish link --help.'
    """
    return _CHOICE.sub(r'\1="\2" is not possible', _FLAG.sub(_keyword, text))


def _keyword(match: re.Match[str]) -> str:
    if match[1] is None:
        return match[0]
    name, value = match[1].replace("-", "_"), match[2]
    if value is None:  # of a faulty value the name alone is said
        return f"{name}:" if match[3] else f"{name}={'True' if match[1] in SWITCHES else ''}"
    values = [value_text.strip() for value_text in value.split(",")]
    literals = [
        value_text if _BARE.fullmatch(value_text) else f'"{value_text}"' for value_text in values
    ]
    return (
        f"{name}=({', '.join(literals)}){match[3]}"
        if len(literals) > 1
        else f"{name}={literals[0]}{match[3]}"
    )


class PlanishError(Exception):
    """Root of all errors that planish raises on purpose."""

    exit_code = 1

    @property
    def text(self) -> str:
        """The message with the options of the command line."""
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
