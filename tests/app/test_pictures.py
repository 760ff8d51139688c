"""Pictures of a session: tiles are the maps, only windows are read, smaller copies are made where
there are none."""

import os
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
import xarray as xr
from PIL import Image

from planish.app import Pictures, Tiles, group_pictures, pictures, strain
from planish.app import picture as computed_levels
from planish.app.picture import Codes, ComputedLevels, trim
from planish.app.pictures import TILE
from planish.core.area import overviews
from planish.core.errors import InputError
from planish.io import ImageParams, map_store, read_image, write_tree
from planish.run import open_run

SHAPE = (1100, 2101)  # 2 overviews and an odd number of columns


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """A cache of its own for each test."""
    monkeypatch.setenv("PLANISH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def maps():
    rng = np.random.default_rng(5)
    thickness = rng.normal(80, 6, SHAPE).astype(np.float32)
    thickness[200:300, 100:900] = np.nan
    coords = {"y": 10 + 2.0 * np.arange(SHAPE[0]), "x": -30 + 2.5 * np.arange(SHAPE[1])}
    return xr.Dataset(
        {
            "thickness": (
                ("y", "x"),
                thickness,
                {"units": "um", "long_name": "Sheet thickness", "role": "property"},
            ),
            "valid": (("y", "x"), np.isfinite(thickness)),
        },
        coords=coords,
    )


def written(folder, maps, *, smaller=True):
    """Write maps as the group ``linked`` of a store, and give its pictures."""
    folder.mkdir()
    groups = {"linked": maps}
    if smaller:
        groups |= {f"overviews/linked/{k}": one for k, one in enumerate(overviews(maps), 1)}
    write_tree(folder / "maps.zarr", groups)
    return Pictures(group_pictures(folder, "linked", plane="fixed", layer="image"))


def decoded(codes, numbers):
    """The values that codes stand for; NaN where they are missing."""
    return np.where(
        numbers == 0, np.nan, codes.offset + codes.scale * (numbers.astype(np.float64) - 1)
    )


def mosaic(tiles, picture, level):
    """All tiles of a level as values; what lies beside the picture is missing in every tile."""
    rows, cols = picture.levels[level].shape
    found = np.zeros((-(-rows // TILE) * TILE, -(-cols // TILE) * TILE), np.uint16)
    for r in range(0, rows, TILE):
        for c in range(0, cols, TILE):
            data = tiles.tile(picture.id, level, r // TILE, c // TILE)
            found[r : r + TILE, c : c + TILE] = np.frombuffer(data, "<u2").reshape(TILE, TILE)
    assert not found[rows:].any()
    assert not found[:, cols:].any()
    return decoded(picture.codes, found[:rows, :cols])


def assert_quantised(found, expected, picture):
    """Half a step of the 16 bits, and rounding; values beyond the first and last code would be
    farther off."""
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    np.testing.assert_allclose(found, expected, rtol=0, atol=picture.codes.scale * 0.5001)


@pytest.fixture(scope="module")
def stored(tmp_path_factory, maps):
    """Pictures of a run with overviews."""
    return written(tmp_path_factory.mktemp("pictures") / "run", maps)


def test_tiles_of_all_levels_are_the_maps_and_their_overviews(stored, maps):
    tiles = Tiles(stored)
    thickness, valid = stored
    assert [len(p.levels) for p in stored] == [4, 4]
    for level, data in enumerate([maps, *overviews(maps)]):
        assert_quantised(
            mosaic(tiles, thickness, level), data["thickness"].values.astype(float), thickness
        )
        np.testing.assert_array_equal(mosaic(tiles, valid, level), data["valid"].values)
    assert thickness.codes.scale < 0.01  # um: far below the noise of a pixel
    facts = SimpleNamespace(**thickness.described())
    assert (facts.name, facts.units, facts.plane, facts.shape) == (
        "thickness",
        "um",
        "fixed",
        SHAPE,
    )
    assert (facts.pixel_um, facts.origin_um) == ((2.0, 2.5), (-30.0, 10.0))
    low, high = facts.range  # of means over 8 x 8 pixels, whose spread is an eighth of 6 um
    assert 78 < low < 79
    assert 81 < high < 82


def test_a_tile_reads_its_chunk_and_no_more(stored, monkeypatch):
    assert stored["p0"].codes  # learnt before: from the smallest copy
    read = []
    whole = map_store.PartCache.part
    monkeypatch.setattr(
        map_store.PartCache,
        "part",
        lambda self, *where: read.append(part := whole(self, *where)) or part,
    )
    tiles = Tiles(stored)
    for tile in ((0, 0), (0, 1), (1, 0), (1, 1)):
        tiles.tile("p0", 0, *tile)
    assert ([part.shape for part in read], tiles.read_bytes) == ([(512, 512)], 512 * 512 * 4)
    tiles.tile("p0", 0, 4, 8)
    assert [part.shape for part in read[1:]] == [(SHAPE[0] - 1024, SHAPE[1] - 2048)]


def test_blocks_are_dropped_when_there_are_many(stored):
    tiles = Tiles(stored, most_bytes=3 * 512 * 512 * 4)
    for col in range(4):
        tiles.block(stored["p0"], 0, 0, col)
    once = tiles.read_bytes
    tiles.block(stored["p0"], 0, 0, 1)  # still there
    assert tiles.read_bytes == once
    tiles.block(stored["p0"], 0, 0, 0)  # gone: read again
    assert tiles.read_bytes == once + 512 * 512 * 4


@pytest.mark.parametrize(
    "bad",
    [
        ("p9", 0, 0, 0),
        ("p0", 4, 0, 0),
        ("p0", -1, 0, 0),
        ("p0", 0, 6, 0),
        ("p0", 3, 0, 2),
        ("p0", 0, -1, 0),
    ],
)
def test_a_tile_beyond_the_picture_is_refused(stored, bad):
    with pytest.raises(InputError):
        Tiles(stored).tile(*bad)


def test_codes_stand_for_values_beyond_them_at_both_ends():
    codes = Codes.between(-1.0, 2.0)
    values = np.array([-50.0, -1.0, 0.5, 2.0, 99.0, np.nan, np.inf])
    np.testing.assert_array_equal(codes.of(values)[[0, 1, 3, 4, 5, 6]], [1, 1, 65535, 65535, 0, 0])
    np.testing.assert_allclose(
        decoded(codes, codes.of(values))[[1, 2, 3]], values[1:4], atol=codes.scale / 2
    )
    assert codes.scale == pytest.approx(3 / 65534)


# --- copies that a store does not have ------------------------------------------------------------
def test_an_older_run_without_overviews_looks_the_same(tmp_path, maps, monkeypatch):
    stored, made = written(tmp_path / "run", maps), written(tmp_path / "older", maps, smaller=False)
    # So that a small map has both kinds of levels.
    monkeypatch.setattr(computed_levels, "_LAST_ON_DEMAND", 1)
    made = Pictures(group_pictures(tmp_path / "older", "linked", plane="fixed", layer="image"))
    for one, other in zip(stored, made, strict=True):
        assert len(other.levels) == 4
        for a, b in zip(one.levels, other.levels, strict=True):
            np.testing.assert_array_equal(a.values, b.values)
            np.testing.assert_allclose(a["x"], b["x"])
            np.testing.assert_allclose(a["y"], b["y"])
        # Windows that begin within the level as well.
        np.testing.assert_array_equal(
            one.levels[1][256:512, 512:768].values, other.levels[1][256:512, 512:768].values
        )


class Counted:
    """Values that count how many of them were read."""

    def __init__(self, values):
        self.values, self.shape, self.dtype, self.read = values, values.shape, values.dtype, 0

    def __getitem__(self, where):
        part = self.values[where]
        self.read += part.size
        return part


def test_copies_are_made_in_one_pass_and_kept_for_the_next_session(maps, cache, monkeypatch):
    monkeypatch.setattr(computed_levels, "_LAST_ON_DEMAND", 1)
    values = Counted(maps["thickness"].values)
    levels = ComputedLevels(values, cache / "levels" / "one").levels()
    assert levels[1][0:256, 0:256].shape == (256, 256)
    assert values.read == 512 * 512  # the window alone, twice as wide
    expected = [one["thickness"].values for one in overviews(maps)]
    np.testing.assert_array_equal(levels[3][:, :], expected[2])
    np.testing.assert_array_equal(levels[2][:, :], expected[1])
    assert values.read == 512 * 512 + values.values.size
    again = Counted(maps["thickness"].values)
    np.testing.assert_array_equal(
        ComputedLevels(again, cache / "levels" / "one").levels()[3][:, :], expected[2]
    )
    assert again.read == 0
    assert [one.name for one in (cache / "levels").iterdir()] == ["one"]  # nothing half made stays


def test_a_cache_that_takes_nothing_is_done_without(tmp_path, maps, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setattr(computed_levels, "_LAST_ON_DEMAND", 1)
    levels = ComputedLevels(maps["thickness"].values, tmp_path / "file" / "levels" / "one").levels()
    np.testing.assert_array_equal(levels[3][:, :], [*overviews(maps)][2]["thickness"].values)


def test_the_cache_keeps_what_was_used_last(tmp_path):
    for k, name in enumerate(("oldest", "older", "newest")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "1.npy").write_bytes(bytes(1000))
        os.utime(tmp_path / name, (k, k))
    trim(tmp_path, keep=tmp_path / "newest", most_bytes=2000)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["newest", "older"]


# --- images ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["tiff", "packed tiff", "colour png"])
def test_an_image_file_is_shown_as_it_is_read(tmp_path, made_run, kind):
    rng = np.random.default_rng(2)
    values = rng.integers(0, 255, (700, 1100, 3), dtype=np.uint8)
    path = tmp_path / ("image.png" if "png" in kind else "image.tif")
    if "png" in kind:
        Image.fromarray(values).save(path)
    else:
        tifffile.imwrite(path, values[..., 0], compression="deflate" if "packed" in kind else None)
    params = ImageParams(path=str(path), pixel_um=2.0)
    found = Pictures.of(made_run, params)
    picture = [*found][-1]
    assert (picture.plane, picture.name) == ("fixed", "image")
    expected = read_image(path, pixel_um=2.0)
    np.testing.assert_array_equal(picture.full.values, expected.values)
    assert picture.title == expected.attrs["long_name"]
    assert_quantised(mosaic(Tiles(found), picture, 0), expected.values, picture)
    np.testing.assert_allclose(
        picture.levels[2].values, [*overviews(expected.to_dataset(name="image"))][1]["image"].values
    )
    assert picture.described()["pixel_um"] == (2.0, 2.0)


def test_of_an_image_that_lies_open_in_its_file_windows_are_read(tmp_path, monkeypatch):
    path = tmp_path / "image.tif"
    tifffile.imwrite(path, np.zeros((1400, 1400), np.uint16))
    params = ImageParams(path=str(path), pixel_um=(1.0, 1.0))
    picture = pictures.image_picture(params, plane="fixed", layer="image", name="image")
    sizes = []
    taken = pictures.channel_of
    monkeypatch.setattr(
        pictures,
        "channel_of",
        lambda part, *a, **k: sizes.append(part.values.shape) or taken(part, *a, **k),
    )
    assert (picture.full[512:768, 0:256].values.shape, sizes) == ((256, 256), [(256, 256)])
    assert not computed_levels.user_cache().exists()


def test_pictures_of_a_linked_run(linked_run):
    found = {(p.plane, p.name): p for p in Pictures.of(linked_run)}
    assert {("moving", "coating_top"), ("moving", "presence")} <= set(found)
    assert {("fixed", "coating_top"), ("fixed", "image")} <= set(found)
    with xr.open_datatree(linked_run / "maps.zarr", engine="zarr") as tree:
        for plane, group in (("moving", "maps"), ("fixed", "linked")):
            drawn = {
                str(n)
                for n, data in tree[group].data_vars.items()
                if data.ndim == 2 and data.dtype.kind in "fb"
            }
            assert {name for of, name in found if of == plane} - set(strain.STRAINS) == drawn
            data = tree[group]["coating_top"]
            rows, cols = data.dims
            facts = SimpleNamespace(**found[plane, "coating_top"].described())
            assert (facts.origin_um, facts.shape) == (
                (float(data[cols][0]), float(data[rows][0])),
                data.shape,
            )


def test_pictures_of_a_link_of_two_images(kinds):
    found = {(p.plane, p.name): p for p in Pictures.of(kinds("images"))}
    assert {("fixed", "white/image"), ("fixed", "uv/image"), ("fixed", "uv/valid")} <= set(found)
    linked = open_run(kinds("images")).groups["layers/white"]
    np.testing.assert_array_equal(found["fixed", "white/image"].full, linked["image"])
    np.testing.assert_array_equal(
        found["moving", "white/image"].full, read_image(kinds.small.image).values
    )
