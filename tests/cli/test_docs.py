"""Pages and schema are those of the program."""

import re
from importlib.resources import files
from pathlib import Path

import from_code
import program_pages as docs

import console
from planish.results import Results
from planish.series_results import SeriesResults

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(
    (*ROOT.glob("*.md"), *(path for path in DOCS.rglob("*.md") if "_build" not in path.parts))
)
# Of run.py, of other programs, and of the change that CONTRIBUTING.md shows.
OTHER = {
    "--all",
    "--fix",
    "--host",
    "--port",
    "--nthreads",
    "--eval",
    "--quiet",
    "--ci",
    "--record-seconds",
    "--coating-above-um",
}
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]+")
MESSAGES = re.compile(r"^```\{messages\}.*?^```$", re.MULTILINE | re.DOTALL)
OTHER |= {"--of", "--size", "--texture"}  # of examples/studies/make.py and of a benchmark
OTHER |= {"--require-hashes", "--cpus-per-task", "--mem", "--wrap", "--bind", "--rm", "--user"}
OTHER |= {"--no-index", "--find-links"}  # of pip
OTHER |= {"--force", "--reinstall"}  # of pipx and uv


def test_the_pages_have_the_help_schema_and_terms_of_the_program():
    for page, form in (
        ("cli.md", "\n## planish marks design\n"),
        ("export.md", "| `ome-zarr` | `.ome.zarr`"),
        ("formats.md", "| DICOM file | `.dcm`"),
    ):
        assert form in from_code.expand((DOCS / page).read_text(encoding="utf-8"))
    for place in (DOCS, files("planish.core")):
        text = place.joinpath("results.schema.json").read_text(encoding="utf-8")
        assert text == docs.schema(Results), "run: python3 run.py docs"
    text = (DOCS / "series.schema.json").read_text(encoding="utf-8")
    assert text == docs.schema(SeriesResults), "run: python3 run.py docs"
    terms = re.findall(r"\*\*([\w -]+)\*\*", (DOCS / "glossary.md").read_text(encoding="utf-8"))
    assert len(terms) == len(set(terms)) > 40


def test_pages_link_to_files_that_exist_and_name_commands_and_options_that_exist():
    known = OTHER | set(OPTION.findall(docs.commands()))
    faults = []
    for path in PAGES:
        text = path.read_text(encoding="utf-8")
        links = {
            link for link in re.findall(r"\]\(([^)#\s]+)", text) if not link.startswith("http")
        }
        wrong = {link for link in links if not (path.parent / link).exists()}
        said = re.findall(r"`(planish [a-z]+ [^`\n\"]+)`", text)
        wrong |= console.unknown_verbs(
            text + "".join(f"\n```console\n$ {command}\n```\n" for command in said)
        )
        # Words of messages are no options.
        wrong |= set(OPTION.findall(MESSAGES.sub("", text))) - known
        faults += [f"{path.relative_to(ROOT)}: {one}" for one in wrong]
    assert faults == []
