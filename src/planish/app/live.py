"""What the marks say on the screen."""

from __future__ import annotations

from typing import Any

from planish.app.session import Session


class Live:
    """Fits of a session."""

    def __init__(self, session: Session) -> None:
        self.session = session

    def shown(self, layer: str) -> dict[str, Any]:
        """The state as the page shows it."""
        session, state = self.session, self.session.state
        marks = [
            {
                "id": m.id, "label": m.label, "used": m.used, "moving": m.moving and m.moving.xy,
                "fixed": m.fixed and m.fixed.xy, "source": "", "residual_um": None, "leave_one_out_um": None,
            } for m in state.of(layer)
        ]  # fmt: skip
        return {
            "version": session.version, "layer": layer, "marks": marks, "model": state.model, "fit": {}, "warnings": [],
            "corrections": [c.model_dump(mode="json") for c in state.corrections],
            "regions": [r.model_dump(mode="json") for r in state.regions],
            "can_undo": session.can_undo, "can_redo": session.can_redo,
        }  # fmt: skip
