"""Pages stay readable: short sentences, few semicolons, plain words."""

import pytest

from tests.house import prose


def test_no_file_uses_an_avoided_phrase():
    found = {
        path.relative_to(prose.ROOT).as_posix(): phrases
        for path in prose.sources()
        if (phrases := prose.avoided(path.read_text("utf-8")))
    }
    assert found == {}


@pytest.mark.parametrize(
    ("name", "find"),
    [("long_sentences", prose.too_long), ("semicolons", prose.too_many_semicolons)],
)
def test_exceptions_only_become_fewer(name, find):
    """Else: shorten what `python -m tests.house.prose` lists, or lower the number in prose.yaml."""
    found = [each for path in prose.pages() for each in find(path.read_text("utf-8"))]
    assert len(found) == prose.RULES["left"][name], found


def test_sentences_of_readme_and_guides_are_short():
    guides = [prose.ROOT / "README.md", *(prose.ROOT / "docs" / "how_to").glob("*.md")]
    assert prose.mean_length(guides) < 18


@pytest.mark.parametrize(
    ("text", "long", "semicolons"),
    [
        ("word " * 36 + ".", 1, 0),
        ("word " * 20 + ". " + "Word " * 20 + ".", 0, 0),
        ("```sh\n" + "word " * 50 + "\n```\n", 0, 0),
        ("a; b; c; d; e.", 0, 1),
        ("| " + "word " * 50 + "|\n", 0, 0),
    ],
)
def test_what_is_beyond_the_rules_is_found(text, long, semicolons):
    assert len(prose.too_long(text)) == long
    assert len(prose.too_many_semicolons(text)) == semicolons
