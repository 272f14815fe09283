"""The office, built once for all tests that look at it."""

from __future__ import annotations

import pytest

from client_sim.synthetic.office import build_office
from client_sim.synthetic.venue import Building


@pytest.fixture(scope="session")
def office() -> Building:
    """The two-storey building of the default seed."""
    return build_office()
