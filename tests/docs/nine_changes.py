"""The nine changes that CONTRIBUTING.md shows, as a user of the changed program meets them.

``test_contributing.py`` runs this file with a copy of the package in which all of them are made.
Each test has the name of a heading there.
"""

from contextlib import redirect_stderr
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import program_pages
import pytest
import tifffile

from analyze.fields import compared, lags_of, texture
from folders import write_image
from kinds import SMALL
from planish.analyze.correlation_evidence import QUESTIONS
from planish.cli import main
from planish.io import read_volume
from planish.register import fit_transform
from planish.report.first_screen import recommendations
from planish.results import Results
from planish.run import open_run
from planish.synthetic import BurnParams, make_specimen, write_instruments
from report.runs import page_of, results_of
from report.test_layers import layers

pytestmark = pytest.mark.ci

LIMIT_UM = 15.0
PAGE_OF_OPTIONS = program_pages.commands()


@pytest.fixture(scope="session")
def link(tmp_path_factory):
    """A link with what the changes brought: a volume of NumPy, a threshold, another model."""
    folder = tmp_path_factory.mktemp("nine")
    specimen = make_specimen(replace(SMALL, holes=BurnParams(pattern="irregular", count=8)))
    image = write_instruments(specimen, folder, volume="stack").image
    volume, run = folder / "volume.npy", folder / "run"
    np.save(volume, specimen.volume.values)
    options = ["--voxel-um", "4", "--model", "quadratic", "--coating-above-um", str(LIMIT_UM)]
    messages = folder / "messages.txt"
    with messages.open("w") as file, redirect_stderr(file), pytest.raises(SystemExit) as end:
        main(["link", str(volume), str(image), "--out", str(run), *options])
    assert end.value.code == 0, messages.read_text()
    return SimpleNamespace(
        specimen=specimen,
        volume=volume,
        folder=run,
        run=open_run(run),
        results=open_run(run).results,
        page=(run / "report.html").read_text(encoding="utf-8"),
        messages=messages.read_text(),
    )


def test_a_property_with_a_parameter(link, passes):
    assert "coating_above" in passes("properties")[0]
    assert "--coating-above-um" in PAGE_OF_OPTIONS
    assert f"coating_above_um = {LIMIT_UM}" in (link.folder / "run.toml").read_text()
    assert "Thick coating, top side" in link.page
    linked, truth = link.run.groups["linked"], link.specimen.truth["coating_top"].values
    is_valid = linked["valid"].values & np.isfinite(truth)
    # Noise of the scan and of the registration takes few pixels over the threshold.
    share = np.mean(truth[is_valid] > LIMIT_UM)
    assert linked["coating_above"].values[is_valid].mean() == pytest.approx(share, abs=0.03)


def test_a_format_of_volumes(link, passes, tmp_path):
    assert "format: NumPy" in passes("info", link.volume)[0]
    passes("import", link.volume, "--voxel-um", 4, "--out", tmp_path / "volume.zarr")
    for path in (link.volume, tmp_path / "volume.zarr"):
        assert np.array_equal(read_volume(path, voxel_um=4.0), link.specimen.volume)


def test_a_registration_model(link):
    def bent(points):
        a, b = points.T / 1000
        return np.stack([900 * a - 40 * b * b + 7, 60 * a + 950 * b + 30 * a * b], axis=1)

    moving = np.random.default_rng(0).uniform(0, 2000, (12, 2))
    fit = fit_transform(moving, bent(moving), model="quadratic")
    assert fit.transform(moving + 50) == pytest.approx(bent(moving + 50), abs=1e-6)
    assert fit.transform.inverse(bent(moving)) == pytest.approx(moving, abs=1e-3)
    registration = link.results.layers[0].registration
    assert registration.model == "quadratic"
    assert 0 < registration.leave_one_out_rms_um < 20
    assert 0 < registration.expected_error.median_um < 20
    assert "quadratic from 8 marks" in link.page


def test_a_statistic_beside_r(link):
    assert link.results.evidence[0].quadrants.n > 20
    assert "Blomqvist&#39;s beta is" in link.page
    assert "Quadrants" in program_pages.schema(Results)
    question = next(row for row in QUESTIONS if row.fields == ("quadrants",))
    values = texture((80, 90), 3.0, np.random.default_rng(0))
    for factor in (3.0, -3.0):
        pair = compared((values, factor * values), lags_of(values, (5.0, 5.0)))
        assert question.answer(pair)["quadrants"].beta == np.sign(factor)


def test_an_export_format(link, passes, tmp_path):
    assert "npz" in PAGE_OF_OPTIONS
    passes("export", link.folder, "--to", "npz", "--out", tmp_path / "maps.npz")
    maps = link.run.groups["linked"]
    with np.load(tmp_path / "maps.npz") as arrays:
        assert np.array_equal(arrays["coating_top"], maps["coating_top"], equal_nan=True)
        assert np.array_equal(arrays["x_um"], maps["x"])


def test_a_check(link):
    check = next(row for row in link.results.checks if row.name == "rims")
    sentence = f"{100 * check.value:.0f} % of the columns lie in rims"
    assert check.state == "look"
    assert sentence in link.page
    assert f"look: rims: {sentence}" in link.messages


def test_a_criterion_of_holes(passes, tmp_path):
    """Of five marks one is a twelfth as deep as the others."""
    y, x = np.mgrid[:300, :900] * 5.0
    grey = np.random.default_rng(0).normal(40_000, 100, y.shape)
    for place, depth in enumerate((36_000, 36_000, 3_000, 36_000, 36_000)):
        grey[np.hypot(x - 450 - 900 * place, y - 750) < 90] -= depth
    path = write_image(tmp_path / "image.tif", grey.astype(np.uint16))
    out, err = passes("holes", path, "--out", tmp_path / "marks.json")
    assert "1 too shallow" in out + err


def test_a_recommendation_on_the_first_page():
    text = "Link both layers directly: each link of a chain adds its error."
    for chain in (True, False):
        run = layers(chain=chain)
        assert (text in dict(recommendations(results_of(run)))) is chain
        assert (text in page_of(run)) is chain


def test_a_budget_of_memory(passes, tmp_path):
    """10 million columns of 940 bytes take 60 % of what is beside the 300 MB of the program."""
    path = tmp_path / "volume.tif"
    tifffile.memmap(path, shape=(3, 2500, 4000), dtype="uint8", photometric="minisblack")
    assert "planish map: 16.0 GB of memory" in passes("info", path)[0]
