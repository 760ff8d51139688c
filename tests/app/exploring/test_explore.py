"""The page of ``planish explore`` as a file: what it holds, what it says, and that nothing else
gets in."""

import base64
import hashlib
import json
import re
import shutil

import numpy as np
import pytest
import tifffile

from app.exploring.made import Explored, put
from folders import bytes_of
from planish.app import explore
from planish.app.exploring import maps as maps_module
from planish.app.exploring import page as page_module
from planish.app.exploring import slices as slices_module
from planish.core.area import overviews
from planish.io import read_group, write_tree
from planish.report.text import as_compared
from planish.run import open_run
from report.pages import HOSTILE
from report.runs import a_run
from report.test_layers import layers


@pytest.fixture(scope="module")
def page_path(linked_run, tmp_path_factory):
    """The page of the small run, whose volume is there."""
    path = tmp_path_factory.mktemp("page") / "page.html"
    explore(linked_run, path)
    return path


@pytest.fixture(scope="module")
def page(page_path):
    return Explored(page_path)


def explored(planish, run, tmp_path):
    path = tmp_path / "page.html"
    code, _, err = planish("explore", run, "--out", path)
    assert code == 0, err
    return Explored(path)


# --- values ---------------------------------------------------------------------------------------
def test_every_value_is_that_of_the_run_to_what_the_page_states(page, linked_run):
    linked = open_run(linked_run).linked
    titles = {
        as_compared(str(v.attrs.get("long_name", k)), str(k)): k
        for k, v in linked.data_vars.items()
    }
    assert "Warp (negative control)" in [one["title"] for one in page.data["maps"]]
    assert len(page.data["maps"]) == 12
    for one in page.data["maps"]:
        spec, found = page.map(one["title"])
        data = linked[titles[one["title"]]].values.astype(float)
        np.testing.assert_array_equal(np.isnan(found), np.isnan(data))
        inside = np.isfinite(found)
        assert (
            np.abs(found - data)[inside].max() <= spec["error"] * (1 + 1e-6) + 1e-4 * spec["step"]
        )
        assert inside.sum() >= 0.998 * np.isfinite(data).sum()
    group = page.data["groups"][0]
    np.testing.assert_array_equal(page.unpack(group["valid"]) > 0, linked["valid"].values)
    for axis, spec in group["places"].items():
        np.testing.assert_allclose(page.unpack(spec), linked[f"volume_{axis}"].values, atol=0.02)


def test_leading_maps_come_first_with_the_sentence_of_the_report_and_a_picture_without_script(
    page, linked_run
):
    report = (linked_run / "report.html").read_text(encoding="utf-8")
    [lead] = re.findall(r'<p class="lead">(.*?)</p>', report)
    assert f'<p class="lead">{lead}</p>' in page.html
    titles = [one["title"] for one in page.data["maps"]]
    assert titles[:2] == ["Coating thickness, top side", "Grey value, uncalibrated"]
    assert not [title for title in titles if "error of the coating" in title or "Place" in title]
    assert page.data["grid"]["dx"] == 5.0
    [image] = [attrs for tag, attrs in page.elements if tag == "img"]
    assert image["src"].startswith("data:image/")
    assert image["alt"] == "Coating thickness, top side, as a picture"
    assert ("div", {"class": "desk", "id": "desk", "hidden": ""}) in page.elements
    assert (
        "Missing are the other 11 maps, the cursor with its values, the scatter and the slices."
        in page.words
    )
    assert "Firefox 113" in page.words


def test_slices_are_every_second_row_with_the_faces_of_the_run(page, linked_run):
    [stack] = page.data["stacks"]
    surfaces = open_run(linked_run).groups["surfaces"]
    rows = np.arange(1, surfaces.sizes["y"], 2)
    kept = [k for k, row in enumerate(rows) if np.isfinite(surfaces["top"].values[row]).any()]
    np.testing.assert_allclose(stack["at"], surfaces["y"].values[rows[kept]])
    every = round(stack["points"][1] / 4.0)
    for name in ("top", "interface_top", "centre", "interface_bottom", "bottom"):
        found, expected = (
            page.unpack(stack["lines"][name]),
            surfaces[name].values[rows[kept]][:, ::every],
        )
        # Heights are written in sixteenths of a voxel of 4 um.
        np.testing.assert_allclose(found, expected, atol=0.5 * 4.0 / 16 + 0.01)
    assert stack["sign"] == 1
    assert "in 2 rows of volume.tif" in page.words


def test_a_picture_of_a_slice_shows_the_volume_with_its_top_up(page, specimen_files):
    import io

    from PIL import Image

    [stack] = page.data["stacks"]
    volume = tifffile.imread(specimen_files[0]).astype(float)
    k = len(stack["at"]) // 2
    begin, end = (stack["ends"][k - 1], stack["ends"][k])
    picture = Image.open(io.BytesIO(base64.b64decode(page.blocks[stack["pictures"]][begin:end])))
    shown = np.asarray(picture.convert("L")).astype(float)
    top = round((stack["top"][k] - 2.0) / 4.0)  # the plane of its first row
    plane = volume[top - shown.shape[0] + 1 : top + 1, round(stack["at"][k] / 4.0)][::-1]
    assert shown.shape == plane.shape
    # Lossy: grains are noise, layers are not. Turned or shifted by two voxels it would fall far
    # below.
    assert np.corrcoef(shown.ravel(), plane.ravel())[0, 1] > 0.97
    assert np.corrcoef(shown[::-1].ravel(), plane.ravel())[0, 1] < 0.8


# --- what it is made of ---------------------------------------------------------------------------
def test_nothing_but_its_own_style_and_script_may_run_and_nothing_is_asked_of_a_server(page):
    [policy] = [
        attrs["content"]
        for tag, attrs in page.elements
        if attrs.get("http-equiv") == "Content-Security-Policy"
    ]
    [script] = page.running

    def hashed(text):
        return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"

    assert (
        policy
        == f"default-src 'none'; style-src {hashed(page.style)}; script-src {hashed(script)};"
        " img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    for tag, attrs in page.elements:
        assert "style" not in attrs, tag
        assert not [name for name in attrs if name.startswith("on")]
        assert all(attrs.get(name, "data:").startswith(("data:", "#")) for name in ("src", "href"))
    assert not re.findall(
        r"(?:https?:)?//[a-z]|@import|url\(|\beval\b|innerHTML|Function\(", page.style + script
    )


def test_the_command_says_what_it_wrote_repeats_its_bytes_and_writes_over_nothing(
    passes, refuses, linked_run, tmp_path, page
):
    path, run = tmp_path / "page.html", bytes_of(linked_run)
    out, _ = passes("explore", linked_run, "--out", path, "--json")
    told = json.loads(out)
    assert (told["bytes"], told["maps"]) == (path.stat().st_size, 12)
    assert told["slices"] == len(page.data["stacks"][0]["at"])
    before = path.read_bytes()
    assert before.decode() == page.html
    refuses("explore", linked_run, "--out", path, words="never written over", out=False)
    assert path.read_bytes() == before
    assert bytes_of(linked_run) == run


def test_it_refuses_an_output_in_the_run_and_what_is_no_run(refuses, made_run, tmp_path):
    inside = made_run / "page.html"
    refuses("explore", made_run, "--out", inside, words="which is read", out=False)
    assert not inside.exists()
    elsewhere = tmp_path.parent / "page-of-no-run.html"
    refuses("explore", tmp_path, "--out", elsewhere, words="is no run", out=False)


# --- other runs -----------------------------------------------------------------------------------
def test_where_the_volume_is_gone_it_shows_the_slices_of_the_run_and_says_so(planish, tmp_path):
    page = explored(planish, put(tmp_path / "run", a_run()), tmp_path)
    [stack] = page.data["stacks"]
    assert stack["at"] == [120.0, 270.0, 420.0]
    assert (
        "3 slices across y: the 3 that the run keeps, as sheet.tif was not there unchanged when"
        " this page" in page.words
    )
    assert str(tmp_path) not in page.html


def test_another_file_in_the_place_of_the_volume_is_not_shown(
    planish, linked_run, specimen_files, tmp_path
):
    run = tmp_path / "run"
    shutil.copytree(linked_run, run)
    volume = tifffile.imread(specimen_files[0])
    tifffile.imwrite(tmp_path / "other.tif", volume[::-1])
    text = (run / "run.toml").read_text(encoding="utf-8")
    (run / "run.toml").write_text(
        re.sub(r'path = ".*volume\.tif"', 'path = "../other.tif"', text), encoding="utf-8"
    )
    page = explored(planish, run, tmp_path)
    assert len(page.data["stacks"][0]["at"]) == 3
    assert "not there unchanged" in page.words


def test_a_sheet_without_an_image(planish, tmp_path):
    page = explored(planish, put(tmp_path / "run", a_run(linked=False)), tmp_path)
    assert page.data["maps"][0]["title"] == "Coating thickness, top side"
    assert page.data["grid"]["names"] == ["u", "v"]
    assert "No image was linked." in page.words
    assert page.data["groups"][0]["valid"] is None


def test_a_map_without_any_value_is_shown_empty(planish, tmp_path):
    page = explored(planish, put(tmp_path / "run", layers(blank=True)), tmp_path)
    assert np.isnan(page.unpack(page.data["maps"][0])).all()


def test_several_layers_each_with_its_own_maps_and_masks(planish, tmp_path):
    run = layers()
    page = explored(planish, put(tmp_path / "run", run), tmp_path)
    assert page.data["several"]
    assert [one["layer"] for one in page.data["maps"]][:3] == ["before", "photo", "after"]
    for one in page.data["maps"][:3]:
        name = "image" if one["layer"] == "photo" else "coating_top"
        expected = run["groups"][f"layers/{one['layer']}"][name].values
        np.testing.assert_allclose(page.unpack(one), expected, atol=one["error"] * 1.001)
        valid = run["groups"][f"layers/{one['layer']}"]["valid"].values
        np.testing.assert_array_equal(
            page.unpack(page.data["groups"][one["group"]]["valid"]) > 0, valid
        )
    assert page.data["stacks"] == []
    assert "No slices: the run does not say where its pixels lie in a volume." in page.words


def test_two_sheets_have_the_slices_of_both(planish, linked_run, tmp_path):
    run = layers()
    for name in ("before", "after"):
        data = run["groups"][f"layers/{name}"]
        places = {
            f"volume_{axis}": (("y", "x"), np.add.outer(data["y"].values, data["x"].values))
            for axis in "xyz"
        }
        run["groups"][f"layers/{name}"] = data.assign(places)
    folder = put(tmp_path / "run", run)
    shutil.copytree(linked_run, folder / "layers" / "before")
    page = explored(planish, folder, tmp_path)
    assert [one["sheet"] for one in page.data["stacks"]] == ["before"]
    assert "No slices of after: its surfaces are not in this run." in page.words


def test_what_checks_doubt_and_withhold_is_said(planish, tmp_path):
    run = a_run()
    run["results"]["checks"] += [
        {
            "name": "blur of the coating",
            "state": "fail",
            "figures": ["coating_top"],
            "layers": ["volume"],
            "sentence": "The coating is thinner than the blur.",
            "advice": "Scan it finer.",
        },
        {
            "name": "few marks",
            "state": "look",
            "figures": ["position"],
            "sentence": "3 marks only.",
        },
    ]
    page = explored(planish, put(tmp_path / "run", run), tmp_path)
    assert [one["trust"] for one in page.data["maps"]][:2] == ["withheld", "ok"]
    assert page.data["maps"][0]["why"] == ["blur of the coating"]
    pairs = {(a, b): (trust, why) for a, b, trust, why in page.data["pairs"]}
    assert pairs[0, 1] == ("withheld", ["blur of the coating"])
    thickness = next(
        k for k, one in enumerate(page.data["maps"]) if one["title"] == "Sheet thickness"
    )
    assert pairs[1, thickness] == ("doubtful", ["few marks"])
    for words in (
        "1 failed",
        "The coating is thinner than the blur.",
        "Scan it finer.",
        "3 marks only.",
        "withheld; see the checks",
    ):
        assert words in page.words


def test_hostile_names_stay_text(planish, tmp_path):
    run = a_run()
    run["results"]["layers"][0]["source"]["name"] = HOSTILE
    run["results"]["checks"].append(
        {
            "name": HOSTILE,
            "state": "look",
            "figures": ["coating_top"],
            "sentence": HOSTILE,
            "advice": HOSTILE,
        }
    )
    for group in ("linked", "maps"):
        run["groups"][group]["coating_top"].attrs |= {"long_name": HOSTILE, "units": HOSTILE}
    page = explored(planish, put(tmp_path / "run", run), tmp_path)
    assert (page.data["maps"][0]["title"], len(page.running)) == (HOSTILE, 1)
    assert sum(tag == "img" for tag, _ in page.elements) == 1
    assert not [name for _, attrs in page.elements for name in attrs if name.startswith("on")]
    # The title, the heading, the check, the map below the picture.
    assert page.words.count(HOSTILE) >= 5


# --- size -----------------------------------------------------------------------------------------
def test_maps_and_slices_are_thinned_out_to_their_budget_and_the_page_says_so(
    planish, linked_run, tmp_path, monkeypatch, page
):
    full = sum(len(text) for text in page.blocks.values())
    monkeypatch.setattr(maps_module, "BUDGET", 60_000)
    monkeypatch.setattr(page_module, "BUDGET", 120_000)
    small = explored(planish, linked_run, tmp_path)
    assert len(small.html) < 0.4 * full
    grid = small.data["grid"]
    halvings = round(np.log2(grid["dx"] / 5.0))
    assert halvings >= 1
    assert small.data["halved"]
    assert (
        f"means of {2**halvings} x {2**halvings} pixels of the run, to keep the page small"
        in small.words
    )
    assert sum(len(small.blocks[one["block"]]) for one in small.data["maps"]) <= 60_000
    [stack] = small.data["stacks"]
    assert f"thinned out to {len(stack['at'])}" in small.words
    assert len(small.blocks[stack["pictures"]]) <= 120_000
    # The first pixel of a halved map lies half a pixel further in.
    assert grid["x0"] == pytest.approx(5.0 * (2**halvings - 1) / 2)
    linked = open_run(linked_run).linked
    spec, found = small.map("Sheet thickness")
    size = 2**halvings
    rows, cols = (n // size * size for n in linked["thickness"].shape)
    blocks = (
        linked["thickness"].values[:rows, :cols].reshape(rows // size, size, cols // size, size)
    )
    inside = np.isfinite(blocks).all(axis=(1, 3))
    expected = np.where(inside, blocks.mean(axis=(1, 3)), np.nan)
    assert (
        np.abs(found[: rows // size, : cols // size] - expected)[inside].max()
        <= spec["error"] * 1.001 + 1e-4
    )


@pytest.mark.ci
def test_large_maps_come_from_the_smaller_copies_of_the_store(planish, tmp_path, monkeypatch):
    monkeypatch.setattr(maps_module, "BUDGET", 30_000)
    folder = put(tmp_path / "run", a_run())
    page = explored(planish, folder, tmp_path)
    assert page.data["halved"]
    smaller = enumerate(overviews(read_group(folder / "maps.zarr", "linked"), most_px=4), 1)
    # Values that no mean of the map has show where they were read.
    marked = {
        f"overviews/linked/{k}": data.assign(thickness=data["thickness"] + 1000.0)
        for k, data in smaller
    }
    write_tree(folder / "maps.zarr", marked)
    (tmp_path / "page.html").unlink()
    _, found = explored(planish, folder, tmp_path).map("Sheet thickness")
    assert np.nanmin(found) > 1000.0


def test_the_budgets_leave_room_below_twelve_megabytes():
    # Picture, words and script take the remainder.
    assert maps_module.BUDGET + slices_module.BUDGET <= page_module.LARGEST - 900_000
    assert page_module.LARGEST == 12_000_000
