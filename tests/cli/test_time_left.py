"""The time that is left of a run: from the expected times of its stages, and how fast those that
passed were."""

import numpy as np
import pytest

from planish.cli import show
from planish.cli.console import console
from planish.cli.runs import study_from
from planish.cli.time_left import TimeLeft, expected_stages
from planish.core.tiles import Engine, tiles_of, tiles_told

STAGES = [
    ("read", 1.0),
    ("surface", 0.2),
    ("faces", 10.0),
    ("layers", 2.0),
    ("measure", 3.0),
    ("write", 4.0),
]


class Clock:
    """Seconds that a test sets."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


@pytest.mark.parametrize("speed", [0.4, 1.0, 3.0])
@pytest.mark.parametrize("tilt", [1.0, 1.2])
def test_after_a_quarter_the_time_left_is_right_within_a_factor_of_one_and_a_half(speed, tilt):
    """On a machine that is slower or faster, and with late stages that take longer than
    expected."""
    clock, ratios = Clock(), []
    left = TimeLeft(STAGES, clock, 1.0)
    times = [
        seconds * speed * (tilt if name in ("measure", "write") else 1.0)
        for name, seconds in STAGES
    ]
    total = sum(times)
    for (name, _), seconds in zip(STAGES, times, strict=True):
        start = clock.now
        if name not in ("faces", "layers"):
            left.enter(name)
        for k in range(1, 41):
            clock.now = start + seconds * k / 40
            if name in ("faces", "layers") and k % 4 == 0:
                left.enter(name, k / 40)
            if 0.25 * total < clock.now < 0.75 * total:
                ratios.append(left.seconds / (total - clock.now))
    assert max(*ratios, *(1 / ratio for ratio in ratios)) < 1.5
    assert len(ratios) > 30


def test_stages_that_are_passed_over_take_no_time_and_unknown_steps_change_nothing():
    clock = Clock()
    left = TimeLeft(STAGES, clock, 1.0)
    left.enter("read")
    left.enter("drawn-1", 0.5)
    clock.now = 1.0
    left.enter("measure")  # surfaces of a run that was there
    assert left.seconds == pytest.approx(7.0, abs=1.0)
    clock.now = 4.0
    left.enter("write")
    clock.now = 8.0
    assert left.seconds < 1.0
    assert left.share > 0.9


def test_tiles_tell_how_far_a_step_is():
    told = []
    tiles = tiles_of((4, 4), (2, 2))
    with tiles_told(lambda step, share: told.append((step, share))):
        results = [
            *Engine(threads=1).map("faces", lambda job, _: job, lambda _: np.zeros(1), tiles)
        ]
    assert len(results) == 4
    assert told == [("faces", 0.25), ("faces", 0.5), ("faces", 0.75), ("faces", 1.0)]


def test_expected_stages_are_those_of_the_run(linked_run, specimen_files):
    volume, image = specimen_files[0], specimen_files[1]
    names = [name for name, _ in expected_stages(study_from((volume, image), {}))]
    assert names[:3] == ["read", "read", "surface"]
    assert names[-4:] == ["register", "link", "correlate", "write"]
    assert "surface" not in [
        name for name, _ in expected_stages(study_from((linked_run, image), {}))
    ]


def test_wide_columns_take_less_time(tmp_path):
    header = 'shape = [1000, 40, 2000]\ndtype = "uint8"\nvoxel_um = [2, 3, 8]\n'
    (tmp_path / "v.raw.toml").write_text(header)
    with (tmp_path / "v.raw").open("wb") as file:
        file.truncate(80_000_000)
    seconds = {}
    for column_um in (None, 4.0, 16.0):
        values = {"through": "y", "column_um": column_um}
        stages = dict(expected_stages(study_from((tmp_path / "v.raw",), values)))
        seconds[column_um] = stages["faces"] - stages["surface"]
    # A voxel is sqrt(2 * 8) = 4 um wide: single voxels, and columns of 4 by 4. 2 million columns
    # of single voxels, 9.8 s a million, of which both stages have 0.1 s in any case.
    assert seconds == pytest.approx({None: 19.6, 4.0: 19.6, 16.0: 19.6 / 16})


def test_the_bar_of_a_terminal_says_what_is_left(monkeypatch, capsys):
    monkeypatch.setattr(show, "animated", lambda: True)
    monkeypatch.setattr(show, "console", lambda **_: console(err=True, width=120))
    with show.stages(3, TimeLeft([("read", 30.0), ("write", 90.0)])) as tell:
        tell("read", "v.tif")
        tell("look", "The grey changes most along y.")
    err = capsys.readouterr().err
    assert "look: The grey changes most along y." in err
