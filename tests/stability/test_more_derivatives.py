"""Hard cases whose derivatives take programs of their own; their values are tested in
test_layered.py and test_line.py."""

import pytest

from tests.stability.test_layered import ON_A_CORE
from tests.stability.test_line import CHARGE

pytestmark = pytest.mark.full

GROUPS = (ON_A_CORE, CHARGE)


def test_hard_case(hard):
    """Finite, with finite derivatives that agree both ways, and within its bound."""
    assert hard.finite
    assert hard.slopes_finite
    assert hard.disagreement < hard.most_disagreement
    assert hard.error < hard.bound
