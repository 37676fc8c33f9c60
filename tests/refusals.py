"""What a refusal has to be: one sentence that names what is wrong."""

import re

import pytest

from srsinv.errors import BadInput


def refused(attempt, *words):
    """The sentence with which `attempt()` is refused: one, with a full stop, and these words."""
    with pytest.raises(BadInput) as caught:
        attempt()
    sentence = str(caught.value)
    assert sentence.endswith(".")
    assert "\n" not in sentence
    assert not re.search(r"\.\s+[A-Z]", sentence), sentence
    assert [word for word in words if word not in sentence] == [], sentence
    return sentence
