"""Random inputs of the tests of controllers."""

import numpy as np
import pytest


@pytest.fixture
def random(request: pytest.FixtureRequest) -> np.random.Generator:
    """Random numbers that a test's name and parameters seed: the same whichever tests ran before."""
    return np.random.default_rng(list(request.node.name.encode()))
