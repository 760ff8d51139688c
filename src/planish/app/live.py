"""The fits of a session: what is quick at once, what takes longer in a thread, from which a new version follows."""

from __future__ import annotations

import logging
import threading
import time
from typing import Any

from planish.app.changes import Mark
from planish.app.fits import QUICK, Fitted, fitted
from planish.app.picture import Plane, finite_or_none
from planish.app.session import Session

WAIT_S = 0.03
"""An answer waits so long for a fit that takes longer."""
REST_S = 0.05
"""What only adds warnings to residuals that are shown waits so long: it does not slow down their way to the screen."""

_log = logging.getLogger("planish.app")


class Live:
    """Fits of a session, one for each registration and each state.

    Parameters
    ----------
    session : Session
        Each fit that was worked out in the thread is a new version of it.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self._lock = threading.Condition()
        self._fits: dict[str, tuple[Any, Fitted]] = {}
        self._queue: dict[str, tuple[Any, tuple[Mark, ...], str]] = {}
        self._thread: threading.Thread | None = None

    def fit(self, layer: str) -> Fitted:
        """The fit of one registration as it stands: of a similarity as long as that of another model is not ready."""
        state = self.session.state
        marks, model = state.of(layer), state.model
        key = (id(marks), model, marks)  # holding the marks keeps their id from being given away
        with self._lock:
            current = self._current(layer, key)
            if current is not None:
                return current
        quick_fit = self._fitted(layer, marks, model, quick=True)
        with self._lock:
            if self._current(layer, key) is None:
                self._fits[layer] = key, quick_fit
                if quick_fit.pending:
                    self._queue[layer] = key, marks, model
                    if self._thread is None:
                        self._thread = threading.Thread(target=self._work, name="fits", daemon=True)
                        self._thread.start()
                    if model not in QUICK:
                        self._lock.wait_for(lambda: not self._fits[layer][1].pending, timeout=WAIT_S)
            return self._current(layer, key) or quick_fit

    def _current(self, layer: str, key: Any) -> Fitted | None:
        entry = self._fits.get(layer)
        return entry[1] if entry is not None and entry[0][:2] == key[:2] else None

    def _fitted(self, layer: str, marks: tuple[Mark, ...], model: str, *, quick: bool) -> Fitted:
        params = self.session.study.registration
        return fitted(marks, model, mirrored=self.session.mirrored(layer), params=params, quick=quick)

    def _work(self) -> None:
        """Work out what is wanted, the newest only, until nothing is."""
        while True:
            with self._lock:
                if not self._queue:
                    self._thread = None
                    return
                layer, (key, marks, model) = self._queue.popitem()
            if model in QUICK:
                time.sleep(REST_S)
                with self._lock:
                    if self._current(layer, key) is None:  # something else was clicked meanwhile
                        continue
            try:
                full_fit = self._fitted(layer, marks, model, quick=False)
            except Exception:  # noqa: BLE001  it is in the log, and the quick fit stays
                _log.exception("A fault in planish: a fit")
                continue
            with self._lock:
                is_current = self._current(layer, key) is not None
                if is_current:
                    self._fits[layer] = key, full_fit
                    self._lock.notify_all()
            if is_current:
                self.session.publish()

    # --- as the page shows it -----------------------------------------------------------------------------------------

    def shown(self, layer: str) -> dict[str, Any]:
        """The state as the page shows it; ChangeError where there is no such registration."""
        session = self.session
        version, state = session.version, session.state
        marks_fit = self.fit(layer)
        row_of = {name: k for k, name in enumerate(marks_fit.ids)}
        fit = marks_fit.fit
        transform = None
        if fit is not None:  # the closest similarity, by which the page lays one picture onto the other
            t = fit.transform
            transform = {"scale": t.scale, "rotation_rad": t.rotation_rad, "shift_um": list(t.shift_um)}
            transform["mirrored"] = bool(t.mirrored)
        return {
            "version": version, "layer": layer, "model": state.model,
            "marks": [self._row(mark, marks_fit, row_of.get(mark.id)) for mark in state.of(layer)],
            "fit": {
                "model": state.model if fit is None else fit.model,
                "rms_um": None if fit is None else finite_or_none(fit.rms_um),
                "loo_rms_um": None if fit is None else finite_or_none(fit.leave_one_out_rms_um),
                "follows": marks_fit.pending and state.model not in QUICK,
                "transform": transform,
            } | ({"error": marks_fit.error} if marks_fit.error else {}),
            "message": marks_fit.message,
            "warnings": [{"text": w.text} | ({} if w.id is None else {"id": w.id}) for w in marks_fit.warnings],
            "corrections": [c.model_dump(mode="json") for c in state.corrections],
            "regions": [r.model_dump(mode="json") for r in state.regions],
            "can_undo": session.can_undo and not session.read_only,
            "can_redo": session.can_redo and not session.read_only,
        }  # fmt: skip

    def _row(self, mark: Mark, marks_fit: Fitted, k: int | None) -> dict[str, Any]:
        sources = dict.fromkeys(end.source for end in (mark.moving, mark.fixed) if end is not None)
        row: dict[str, Any] = {
            "id": mark.id, "label": mark.label, "used": mark.used, "source": " and ".join(sources),
            "moving": None if mark.moving is None else mark.moving.xy,
            "fixed": None if mark.fixed is None else mark.fixed.xy,
            "residual_um": None if k is None else finite_or_none(marks_fit.residual_um[k]),
            "leave_one_out_um": None if k is None else finite_or_none(marks_fit.leave_one_out_um[k]),
        }  # fmt: skip
        if k is None:
            side: Plane = "moving" if mark.fixed is None else "fixed"
            other: Plane = "fixed" if side == "moving" else "moving"
            end = getattr(mark, side)
            prediction = marks_fit.predicted(side, end.xy)
            row |= {} if prediction is None else {"predicted": {other: prediction[0]}, "note": prediction[2]}
        elif marks_fit.pending and self.session.state.model not in QUICK:
            row["note"] = f"{self.session.state.model} follows"
        return row
