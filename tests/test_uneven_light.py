"""A linked run in even and in uneven light: page, figures and results say both r, and the one that
was declared leads."""

import csv
import io
import json

import numpy as np
import pytest
import tifffile

from folders import write_image
from planish.cli import main
from planish.results import Results
from planish.run import open_run
from planish.run.facts import figures_text
from report.pages import Page


@pytest.fixture(scope="module")
def lit(kinds, tmp_path_factory):
    """Runs of one sheet whose image is in a light that falls off by 30 %, and in an even one."""
    folder, run = tmp_path_factory.mktemp("lit"), kinds("upright")
    stored = tifffile.imread(kinds.small.image).astype(np.float64)
    y, x = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in stored.shape), indexing="ij")
    radius = (y * (stored.shape[0] - 1)) ** 2 + (x * (stored.shape[1] - 1)) ** 2
    radius /= np.sum(np.square(stored.shape))
    vignetting = kinds.specimen("small").params.camera.vignetting
    even = stored / (1 - vignetting * radius)
    lamp = 1 - 0.3 * ((x + 0.3) ** 2 + y**2) / (1.3**2 + 1)
    pixel_um = kinds.specimen("small").params.camera.pixel_um
    for name, image in (("even", even), ("uneven", even * lamp)):
        grey = np.rint(np.clip(image, 0, 65535)).astype(np.uint16)
        write_image(folder / f"{name}.tif", grey, pixel_um)

    def link(name, out, *options):
        arguments = [str(run), str(folder / f"{name}.tif"), *options, "--out", str(folder / out)]
        with pytest.raises(SystemExit) as end:
            main(["link", *arguments])
        assert end.value.code == 0
        return folder / out

    return {
        "even": link("even", "of-even"),
        "uneven": link("uneven", "of-uneven"),
        "declared": link("uneven", "of-declared", "--light", "quadratic"),
    }


def leading(results, point_um=100.0):
    return next(
        row
        for row in results.correlations
        if (row.a_map, row.b_map, row.point_um) == ("coating_top", "image", point_um)
    )


def check_of(results):
    return next(check for check in results.checks if check.name == "even light")


def figures_of(run):
    with (run / "figures.csv").open(encoding="utf-8") as lines:
        return {(row["figure"], row["statistic"]): row for row in csv.DictReader(lines)}


@pytest.mark.ci
def test_uneven_light_is_a_look_and_both_r_are_said(lit):
    even, uneven = (Results.read(lit[name] / "results.json") for name in ("even", "uneven"))
    assert leading(even).r - leading(uneven).r > 0.2
    assert check_of(uneven).state == "look"
    assert leading(uneven).trust == "doubtful"
    (evidence,) = uneven.evidence
    field = evidence.light_field
    assert field.r == pytest.approx(even.evidence[0].light_field.r, abs=0.03)
    assert not field.declared
    page = Page((lit["uneven"] / "report.html").read_text(encoding="utf-8")).text()
    for text in (
        f"{field.r:.2f}",
        f"{field.r_plain:.2f}",
        "with a smooth field of light off",
        "Uneven light is such a field",
    ):
        assert text in page
    rows = figures_of(lit["uneven"])
    off = rows[("r of coating_top and image, a quadratic field of light off", "points of 100 um")]
    assert float(off["value"]) == pytest.approx(field.r)
    assert (off["trust"], off["checks"]) == ("ok", "")
    plain = rows[("r of coating_top and image", "points of 100 um")]
    assert (plain["trust"], plain["checks"]) == ("doubtful", "even light")


@pytest.mark.ci
def test_the_declared_field_is_off_everywhere(lit):
    uneven, declared = (Results.read(lit[name] / "results.json") for name in ("uneven", "declared"))
    assert check_of(declared).state == "pass"
    (before,), (evidence,) = uneven.evidence, declared.evidence
    field = evidence.light_field
    assert field.declared
    # With the light put back, what stands beside is what stood beside.
    assert field.r == pytest.approx(before.light_field.r, abs=0.005)
    assert field.r_plain == pytest.approx(before.light_field.r_plain, abs=0.005)
    row = leading(declared)
    assert row.trust == "ok"
    assert row.r == pytest.approx(field.r, abs=0.01)
    assert row.interval == pytest.approx(field.interval, abs=0.03)
    own = next(r for r in reversed(declared.comparison) if r.point_um == 100.0)
    assert own.r == pytest.approx(row.r, abs=0.03)
    at_points = min(evidence.sizes, key=lambda size: abs(size.point_um - 100.0))
    assert at_points.r == pytest.approx(row.r, abs=0.05)
    page = Page((lit["declared"] / "report.html").read_text(encoding="utf-8")).text()
    assert "a quadratic field of light taken off the image, as declared" in page
    rows = figures_of(lit["declared"])
    name = "r of coating_top and image, a quadratic field of light off"
    assert float(rows[(name, "points of 100 um")]["value"]) == pytest.approx(row.r)
    left_in = rows[("r of coating_top and image, light left in", "points of 100 um")]
    assert float(left_in["value"]) == pytest.approx(field.r_plain)
    assert (
        json.loads((lit["declared"] / "results.json").read_text(encoding="utf-8"))["parameters"][
            "correlate"
        ]["light"]
        == "quadratic"
    )
    assert "smooth light off" in open_run(lit["declared"]).linked["image"].attrs["long_name"]


@pytest.mark.ci
def test_only_an_r_with_the_image_is_said_to_be_without_its_light(kinds):
    results = open_run(kinds("chain")).results
    declared = results.model_copy(update={"parameters": {"correlate": {"light": "quadratic"}}})
    lines = csv.DictReader(io.StringIO(figures_text(declared)))
    names = [layer.name for layer in results.layers]
    off = {row["layers"] for row in lines if row["figure"].endswith("light off")}
    assert off == {f"{names[0]} {names[2]}", f"{names[1]} {names[2]}"}


@pytest.mark.ci
def test_points_smaller_than_pixels_hold_no_field(kinds, planish, tmp_path):
    options = ("--light", "quadratic", "--point-um", "1", "--out", tmp_path / "refused")
    code, _, err = planish("link", kinds("upright"), kinds.small.image, *options)
    assert code == 3
    assert "points of 1 um are smaller than the image's pixels" in " ".join(err.split())
    assert not (tmp_path / "refused").exists()
