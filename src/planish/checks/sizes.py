"""Judge sizes that come from a resolution which programs write by default."""

from dataclasses import dataclass

from planish.core.checks import Check, CheckRule
from planish.core.facts import InputFile

LIMIT = 0.03  # by which the scale of a registration may differ from 1


@dataclass(frozen=True, slots=True, kw_only=True)
class SizedLayer:
    """A layer's file, and the scale at which it lies on a layer whose size is not doubted.

    The scale is None where there is no such layer, or where the model leaves none free.
    """

    source: InputFile
    scale: float | None = None


def size_by_dpi(rule: CheckRule, sized: SizedLayer) -> Check | None:
    """Judge a size that nobody may have measured; None where the file states no such size."""
    doubt = sized.source.size_doubt
    if not doubt:
        return None
    if sized.scale is not None and abs(sized.scale - 1) <= LIMIT:
        sentence = f"{doubt} The registration confirms it: its scale is {sized.scale:.4f}."
        return rule.check("pass", sentence, value=abs(sized.scale - 1), limit=LIMIT, units="share")
    word = "voxel_um" if len(sized.source.size_um) > 2 else "pixel_um"
    return rule.check(
        "look",
        doubt,
        advice="Compare a known length.",
        remedy=f"If the size is another one, give it with `{word}=SIZE` and `override_size=True`.",
    )
