"""Apply makes a new run by a process of its own.

So the page stays quick, and a cancel is at once.
"""

import json
import os
import secrets
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from planish.app.apply_worker import TARGET
from planish.app.changes import State
from planish.app.order import STAGING, new_run_folder, order_of
from planish.app.session import Session
from planish.core.errors import InputError
from planish.core.facts import ResultModel
from planish.core.typing import Entries
from planish.io.run_folder import sweep

Phase = Literal["idle", "working", "done", "failed", "cancelled"]
# Share of the work that is behind it when a stage begins, by the time that stages take.
_SHARE_BEFORE = {
    "read": 0.02,
    "surface": 0.05,
    "measure": 0.25,
    "flatten": 0.35,
    "resample": 0.4,
    "check": 0.42,
    "register": 0.45,
    "link": 0.5,
    "correlate": 0.65,
    "write": 0.88,
}
_LOST_MESSAGE = (
    "The process that made the run ended unexpectedly, most likely because it ran out of memory."
    " Close other programs and apply it again."
)


class Progress(ResultModel):
    """Progress of an Apply."""

    state: Phase = "idle"
    stage: str = ""
    share: float = 0.0  # of the work, 0 to 1
    message: str = ""  # what is done at this moment, or what was wrong
    run: str | None = None  # folder of the new run, when it is done
    report: str | None = None  # where its page is served
    outdated: bool | None = None  # whether something was changed since the new run was begun


class Busy(InputError):
    """Something is being applied already."""


@dataclass(eq=False)
class Applying:
    """Apply of one session: at most one new run at a time."""

    session: Session
    # Pages of runs that were made, by ticket.
    reports: dict[str, Path] = field(default_factory=dict[str, Path])
    progress: Progress = field(default_factory=Progress)  # of the run that is made
    _begun_state: State | None = None  # what stood when it was begun
    _process: subprocess.Popen[str] | None = None
    _warm_process: subprocess.Popen[str] | None = None
    _progress_thread: threading.Thread | None = None
    _is_cancelled: bool = False
    _is_closed: bool = False
    _stop_listening: Callable[[], None] = lambda: None
    _lock: threading.RLock = field(default_factory=threading.RLock)

    def __post_init__(self) -> None:
        """Remove what an Apply left that was killed together with its worker process."""
        if not self.session.read_only:
            self._clean()
            self._stop_listening = self.session.listen(self._warm_soon)

    @property
    def shown(self) -> Progress:
        """How far the new run is, and whether it lacks what was changed since it was begun."""
        is_outdated = self._begun_state not in (None, self.session.state)
        return self.progress.model_copy(update={"outdated": is_outdated or None})

    def warm(self) -> None:
        """Start the process that the next Apply will use, which takes a second or two."""
        with self._lock:
            process = self._warm_process
            is_ready = process is not None and process.poll() is None
            if self._is_closed or is_ready:
                return
            self._warm_process = subprocess.Popen(
                [sys.executable, "-m", "planish.app.apply_worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                # As the command line has it.
                encoding="utf-8",
                env={"OPENBLAS_NUM_THREADS": "1"} | os.environ,
            )

    def _warm_soon(self) -> None:
        """Once something was changed, it will be applied.

        But not while the first clicks follow each other.
        """
        if self.session.state is not self.session.first:
            self._stop_listening()
            timer = threading.Timer(5.0, self.warm)  # after the first change
            timer.daemon = True
            timer.start()

    def start(self) -> Progress:
        """Begin to make a run of what stands in the session; Busy where one is being made."""
        with self._lock:
            if self.progress.state == "working":
                raise Busy("A run is being made already. Wait for it, or cancel it first.")
            folder = self.session.folder.absolute()
            staging = folder / STAGING
            self._begun_state = self.session.state
            study, file_texts = order_of(self.session, staging)
            out = new_run_folder(folder, linked=self.session.image_params is not None)
            self.warm()
            process = self._warm_process
            self._warm_process = None
            assert process is not None
            assert process.stdin is not None
            order = {
                "study": study.model_dump_json(),
                "files": file_texts,
                "out": str(out),
                "run": str(folder),
                "staging": str(staging),
            }
            with suppress(BrokenPipeError):  # it died: whoever reads from it says so
                print(json.dumps(order), file=process.stdin, flush=True)
            self._process = process
            self._is_cancelled = False
            self.progress = Progress(state="working", message=f"Making {out.name} ...")
            self._progress_thread = threading.Thread(
                target=self._follow_progress, args=(process, out), daemon=True
            )
            self._progress_thread.start()
            return self.progress

    def cancel(self) -> Progress:
        """Stop; when this returns, nothing is left of the new run, or it was done already."""
        with self._lock:
            process = self._process
            thread = self._progress_thread
            self._is_cancelled = True
        if process is not None and thread is not None:
            assert process.stdin is not None
            with suppress(OSError):
                process.stdin.close()
            try:
                # Before its first stage it writes nothing, and hears nothing.
                process.wait(5.0 if self.progress.stage else 0)
            except subprocess.TimeoutExpired:
                process.kill()
            thread.join()
        return self.progress

    def close(self) -> None:
        """End with the server."""
        self.cancel()
        with self._lock:
            process = self._warm_process
            self._warm_process = None
            self._is_closed = True
        if process is not None:
            process.kill()
            _wait_and_close(process)

    def _follow_progress(self, process: subprocess.Popen[str], out: Path) -> None:
        """Take over what the process reports, until it ends, and clean up where it made nothing.

        Each line is JSON: ``state``, while it is working with ``stage`` and ``message``. ``out`` is
        the folder of the new run.
        """
        assert process.stdout is not None
        last_message: Entries = {}
        for line in process.stdout:
            last_message = json.loads(line)
            if last_message["state"] == "working":
                share = max(self.progress.share, _SHARE_BEFORE.get(last_message["stage"], 0.0))
                self.progress = Progress(**last_message, share=share)
        _wait_and_close(process)
        state = last_message.get("state")
        if state == "done":
            ticket = secrets.token_urlsafe(24)
            self.reports[ticket] = out / "report.html"
            page = f"/report/{ticket}"
            message = f"{out.name} is made."
            final = Progress(state="done", share=1.0, message=message, run=str(out), report=page)
        elif state == "failed":
            final = Progress(**last_message)
        elif state == "cancelled" or self._is_cancelled:
            final = Progress(state="cancelled", message="Cancelled; nothing was written.")
        else:
            final = Progress(state="failed", message=_LOST_MESSAGE)
        if state != "done":
            self._clean()
            sweep(out)
        with self._lock:
            self._process = self._progress_thread = None
            self.progress = final

    def _clean(self) -> None:
        staging = self.session.folder / STAGING
        with suppress(OSError, ValueError):
            sweep(Path((staging / TARGET).read_text(encoding="utf-8")))
        shutil.rmtree(staging, ignore_errors=True)


def _wait_and_close(process: subprocess.Popen[str]) -> None:
    process.wait()
    with suppress(OSError), process:
        pass
