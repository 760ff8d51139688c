"""The fits of a session: what is quick at once, what takes longer in a thread, from which a new version follows."""

from __future__ import annotations

import logging
import threading
import time
from typing import Any

from planish.app.changes import Mark
from planish.app.fits import QUICK, Fitted, Warned, fitted
from planish.app.picture import Plane
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
        self._found: dict[str, tuple[Any, Fitted]] = {}
        self._wanted: dict[str, tuple[Any, tuple[Mark, ...], str]] = {}
        self._thread: threading.Thread | None = None

    def fit(self, layer: str) -> Fitted:
        """The fit of one registration as it stands: of a similarity as long as that of another model is not ready."""
        state = self.session.state
        marks, model = state.of(layer), state.model
        key = (id(marks), model, marks)  # holding the marks keeps their id from being given away
        with self._lock:
            known = self._known(layer, key)
            if known is not None:
                return known
        found = self._fitted(layer, marks, model, quick=True)
        with self._lock:
            if self._known(layer, key) is None:
                self._found[layer] = key, found
                if found.follows:
                    self._wanted[layer] = key, marks, model
                    self._start()
                    if model not in QUICK:
                        self._lock.wait_for(lambda: not self._found[layer][1].follows, timeout=WAIT_S)
            return self._known(layer, key) or found

    def _known(self, layer: str, key: Any) -> Fitted | None:
        held = self._found.get(layer)
        return held[1] if held is not None and held[0][:2] == key[:2] else None

    def _fitted(self, layer: str, marks: tuple[Mark, ...], model: str, *, quick: bool) -> Fitted:
        params = self.session.study.registration
        return fitted(marks, model, mirrored=self.session.mirrored(layer), params=params, quick=quick)

    def _start(self) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._follow, name="fits", daemon=True)
            self._thread.start()

    def _follow(self) -> None:
        """Work out what is wanted, the newest only, until nothing is."""
        while True:
            with self._lock:
                if not self._wanted:
                    self._thread = None
                    return
                layer, (key, marks, model) = self._wanted.popitem()
            if model in QUICK:
                time.sleep(REST_S)
                with self._lock:
                    if self._known(layer, key) is None:  # something else was clicked meanwhile
                        continue
            try:
                found = self._fitted(layer, marks, model, quick=False)
            except Exception:  # noqa: BLE001  it is in the log, and the quick fit stays
                _log.exception("A fault in planish: a fit")
                continue
            with self._lock:
                current = self._known(layer, key) is not None
                if current:
                    self._found[layer] = key, found
                    self._lock.notify_all()
            if current:
                self.session.publish()

    # --- as the page shows it -----------------------------------------------------------------------------------------

    def shown(self, layer: str) -> dict[str, Any]:
        """The state as the page shows it; ChangeError where there is no such registration."""
        session = self.session
        version, state = session.version, session.state
        found = self.fit(layer)
        place = {name: k for k, name in enumerate(found.ids)}
        fit = found.fit
        return {
            "version": version, "layer": layer, "model": state.model,
            "marks": [self._row(mark, found, place.get(mark.id)) for mark in state.of(layer)],
            "fit": {
                "model": state.model if fit is None else fit.model,
                "rms_um": None if fit is None else _number(fit.rms_um),
                "loo_rms_um": None if fit is None else _number(fit.leave_one_out_rms_um),
                "follows": found.follows and state.model not in QUICK,
                "transform": None if fit is None else _similarity(fit),
            } | ({"error": found.error} if found.error else {}),
            "message": found.message,
            "warnings": [_warning(one) for one in found.warnings],
            "corrections": [c.model_dump(mode="json") for c in state.corrections],
            "regions": [r.model_dump(mode="json") for r in state.regions],
            "can_undo": session.can_undo and not session.read_only,
            "can_redo": session.can_redo and not session.read_only,
        }  # fmt: skip

    def _row(self, mark: Mark, found: Fitted, k: int | None) -> dict[str, Any]:
        row: dict[str, Any] = {
            "id": mark.id, "label": mark.label, "used": mark.used, "source": _source(mark),
            "moving": None if mark.moving is None else mark.moving.xy,
            "fixed": None if mark.fixed is None else mark.fixed.xy,
            "residual_um": None if k is None else _number(found.residual_um[k]),
            "leave_one_out_um": None if k is None else _number(found.leave_one_out_um[k]),
        }  # fmt: skip
        if k is None:
            side: Plane = "moving" if mark.fixed is None else "fixed"
            other: Plane = "fixed" if side == "moving" else "moving"
            end = getattr(mark, side)
            there = found.predicted(side, end.xy)
            row |= {} if there is None else {"predicted": {other: there[0]}, "note": there[2]}
        elif found.follows and self.session.state.model not in QUICK:
            row["note"] = f"{self.session.state.model} follows"
        return row


def _source(mark: Mark) -> str:
    """How the ends of a mark were found, in a word or two."""
    return " and ".join(dict.fromkeys(end.source for end in (mark.moving, mark.fixed) if end is not None))


def _number(value: Any) -> float | None:
    number = float(value)
    return number if number == number and abs(number) != float("inf") else None


def _similarity(fit: Any) -> dict[str, Any]:
    """The closest similarity, by which the page lays one picture onto the other."""
    t = fit.transform
    return {
        "scale": t.scale, "rotation_rad": t.rotation_rad, "shift_um": list(t.shift_um), "mirrored": bool(t.mirrored),
    }  # fmt: skip


def _warning(one: Warned) -> dict[str, str]:
    return {"text": one.text} | ({} if one.id is None else {"id": one.id})
