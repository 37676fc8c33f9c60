"""Where the time of a run of the tests goes: with `--seconds`, a table of each file's tests, wall
seconds, CPU seconds and seconds of tracing, lowering and compiling.

A plugin of pytest. jax reports a compilation when it ends, with its duration; those inside another
are counted once.
"""

import os
import time
from collections import defaultdict

import jax.monitoring
import pytest

USED = "seconds used"
EVENTS = "/jax/core/compile/"
STARTED = pytest.StashKey[float]()


def cpu_seconds() -> float:
    """Of this process and of those that it started and that have ended."""
    return sum(os.times()[:4])


class Intervals:
    """The union of spans of time that end one after the other."""

    def __init__(self):
        self.spans: list[tuple[float, float]] = []

    def add(self, event: str, seconds: float, **_) -> None:
        """A span of `seconds` that ends now, if `event` is one of compiling."""
        if not event.startswith(EVENTS):
            return
        end = time.perf_counter()
        while self.spans and self.spans[-1][0] >= end - seconds:
            self.spans.pop()
        self.spans.append((end - seconds, end))

    def take(self) -> float:
        """Seconds since the last call."""
        taken, self.spans = sum(end - start for start, end in self.spans), []
        return taken


COMPILING = Intervals()


def pytest_addoption(parser):
    parser.addoption("--seconds", action="store_true", help="print where the tests' time goes")


def pytest_configure(config):
    jax.monitoring.register_event_duration_secs_listener(COMPILING.add)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    item.stash[STARTED] = cpu_seconds()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    if call.when == "teardown":
        cpu = cpu_seconds() - item.stash[STARTED]
        item.user_properties.append((USED, [cpu, COMPILING.take()]))
    return (yield)


def pytest_terminal_summary(terminalreporter, config):
    if not config.getoption("--seconds"):
        return
    files = defaultdict(lambda: [0, 0.0, 0.0, 0.0])
    for reports in terminalreporter.stats.values():
        for report in reports:
            if not isinstance(report, pytest.TestReport):
                continue
            row = files[report.nodeid.split("::")[0]]
            row[1] += report.duration
            for _, (cpu, compiling) in [p for p in report.user_properties if p[0] == USED]:
                row[0] += 1
                row[2] += cpu
                row[3] += compiling
    rows = sorted(files.items(), key=lambda each: -each[1][1])
    total = [sum(column) for column in zip(*files.values(), strict=True)]
    terminalreporter.section("seconds by file")
    terminalreporter.write_line("tests   wall    cpu  compiling")
    for name, (count, wall, cpu, compiling) in [*rows, ("all files", total)]:
        terminalreporter.write_line(f"{count:5d} {wall:6.1f} {cpu:6.1f} {compiling:6.1f}  {name}")
