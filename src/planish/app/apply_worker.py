"""The process that makes a new run, ``python -m planish.app.apply_worker``.

:mod:`planish.app.apply` starts it.

It reads one order from standard input and tells its progress on standard output, a line of JSON
each. Where standard input is closed before it is done, by a cancel or because the server is gone,
it stops and leaves nothing.
"""

import _thread
import gc
import json
import os
import shutil
import signal
import sys
import threading
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, TextIO

from planish.core.errors import PlanishError
from planish.core.files import as_sentence, write_text, writing
from planish.core.typing import Fields

TARGET = "target"
"""File among those of an order: where the new run will stand."""


def main() -> None:
    """Make the run that a line of JSON on standard input orders.

    Lines of JSON on standard output say how it goes. The end of standard input cancels it.
    """
    # To whoever started this process.
    parent_stream: TextIO = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what others print goes to standard error

    def send(message: Fields) -> None:
        with suppress(OSError):  # nobody listens any more
            print(json.dumps(message), file=parent_stream, flush=True)

    main_thread = threading.get_ident()

    def interrupt_after_input() -> None:
        sys.stdin.read()
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(main_thread, signal.SIGINT)  # also out of a wait
        else:
            _thread.interrupt_main()

    # It may be ignored where the server was started.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with suppress(OSError, AttributeError):
        os.nice(5)  # the page and whatever else a person does come first
    try:
        _warm_up()
        order = sys.stdin.readline()
        if order:
            threading.Thread(target=interrupt_after_input, daemon=True).start()
            _make_run(json.loads(order), send)
    except KeyboardInterrupt:
        send({"state": "cancelled"})


def _warm_up() -> None:
    """Load what a run needs, before there is one to make."""
    gc.disable()  # all that is loaded stays
    import_module("contourpy")
    import numpy as np

    from planish.core.area import halved_values
    from planish.flatten import relax_grid
    from planish.report.text import template
    from planish.run import run_study

    assert callable(run_study)  # it is loaded when it is asked for
    template("planish.report", "report.html.j2")
    # Compiled code is read from the disk when it is used first.
    x, y = np.meshgrid(np.arange(16.0), np.arange(16.0))
    relax_grid(np.dstack([x, y, 0.01 * x * y]))
    for dtype in (np.float32, np.float64, np.bool_):
        halved_values(np.zeros((2, 2), dtype))
    # Where it is installed, xarray loads it with the first array that stays in its file.
    with suppress(ImportError):
        import_module("dask.array")
    gc.freeze()
    gc.enable()


def _make_run(order: Fields, send: Any) -> None:
    """Make the run of an order, and send its progress and its end."""
    from planish.run import run_study
    from planish.run.study import Study, in_study_words

    def progress(stage: str, detail: str) -> None:
        send({"state": "working", "stage": stage, "message": f"{stage}: {detail}"})

    out = Path(order["out"])
    staging = Path(order["staging"])
    outcome = {"state": "done"}
    ignored_errors = () if order["files"] else (PlanishError,)
    try:
        with suppress(*ignored_errors), writing(staging):
            staging.mkdir(parents=True, exist_ok=True)
            for name, text in {TARGET: str(out), **order["files"]}.items():
                write_text(staging / name, text)
        run_study(
            Study.model_validate_json(order["study"]),
            out,
            old=Path(order["run"]),
            progress=progress,
        )
    except Exception as error:  # noqa: BLE001  the page gets a sentence
        remedy = "Close other programs, or apply it on a machine with more memory."
        message = in_study_words(as_sentence(error, "the new run", remedy).text)
        outcome = {"state": "failed", "message": message}
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    send(outcome)


if __name__ == "__main__":
    main()
