"""How a process of the command line ends: with its exit code, and nothing that was said is lost."""

import subprocess
import sys

import pytest

ENDS = """
import atexit, sys, threading, time
from planish.cli import main
atexit.register(print, "registered first", flush=False)
threading.Thread(target=lambda: (time.sleep(0.1), print("of a thread"))).start()
sys.argv = ["planish", *{words}]
main()
"""


@pytest.mark.parametrize(("words", "status"), [((), 2), (("--help",), 0), (("nothing",), 2)])
def test_the_end_loses_nothing(words, status):
    """A thread goes on to its end, what is registered runs, the streams are written."""
    ran = subprocess.run(
        [sys.executable, "-c", ENDS.format(words=words)], capture_output=True, text=True
    )
    assert ran.returncode == status, ran.stderr
    assert {"of a thread", "registered first"} <= set(ran.stdout.splitlines())
