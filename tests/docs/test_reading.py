"""The documents and the page of a run read well: short sentences, the glossary's words, and none of
the old ones."""

import re
import statistics
from pathlib import Path

import reading

ROOT = Path(__file__).resolve().parents[2]
MOST_WORDS = 18  # median of a page
LONGEST = 75  # of one sentence: a list of what a table cannot hold
PAGES = reading.pages(ROOT)

# Words of the project's early days, and what is said in their place.
OLD = {
    r"\btold\b": "reported, stated, distinguished",
    r"\bthe door\b": "the entry point",
    r"\brungs?\b": "models",
    r"\bcrumbs?\b": "fragments",
    r"\blook_over\b": "inspect",
    r"\blean_of\b": "tilt of",
    r"\b_as_seen\b": "as displayed",
    r"\bsays nothing of\b": "inconclusive",
    r"\bnobody said\b": "not given",
    r"\bwhat became of\b": "status",
    r"\btends to be\b": "is",
    r"\bnot higher: with\b": "not chosen: its error is higher",
    r"\bthe next best arrangement\b": "the second-best match",
    r"\bone's way\b": "path",
    r"\bmade-up\b": "synthetic",
    r"\btell-tale\b": "sign",
}

# One thing, one name: other names of what the glossary has a term for.
TERMS = {
    r"\bmid-?surfaces?\b|\b(middle|central|median) surfaces?\b": "centre surface",
    r"\bgr[a]y( values?| levels?|scale)?\b|\bgreyscale\b": "grey",
    r"\b(run|output|results?) director(y|ies)\b|\b(output|results?) folders?\b": "run folder",
    r"\b(config(uration)?|settings|parameter) files?\b": "study",
    r"\b(cross-validation|jack-?knife|LOO|LOOCV) errors?\b|\bLOO\b": "leave-one-out error",
    r"\b(target|moving|source) images?\b|\breference images?\b": (
        "moving layer, fixed layer, reference"
    ),
    r"\b(front|back|upper|lower|wire|felt) sides?\b": "top side, bottom side",
    r"\b(upper|lower) (face|surface)s?\b|\b(top|bottom) surfaces?\b": "face",
    r"\b(mesh|grid) (points?|vertex|vertices)\b|\bvertex\b|\bvertices\b": "node",
    r"\bbase (sheet|layer|stock)s?\b": "base",
    r"\bcoating layers?\b": "coating",
    r"\b(effective|independent) (sample size|samples)\b": "independent points",
    r"\bresidual errors?\b": "residual",
    r"\b(unwrap|unroll|unfold)(s|ped|ed|ping|ing)? (the|a) sheet\b": "flatten",
    r"\b(drill|puncture|pinhole)s?\b": "hole",
    r"\bthe other side of the (paper|sheet)\b": "bottom side",
}
# Pages that speak of other programs, in the words of these, or lead from the words of readers to
# ours.
THEIRS = {"words.md", "marks-files.md", "other-tools.md", "paper.md", "marks-from-imagej.md"}


def read(path):
    return path.read_text(encoding="utf-8")


def with_words(unwanted, pages):
    """The sentences in which one of the words stands, with their page and what to write instead."""
    found = []
    for path in pages:
        text = " ".join(reading.prose(read(path)).split())
        for word, instead in unwanted.items():
            for match in re.finditer(word, text, re.IGNORECASE):
                start, end = text.rfind(". ", 0, match.start()) + 1, text.find(". ", match.end())
                found.append(
                    f"{path.relative_to(ROOT)}: {text[start:end].strip()!r}: write {instead}"
                )
    return found


def test_sentences_are_short():
    found = []
    for path in PAGES:
        sentences = reading.sentences(read(path), template=path.suffix == ".j2")
        lengths = [len(reading.words(one)) for one in sentences]
        if len(lengths) < 5:
            continue
        if (median := statistics.median(lengths)) > MOST_WORDS:
            found.append(
                f"{path.relative_to(ROOT)}: half of the sentences have {median} words and more"
            )
        longest = [one for one, length in zip(sentences, lengths, strict=True) if length > LONGEST]
        found += [f"{path.relative_to(ROOT)}: {one}" for one in longest]
    assert found == []


def test_no_word_of_the_old_idiolect():
    assert with_words(OLD, PAGES) == []


def test_each_term_of_the_glossary_is_used_one_way():
    assert with_words(TERMS, [path for path in PAGES if path.name not in THEIRS]) == []


def test_sentences_are_counted_and_terms_are_those_of_the_glossary():
    page = (
        "# A heading\n\nTwo words here. `code` begins this one, see e.g. [a page](x.md#y) for"
        " it.\n\n| a | table |\n|---|---|\n| that does not | count |\n\n- One point of a list\n-"
        " Another one, with **bold** words\n\n```\nnot counted at all\n```\n"
    )
    found = reading.sentences(page)
    assert [len(reading.words(one)) for one in found] == [3, 10, 5, 5]
    assert reading.sentences(
        "<p>One short sentence here.</p><p>{{ value }} um are stated.</p>", template=True
    ) == [
        "One short sentence here.",
        "7 um are stated.",
    ]
    glossary = set(re.findall(r"\*\*([\w -]+)\*\*", read(ROOT / "docs" / "glossary.md")))
    wanted = {term for terms in TERMS.values() for term in terms.split(", ")}
    assert wanted - {"grey", "flatten", "moving layer", "fixed layer"} <= glossary | {
        "independent points"
    }
