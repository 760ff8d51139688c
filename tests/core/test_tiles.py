import numpy as np
import pytest

from planish.core.tiles import Engine, Tile, tiles_of


def double(grid, tile):
    return 2.0 * grid[tile.rows, tile.cols]


def fails(_job, _tile):
    raise RuntimeError("asked again for what was kept")


@pytest.mark.parametrize(
    ("shape", "size"), [((7, 9), (3, 4)), ((6, 8), (3, 4)), ((2, 2), (5, 5)), ((1, 10), (1, 3))]
)
def test_tiles_cover_every_place_once(shape, size):
    count = np.zeros(shape, int)
    for tile in tiles_of(shape, size):
        count[tile.rows, tile.cols] += 1
        assert tile.shape[0] <= size[0]
        assert tile.shape[1] <= size[1]
    assert (count == 1).all()


def test_a_grown_tile_stays_in_the_grid_and_an_error_in_a_tile_comes_out():
    tile = Tile(2, 5, 0, 4)
    outer = tile.grown(3, 2, (6, 10))
    assert (outer, tile.within(outer)) == (Tile(0, 6, 0, 6), Tile(2, 5, 0, 4))
    with pytest.raises(RuntimeError, match="asked again"):
        list(Engine(threads=2).map("double", fails, lambda _tile: None, tiles_of((50, 50), (1, 1))))


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_order_whatever_the_threads(threads):
    grid = np.arange(300.0).reshape(15, 20)
    tiles = tiles_of(grid.shape, (2, 3))
    found = list(Engine(threads=threads).map("double", double, lambda _tile: grid, tiles))
    assert [tile for tile, _ in found] == tiles
    out = np.empty_like(grid)
    for tile, part in found:
        out[tile.rows, tile.cols] = part
    np.testing.assert_array_equal(out, 2 * grid)


def test_what_was_kept_is_not_worked_out_again(tmp_path):
    grid = np.arange(12.0).reshape(3, 4)
    tiles = tiles_of(grid.shape, (1, 4))
    engine = Engine(threads=1, folder=tmp_path)
    first = list(engine.map("double", double, lambda _tile: grid, tiles))
    again = list(engine.map("double", fails, lambda _tile: grid, tiles))
    for (_, a), (_, b) in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert not list(tmp_path.rglob("*.part"))
