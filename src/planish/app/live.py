"""The fits of a session: quick ones at once, those that take longer in a thread.

From the thread a new version follows.
"""

import logging
import threading
import time
from dataclasses import asdict

from planish.app.changes import Mark, Marks
from planish.app.fits import QUICK, Fitted, fitted
from planish.app.picture import PLANES, finite_or_none
from planish.app.session import Session
from planish.core.typing import Entries

WAIT_S = 0.03
"""An answer waits so long for a fit that takes longer."""
REST_S = 0.05
"""What only adds warnings to residuals that are shown waits so long: it does not slow down their
way to the screen."""

_log = logging.getLogger("planish.app")


Wanted = tuple[Marks, str]  # marks, and the model that is fitted to them


class Live:
    """Fits of a session, one for each registration and state.

    One worked out in the thread is a new version of it.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self._lock = threading.Condition()
        self._fits: dict[str, tuple[Wanted, Fitted]] = {}
        self._queue: dict[str, Wanted] = {}
        self._thread: threading.Thread | None = None

    def fit(self, layer: str) -> Fitted:
        """Give the fit of one registration as it stands.

        It is that of a similarity as long as that of another model is not ready.
        """
        state = self.session.state
        wanted = state.of(layer), state.model
        with self._lock:
            current = self._current(layer, wanted)
            if current is not None:
                return current
        quick_fit = self._fitted(layer, wanted, quick=True)
        with self._lock:
            if self._current(layer, wanted) is None:
                self._fits[layer] = wanted, quick_fit
                if quick_fit.is_pending:
                    self._queue[layer] = wanted
                    if self._thread is None:
                        self._thread = threading.Thread(target=self._work, name="fits", daemon=True)
                        self._thread.start()
                    if state.model not in QUICK:
                        self._lock.wait_for(
                            lambda: not self._fits[layer][1].is_pending, timeout=WAIT_S
                        )
            return self._current(layer, wanted) or quick_fit

    def _current(self, layer: str, wanted: Wanted) -> Fitted | None:
        fit_of, fit = self._fits.get(layer, (None, None))
        return fit if fit_of == wanted else None

    def _fitted(self, layer: str, wanted: Wanted, *, quick: bool) -> Fitted:
        params = self.session.study.registration
        mirrored = self.session.mirrored(layer)
        where = self.session.where(layer)
        return fitted(*wanted, mirrored=mirrored, params=params, quick=quick, where=where)

    def _work(self) -> None:
        """Work out what is wanted, the newest only, until nothing is."""
        while True:
            with self._lock:
                if not self._queue:
                    self._thread = None
                    return
                layer, wanted = self._queue.popitem()
            if wanted[1] in QUICK:
                time.sleep(REST_S)
                # Something else was clicked meanwhile.
                if self._current(layer, wanted) is None:
                    continue
            try:
                full_fit = self._fitted(layer, wanted, quick=False)
            except Exception:  # noqa: BLE001  it is in the log, and the quick fit stays
                _log.exception("A fault in planish: a fit")
                continue
            with self._lock:
                if self._current(layer, wanted) is None:
                    continue
                self._fits[layer] = wanted, full_fit
                self._lock.notify_all()
            self.session.publish()

    def shown(self, layer: str) -> Entries:
        """The state as the page shows it; ChangeError where there is no such registration."""
        session = self.session
        version = session.version
        state = session.state
        fit = self.fit(layer)
        row_of = {mark.id: k for k, mark in enumerate(fit.pairs)}
        marks = state.of(layer)
        rows = [self._row(mark, fit, row_of.get(mark.id)) for mark in marks]
        warnings = [warning.model_dump(exclude_none=True) for warning in fit.warnings]
        corrections = [c.model_dump(mode="json", exclude={"do"}) for c in state.corrections]
        can_change = not session.read_only
        return {
            "version": version,
            "layer": layer,
            "model": state.model,
            "marks": rows,
            "fit": _facts_of(fit, state.model),
            "message": fit.message,
            "warnings": warnings,
            "corrections": corrections,
            "regions": [region.model_dump(mode="json") for region in state.regions],
            "can_undo": session.can_undo and can_change,
            "can_redo": session.can_redo and can_change,
        }

    def _row(self, mark: Mark, marks_fit: Fitted, k: int | None) -> Entries:
        """A mark as the page shows it; ``k`` is its number among the pairs, where it is one."""
        ends = filter(None, (mark.moving, mark.fixed))
        sources = dict.fromkeys(end.source for end in ends)
        row: Entries = {
            "id": mark.id,
            "label": mark.label,
            "used": mark.used,
            "without_weight": False,
            "source": " and ".join(sources),
            "moving": mark.moving and mark.moving.xy,
            "fixed": mark.fixed and mark.fixed.xy,
            "residual_um": None,
            "leave_one_out_um": None,
        }
        if k is None:  # it has one end: where the other one will lie
            side, opposite = PLANES if mark.fixed is None else PLANES[::-1]
            prediction = marks_fit.predicted(side, getattr(mark, side).xy)
            if prediction is not None:
                place, _, error_text = prediction
                row |= {"predicted": {opposite: place}, "note": error_text}
            return row
        row["without_weight"] = bool(marks_fit.is_rejected[k])
        row["residual_um"] = finite_or_none(marks_fit.residual_um[k])
        row["leave_one_out_um"] = finite_or_none(marks_fit.leave_one_out_um[k])
        if marks_fit.is_pending and self.session.state.model not in QUICK:
            row["note"] = f"{self.session.state.model} follows"
        return row


def _facts_of(marks_fit: Fitted, model: str) -> Entries:
    """A fit as the page shows it, and why there is none of the chosen model."""
    facts: Entries = dict.fromkeys(("rms_um", "loo_rms_um", "transform"))
    facts |= {"model": model, "follows": marks_fit.is_pending and model not in QUICK}
    fit = marks_fit.fit
    if fit is not None:
        facts["model"] = fit.model
        facts["rms_um"] = finite_or_none(fit.rms_um)
        facts["loo_rms_um"] = finite_or_none(fit.leave_one_out_rms_um)
        # Lays one picture onto the other.
        facts["transform"] = asdict(fit.transform.similarity)
    if marks_fit.error:
        facts["error"] = marks_fit.error
    return facts
