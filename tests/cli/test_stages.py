"""Each stage alone, through its command: the chain of files gives what the whole line gives."""

import json

import xarray as xr


def load(path, group):
    with xr.open_datatree(path, engine="zarr") as tree:
        return tree[group].to_dataset().load()


def test_the_stages_take_the_groups_of_a_run(passes, linked_run, specimen_files, tmp_path):
    """Surface and measure, and the whole chain byte by byte, are in tests/test_one_line.py."""
    steps = [
        ("flatten", linked_run, "-o", tmp_path / "f.zarr"),
        ("resample", linked_run, tmp_path / "f.zarr", "-o", tmp_path / "m.zarr"),
        ("holes", specimen_files[1], "-o", tmp_path / "image.json"),
        ("holes", linked_run, "-o", tmp_path / "sheet.json"),
        ("register", tmp_path / "sheet.json", tmp_path / "image.json", "-o", tmp_path / "marks.json"),
    ]
    for step in steps:
        out, _ = passes(*step)
        assert out.strip()
    chain, line = (load(path, "maps")["thickness"] for path in (tmp_path / "m.zarr", linked_run / "maps.zarr"))
    # The columns of a run count as measured only where a normal meets both faces: their weight in the mesh differs.
    assert float(abs(chain.mean() - line.mean())) < 0.1
    assert (tmp_path / "marks.json").read_bytes() == (linked_run / "marks.json").read_bytes()
    assert (tmp_path / "marks.csv").read_bytes() == (linked_run / "marks.csv").read_bytes()


def test_correlate_reads_a_run(passes, refuses, linked_run):
    out, _ = passes("correlate", linked_run, "--json")
    results = json.loads((linked_run / "results.json").read_text())
    assert json.loads(out) == results["correlations"]
    out, _ = passes("correlate", linked_run, "--property", "thickness", "--json")
    assert [r["a_map"] for r in json.loads(out)] == ["thickness"] * 2
    refuses("correlate", linked_run, "--property", "gloss", words="gloss", out=False)


def test_report_is_made_again_from_a_run(passes, linked_run, tmp_path):
    passes("report", linked_run, "-o", tmp_path / "again.html")
    assert (tmp_path / "again.html").read_bytes() == (linked_run / "report.html").read_bytes()


def test_info(passes, specimen_files):
    out, _ = passes("info", specimen_files[0], "--json")
    facts = json.loads(out)
    assert facts["kind"] == "volume"
    out, _ = passes("info", specimen_files[1])
    assert "pixel size: 5 x 5 um (y, x), from the TIFF resolution" in out


def test_a_store_of_the_wrong_kind(refuses, tmp_path):
    refuses("measure", tmp_path / "none.zarr", "-o", tmp_path / "p.zarr", words="none.zarr does not exist", out=False)


def test_help_of_every_command(planish, passes):
    out, _ = passes("--help")
    for name in ("link", "map", "demo", "info", "run", "surface", "measure", "flatten", "resample", "register"):
        assert name in out
        assert planish(name, "--help")[0] == 0


def test_a_fault_of_ours_is_a_sentence_and_a_log(planish, specimen_files, tmp_path, monkeypatch):
    def broken(*_args, **_kwargs):
        raise RuntimeError("wires crossed")

    monkeypatch.setattr("planish.run.sheet.find_surfaces", broken)
    code, _, err = planish("map", specimen_files[0], "-o", tmp_path / "run")
    assert code == 1
    assert "wires crossed" in err
    assert ".log" in err
    assert "Traceback" not in err


def test_figures_of_a_run_stand_beside_its_page(planish, passes, linked_run, tmp_path):
    page, figures = tmp_path / "page.html", tmp_path / "figures"
    passes("report", linked_run, "-o", page, "--figures")
    assert page.read_bytes() == (linked_run / "report.html").read_bytes()
    assert any(figures.glob("*-points.csv"))
    # What stands there already is not overwritten, and no page is written without its figures.
    code, _, err = planish("report", linked_run, "-o", tmp_path / "other.html", "--figures")
    assert code != 0
    assert "figures" in err
    assert not (tmp_path / "other.html").exists()
