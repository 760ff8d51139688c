"""How long ``planish info`` says that a link takes: what it does take, and on this machine."""

import subprocess
import sys

import numpy as np
import pytest
import tifffile
from scipy import ndimage

from folders import write_image
from planish.cli import show
from planish.core import durations
from planish.io import describe

PROCESSOR_SECONDS = """
import sys, time
from planish.cli import main
try:
    main(sys.argv[1:])
except SystemExit as end:
    assert end.code in (0, 4), end.code
print(time.process_time())
"""


def test_times_are_shown_for_this_machine(tmp_path, monkeypatch):
    write_image(tmp_path / "image.tif", np.arange(60000, dtype=np.uint16).reshape(200, 300))
    facts = describe(tmp_path / "image.tif")
    assert facts["link_seconds"] == durations.link_seconds(60000)
    for pace in (1.0, 4.0):
        monkeypatch.setattr(show, "slowness", lambda pace=pace: pace)
        line = next(text for text in show.fact_lines(facts) if text.startswith("planish link"))
        assert f"and {pace * facts['link_seconds']:.0f} s after" in line


def test_a_loop_says_how_quick_the_machine_is(monkeypatch):
    times = iter([0.0, 0.5, 1.0, 1.2, 2.0, 2.3])
    monkeypatch.setattr(durations.time, "thread_time", lambda: next(times))
    assert durations.slowness() == pytest.approx(0.2 / durations.LOOP_SECONDS)


def test_on_windows_the_loop_is_timed_by_a_clock_of_fine_steps(monkeypatch):
    times = iter([0.0, 0.03, 1.0, 1.02, 2.0, 2.05])
    with monkeypatch.context() as patch:
        patch.setattr(durations.os, "name", "nt")
        patch.setattr(durations.time, "thread_time", lambda: 0.015625)  # its steps are too long
        patch.setattr(durations.time, "perf_counter", lambda: next(times))
        slowness = durations.slowness()
    assert slowness == pytest.approx(0.02 / durations.LOOP_SECONDS)


@pytest.mark.nightly
@pytest.mark.parametrize("pixel_um", [10.0, 7.0, 5.0, 2.5, 1.5])
def test_a_link_takes_what_is_promised_within_a_factor_of_two(kinds, tmp_path, pixel_um):
    """In processor time, which does not depend on what else the machine does."""
    files = kinds.files("upright")
    grey = tifffile.imread(files.image).astype(np.float64)
    zoomed = ndimage.zoom(grey, 5.0 / pixel_um, order=1, grid_mode=True, mode="nearest")
    image = tmp_path / "image.tif"
    write_image(image, np.rint(zoomed).clip(0, 65535).astype(np.uint16), pixel_um)
    arguments = ("link", kinds("upright"), image, "--out", tmp_path / "run")
    promised = describe(image)["link_seconds"] * durations.slowness()
    done = subprocess.run(
        [sys.executable, "-c", PROCESSOR_SECONDS, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert 0.5 < float(done.stdout.splitlines()[-1]) / promised < 2.0
