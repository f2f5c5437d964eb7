"""How old what a robot is asked for may be: the lesser of what the table of topics and the cell say."""

import pytest

from deltaq_cell.load import load_cell
from deltaq_services.sim.gated_robot import GatedRobot

LAB = load_cell("lab")


def made(cycle_s, **changes):
    gate = LAB.gate.model_copy(update=changes)
    return GatedRobot("fr", LAB.robots["fr"], gate, cycle_s)


@pytest.mark.parametrize(
    ("cycle_s", "max_request_age_s", "cycles"),
    [(0.012, 0.12, 10), (0.012, 0.06, 5), (0.012, 9.0, 10), (0.004, 0.12, 10), (0.004, 0.02, 5)],
)
def test_requests_and_commands_may_be_as_old_as_the_stricter_of_table_and_cell_says(
    cycle_s, max_request_age_s, cycles
):
    robot = made(cycle_s, max_request_age_s=max_request_age_s)
    assert robot.max_age_cycles == cycles
    assert robot.inbox._max_age_cycles == cycles
