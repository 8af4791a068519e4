"""What the tests of the loop share."""

from __future__ import annotations

import pytest

from tests.unit.rt.bench import Bench


@pytest.fixture
def bench() -> Bench:
    return Bench()
