"""``planish compare``: a table, a folder, and clear words for what cannot be compared."""

import json

import pytest

from folders import refused
from planish.core.errors import FileError, InputError
from planish.series import members_of
from series.runs import put, results_of


@pytest.fixture
def runs(tmp_path, monkeypatch):
    """Six runs in folders with blanks and umlauts, and a table of them."""
    monkeypatch.chdir(tmp_path)
    lines = ["run;Paper;sheet"]
    for k in range(6):
        put(
            tmp_path / "Läufe" / f"Blatt {k}",
            results_of(mean=20.0 + k + 4 * (k > 2), r=0.5 + k / 50),
        )
        lines.append(f"Läufe/Blatt {k};{'AB'[k > 2]};{k % 3}")
    (tmp_path / "table.csv").write_text("\n".join(lines), encoding="utf-8")
    return sorted((tmp_path / "Läufe").iterdir())


def test_runs_are_compared_and_written_into_a_folder(runs, passes, refuses):
    table = ("compare", "--table", "table.csv", "--out", "both")
    out, _ = passes(*table, "--by", "Paper", "--margin", "coating_top=0.5")
    assert "A and B differ in mean coating thickness (top side): B - A = +7.0" in out
    assert "Blatt 5" in out
    folder = runs[0].parents[1] / "both"
    assert {"report.html", "results.json", "specimens.csv", "values.csv"} <= {
        p.name for p in folder.iterdir()
    }
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert results["specimens"][0]["member"]["run"] == "../Läufe/Blatt 0"
    assert results["differences"][0]["equivalence"]["verdict"] == "larger"
    refuses(*table, words="exists already", out=False)


def test_runs_alone_give_a_table_and_their_mean(runs, passes):
    out, err = passes("compare", *runs, "--json")
    results = json.loads(out)
    assert [s["member"]["name"] for s in results["specimens"]] == [f"Blatt {k}" for k in range(6)]
    assert (results["groups"][0]["sheets"], results["differences"]) == (6, [])
    assert "names no sheets" in err


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (["Läufe/Blatt 0"], 2, "two runs or more"),
        (["Läufe/Blatt 0", "Läufe/Blatt 1", "--by", "paper"], 2, "--table"),
        (["Läufe/Blatt 0", "Läufe/Blatt 1", "--margin", "coating_top"], 2, "no margin"),
        (["Läufe/Blatt 0", "Läufe/nirgends"], 3, "nirgends does not exist"),
        (["Läufe/Blatt 0", "Läufe"], 3, "is no run"),
        (["Läufe/Blatt 0", "Läufe/../Läufe/Blatt 0"], 3, "given twice"),
        (
            ["Läufe/Blatt 0", "Läufe/Blatt 1", "--headline", "coatng_top"],
            3,
            "Did you mean coating_top",
        ),
        (["--table", "table.csv", "--by", "papier"], 3, "Did you mean paper"),
        (["Läufe/Blatt 0", "Läufe/Blatt 1", "--table", "table.csv"], 3, "4 rows without a run"),
    ],
)
@pytest.mark.usefixtures("runs")
def test_what_cannot_be_compared_is_said_in_a_sentence(refuses, args, code, words):
    refuses("compare", *args, words=words, code=code, out=False)


def test_a_damaged_run_ends_with_4_and_none_that_can_be_read_with_3(runs, passes, refuses):
    (runs[0] / "results.json").write_text("{}")
    out, err = passes("compare", *runs[:3], codes=(4,))
    assert "Blatt 0: damaged" in err
    assert "Blatt 2" in out
    for run in runs[1:3]:
        (run / "results.json").write_text(f"{{{run.name}")
    refuses("compare", *runs[:3], words="None of 3 runs can be read")


def test_runs_of_one_name_are_told_apart_by_their_folders_and_a_copy_counts_once(tmp_path):
    one, two, copy = (
        put(tmp_path / k / "run", results_of(mean=mean))
        for k, mean in (("a", 1.0), ("b", 2.0), ("c", 1.0))
    )
    found = members_of([one, two], home=tmp_path / "b")
    assert [(m.name, m.run) for m in found] == [("a/run", "../a/run"), ("b/run", "run")]
    refused(InputError, "one is a copy", members_of, [one, copy], home=tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("paper\nA\n", "neither a column run nor name"),
        ("run,paper\n", "no rows"),
        ("name,paper\nrun-1,A\nrun-1,B\n", "2 rows for the run run-1"),
        ("name,paper\nother,A\n", "no row for the run"),
        (None, r"t\.csv"),
    ],
)
def test_a_table_that_is_missing_or_does_not_fit_is_an_error(tmp_path, text, words):
    table = tmp_path / "t.csv"
    if text is not None:
        table.write_text(text)
    run = put(tmp_path / "run-1", results_of())
    refused((InputError, FileError), words, members_of, [run], home=tmp_path, table=table)
