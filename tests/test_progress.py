"""What is said while a command works: what it does, how far it is, nothing when it is done."""

import io
import re
import sys
import time

import pytest

from srsinv.progress import stage, steps


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture(params=[Terminal, io.StringIO])
def stream(request) -> io.StringIO:
    return request.param()


def test_a_short_stage_says_nothing(stream, monkeypatch):
    monkeypatch.setattr(sys, "stderr", stream)
    with stage("inverting", delay_s=60.0):
        time.sleep(0.02)
    assert stream.getvalue() == ""


def test_steps_say_how_many_are_done_and_what_is_left(stream, monkeypatch):
    monkeypatch.setattr(sys, "stderr", stream)
    with steps("cases", "ab", delay_s=0.0, every_s=0.02) as each:
        for item in each:
            with stage(f"case {item}", delay_s=0.0, every_s=0.02):
                time.sleep(0.3)
    words = stream.getvalue()
    for part in ("cases", "0 of 2", "1 of 2, about", "case a", "case b"):
        assert part in words
    if not stream.isatty():
        first, *_, last = words.splitlines()
        assert first == "cases ..."
        assert re.fullmatch(r"cases \.\.\. 1 of 2, about \d s left; case b \.\.\. 0 s", last)


def test_a_line_of_a_file_is_said_at_intervals(stream, monkeypatch):
    monkeypatch.setattr(sys, "stderr", stream)
    with stage("inverting", delay_s=0.0, every_s=60.0):
        time.sleep(0.1)
    if not stream.isatty():
        assert stream.getvalue() == "inverting ...\n"


def test_nothing_is_said_after_a_refusal(stream, monkeypatch):
    monkeypatch.setattr(sys, "stderr", stream)
    with pytest.raises(ZeroDivisionError), steps("cases", [0], delay_s=0.0) as each:  # noqa: PT012
        for item in each:
            time.sleep(0.05)
            1 / item
    words = stream.getvalue()
    time.sleep(0.2)
    assert stream.getvalue() == words


def test_the_terminal_is_left_as_it_was(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with stage("inverting", delay_s=0.0):
        time.sleep(0.1)
    words = sys.stderr.getvalue()
    assert words.count("\x1b[?25l") == words.count("\x1b[?25h") == 1  # the cursor
