"""The page that answers one question; one file that needs nothing else."""

from planish.core.typing import Fields
from planish.report import text

# Tables by their headings: rows of texts, by the headings of their columns
WordTables = dict[str, list[dict[str, str]]]


def answer_page(section: Fields, *, source: str, version: str) -> str:
    """Return the page of an answer as HTML.

    Parameters
    ----------
    section : mapping of str
        ``question``, ``about``, ``is_sound``, ``answer``, ``tiles``, ``surer``, ``reading``,
        ``tables``, ``notes`` and ``pictures``.
    source : str; name of the run or series
    version : str; of the program
    """
    template = text.template("planish.report", "answer.html.j2")
    return f"{template.render(**section, source=source, version=version)}\n"
