"""Kubelka and Munk's curve: scattering of the coating and its backing."""

from collections.abc import Iterator

from planish.analyze.kubelka_munk import KubelkaMunk
from planish.core.facts import is_known
from planish.core.numbers import number
from planish.core.typing import Pair


def say_kubelka_munk(curve: KubelkaMunk, *_: object) -> Iterator[str]:
    """S and the backing with their intervals."""
    title = f"Kubelka and Munk's curve with K/S = {curve.ratio:g}"
    if curve.reason is not None:
        yield f"{title}: none. {curve.reason}"
        return
    unit_text = "per µm"
    if curve.weight:
        unit_text = "m²/kg"
    interval_text = _limits_text(curve.scattering_interval) or "its 95 % interval has no upper end"
    backing_text = _limits_text(curve.backing_interval)
    yield (
        f"{title}: the coating scatters with S = {number(curve.scattering)} {unit_text}"
        f" ({interval_text}), over a backing of {number(curve.backing)}"
        f" ({backing_text}). S counts all that varies with the thickness as scattering in the"
        " coating; errors of the thickness lower it, as they lower a slope."
    )


def _limits_text(limits: Pair) -> str:
    if not is_known(limits):
        return ""
    return f"95 %: {number(limits[0])} to {number(limits[1])}"
