"""The sentences on a pair of maps: a row a question, in the order of the page."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Literal, NamedTuple

from planish.analyze.correlation_evidence import EvidenceFacts
from planish.report.sentences.agreement import say_agreement
from planish.report.sentences.attenuation import say_attenuation
from planish.report.sentences.conley_interval import say_conley_interval
from planish.report.sentences.correlogram import say_correlogram
from planish.report.sentences.curve import say_curve
from planish.report.sentences.kubelka_munk import say_kubelka_munk
from planish.report.sentences.light_field import say_light_field
from planish.report.sentences.light_spread import say_light_spread
from planish.report.sentences.origins import say_origins
from planish.report.sentences.partial import say_partial
from planish.report.sentences.short_waves import say_short_waves
from planish.report.sentences.thin_regions import say_thin
from planish.report.sentences.variograms import say_variograms
from planish.report.sentences.wording import Wording

Section = Literal["scale", "distance", "repeated", "light"]


class QuestionText(NamedTuple):
    """What the page says of one question.

    Where one of ``fields`` of :class:`~planish.analyze.correlation_evidence.EvidenceFacts` is not
    empty, ``say`` gives the sentences of ``section`` from the first of them.
    """

    fields: tuple[str, ...]
    say: Callable[[Any, EvidenceFacts, Wording], Iterable[str]]
    section: Section = "scale"


SENTENCES = (
    QuestionText(("origins",), say_origins),
    QuestionText(("conley_interval",), say_conley_interval),
    QuestionText(("curve",), say_curve),
    QuestionText(("thin",), say_thin),
    QuestionText(("short_waves", "short_waves_um"), say_short_waves),
    QuestionText(("light_field",), say_light_field),
    QuestionText(("partial", "commonality"), say_partial),
    QuestionText(
        ("attenuation_limit", "reliability", "attenuation_limit_noise", "attenuation_limit_both"),
        say_attenuation,
    ),
    QuestionText(("variograms",), say_variograms, section="distance"),
    QuestionText(("correlogram",), say_correlogram, section="distance"),
    QuestionText(("agreement",), say_agreement, section="repeated"),
    QuestionText(("kubelka_munk",), say_kubelka_munk, section="light"),
    QuestionText(("light_spread",), say_light_spread, section="light"),
)


def sentences(
    evidence: EvidenceFacts, section: Section, words: Wording | None = None
) -> Iterator[str]:
    """Give what a section of the page says of two maps, question by question."""
    for row in SENTENCES:
        answers = [getattr(evidence, name) for name in row.fields]
        if row.section == section and any(answer not in (None, ()) for answer in answers):
            yield from row.say(answers[0], evidence, words or Wording())
