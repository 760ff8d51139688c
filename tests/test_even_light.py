"""Links with a white and a dark image: r is that of an even light, the run keeps the light, and
repeats itself from its study, in a series and from the browser."""

import json
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

from app.asgi import HOST, TOKEN, Client
from app.conftest import beside
from folders import write_image
from planish.app import Session, create_app
from planish.app.order import STAGING, order_of
from planish.app.pictures import Pictures, image_picture
from planish.cli import main
from planish.io import ImageParams
from planish.run import open_run, read_study

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def lit(kinds, tmp_path_factory):
    """The small specimen in even light and in one that falls off, with the pictures to undo it."""
    folder, specimen = tmp_path_factory.mktemp("lit"), kinds.specimen("small")
    reflectance, pixel_um = specimen.image.values, specimen.params.camera.pixel_um
    rng = np.random.default_rng(0)
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in reflectance.shape), indexing="ij")
    light = 50000 * (1 - 0.3 * (x**2 + y**2) / 2) * (1 + 0.1 * x)
    noise = 0.01 * light * rng.standard_normal(light.shape)
    dark = 800 + 50 * rng.standard_normal(light.shape)
    pictures = {
        "even": 800 + 50000 * reflectance,
        "uneven": 800 + light * reflectance,
        "white": 800 + light + noise,
        "dark": dark,
    }
    files = {"volume": kinds.small.volume, "folder": folder}
    for name, values in pictures.items():
        grey = np.clip(np.rint(values), 0, 65535).astype(np.uint16)
        files[name] = write_image(folder / f"{name}.tif", grey, pixel_um)
    return SimpleNamespace(**files)


@pytest.fixture(scope="module")
def corrected(lit, link):
    """Folder of the run with white and dark image."""
    return link(lit, "corrected", "--white", lit.white, "--dark", lit.dark)


@pytest.fixture(scope="module")
def link(kinds):
    """Link the uneven image, or another one, with some options, to the maps of the small one."""

    def linked(lit, name, *options, image=None):
        out = lit.folder / name
        words = ["link", kinds("upright"), image or lit.uneven, "--out", out, *options]
        with pytest.raises(SystemExit) as end:
            main([str(word) for word in words])
        assert end.value.code in (0, 4)
        return out

    return linked


def leading(folder, results=None):
    results = results or open_run(folder).results
    rows = [row for row in results.correlations if row.a_map == "coating_top"]
    return max(rows, key=lambda row: row.point_um)


def test_r_is_that_of_an_even_light_and_the_run_keeps_the_light(lit, corrected, link):
    even, uneven = link(lit, "even", image=lit.even), link(lit, "uneven-only")
    r = {name: leading(run).r for name, run in (("even", even), ("plain", uneven))}
    run = open_run(corrected)
    assert leading(corrected).r == pytest.approx(r["even"], abs=0.01)
    assert abs(r["plain"] - r["even"]) > 0.05
    image = run.results.layer("image").image
    assert image.quantity == "reflectance, up to a factor"
    assert list(image.light.files) == ["white.tif", "dark.tif"]
    light = run.groups["light/image"]
    assert light.factor.shape == run.linked.image.shape
    assert int(light.status.max()) == 0
    assert 1 - float(light.factor.min() / light.factor.max()) > 0.25
    assert run.linked.image.attrs["long_name"] == "Reflectance, up to a factor"
    checks = {check.name: check for check in run.results.checks}
    assert checks["white image"].state == "pass"
    page = (corrected / "report.html").read_text(encoding="utf-8")
    assert "Light on image" in page
    assert "grey over that of white.tif, the white sheet, both less dark.tif" in page
    assert str(lit.folder) not in page


def test_a_run_repeats_itself_and_names_its_files_beside_it(planish, corrected):
    text = (corrected / "run.toml").read_text(encoding="utf-8")
    assert 'white = "../white.tif"' in text
    assert read_study(corrected / "run.toml").layers[-1].image.dark == str(
        corrected.parent / "dark.tif"
    )
    code, _, err = planish("run", corrected / "run.toml")
    assert (code in (0, 4), f"same bytes as {corrected}" in err) == (True, True), err


def test_saturated_pixels_do_not_count_and_say_why(lit, link):
    grey = tifffile.imread(lit.uneven)
    grey[40:80, 40:80] = 65535
    path = write_image(lit.folder / "clipped.tif", grey, 5.0)
    options = ("--white", lit.white, "--dark", lit.dark, "--white-exposure", "1")
    run = open_run(link(lit, "clipped", *options, image=path))
    assert not run.linked.valid.values[40:80, 40:80].any()
    assert np.isnan(run.linked.image.values[40:80, 40:80]).all()
    assert (run.groups["light/image"].status.values[40:80, 40:80] == 1).all()
    assert run.results.layer("image").image.quantity == "reflectance"
    check = next(check for check in run.results.checks if check.name == "white image")
    assert check.state == "look"
    assert "of the pixels of the image are saturated" in check.sentence


def test_the_level_is_needed_where_its_curve_is_fitted(planish, lit, kinds, tmp_path):
    call = ("link", kinds("upright"), lit.uneven, "--white", lit.white, "--out", tmp_path / "r")
    code, _, err = planish(*call, "--kubelka-munk", "0.002")
    assert (code, "Give --white-exposure, 1 where" in err) == (3, True), err
    code, _, err = planish(*call, "--dark-grey", "1", "--white-grey", "2")
    assert (code, "pictures or single greys" in err) == (2, True), err
    code, _, err = planish("link", kinds("upright"), lit.uneven, "--dark", lit.dark, "-o", "r")
    assert (code, "give the picture of a white sheet" in err) == (2, True), err


def test_a_series_takes_them_for_all_specimens(planish, lit, kinds, corrected, tmp_path):
    table = tmp_path / "series.toml"
    table.write_text(
        f'[image]\nwhite = "{lit.white}"\ndark = "{lit.dark}"\n'
        f'[[specimens]]\nname = "one"\nlayers = ["{kinds("upright")}", "{lit.uneven}"]\n'
    )
    code, _, err = planish("study", table, "--out", tmp_path / "out")
    assert code in (0, 4), err
    results = open_run(tmp_path / "out" / "runs" / "one").results
    assert leading(None, results).r == leading(corrected).r


def test_apply_keeps_them_and_the_browser_shows_what_is_compared(corrected):
    with closing(Session.open(corrected)) as session:
        app = create_app(session, token=TOKEN, hosts=[HOST])
        client, applied = Client(app), app.state.served.applying
        try:
            change = {"do": "model", "model": "similarity"}
            assert client.post("/api/change", {"change": change}).status == 200
            assert client.post("/api/apply").status == 202
            applied._progress_thread.join(120)
            end = client.get("/api/apply").json()
        finally:
            applied.close()
    assert end["state"] == "done", end
    run = open_run(Path(end["run"]))
    assert run.results.layer("image").image == open_run(corrected).results.layer("image").image
    assert (
        json.loads((Path(end["run"]) / "results.json").read_text())["layers"][0]["registration"][
            "model"
        ]
        == "similarity"
    )
    params = read_study(corrected / "run.toml").layers[-1].image
    picture = image_picture(params, plane="fixed", layer="image", name="image")
    shown = picture.levels[0][0:40, 0:60].values
    whole = open_run(corrected).linked.image.values[0:40, 0:60]
    np.testing.assert_allclose(shown[np.isfinite(whole)], whole[np.isfinite(whole)], rtol=1e-6)
    assert [p.name for p in Pictures.of(corrected)].count("image") == 1


def test_a_map_and_an_image_are_opened_in_even_light(lit, kinds, tmp_path):
    """As after a link that was refused; Apply makes the run with what the image was given."""
    folder = beside(kinds("other-map"), tmp_path)
    params = ImageParams(path=str(lit.uneven), white=str(lit.white), dark=str(lit.dark))
    with closing(Session.open(folder, params)) as session:
        assert session.image.attrs["long_name"] == "Reflectance, up to a factor"
        picture = next(picture for picture in session.pictures if picture.plane == "fixed")
        np.testing.assert_array_equal(picture.levels[0][0:30, 0:40].values, session.image[:30, :40])
        study, _ = order_of(session, folder / STAGING)
    assert (study.layers[-1].image.white, study.layers[-1].image.dark) == (
        str(lit.white),
        str(lit.dark),
    )
