"""Parameters named in texts: by key, in backticks, and in the words of those who read them.

A message, a check and a help text name a parameter in backticks, by the word of a call::

    Give `voxel_um=SIZE`, or check `through`. If the image is a print, give `printed=True`.

So stages say nothing of command lines, and ``results.json`` can be read as it stands. Where a text
is shown, it is worded for the terminal or for Python; ``planish.run.study`` words it for studies.
"""

import re
from collections.abc import Callable

# At the ends of words alone, so that names of files with backticks stay.
_NAMED = re.compile(r"(?<![\w`])`([a-z][a-z0-9_]*)(?:=([^`\n]*))?`(?!\.?[\w`])(?=(:?))")
_BARE = re.compile(r"[A-Z]+|[\d.]+|True")  # a placeholder, a number: without quotes


def flag_of(word: str) -> str:
    """Option of the command line for a word of a call."""
    return f"--{word.replace('_', '-')}"


def with_names(text: str, name_of: Callable[[str], str]) -> str:
    """Write ``name_of`` each parameter and its value, as on a command line; no value of switches.

    >>> with_names("Give `voxel_um=SIZE`, or `mirror=True`.", str.upper)
    'Give VOXEL_UM SIZE, or MIRROR.'
    """

    def words(named: re.Match[str]) -> str:
        value = "" if named[2] in (None, "True") else f" {named[2]}"
        return f"{name_of(named[1])}{value}"

    return _NAMED.sub(words, text)


def names_in(text: str) -> list[str]:
    """Parameters that a text names, each once.

    >>> names_in("Give `voxel_um=SIZE`, or `mirror=True`.")
    ['voxel_um', 'mirror']
    """
    return list(dict.fromkeys(named[1] for named in _NAMED.finditer(text)))


def in_terminal_words(text: str) -> str:
    """Name options of the command line.

    >>> in_terminal_words("Give `voxel_um=SIZE`, or `mirror=True`.")
    'Give --voxel-um SIZE, or --mirror.'
    """
    return with_names(text, flag_of)


def in_python_words(text: str) -> str:
    """Name keywords of a Python call.

    >>> in_python_words("Give `voxel_um=SIZE`, or try `through=y`; `near`: too far.")
    'Give voxel_um=SIZE, or try through="y"; near: too far.'
    """
    return _NAMED.sub(_keyword, text)


def _keyword(named: re.Match[str]) -> str:
    word, value, colon = named.groups()
    if value is None:  # of a faulty value the name alone is said
        return word if colon else f"{word}="
    literals = [_literal(part.strip()) for part in value.split(",")]
    return f"{word}={literals[0]}" if len(literals) == 1 else f"{word}=({', '.join(literals)})"


def _literal(part: str) -> str:
    return part if _BARE.fullmatch(part) else f'"{part}"'
