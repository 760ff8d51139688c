"""Registrations as JSON: a fit that is read back gives the same bytes wherever it is used."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, get_origin, get_type_hints

import numpy as np

from planish.core.errors import MarkError
from planish.core.typing import Floats
from planish.register.models import model_named
from planish.register.result import FittedTransform

FORMAT = "planish registration 1"
_ARRAYS = ("moving", "fixed", "information", "robust_weights", "residuals_um")


def registration_to_json(fit: FittedTransform) -> dict[str, Any]:
    """Return a fit as numbers, texts, lists and dictionaries, for :func:`json.dump`; lengths in um.

    Besides what `registration_from_json` needs it holds numbers to read: scale, rotation, errors of every mark. NaN
    becomes None.
    """
    t = fit.transform
    return {
        "format": FORMAT,
        "model": fit.model,
        "sentence": fit.sentence,
        "warnings": list(fit.warnings),
        "scale": t.scale,
        "rotation_rad": t.rotation_rad,
        "shift_um": list(t.shift_um),
        "mirrored": t.mirrored,
        "rms_um": _plain(fit.rms_um),
        "localisation_error_um": _plain(fit.localisation_error_um),
        "leave_one_out_um": _plain(fit.leave_one_out_um),
        "transform": {f.name: _plain(getattr(t, f.name)) for f in fields(model_named(fit.model).transform)},
        **{name: _plain(getattr(fit, name)) for name in _ARRAYS},
    }


def registration_from_json(data: Any) -> FittedTransform:
    """Read back what `registration_to_json` returned.

    Raises
    ------
    MarkError
        If it is no such fit.
    """
    try:
        if data["format"] != FORMAT:
            raise MarkError(f"The registration has the format {data['format']!r}; {FORMAT!r} is read.")
        kind = model_named(data["model"]).transform
        hints = get_type_hints(kind)
        values = {f.name: _read(data["transform"][f.name], hints[f.name]) for f in fields(kind)}
        return FittedTransform(
            transform=kind(**values),
            model=str(data["model"]),
            sentence=str(data["sentence"]),
            warnings=tuple(str(w) for w in data["warnings"]),
            **{name: _read(data[name], Floats) for name in _ARRAYS},
        )
    except (ValueError, KeyError, TypeError, IndexError) as fault:
        raise MarkError(
            f"This is no registration written by planish ({fault!r}). Register the marks again and save that."
        ) from fault


def _plain(value: Any) -> Any:
    """Lists for arrays and tuples; None for NaN, texts for infinities, which JSON does not have."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]  # pyright: ignore[reportUnknownVariableType]
    if isinstance(value, float) and not np.isfinite(value):
        return None if np.isnan(value) else str(value)
    return value


def _read(value: Any, hint: Any) -> Any:
    if get_origin(hint) is np.ndarray:
        return np.array(value, dtype=np.float64)
    if isinstance(value, list):
        return tuple(_read(v, None) for v in value)  # pyright: ignore[reportUnknownVariableType]
    return value if isinstance(value, bool) else float("nan") if value is None else float(value)
