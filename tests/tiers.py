"""Three tiers of tests: which one a test belongs to, what runs, in which order, and what a fast
test may cost.

A test belongs to the highest tier that it names (``@pytest.mark.ci``, ``@pytest.mark.nightly``) or
that one of its fixtures needs; all others are fast.
"""

import json
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

from cpu_time import SHARED, cpu_seconds, loop_seconds

#: Lowest first. ``run.py test`` runs the first, ``--ci`` the second, ``--all`` all of them.
TIERS = ("fast", "ci", "nightly")

#: What a fixture takes: a linked run or a browser is no matter of milliseconds, measured data are
#: not everywhere.
NEEDED_TIER = {"linked_run": "ci", "kinds": "ci", "chromium": "ci", "shared_data": "nightly"}

#: CPU time above which a fast test fails, on a machine that counts to 3 million in .25 s; what
#: several tests share does not count (fixtures, kernels that are compiled or loaded). Write them
#: for half of it: a machine may be twice as slow from one minute to the next. This is the one limit
#: on the time of tests.
FAST_CPU_S = 1.0
REFERENCE_LOOP_S = 0.25

#: Seconds by the clock of each file and tier, longest first; ``--record-seconds`` writes it.
SECONDS_PATH = Path(__file__).parent / "expected_seconds.json"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of ``run.py test``."""
    group = parser.getgroup("planish")
    group.addoption("--ci", action="store_true", help="run the tests of the tier ci")
    group.addoption("--all", action="store_true", help="run the tests of all tiers")
    group.addoption("--alone", action="store_true", help="nothing runs beside: the limit decides")
    group.addoption(
        "--record-seconds",
        action="store_true",
        help="write how long each file takes, for the schedule",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Watch the tests where their results arrive."""
    if hasattr(config, "workerinput"):
        return
    config.pluginmanager.register(FastLimit(alone=config.option.alone))
    if config.option.record_seconds:
        config.pluginmanager.register(SecondsRecorder())


# --- which tests run, and in which order ----------------------------------------------------------


def tier_of(item: pytest.Item) -> str:
    """Return the highest tier that a test or one of its fixtures names."""
    named = [tier for tier in TIERS if item.get_closest_marker(tier)]
    needed = [
        NEEDED_TIER[name] for name in getattr(item, "fixturenames", ()) if name in NEEDED_TIER
    ]
    return max(("fast", *named, *needed), key=TIERS.index)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Give each test its tier, leave out those that were not asked for, and put files that take
    long first."""
    for item in items:
        if "shared_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.realdata)
        item.add_marker(tier_of(item))
    is_named = any("::" in name for name in config.args)
    if not (config.option.all or is_named or config.option.markexpr):
        wanted = "ci" if config.option.ci else "fast"
        left_out = [item for item in items if tier_of(item) != wanted]
        items[:] = [item for item in items if tier_of(item) == wanted]
        config.hook.pytest_deselected(items=left_out)
    expected = expected_seconds(items)
    items.sort(key=lambda item: (-expected[item.path], item.path))


def expected_seconds(items: list[pytest.Item]) -> dict[Path, float]:
    """Return how long the tests of each file may take together; a file that was never timed counts
    nothing."""
    recorded = json.loads(SECONDS_PATH.read_text(encoding="utf-8"))
    tiers = {(item.path, tier_of(item)) for item in items}
    seconds = dict.fromkeys((item.path for item in items), 0.0)
    for path, tier in tiers:
        name = path.relative_to(SECONDS_PATH.parent).as_posix()
        seconds[path] += recorded.get(name, {}).get(tier, 0.0)
    return seconds


class SecondsRecorder:
    """Adds up how long each file took in each tier, its fixtures included, and writes the table."""

    def __init__(self) -> None:
        self.seconds: dict[str, dict[str, float]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        tier = dict(report.user_properties).get("tier")
        if isinstance(tier, str):
            file = report.nodeid.partition("::")[0].removeprefix("tests/")
            tiers = self.seconds.setdefault(file, {})
            tiers[tier] = tiers.get(tier, 0.0) + report.duration

    def pytest_sessionfinish(self) -> None:
        table = json.loads(SECONDS_PATH.read_text(encoding="utf-8"))
        for file, tiers in self.seconds.items():
            timed = {tier: round(seconds) for tier, seconds in tiers.items()}
            table[file] = table.get(file, {}) | timed
        rows = [
            f"{json.dumps(file)}: {json.dumps({tier: s for tier, s in tiers.items() if s >= 1})}"
            for file, tiers in sorted(
                table.items(), key=lambda row: (-sum(row[1].values()), row[0])
            )
            if max(tiers.values()) >= 1 and (SECONDS_PATH.parent / file).exists()
        ]
        SECONDS_PATH.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8", newline="\n")


# --- CPU time of each test ------------------------------------------------------------------------

USED = pytest.StashKey[float]()


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[object]) -> Generator[None, object, object]:
    """Take the time of a shared fixture off the test that happens to make it."""
    if fixturedef.scope == "function":
        return (yield)
    with SHARED.within():
        return (yield)


def count(item: pytest.Item) -> Generator[None, object, object]:
    """Add what the wrapped step uses to the test's CPU time."""
    before, shared = cpu_seconds(), SHARED.seconds
    try:
        return (yield)
    finally:
        used = cpu_seconds() - before - (SHARED.seconds - shared)
        item.stash[USED] = item.stash.get(USED, 0.0) + used


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, object, object]:
    """Count the fixtures that are this test's alone."""
    item.user_properties.append(("tier", tier_of(item)))
    return (yield from count(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Count the test itself, and note it with the result."""
    try:
        return (yield from count(item))
    finally:
        item.user_properties.append(("cpu_s", item.stash[USED]))


class FastLimit:
    """Collects the fast tests above the limit; they are taken again alone, as tests beside them
    slow them down."""

    def __init__(self, *, alone: bool) -> None:
        self.alone = alone
        self.over: dict[str, float] = {}
        self.limit_s = 0.0

    def pytest_sessionstart(self) -> None:
        self.limit_s = FAST_CPU_S * max(1.0, loop_seconds() / REFERENCE_LOOP_S)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        noted = dict(report.user_properties)
        used = noted.get("cpu_s")
        if report.when != "call" or noted.get("tier") != "fast" or not isinstance(used, float):
            return
        if used > self.limit_s:
            self.over[report.nodeid] = used

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if not self.over or session.exitstatus != pytest.ExitCode.OK:
            return
        if self.alone:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
            return
        print(
            f"\n{len(self.over)} fast tests used more than {self.limit_s:.2g} s CPU; once more,"
            " alone:"
        )
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "--no-header",
            "-p",
            "no:cacheprovider",
            "--alone",
        ]
        done = subprocess.run([*command, *self.over], check=False, cwd=session.config.rootpath)
        if done.returncode:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if self.alone:
            for name, used in self.over.items():
                line = f"{used:.1f} s CPU, a fast test may use {self.limit_s:.2g} s: {name}"
                terminalreporter.line(line, red=True)
