"""Files of a watched folder: taken once, when they are whole and stand still."""

import os
from functools import partial

import h5py
import numpy as np
import pytest
import tifffile

from planish.core.errors import InputError
from planish.series import Plan, watched
from planish.series.watch import watch_params


class Clock:
    now = 0.0

    def __call__(self):
        return self.now

    def after(self, seconds, coming):
        """What a look at the folder finds so much later."""
        self.now += seconds
        return next(coming)


def plan(folder, **watch):
    return Plan(specimens=(), home=folder, watch=watch)


def write(path, *, seed=0):
    values = np.random.default_rng(seed).integers(0, 255, (6, 40, 30), dtype=np.uint8)
    if "_ct" in path.name:
        tifffile.imwrite(path, values, imagej=True, metadata={"axes": "ZYX"})
    else:
        tifffile.imwrite(path, values[0])
    return path.read_bytes()


def test_pairs_are_taken_once_when_they_are_whole_and_stand_still(tmp_path):
    clock, said = Clock(), list[str]()
    coming = watched(
        plan(tmp_path, volume="{paper} {sheet}_ct.tif", image="{paper} {sheet}_img.tif"),
        tmp_path,
        settle_s=30,
        idle_s=200,
        tell=said.append,
        clock=clock,
    )
    look = partial(clock.after, coming=coming)
    write(tmp_path / "Süd 1_img.tif")
    whole = write(tmp_path / "Süd 1_ct.tif")
    (tmp_path / "Süd 1_ct.tif").write_bytes(whole[:3000])
    assert (look(0), look(20)) == (None, None)
    (tmp_path / "Süd 1_ct.tif").write_bytes(whole[:5000])  # still being written
    assert (look(20), said) == (None, [])
    assert look(31) is None  # stands still, and is not whole
    assert (look(31), len(said)) == (None, 1)
    assert "tried again" in said[0]
    (tmp_path / "part").write_bytes(whole)
    (tmp_path / "part").replace(tmp_path / "Süd 1_ct.tif")  # renamed at the end
    assert look(1) is None
    found = look(31)
    assert (found.name, found.factors, look(100)) == ("Süd-1", {"paper": "Süd", "sheet": "1"}, None)
    with pytest.raises(StopIteration):
        look(101)


def test_an_image_that_is_missing_is_waited_for(tmp_path):
    clock = Clock()
    coming = watched(
        plan(tmp_path, volume="{sheet}_ct.tif", image="{sheet}_img.tif"),
        tmp_path,
        settle_s=0,
        idle_s=None,
        tell=lambda _: None,
        clock=clock,
    )
    write(tmp_path / "1_ct.tif")
    assert [next(coming) for _ in range(3)] == [None] * 3
    write(tmp_path / "1_img.tif")
    assert next(coming) is None
    found = next(coming)
    names = [os.path.basename(file) for file in found.files]  # noqa: PTH119
    assert names == ["1_ct.tif", "1_img.tif"]


def test_a_part_of_each_file_is_taken_when_all_of_it_stands_still(tmp_path):
    clock, said = Clock(), list[str]()
    coming = watched(
        plan(tmp_path, volume="{sheet}_ct.h5:/entry/a"),
        tmp_path,
        settle_s=30,
        idle_s=None,
        tell=said.append,
        clock=clock,
    )
    look = partial(clock.after, coming=coming)
    for rows in (4, 9):
        with h5py.File(tmp_path / "1_ct.h5", "w") as file:
            file["entry/a"] = np.zeros((9, rows, 7), np.uint8)
        assert look(20) is None  # the second time the file was written anew
    found = look(31)
    assert (found.name, found.files, said) == ("1", (f"{tmp_path / '1_ct.h5'}:/entry/a",), [])


@pytest.mark.parametrize(
    ("watch", "words"),
    [
        ({}, "needs to know how files pair"),
        ({"volume": "ct.tif"}, "each factor once"),
        ({"volume": "{a}_{a}.tif"}, "each factor once"),
        ({"volume": "{a}.tif", "image": "{b}.tif"}, "needs the factors of watch.volume"),
        ({"volume": "{a}.tif", "picture": "x"}, "watch.picture"),
    ],
)
def test_patterns_that_pair_nothing_are_refused(tmp_path, watch, words):
    with pytest.raises(InputError) as caught:
        watch_params(plan(tmp_path, **watch))
    assert words in str(caught.value)
