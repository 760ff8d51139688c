"""Chunks of maps that planish packs itself against those of zarr."""

import numpy as np
import pytest
import zarr

from planish.io.map_chunks import CODECS, is_ours, read_chunks, write_chunks

WHOLE = slice(0, 700), slice(0, 530)


def made(folder, name="map", dtype=np.float32, **other):
    fill_value = np.nan if np.dtype(dtype).kind == "f" else 0
    options = {
        "chunks": (256, 200),
        "compressors": CODECS,
        "config": {"write_empty_chunks": True},
    } | other
    return zarr.create_array(
        folder, name=name, shape=(700, 530), dtype=dtype, fill_value=fill_value, **options
    )


@pytest.fixture(params=[np.float32, np.float64, np.bool_])
def values(request):
    values = np.random.default_rng(0).normal(size=(700, 530)) * 50
    return values > 0 if request.param is np.bool_ else values.astype(request.param)


def test_the_files_are_those_of_zarr(tmp_path, values):
    made(tmp_path / "zarr", dtype=values.dtype)[:] = values
    ours = made(tmp_path / "ours", dtype=values.dtype)
    assert is_ours(ours)
    write_chunks(tmp_path / "ours" / "map", ours, WHOLE, values)
    sides = tmp_path / "zarr", tmp_path / "ours"
    files = [
        {p.relative_to(side): p.read_bytes() for p in side.rglob("*") if p.is_file()}
        for side in sides
    ]
    assert len(files[0]) == 2 + 9
    assert files[0] == files[1]
    np.testing.assert_array_equal(zarr.open_array(tmp_path / "ours", path="map")[:], values)


@pytest.mark.parametrize(
    "where", [WHOLE, (slice(100, 300), slice(390, 530)), (slice(256, 512), slice(0, 200))]
)
def test_parts_are_written_and_read_wherever_they_lie(tmp_path, where):
    values = np.random.default_rng(1).normal(size=(700, 530)).astype(np.float32)
    array = made(tmp_path / "a")
    write_chunks(tmp_path / "a" / "map", array, where, values[where])
    np.testing.assert_array_equal(array[where], values[where])
    # The rest is missing.
    np.testing.assert_array_equal(read_chunks(tmp_path / "a" / "map", array, WHOLE), array[:])
    rest = (slice(0, 700), slice(0, 100))  # beside and over it: what was there stays
    write_chunks(tmp_path / "a" / "map", array, rest, values[rest])
    np.testing.assert_array_equal(read_chunks(tmp_path / "a" / "map", array, where), values[where])


def test_a_damaged_chunk_is_told(tmp_path):
    array = made(tmp_path / "a")
    array[:] = 1.0
    file = tmp_path / "a" / "map" / "c" / "1" / "0"
    raw = bytearray(file.read_bytes())
    raw[len(raw) // 2] ^= 1
    file.write_bytes(raw)
    with pytest.raises(ValueError, match="chunk 0 of map is damaged"):
        read_chunks(tmp_path / "a" / "map", array, WHOLE)
    read_chunks(tmp_path / "a" / "map", array, (slice(0, 256), slice(0, 200)))  # another chunk
    smaller = made(tmp_path / "b", chunks=(128, 200))
    smaller[:] = 1.0
    for content in (b"", b"\0" * 4, (tmp_path / "b" / "map" / "c" / "0" / "0").read_bytes()):
        file.write_bytes(content)  # nothing, nothing with its sum, and a chunk of another size
        with pytest.raises((ValueError, RuntimeError)):
            read_chunks(tmp_path / "a" / "map", array, WHOLE)


def test_what_is_packed_otherwise_is_left_to_zarr(tmp_path):
    others = ({"compressors": None}, {"compressors": zarr.codecs.ZstdCodec()}, {"dtype": ">f4"})
    for k, other in enumerate(others):
        assert not is_ours(made(tmp_path / "a", name=str(k), **other))
