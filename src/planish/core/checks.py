"""One check of a result.

What was seen, against which limit, what it means for which figures, and what to do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import AfterValidator

from planish.core.facts import DescribedModel, Number, Trust
from planish.core.text import plain_numbers
from planish.core.typing import Entries, Texts

State = Literal["pass", "look", "fail", "unknown"]
"""``look``: the figures are doubtful; ``fail``: they are wrong and withheld; ``unknown``: nothing
can be said."""

PROPERTIES = "properties"
POSITION = "position"
CORRELATION = "correlation"
"""Figures beside single maps: all maps of a sheet, the place of a pixel, all that is computed from
linked layers."""


class Check(DescribedModel):
    """Result of one check. A stage that knows one layer only leaves ``layers`` empty."""

    name: str
    """Short and unique in a run, as 'slices along z'."""
    state: State
    """pass, look, fail or unknown."""
    sentence: Annotated[str, AfterValidator(plain_numbers)]
    """What was found; with unknown, why nothing can be said."""
    value: Number = None
    """What was compared."""
    limit: Number = None
    """The limit that the state was judged by."""
    units: str = ""
    """Of value and limit; 'share' for a part of 1."""
    advice: str = ""
    """What to do; empty where nothing has to be done."""
    remedy: str = ""
    """What to set in the next run; names parameters, as `voxel_um`."""
    figures: Texts = ()
    """What it concerns: names of maps, or properties, position, correlation."""
    layers: Texts = ()
    """Layers that it is about."""

    @property
    def text(self) -> str:
        """What was found, what to do and what to set."""
        return " ".join(filter(None, (self.sentence, self.advice, self.remedy)))


@dataclass(frozen=True, slots=True)
class CheckRule:
    """A rule that makes one check: a row of the table ``planish.checks.CHECKS``."""

    name: str  # of the check
    stage: type  # of a run, by the class of what it gives to judge
    figures: Texts  # that the check concerns, where the function names no others
    # Takes the rule and what is judged; None where there is nothing.
    judge: Callable[[CheckRule, Any], Check | None]

    def __call__(self, subject: Any) -> Check | None:
        """Judge a subject."""
        return self.judge(self, subject)

    def check(
        self,
        state: State,
        sentence: str,
        *,
        advice: str = "",
        figures: Texts | None = None,
        **fields: Any,
    ) -> Check:
        """Make a check of this name; ``figures`` are those of the rule where not given."""
        fields["figures"] = self.figures if figures is None else figures
        return Check(name=self.name, state=state, sentence=sentence, advice=advice, **fields)

    def at_most(
        self,
        value: float,
        *,
        look: float | None = None,
        fail: float | None = None,
        sentence: str,
        advice: str = "",
        remedy: str = "",
        **fields: Any,
    ) -> Check:
        """Judge a value that should be small; advice and remedy are dropped where it passes.

        Above ``fail`` it fails, above ``look`` it is a look; where one of these limits is not
        given, nothing is judged by it, but ``fail`` alone is the limit of a look, too. NaN passes
        nothing and is a look.
        """
        look_limit = fail if look is None else look
        state: State = "pass"
        if fail is not None and value > fail:
            state = "fail"
        elif look_limit is not None and not value <= look_limit:
            state = "look"
        limit = fail if state == "fail" else look_limit
        if state != "pass":
            fields |= {"advice": advice, "remedy": remedy}
        return self.check(state, sentence, value=float(value), limit=limit, **fields)

    def at_least(
        self, value: float, *, look: float, sentence: str, advice: str, units: str
    ) -> Check:
        """Judge a value that should be large."""
        judged: Entries = {"value": float(value), "limit": look, "units": units}
        if value >= look:
            return self.check("pass", sentence, **judged)
        return self.check("look", sentence, advice=advice, **judged)


def concerned(
    checks: Iterable[Check], layers: Iterable[str], figures: Iterable[str]
) -> list[Check]:
    """The checks about one of ``layers`` that concern one of ``figures``.

    ``properties`` are all maps of a sheet.
    """
    wanted_figures = {*figures}
    layer_names = {*layers}
    if wanted_figures - {POSITION, CORRELATION}:
        wanted_figures.add(PROPERTIES)
    of_figures = [check for check in checks if wanted_figures & {*check.figures}]
    return [check for check in of_figures if not check.layers or layer_names & {*check.layers}]


def trust_of(checks: Iterable[Check], layers: Iterable[str], figures: Iterable[str]) -> Trust:
    """Trust in a figure of some layers, by all checks that concern one of ``figures``."""
    states = {check.state for check in concerned(checks, layers, figures)}
    if "fail" in states:
        return "withheld"
    return "doubtful" if "look" in states else "ok"
