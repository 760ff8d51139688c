"""Figures as files: they stand alone, hold what the page shows, and come with their numbers."""

import csv
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from folders import bytes_of
from planish.core.errors import FileError
from planish.report import Canvas, relation, write_report
from planish.report.page import standalone
from report.pages import Page
from report.runs import IMAGE_PAIR, a_run, results_of

SIZE = {"point_um": 100.0, "n": 40, "r": 0.8, "n_eff": 31.2, "interval": [0.6, 0.9], "band": None}
BAND = {
    "shortest_um": 50.0,
    "longest_um": 100.0,
    "coherence": 0.5,
    "p_of_bands": 0.01,
    "phase_deg": 3.0,
    "gain": 2.0,
    "modes": 30.0,
}


def with_evidence():
    run = a_run()
    run["results"]["evidence"] = [IMAGE_PAIR | {"declared": True, "sizes": [SIZE], "bands": [BAND]}]
    return run


def written(folder, run):
    folder.mkdir()
    write_report(
        folder / "report.html", **run | {"results": results_of(run)}, figures=folder / "figures"
    )
    return folder / "figures"


@pytest.fixture(scope="module")
def figures(tmp_path_factory):
    return written(tmp_path_factory.mktemp("run") / "a", with_evidence())


def test_every_figure_of_the_page_is_a_file(figures):
    page = Page((figures.parent / "report.html").read_text(encoding="utf-8"))
    drawn = sorted(figures.glob("*.svg"))
    assert len(drawn) == page.drawings
    assert [path.name[:2] for path in drawn] == [f"{k:02d}" for k in range(1, len(drawn) + 1)]
    for path, shown in zip(drawn, page.svgs, strict=True):
        root = ElementTree.parse(path).getroot()
        assert (root.tag, root.attrib["aria-label"]) == (
            "{http://www.w3.org/2000/svg}svg",
            shown["aria-label"],
        )
        assert "Liberation Sans" in root.attrib["font-family"]
        title, caption = root[0].text, root[1].text
        assert title == shown["aria-label"]
        assert caption in page.text("figcaption").replace("\n", " ")


def test_a_folder_of_figures_that_is_there_is_refused_before_the_page_is_written(tmp_path):
    run = a_run()
    kept = tmp_path / "figures"
    kept.mkdir()
    page = tmp_path / "report.html"
    with pytest.raises(FileError, match="exists already"):
        write_report(page, **run | {"results": results_of(run)}, figures=kept)
    assert [*tmp_path.iterdir()] == [kept]
    assert [*kept.iterdir()] == []
    inner = tmp_path / "new" / "figures"
    write_report(page, **run | {"results": results_of(run)}, figures=inner)
    assert any(inner.glob("*.svg"))


def test_numbers_of_the_figures_are_those_of_the_results(figures):
    rows = {
        path.stem: csv.DictReader(path.read_text(encoding="utf-8").splitlines())
        for path in figures.glob("*.csv")
    }
    found = {re.sub(r"^\d+-", "", stem): list(rows[stem]) for stem in sorted(rows)}
    run = with_evidence()
    linked = run["groups"]["linked"]
    a, b = relation.block_means(
        linked["coating_top"], linked["image"], point_um=100.0, valid=[linked["valid"]]
    )
    points = found["points-of-100-um-points"]
    np.testing.assert_array_equal(
        [float(v) for row in points for v in row.values()], np.stack([a, b], axis=1).ravel()
    )
    assert list(points[0]) == [
        "Coating thickness, top side / µm",
        "Grey value, uncalibrated, luminance",
    ]
    names = {name.rpartition("-")[2]: rows for name, rows in found.items()}
    assert [float(row["r"]) for row in names["sizes"]] == [0.8]
    assert names["sizes"][0]["lower end of the band"] == ""
    assert [float(row["squared coherence"]) for row in names["octaves"]] == [0.5]
    assert [float(row["residual_x / µm"]) for row in names["marks"]] == [0.3, -0.4, 0.1]
    assert names["marks"][0]["label"] == "hole 1"
    known = int(np.isfinite(run["groups"]["maps"]["thickness"].values).sum())
    assert sum(int(row["map pixels"]) for row in found["sheet-thickness-histogram"]) == known
    assert len(names["steps"]) == 4


def test_same_run_gives_the_same_page_and_files(figures, tmp_path):
    again = written(tmp_path / "again", with_evidence())
    assert bytes_of(figures.parent) == bytes_of(again.parent)


def test_hostile_titles_stay_text_and_a_figure_alone_lies_on_white(tmp_path):
    run = a_run(linked=False)
    title = '../../x"><script>紙</script>'
    run["groups"]["maps"]["coating_top"].attrs["long_name"] = title
    folder = written(tmp_path / "run", run)
    assert {path.parent for path in tmp_path.rglob("*.svg")} == {folder}
    assert (folder / "01-x-script-script.svg").is_file()
    assert ElementTree.parse(folder / "01-x-script-script.svg").getroot()[0].text == title
    root = ElementTree.fromstring(
        standalone(Canvas(20, 10).picture(title="紙", caption="a < b")).encode()
    )
    assert root[1].text == "a < b"
    assert root[2].attrib["fill"] == "#ffffff"
