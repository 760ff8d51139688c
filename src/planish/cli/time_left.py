"""How much of a run is done and how long the rest takes.

Expected times of its stages, scaled by those that passed.
"""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from planish.core.durations import (
    LINK_SECONDS,
    READ_SECONDS,
    SHEET_SECONDS,
    WRITE,
    Seconds,
    slowness,
)
from planish.core.errors import PlanishError
from planish.run.study import GivenLayer, Study

# Its name, or that of a step of tiles within it, and its expected seconds.
Stage = tuple[str, float]
Clock = Callable[[], float]


class TimeLeft:
    """Follows a run through its expected stages; ``guess`` is a first one of their scale."""

    def __init__(
        self, stages: Sequence[Stage], clock: Clock = time.monotonic, guess: float | None = None
    ) -> None:
        self._names = [name for name, _ in stages]
        self._seconds = [seconds for _, seconds in stages]  # expected
        self._clock = clock
        self._total = sum(self._seconds)
        self._at = -1  # number of the stage
        self._share = 0.0  # of its tiles that are done
        self._start = self._entered = clock()
        # Seconds by the clock in which an expected one passes.
        self._rate = self._guess = slowness() if guess is None else guess

    def enter(self, name: str, share: float = 0.0) -> None:
        """A stage begins, or the ``share`` (0 to 1) of its tiles is done.

        Stages that were passed over take no time.
        """
        # A name may stand for several stages: where it begins, for the next one of this name.
        first = max(self._at + (share == 0), 0)
        if name not in self._names[first:]:
            return
        stage = self._names.index(name, first)
        if stage != self._at:
            for k in range(self._at + 1, stage):
                self._seconds[k] = 0.0
            self._move(stage)
        if share >= 1 and stage + 1 < len(self._names):
            self._move(stage + 1)
        elif share:
            self._move(stage, share)

    def _move(self, stage: int, share: float = 0.0) -> None:
        self._at = stage
        self._share = share
        self._entered = self._clock()
        self._rate = self._rate_at(self._passed(), self._clock())

    def _rate_at(self, passed: float, now: float) -> float:
        """Rate by the clock when so many of the expected seconds have passed."""
        # At first the guess counts more than the few seconds that passed.
        guessed = 0.05 * self._total
        return (now - self._start + guessed * self._guess) / (passed + guessed)

    def _passed(self) -> float:
        """Expected seconds of what is done."""
        if self._at < 0:
            return 0.0
        earlier = sum(self._seconds[: self._at])
        return earlier + self._share * self._seconds[self._at]

    @property
    def seconds(self) -> float:
        """Seconds that are probably left."""
        total = sum(self._seconds)
        passed = self._passed()
        rate = self._rate
        now = self._clock()
        if self._at >= 0 and not self._share:  # no tiles say how far the stage is
            most = 0.9 * self._seconds[self._at]  # before it is over
            passed += min((now - self._entered) / rate, most)
            # Where a stage takes longer than expected, what follows probably will, half as much.
            rate = max(rate, (rate + self._rate_at(passed, now)) / 2)
        return rate * max(total - passed, 0.0)

    @property
    def share(self) -> float:
        """Share of the whole time that has passed."""
        passed = self._clock() - self._start
        return passed / max(passed + self.seconds, 1e-9)


def expected_stages(study: Study) -> list[Stage]:
    """Stages of a run with the seconds that each takes by the sizes of its files.

    The sizes are read from the headers of the files.
    """
    sizes = [_millions(layer) for layer in study.layers]
    n_read = sum(layer.kind != "volume" for layer in study.layers)
    stages: list[Stage] = [("read", READ_SECONDS)] * n_read
    for layer, millions in zip(study.layers, sizes, strict=True):
        if layer.kind == "volume":
            stages += _timed(SHEET_SECONDS, millions)
    # Each layer is registered to the next one; the rest is done once, on the pixels of the last.
    if len(study.layers) > 1:
        for millions in sizes[1:-1]:
            stages.append(_timed(LINK_SECONDS, millions)[0])
        stages += _timed(LINK_SECONDS, sizes[-1])
    return stages + _timed(WRITE, sizes[-1])


def _timed(seconds: Seconds, millions: float) -> list[Stage]:
    return [(name, fixed + each * millions) for name, (fixed, each) in seconds.items()]


def _millions(layer: GivenLayer) -> float:
    """Columns measured through the sheet of a volume, or pixels of an image, in millions.

    A million where the file does not say.
    """
    from planish.io import describe  # here, so that help does not wait for it

    with suppress(PlanishError, OSError):
        if layer.volume is None:
            return math.prod(describe(layer.path, values=False)["shape"]) / 1e6
        given_um = layer.volume.voxel_um
        column_um = layer.volume.column_um
        facts = describe(layer.path, voxel_um=given_um, override_size=True, values=False)
        across = [axis for axis in range(3) if "zyx"[axis] != layer.volume.through]
        columns = math.prod(facts["shape"][axis] for axis in across)
        if column_um is not None and facts["size_um"] is not None:
            pitch_um = math.sqrt(math.prod(facts["size_um"][axis] for axis in across))
            columns /= max(1, round(column_um / pitch_um)) ** 2
        return columns / 1e6
    return 1.0
