"""The clients in other languages against a cell of real processes, one after another."""

import math

import numpy as np
import pytest
from languages import LANGUAGES, Language
from ran import ran

pytestmark = [pytest.mark.live, pytest.mark.long]


@pytest.fixture(scope="module")
def stack(shared_stack):
    return shared_stack.renewed()


@pytest.mark.parametrize("language", LANGUAGES, ids=lambda language: language.name)
def test_the_example_turns_a1_by_ten_degrees(language: Language, stack) -> None:
    if why_not := language.why_not():
        pytest.skip(why_not)
    before = np.array(stack.emulator()["q"])
    done = ran(language.turn_a1(stack.cell.tcp_port), env=language.environment())
    stack.wait_until_at_rest()
    turned = np.array(stack.emulator()["q"]) - before
    np.testing.assert_allclose(turned, [math.radians(10), 0, 0, 0, 0, 0], atol=math.radians(0.1))
    assert "A1 is at" in done.stdout
    phase, reason = stack.phase()
    assert (phase.value, reason) == ("ready", None)  # given back, not lost
