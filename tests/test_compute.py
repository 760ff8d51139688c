"""A run under other conditions: killed, on a cluster, with little memory.

Its bytes are always the same.
"""

import gzip
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import nibabel
import numpy as np
import pytest

from folders import bytes_of, write_volume
from planish.cli import show
from planish.core import tiles
from planish.core.errors import FileError, InputError, ResourceError
from planish.core.frame import Frame
from planish.core.memory import COLUMN_BYTES
from planish.core.tiles import tiles_of
from planish.io import (
    VolumeParams,
    describe,
    new_folder,
    read_volume,
    run_folder,
    work_folder,
    write_store,
)
from planish.io.run_folder import WORK_MARKER
from planish.run import Compute, as_study, column_step, engine, map_sheet, read_whole, run_study
from surface.sheets import slab, volume


def map_of(kinds, out, **options):
    """Map the volume of the run `other-map`."""
    run_study(
        as_study({"volume": {"path": str(kinds.other.volume)}}), out, compute=Compute(**options)
    )


def same_as_the_shared_run(kinds, out):
    """All bytes but those of the study, which says how to get from the run to its volume."""
    one, other = bytes_of(kinds("other-map")), bytes_of(out)
    assert one.pop("run.toml")
    assert other.pop("run.toml")
    assert other == one


LITTLE = 530 * 10**6  # for columns of one voxel, in many tiles


def test_a_run_that_stops_goes_on_with_its_tiles_other_memory_and_threads_and_gives_the_same(
    kinds, tmp_path, monkeypatch
):
    """As if it were killed: what vanishes after an error is still there."""
    usual, kept = tiles.move, []

    def stop_at_the_third(partial_path, path, *, over):
        usual(partial_path, path, over=over)
        kept.append(path)
        if len(kept) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(tiles, "move", stop_at_the_third)
    with monkeypatch.context() as killed:
        killed.setattr(run_folder, "_remove_work_folder", lambda _: None)
        with pytest.raises(KeyboardInterrupt):
            map_of(kinds, tmp_path / "run", memory_bytes=LITTLE)
    assert [path.is_file() for path in kept] == [True] * 3
    map_of(kinds, tmp_path / "run", memory_bytes=LITTLE, threads=3)
    assert len(kept) == len(set(kept)) > 3
    same_as_the_shared_run(kinds, tmp_path / "run")


def test_two_runs_do_not_write_to_one_place(tmp_path):
    path = write_volume(tmp_path / "v.tif", np.zeros((8, 9, 10), np.uint8))
    with work_folder(tmp_path / "run", "a"), pytest.raises(FileError, match="Another planish"):
        run_study(as_study({"volume": {"path": str(path)}}), tmp_path / "run")


def test_tiles_of_another_study_are_not_used(tmp_path):
    work = tmp_path / ".run.work"
    (work / "tiles").mkdir(parents=True)
    (work / "key").write_text("another")
    (work / "lock").write_text("")  # what versions before the marker wrote
    (work / "tiles" / "0-1-0-1.npy").write_bytes(b"wrong")
    with work_folder(tmp_path / "run", "this") as folder:
        assert not list(folder.rglob("*.npy"))


def test_what_a_run_left_that_was_killed_while_it_wrote_is_swept_up(tmp_path):
    with work_folder(tmp_path / "run", "this") as work:
        marker = (work / WORK_MARKER).read_bytes()
    half = tmp_path / ".run.work" / ".run.abc.partial"
    half.mkdir(parents=True)
    (half / "maps.zarr").write_text("half")
    (half.parent / WORK_MARKER).write_bytes(marker)
    with (
        work_folder(tmp_path / "run", "this") as work,
        new_folder(tmp_path / "run", inside=work) as folder,
    ):
        assert not half.exists()
        (folder / "whole").write_text("whole")
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["whole"]


@pytest.fixture(scope="module")
def cluster():
    """A scheduler and two workers, processes of their own on this machine."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
    ) as made:
        yield made


@pytest.mark.nightly
def test_a_cluster_gives_the_same_bytes(kinds, cluster, tmp_path):
    map_of(kinds, tmp_path / "run", scheduler=cluster.scheduler_address, memory_bytes=LITTLE)
    same_as_the_shared_run(kinds, tmp_path / "run")


def slow_sum(grid, tile):
    time.sleep(0.1)
    return np.array([[grid[tile.rows, tile.cols].sum(), os.getpid()]])


@pytest.mark.nightly
def test_a_worker_that_dies_costs_only_time(cluster):
    grid = np.arange(400.0).reshape(20, 20)
    parts = tiles_of(grid.shape, (2, 5))
    workers = {w.pid for w in (n.process for n in cluster.workers.values()) if w is not None}
    assert len(workers) == 2
    with engine(Compute(scheduler=cluster.scheduler_address)) as on:
        found, seen = [], set()
        for tile, part in on.map("sums", slow_sum, lambda _tile: grid, parts):
            found.append((tile, part[0, 0]))
            if len(found) == 4:
                os.kill(min(workers), signal.SIGKILL)
            seen.add(int(part[0, 1]))
    assert found == [(tile, grid[tile.rows, tile.cols].sum()) for tile in parts]
    assert seen - workers or len(seen) >= 1


@pytest.mark.nightly
def test_import_takes_a_scheduler(cluster, kinds, tmp_path, planish):
    for name, how in (("local", ()), ("cluster", ("--scheduler", cluster.scheduler_address))):
        assert planish("import", kinds.other.volume, "--out", tmp_path / name, *how)[0] == 0
    assert bytes_of(tmp_path / "cluster") == bytes_of(tmp_path / "local")


@pytest.mark.nightly
def test_a_scheduler_that_is_lost_is_a_sentence(cluster):
    with (
        pytest.raises(ResourceError, match="was lost"),
        engine(Compute(scheduler=cluster.scheduler_address)) as on,
    ):
        list(on.map("sums", dies, lambda _tile: None, tiles_of((4, 4), (2, 2))))


def dies(_job, _tile):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.ci
def test_no_scheduler_is_a_sentence():
    pytest.importorskip("distributed")
    with (
        pytest.raises(InputError, match="No scheduler answers"),
        engine(Compute(scheduler="tcp://127.0.0.1:1")),
    ):
        pass


def test_what_the_program_takes_comes_off_the_memory_and_columns_get_wider():
    assert Compute(memory_bytes=4 * 10**9).for_work == 37 * 10**8
    # Of little memory the program is not given more than half, and the blocks of an import get most
    # of the rest.
    assert Compute(memory_bytes=3 * 10**8).for_work == 15 * 10**7
    assert Compute(memory_bytes=3 * 10**8).block_bytes == 10**8
    assert (
        Compute(memory_bytes=9 * 10**9).block_bytes == Compute(memory_bytes=9 * 10**9).volume_bytes
    )
    grey, *_ = slab(shape=(40, 90, 120))
    data = volume(grey)
    data.attrs["voxel_um"] = [3.0] * 3
    columns = 90 * 120
    assert column_step(data, Frame(), None, Compute(memory_bytes=10 * columns * COLUMN_BYTES)) == 1
    assert column_step(data, Frame(), None, Compute(memory_bytes=columns * COLUMN_BYTES)) == 2
    assert column_step(data, Frame(), 6.2, Compute(memory_bytes=10)) == 2
    with pytest.raises(ResourceError, match="memory="):
        column_step(data, Frame(), None, Compute(memory_bytes=columns * COLUMN_BYTES // 100))
    with pytest.raises(InputError, match="less than a voxel"):
        column_step(data, Frame(), 1.0, Compute())


@pytest.mark.parametrize("shape", [(3, 2500, 4000), (1500, 7, 2000), (40, 90, 120)])
def test_the_memory_that_info_states_is_enough_for_single_voxels(shape, tmp_path, monkeypatch):
    """Of 10 million columns and fewer, through the shortest axis; as the line says it, which is
    rounded."""
    (tmp_path / "v.raw.toml").write_text(f'shape = {list(shape)}\ndtype = "uint8"\nvoxel_um = 3\n')
    with (tmp_path / "v.raw").open("wb") as file:
        file.truncate(int(np.prod(shape)))
    monkeypatch.setattr(show, "slowness", lambda: 1.0)
    line = next(
        one
        for one in show.fact_lines(describe(tmp_path / "v.raw", values=False))
        if one.startswith("planish map")
    )
    stated = Compute.model_validate({"memory_bytes": line.split()[2] + "GB"})
    frame = Frame(through="zyx"[int(np.argmin(shape))])
    assert column_step(read_volume(tmp_path / "v.raw"), frame, None, stated) == 1
    assert ("; about 8 s, " in line) is (shape[0] == 40)


def test_the_memory_that_info_states_holds_a_volume_that_is_decoded_as_a_whole(tmp_path):
    # 1040 bytes a column, of which thrice the size is asked.
    values = np.random.default_rng(0).random((130, 60, 60))
    (tmp_path / "v.nii.gz").write_bytes(
        gzip.compress(nibabel.Nifti1Image(values, np.eye(4)).to_bytes(), 1)
    )
    for limit in (None, 2**20):  # decoded already, or left in its file for its size
        stated = describe(tmp_path / "v.nii.gz", memory_bytes=limit)["run_bytes"]
        assert Compute(memory_bytes=stated).volume_bytes >= values.nbytes


def test_sections_that_do_not_fit_are_imported_in_parts(kinds, tmp_path):
    files = kinds.files("sections")
    section = VolumeParams(path=str(files.volume), through="y")
    silent = lambda _stage, _detail: None  # noqa: E731
    whole = read_whole(section, Compute(), silent)
    small = Compute(memory_bytes=whole.nbytes)
    parts = read_whole(section, small, silent)
    assert parts.encoding.get("whole_slices")
    write_store(parts, tmp_path / "sheet.zarr", memory_bytes=2**28)
    np.testing.assert_array_equal(read_volume(tmp_path / "sheet.zarr").values, whole.values)
    with pytest.raises(ResourceError, match=r"planish import .* --through y"):
        map_sheet(files.volume, volume={"through": "y"}, compute=small)


@pytest.mark.nightly
@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="the peak of the memory is not known"
)
def test_a_mapped_volume_counts_as_memory_and_the_limit_is_kept(tmp_path):
    """600 million voxels in 1 GB, columns widened; with columns of that width the bytes do not
    depend on it."""
    shape = (300, 1414, 1414)
    rng = np.random.default_rng(0)
    y, x = np.ogrid[: shape[1], : shape[2]]
    middle = (150 + 30 * np.sin(x / 200) + 10 * np.cos(y / 150)).astype(np.float32)
    with (tmp_path / "v.raw").open("wb") as file:
        for z in range(shape[0]):
            away = abs(z - middle)
            grey = np.where(away < 40, np.where(away > 30, 200, 110), 50).astype(np.float32)
            file.write(
                (grey + rng.normal(0, 6, shape[1:]).astype(np.float32))
                .clip(0, 255)
                .astype(np.uint8)
                .tobytes()
            )
    header = f'shape = [{", ".join(map(str, shape))}]\ndtype = "uint8"\nvoxel_um = 1.5\n'
    (tmp_path / "v.raw.toml").write_text(header)
    code = (
        "import re, sys; from planish.cli.main import main\n"
        "try: main(sys.argv[1:])\nexcept SystemExit as end: assert end.code in (0, 4), end.code\n"
        "print('peak', re.search(r'VmHWM:\\s*(\\d+)', open('/proc/self/status').read())[1])"
    )
    peaks = []
    for name, memory in (("low", "1GB"), ("high", "4GB")):
        # The width that 1 GB asks for.
        command = (
            "map",
            str(tmp_path / "v.raw"),
            "-o",
            str(tmp_path / name),
            "--memory",
            memory,
            "--column-um",
            "3",
        )
        done = subprocess.run(
            [sys.executable, "-c", code, *command], capture_output=True, text=True, check=True
        )
        peaks.append(1024 * int(done.stdout.splitlines()[-1].split()[1]))
    assert peaks[0] < 1.0e9
    assert bytes_of(tmp_path / "low") == bytes_of(tmp_path / "high")


@pytest.mark.ci
def test_memory_that_others_take_meanwhile_changes_no_column(specimen_files, monkeypatch):
    free = iter([10**10])  # then next to nothing
    monkeypatch.setattr(
        Compute, "memory", property(lambda self: self.memory_bytes or next(free, 2 * 10**8))
    )
    run = map_sheet(specimen_files[0])
    assert run.study.layers[0].volume.column_um is None
