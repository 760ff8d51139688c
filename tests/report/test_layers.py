"""The page of several layers: what it shows of each layer and each pair, and that names stay
text."""

import re

import numpy as np
import pytest
import xarray as xr

from planish.analyze import correlate_layers
from planish.core.numbers import to_spread
from planish.report import largest, relation, summary
from planish.report.text import Basis
from planish.results import CorrelationRow
from report.pages import HOSTILE, Page, assert_alone, captions_of
from report.runs import lag_of, marks_of, page_of, planes, registration_of, results_of, text_of

MICRO = "\u202fµm"
# um: what map b of the coating has more than map a, and how much that varies.
OFFSET, SPREAD = 2.5, 0.8


def layer_of(y, x, **values):
    """Return a layer with these maps and what every layer has beside them."""
    data = xr.Dataset(planes(values), {"y": y, "x": x}).astype(np.float32)
    for plane in data.values():
        plane.attrs["role"] = "property"
    is_known = np.isfinite(next(iter(values.values())))
    y, x = np.meshgrid(y, x, indexing="ij")
    data["valid"] = (("y", "x"), is_known & (np.hypot(y - 300, x - 500) > 90))
    error = np.where(is_known, 1 + 0.002 * np.hypot(y - 300, x - 300), np.nan)
    return data.assign(planes({"expected_error": error.astype(np.float32)}))


def some_marks(seed):
    fixed = np.array([[150.0, 120.0], [700.0, 140.0], [430.0, 500.0], [300.0, 330.0]])
    return marks_of(fixed, np.random.default_rng(seed).normal(0, 0.8, fixed.shape), list("abcd"))


def rows_of(maps, a, b):
    """Return the rows of two layers as the program makes them, but for those of an image and the
    thickness."""
    rows = [row.model_dump() for row in correlate_layers(a, b, maps, 60.0)]
    return [row for row in rows if (row["a_map"], row["b_map"]) != ("image", "thickness")]


def layers(*, chain=False, blank=False):
    """Return a sheet before and after calendering and a photograph, on the pixels of the sheet
    after it."""
    rng = np.random.default_rng(3)
    y, x = 6.0 * np.arange(100), 6.0 * np.arange(140)
    after = 18 + 4 * np.sin(y / 41)[:, None] * np.cos(x / 55)[None, :]
    before = after - OFFSET + rng.normal(0, SPREAD, after.shape)
    before[:, :20] = np.nan
    photo = 1000 + 30 * (after - 18) + rng.normal(0, 30, after.shape)
    if blank:
        before[:], photo[:] = np.nan, np.nan
    maps = {
        "before": layer_of(y, x, coating_top=before, thickness=90 + 0.2 * before),
        "photo": layer_of(y, x, image=photo),
        "after": (
            layer_of(y, x, coating_top=after, thickness=90 + 0.2 * after).drop_vars(
                "expected_error"
            )
        ),
    }
    marks = {"before": some_marks(1), "photo": some_marks(2)}
    paths = {
        "before": ("before", "photo", "after") if chain else ("before", "after"),
        "photo": ("photo", "after"),
    }
    listed = []
    for name in maps:
        layer = {
            "name": name,
            "kind": "image" if name == "photo" else "sheet",
            "source": {
                "name": f"{name}.tif",
                "shape": [100, 140],
                "dtype": "uint8",
                "bytes": 14_000,
                "sha256": "ab" * 32,
                "size_um": [6.0, 6.0],
                "size_source": "given",
            },
            "headline": "image" if name == "photo" else "coating_top",
            "share_of_reference": 0.86,
        }
        if name in paths:
            to = paths[name][1]
            layer["registration"] = registration_of(name, to, path=paths[name])
            layer["registration"]["orientation"] = layer["registration"]["orientation"] | {
                "md_deg_fixed_from_moving": 30.0,
                "sentence": f"The machine direction lies at 30 deg in {to}.",
            }
        listed.append(layer)
    listed[0]["registration"]["lag"] = lag_of()
    results = {
        "planish": "0.2.0",
        "versions": {"numpy": "2.4.6"},
        "chain": chain,
        "layers": listed,
        "correlations": [*rows_of(maps, "before", "after"), *rows_of(maps, "photo", "after")],
        "checks": [
            {
                "name": "marks",
                "layers": ["before", "after"],
                "value": 1.5,
                "limit": 20.0,
                "state": "pass",
                "sentence": "4 marks agree to 1.5 um.",
            }
        ],
        "parameters": {
            "chain": chain,
            "layers": [{"name": "before", "volume": {"voxel_um": [3.0, 3.0, 3.0]}}],
            "holes": {"hole_um": [120.0, 320.0]},
        },
    }
    groups = {f"layers/{name}": data for name, data in maps.items()}
    return {"groups": groups, "marks": marks, "results": results}


@pytest.fixture(scope="module")
def page():
    return page_of(layers())


@pytest.fixture(scope="module")
def chain_page():
    return page_of(layers(chain=True))


def test_page_shows_every_layer_and_pair(page):
    read = Page(page)
    text = read.text()
    assert read.sections == ["relation", "linked", "registration", "inputs", "checks", "record"]
    assert read.text("title") == "3 layers on the pixels of after"
    for expected in (
        "before.tif",
        "photo.tif",
        "after.tif",
        "86\u202f%",
        "1.4; 2.6",
        "before → after",
        f"3 marks of before agree to 0.9{MICRO}.",
        "at 30° in after",
        "The check passed.",
        "3 matched, of 5 holes in before and 6 in after",
        f"Points of 60{MICRO}",
        f"The expected error is 1.4{MICRO} (rms, median over the worst layer), at most 2.6",
    ):
        assert expected in text
    # The first page; residuals and expected error of either layer, the lags of one, two maps side
    # by side, and a figure for each pair.
    captions = captions_of(page)
    assert read.drawings == len(captions) == 3 + 2 * 2 + 1 + 2 + 3
    assert [int(v) for v in re.findall(r"<b>Figure (\d+)\.", page)] == [
        *range(1, len(captions) + 1)
    ]
    for caption in captions:
        assert re.search(r"\bn\b", caption)
        assert "mask" in caption.lower()


def test_the_page_states_registrations_and_differences_of_the_same_quantity(page):
    # The weakest correlation in a tile and in the scatter of the first page, a caption for each
    # pair, and the table.
    assert (
        len(re.findall("registration: marks only", Page(page).text(), flags=re.IGNORECASE))
        == 1 + 1 + 3 + 1
    )
    rows = [largest(group) for group in summary.by_pair(results_of(layers()))]
    assert [row.point_um for row in rows] == [60.0] * 3
    assert rows[0].difference_mean == pytest.approx(OFFSET, abs=0.05)
    found = to_spread(rows[0].difference_mean, rows[0].difference_sd)
    assert (
        f"coating thickness (top side) of after minus that of before is {found} µm on average"
        in Page(page).text()
    )
    drawn = [
        "the difference (map on the vertical axis minus map on" in c for c in captions_of(page)[3:6]
    ]
    assert drawn == [True, True, False]


def test_difference_and_drawing_have_one_sign_and_a_pair_without_correlation_is_drawn():
    given = layers()
    a, b = (given["groups"][f"layers/{name}"]["coating_top"] for name in ("before", "after"))
    first, second = relation.block_means(a, b, point_um=60.0)
    row = largest(summary.by_pair(results_of(given))[0])
    assert float((second - first).mean()) == pytest.approx(row.difference_mean, abs=0.1)
    a = layers(blank=True)["groups"]["layers/before"]["coating_top"]
    row = CorrelationRow(
        a="a",
        a_map="m",
        b="b",
        b_map="m",
        point_um=60.0,
        n=0,
        r=None,
        r2=None,
        slope=None,
        intercept=None,
        same_quantity=True,
        units="um",
    )
    drawn = relation.draw_pair(relation.MapPair(a, a, [row]), names=("a", "b"), basis=Basis())
    assert "no correlation" in drawn.svg
    assert "nan" not in drawn.svg


def test_two_instruments_of_one_sheet_are_compared_by_their_difference():
    given = layers()
    results = given["results"]
    results["layers"] = [results["layers"][0], results["layers"][2]]
    results["correlations"] = [row for row in results["correlations"] if row["a"] == "before"]
    read = Page(page_of(given))
    text = read.text()
    assert read.text("title") == "before.tif linked to after.tif"
    assert "minus that of before is" in text
    assert (
        "Coating thickness (top side) of after is larger where coating thickness (top side) of"
        " before is larger" in text
    )
    assert "on the pixels of after" in read.text("figcaption")


def test_two_images_are_called_by_their_names_and_nothing_is_said_of_a_volume():
    given = layers()
    white, results = given["groups"]["layers/photo"], given["results"]
    uv = white.drop_vars("expected_error").assign(image=-white["image"])
    photo = results["layers"][1]
    maps, registration = {"white": white, "uv": uv}, registration_of("white", "uv")
    rows = rows_of(maps, "white", "uv")
    results |= {
        "layers": [
            photo | {"name": "white", "registration": registration},
            photo | {"name": "uv", "registration": None},
        ],
        "correlations": rows,
    }
    given |= {
        "groups": {f"layers/{name}": data for name, data in maps.items()},
        "marks": {"white": some_marks(1)},
    }
    read = Page(page_of(given))
    assert (
        "Uv is darker (grey value, uncalibrated, luminance) where white is lighter: r = −1.00"
        in read.text("p")
    )
    assert "A pixel is one of uv." in read.text("p")
    assert "volume" not in read.text("p")
    axes = [f"Grey value, uncalibrated, luminance, {name}" for name in ("white", "uv")]
    # On the first page, and of pixels and of points.
    assert [read.text("svg").count(axis) for axis in axes] == [3, 3]
    rows[0]["trust"] = rows[1]["trust"] = "doubtful"
    assert "The correlation of white and uv is doubtful" in Page(page_of(given)).text("p")


def test_marks_of_a_chain_are_drawn_in_the_layer_that_they_join(page, chain_page):
    text = Page(chain_page).text()
    assert "before → photo → after" in text
    assert "Places are in the coordinates of photo" in text
    assert "Places are in the coordinates of" not in Page(page).text()


def test_layers_without_a_common_point_still_have_a_page():
    given = layers(blank=True)
    text = text_of(given)
    assert not re.search(r"\b(nan|None|inf)\b", text)
    given["results"]["correlations"] = []
    for layer in given["results"]["layers"][:2]:
        layer["registration"] |= {"expected_error": None, "lag": None, "leave_one_out_rms_um": None}
    given["marks"] = {}
    text = text_of(given)
    assert "No two layers have points in common" in text
    assert not re.search(r"\b(nan|None|inf)\b", text)


def test_names_stay_text():
    given = layers()
    given["groups"] = {k.replace("before", HOSTILE): v for k, v in given["groups"].items()}
    given["marks"][HOSTILE] = given["marks"].pop("before")
    for row in given["results"]["correlations"]:
        row["a"] = row["a"].replace("before", HOSTILE)
    first = given["results"]["layers"][0]
    first["name"] = first["source"]["name"] = HOSTILE
    first["registration"]["path"] = [HOSTILE, "after"]
    given["groups"]["layers/after"]["coating_top"].attrs |= {"long_name": HOSTILE, "units": HOSTILE}
    read = Page(page_of(given))
    assert_alone(read)
    for tag in ("h1", "figcaption", "svg"):
        assert HOSTILE in read.text(tag)
