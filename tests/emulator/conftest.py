import pytest
from krc_bench import Bench


@pytest.fixture
def bench() -> Bench:
    return Bench()
