"""Each stage alone, through its command: the chain of files gives what the whole line gives."""

from __future__ import annotations

import json

import numpy as np
import xarray as xr


def load(path, group):
    with xr.open_datatree(path, engine="zarr") as tree:
        return tree[group].to_dataset().load()


def test_the_chain_of_stages_equals_the_line(planish, linked_run, specimen_files, tmp_path):
    volume, image = specimen_files
    steps = [
        ("surface", volume, "-o", tmp_path / "s.zarr"),
        ("measure", tmp_path / "s.zarr", "-o", tmp_path / "p.zarr"),
        ("flatten", tmp_path / "s.zarr", "-o", tmp_path / "f.zarr"),
        ("resample", tmp_path / "p.zarr", tmp_path / "f.zarr", "-o", tmp_path / "m.zarr"),
        ("holes", image, "-o", tmp_path / "image.csv"),
        ("holes", linked_run, "-o", tmp_path / "sheet.csv"),
        ("register", tmp_path / "sheet.csv", tmp_path / "image.csv", "-o", tmp_path / "marks.csv"),
    ]
    for step in steps:
        code, out, err = planish(*step)
        assert code == 0, err
        assert out.strip()
    chain, line = (load(path, "maps")["thickness"] for path in (tmp_path / "m.zarr", linked_run / "maps.zarr"))
    # a run stores properties in single precision
    np.testing.assert_allclose(chain, line, rtol=1e-6)
    line = np.genfromtxt(linked_run / "marks.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    chain = np.genfromtxt(tmp_path / "marks.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    np.testing.assert_allclose(np.sort(chain["fixed_x_um"]), np.sort(line["fixed_x_um"]), atol=1e-9)


def test_correlate_reads_a_run(planish, linked_run):
    code, out, err = planish("correlate", linked_run, "--json")
    assert code == 0, err
    results = json.loads((linked_run / "results.json").read_text())
    whole = [r for r in results["correlation"] if r["property"] == "coating_top"]
    assert [r["n"] for r in json.loads(out)] == [r["n"] for r in whole]
    code, _, err = planish("correlate", linked_run, "--property", "gloss")
    assert code == 3
    assert "gloss" in err


def test_report_is_made_again_from_a_run(planish, linked_run, tmp_path):
    code, _, err = planish("report", linked_run, "-o", tmp_path / "again.html")
    assert code == 0, err
    assert (tmp_path / "again.html").read_bytes() == (linked_run / "report.html").read_bytes()


def test_info(planish, specimen_files):
    code, out, err = planish("info", specimen_files[0], "--json")
    assert code == 0, err
    facts = json.loads(out)
    assert facts["kind"] == "volume"
    code, out, _ = planish("info", specimen_files[1])
    assert code == 0
    assert "pixel size: 5 x 5 um (y, x), from the TIFF resolution" in out


def test_a_store_of_the_wrong_kind(planish, tmp_path):
    code, _, err = planish("measure", tmp_path / "none.zarr", "-o", tmp_path / "p.zarr")
    assert code == 3
    assert "no zarr store" in err


def test_help_of_every_command(planish):
    code, out, _ = planish("--help")
    assert code == 0
    for name in ("link", "map", "demo", "info", "run", "surface", "measure", "flatten", "resample", "register"):
        assert name in out
        assert planish(name, "--help")[0] == 0


def test_a_fault_of_ours_is_a_sentence_and_a_log(planish, specimen_files, tmp_path, monkeypatch):
    def broken(*_args, **_kwargs):
        raise RuntimeError("wires crossed")

    monkeypatch.setattr("planish.pipeline.sheet.find_surfaces", broken)
    code, _, err = planish("map", specimen_files[0], "-o", tmp_path / "run")
    assert code == 1
    assert "wires crossed" in err
    assert ".log" in err
    assert "Traceback" not in err
