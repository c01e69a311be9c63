"""Fixtures that several files of these tests share."""

import pytest

from pcnav.runs.estimate import Estimate
from tests.runs.made_estimates import made


@pytest.fixture
def frames() -> list[Estimate]:
    return made()
