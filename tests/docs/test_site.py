"""The site builds without a warning, its links lead somewhere, and it needs no network to be read or searched."""

import json
import re
import subprocess
import sys
from pathlib import Path

import check_site
import from_code
import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site."""
    folder = tmp_path_factory.mktemp("site") / "html"
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q", str(DOCS), str(folder)]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return folder


@pytest.mark.study
def test_links_are_whole_and_nothing_comes_from_a_network(site):
    assert check_site.faults(site) == []


@pytest.mark.study
def test_every_document_is_a_page_that_others_lead_to(site):
    documents = [p.relative_to(DOCS) for p in DOCS.rglob("*.md") if "_build" not in p.parts]
    sources = {path.with_suffix(".html") for path in documents}
    pages = {path.relative_to(site) for path in site.rglob("*.html")}
    assert sources <= pages
    linked = set()
    for path in (site / page for page in sources):
        for link in check_site.Page(path.read_text(encoding="utf-8")).links:
            linked.add((path.parent / link.split("#")[0]).resolve())
    assert {str(page) for page in sources if (site / page).resolve() not in linked} == set()


@pytest.mark.study
def test_the_search_finds_words_without_fetching_pages(site):
    options = (site / "_static" / "documentation_options.js").read_text(encoding="utf-8")
    assert "SHOW_SEARCH_SUMMARY: false" in options  # a summary would be fetched, which a page from a folder may not
    assert 'src="searchindex.js"' in (site / "search.html").read_text(encoding="utf-8")
    text = (site / "searchindex.js").read_text(encoding="utf-8")
    index = json.loads(text.removeprefix("Search.setIndex(").removesuffix(")"))
    for word in ("neutral", "bigwarp", "grammag"):
        hits = index["terms"][word]
        assert index["docnames"][hits if isinstance(hits, int) else hits[0]]
    assert "planish.io.read_volume" in json.dumps(index["objects"]) or "read_volume" in json.dumps(index["objects"])


@pytest.mark.study
def test_every_public_name_has_its_entry(site):
    import public_names

    entries = {
        place for path in (site / "reference" / "api").glob("*.html")
        for place in check_site.Page(path.read_text(encoding="utf-8")).places
    }  # fmt: skip
    linked = {
        link.partition("#")[2] for path in (site / "reference" / "api").glob("*.html")
        for link in check_site.Page(path.read_text(encoding="utf-8")).links
    }  # fmt: skip
    for package in public_names.packages():
        page = (site / "reference" / "api" / f"{package}.html").read_text(encoding="utf-8")
        for name in public_names.sources(package):
            assert f"{package}.{name}" in entries or re.search(rf'#planish[\w.]*\.{name}"', page), f"{package}.{name}"
    assert {link for link in linked if link.startswith("planish.")} <= entries


def test_blocks_and_links_are_replaced_by_what_they_name():
    text = from_code.expand("```{public} planish.report\n```\n")
    assert "write_report" in text
    assert "autofunction:: planish.report.map_html" in text
    assert from_code.expand("```{note} x\ny\n```\n") == "```{note} x\ny\n```\n"
    assert from_code.with_links("[CONTRIBUTING.md](../CONTRIBUTING.md#code)") == "[](/project/contributing.md#code)"
    assert from_code.with_links("[linking.md](linking.md)") == "[](linking.md)"
    assert from_code.with_links("[an example](../examples/01_read.py)") == "[an example](../examples/01_read.py)"


def test_faults_of_a_site_are_named(tmp_path):
    (tmp_path / "index.html").write_text(
        '<a href="other.html#there">a</a><a href="none.html">b</a><script src="https://cdn.example.org/x.js"></script>'
        '<img src="none.png"><a href="https://nohost/">c</a><a href="https://example.org/page">d</a>',
        encoding="utf-8",
    )
    (tmp_path / "other.html").write_text('<p id="here">', encoding="utf-8")
    (tmp_path / "site.css").write_text("@import url('//fonts.example.org/a.css');", encoding="utf-8")
    found = "\n".join(check_site.faults(tmp_path))
    for part in (
        "other.html#there leads to no place", "none.html leads to nothing", "loads https://cdn", "none.png, which",
        "https://nohost/ names no host", "site.css: loads //fonts",
    ):  # fmt: skip
        assert part in found
    assert "page" not in found.replace("that page", "")
