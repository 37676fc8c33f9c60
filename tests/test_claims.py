"""README's numbers are those that its commands gave, and every study is of what it says."""

import pytest

from tests.claims import commands, readme

ENV = readme.environment()
SAID = [
    (readme.digits(0.0832, "%"), "8.3"),
    (readme.digits(0.97), "0.97"),
    (readme.digits(0.0), "0"),
    (readme.digits(12559, figures=3), "12600"),
    (readme.with_error(3.80061e-3, 1.5e-6, "mm"), "3.8006 ± 0.0015"),
    (readme.with_error(6009.2, 93.0), "6009 ± 93"),
    (readme.power(2.4e-4), "2e-4"),
    (readme.power(0.0), "0"),
    (readme.duration(17.0), "20 s"),
    (readme.duration(95.0), "2 min"),
    (readme.other_lines({"lines": 0}), "none"),
    (readme.other_lines({"lines": 2, "line_1_m": 0.0201, "line_2_m": 1e-3}),
     "20.10, and shorter ones"),
]  # fmt: skip


@pytest.mark.parametrize(("written", "meant"), SAID)
def test_numbers_are_written_for_reading(written, meant):
    assert written == meant


def test_pages_say_what_was_measured():
    """Else: python -m tests.claims.readme."""
    assert not list(readme.stale())


def test_what_was_measured_is_what_is_typed():
    """Else: python -m tests.claims.commands."""
    assert {name: each["typed"] for name, each in commands.results().items()} == commands.commands()


def test_a_part_is_written_anew_and_nothing_else():
    text = "a\n<!-- rules: written -->\nold\n<!-- end of rules -->\nb\n"
    new = readme.renewed(text, ENV)
    assert new.startswith("a\n<!-- rules: written -->\n\nWhere the noise level")
    assert new.endswith("\n\n<!-- end of rules -->\nb\n")
    assert readme.renewed(new, ENV) == new
