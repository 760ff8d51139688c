"""The site builds without a warning, its links lead somewhere, and it needs no network to be read
or searched."""

import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import quote

import api_pages
import check_site
import from_code
import public_names
import pytest
import words

DOCS = Path(__file__).resolve().parents[2] / "docs"

# What people type, and the page that answers it.
SOUGHT = {
    "how-to/my-scanner-writes": (
        "SkyScan",
        "Bruker",
        "Zeiss Xradia",
        "Xradia",
        "Nikon XTH",
        "Nikon",
        "Yxlon",
        "GE phoenix",
        "phoenix",
        "RX Solutions",
        "Thermo HeliScan",
        "HeliScan",
        "Tescan",
        "DICOM",
        "TIFF stack",
        "pixel size",
        "voxel size",
        "Voxelgröße",
    ),
    "how-to/grams-per-square-metre": (
        "g/m²",
        "g/m2",
        "gsm",
        "basis weight",
        "grammage",
        "coat weight",
        "Flächengewicht",
        "Strichgewicht",
    ),
    "how-to/sides": (
        "back side",
        "backside",
        "wire side",
        "my image shows the back",
        "Rückseite",
        "mirrored image",
    ),
    "how-to/red-run": ("red", "my run is red", "withheld"),
    "how-to/exclude-a-stain": ("exclude", "stain", "exclude a stain", "mask", "ROI", "Fleck"),
    "how-to/two-holes": ("two holes", "only two holes", "only 2 holes"),
    "how-to/no-holes": ("no laser", "no holes", "ohne Laser"),
    "how-to/marks-from-imagej": (
        "marks from ImageJ",
        "landmarks",
        "Passpunkte",
        "multi-point tool",
    ),
    "how-to/open-in-fiji": ("ImageJ", "Fiji"),
    "how-to/open-in-python": ("MATLAB", "Octave"),
    "how-to/windows": ("Windows", "PowerShell", "execution policy"),
    "how-to/install": ("install", "offline", "uninstall"),
    "how-to/volumes-larger-than-memory": ("out of memory", "RAM"),
    "properties": (
        "Strichdicke",
        "Dicke",
        "caliper",
        "coating thickness",
        "Rauheit",
        "porosity",
        "fiber orientation",
    ),
    "explanation/limits": ("resolution", "Auflösung"),
    "linking": ("Glanz", "gloss", "machine direction"),
    "evidence": ("Helligkeit", "brightness", "relative grey", "p value", "mottle"),
    "explanation/a-report-in-hand": ("side light", "how to cite", "cite", "how strong"),
    "registration": ("image registration", "Registrierung"),
}
# Questions that the documents once left open: each answer is at most two links away from the front
# page.
ANSWERS = (
    "how-to/grams-per-square-metre",
    "how-to/exclude-a-stain",
    "how-to/two-holes",
    "how-to/marks-from-imagej",
    "how-to/red-run",
    "how-to/sides",
    "how-to/my-scanner-writes",
    "explanation/a-report-in-hand",
    "how-to/windows",
    "how-to/install",
    "project/index",
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site."""
    folder = tmp_path_factory.mktemp("site") / "html"
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-b",
        "html",
        "-W",
        "--keep-going",
        "-q",
        str(DOCS),
        str(folder),
    ]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return folder


@pytest.mark.nightly
def test_links_are_whole_and_nothing_comes_from_a_network(site):
    assert check_site.faults(site) == []


@pytest.mark.nightly
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


@pytest.mark.nightly
def test_the_search_finds_the_words_of_users(site, chromium):
    """Typed into the search of the site, opened from a folder, each word has its page once among
    the first three."""
    context = chromium.new_context()
    page = context.new_page()
    missed = {}
    for answer, queries in SOUGHT.items():
        for query in queries:
            page.goto(f"{(site / 'search.html').as_uri()}?q={quote(query)}")
            page.wait_for_function(
                "/finished|did not"
                " match/.test(document.querySelector('.search-summary')?.innerText)"
            )
            links = page.locator("#search-results ul.search > li > a:first-of-type")
            hits = [link.get_attribute("href") for link in links.all()[:3]]
            first = [hit for hit in hits if hit.startswith(f"{answer}.html")]
            # A section may be a hit beside its page, but the page itself is listed once.
            if not first or sum("#" not in hit or "#index-" in hit for hit in first) > 1:
                missed[query] = hits
    context.close()
    assert sum(map(len, SOUGHT.values())) >= 40
    assert missed == {}


def test_every_question_is_answered_within_two_links_of_the_front_page():
    def linked(page):
        path = DOCS / f"{page}.md"
        links = re.findall(r"\]\(([\w./-]+\.md)", path.read_text(encoding="utf-8"))
        leads = {(path.parent / link).resolve() for link in links}
        return {
            lead.relative_to(DOCS).with_suffix("").as_posix()
            for lead in leads
            if lead.is_relative_to(DOCS)
        }

    near = linked("index") | {"project/index"}  # which the bar at the top has on every page
    assert set(ANSWERS) <= near.union(*(linked(page) for page in near))
    assert set(ANSWERS[:9]) <= near


def test_words_of_users_lead_to_pages_that_exist():
    rows = [
        line
        for line in (DOCS / "words.md").read_text(encoding="utf-8").splitlines()
        if line.startswith("| ")
    ]
    rows = [row for row in rows if "](" in row]
    entries = words.entries()
    assert (
        sum(len(sections) for sections in entries.values())
        <= len(rows)
        == len([r for r in rows if words.ROW.match(r)])
    )
    spread = {}
    for page, sections in entries.items():
        text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
        written = words.with_entries(page, text)
        for word in (word for listed in sections.values() for word in listed):
            assert f"! {word}" in written
            spread.setdefault(word.lower(), set()).add(page)
    assert {word: pages for word, pages in spread.items() if len(pages) > 1} == {}


def test_an_entry_stands_behind_its_heading(monkeypatch):
    monkeypatch.setattr(
        words, "entries", lambda: {"page": {"": ["a word"], "the-part": ["b", "c"]}}
    )
    written = words.with_entries("page", "# Page\n\nText.\n\n## The part\n\nMore.\n")
    assert (
        written
        == "# Page\n\n```{index} ! a word\n```\n\n\nText.\n\n## The part\n\n```{index} ! b, !"
        " c\n```\n\n\nMore.\n"
    )
    assert words.with_entries("other", "# Page\n") == "# Page\n"
    with pytest.raises(ValueError, match="the-part"):
        words.with_entries("page", "# Page\n")


@pytest.mark.nightly
def test_every_public_name_has_its_entry(site):
    texts = {
        path.stem: path.read_text(encoding="utf-8")
        for path in (site / "reference" / "api").glob("*.html")
    }
    pages = [check_site.Page(text) for text in texts.values()]
    entries = {place for page in pages for place in page.places}
    linked = {link.partition("#")[2] for page in pages for link in page.links}
    for package in public_names.packages():
        for name in public_names.sources(package):
            has_link = re.search(rf'#planish[\w.]*\.{name}"', texts[package])
            assert f"{package}.{name}" in entries or has_link, f"{package}.{name}"
    assert {link for link in linked if link.startswith("planish.")} <= entries


def test_blocks_and_links_are_replaced_by_what_they_name():
    text = from_code.expand("```{public} planish.report\n```\n")
    assert "write_report" in text
    assert "autofunction:: planish.report.map_html" in text
    assert from_code.expand("```{note} x\ny\n```\n") == "```{note} x\ny\n```\n"
    assert (
        from_code.with_links("[CONTRIBUTING.md](../CONTRIBUTING.md#code)")
        == "[](/project/contributing.md#code)"
    )
    assert from_code.with_links("[linking.md](linking.md)") == "[](linking.md)"
    assert (
        from_code.with_links("[`planish.io`](reference/api/index.md)")
        == "[`planish.io`](reference/api/planish.io.md)"
    )
    assert (
        from_code.with_links("[an example](../examples/01_read.py)")
        == "[an example](../examples/01_read.py)"
    )


def test_each_package_has_a_source_and_no_other_has(tmp_path):
    (tmp_path / "index.md").write_text("# Python\n", encoding="utf-8")
    (tmp_path / "planish.gone.md").write_text("# `planish.gone`\n", encoding="utf-8")
    api_pages.write_sources(tmp_path)
    names = {path.stem for path in tmp_path.glob("*.md")}
    assert names == {"index", *public_names.packages()}
    page = tmp_path / "planish.io.md"
    before = page.stat().st_mtime_ns
    api_pages.write_sources(tmp_path)
    assert page.stat().st_mtime_ns == before


def test_faults_of_a_site_are_named(tmp_path):
    (tmp_path / "index.html").write_text(
        '<a href="other.html#there">a</a><a href="none.html">b</a><script'
        ' src="https://cdn.example.org/x.js"></script><img src="none.png"><a'
        ' href="https://nohost/">c</a><a href="https://example.org/page">d</a>',
        encoding="utf-8",
    )
    (tmp_path / "other.html").write_text('<p id="here">', encoding="utf-8")
    (tmp_path / "site.css").write_text(
        "@import url('//fonts.example.org/a.css');", encoding="utf-8"
    )
    found = "\n".join(check_site.faults(tmp_path))
    for part in (
        "other.html#there leads to no place",
        "none.html leads to nothing",
        "loads https://cdn",
        "none.png, which",
        "https://nohost/ names no host",
        "site.css: loads //fonts",
    ):
        assert part in found
    assert "page" not in found.replace("that page", "")
