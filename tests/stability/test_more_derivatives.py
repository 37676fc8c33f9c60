"""Hard cases whose derivatives take programs of their own, like those of other groups in kind;
their values are tested in the files that have them."""

import pytest

from tests.stability.test_contact import BONE, LAG, ODD, SHORT
from tests.stability.test_inversion import CURVATURE, MANY, ONE
from tests.stability.test_layered import ON_A_CORE
from tests.stability.test_line import CHARGE

pytestmark = pytest.mark.claim

GROUPS = (ON_A_CORE, CHARGE, ODD, SHORT, LAG, BONE, CURVATURE, ONE, MANY)


def test_hard_case(hard):
    """Finite, with finite derivatives that agree both ways, and within its bound."""
    assert hard.finite
    assert hard.slopes_finite
    assert hard.disagreement < hard.most_disagreement
    assert hard.error < hard.bound
