"""What can be true of a reported position."""

import math

import numpy as np
import pytest

from deltaq_cell.load import load_cell
from deltaq_services.robot_server.session import (
    LIMIT_MARGIN_M,
    LIMIT_MARGIN_RAD,
    RESOLUTION_M,
    RESOLUTION_RAD,
    VELOCITY_MARGIN,
    Plausibility,
)

CELL = load_cell("lab")
GR = CELL.robots["gr"]
LINEAR = np.array([unit == "m" for unit in GR.units])
MARGIN = np.where(LINEAR, LIMIT_MARGIN_M, LIMIT_MARGIN_RAD)


@pytest.fixture
def plausible():
    """Made for each test: what a module makes as it is read is made once, whatever is tried on the code later."""
    return Plausibility.of(GR, CELL.cycle_s)


def with_joint(q, joint, value):
    changed = q.copy()
    changed[joint] = value
    return changed.tolist()


@pytest.mark.parametrize("joint", range(9))
def test_a_joint_is_believed_to_its_limit_and_a_margin_and_no_further(plausible, joint):
    for bound, sign, word in ((GR.lower - MARGIN, -1, "below"), (GR.upper + MARGIN, 1, "above")):
        assert plausible.of_place(with_joint(GR.home, joint, bound[joint] - sign * 1e-9)) is None
        fault = plausible.of_place(with_joint(GR.home, joint, bound[joint] + sign * 1e-6))
        assert (fault.joint, fault.what) == (GR.joint_names[joint], f"is {word} its limit and a margin")
        assert fault.value == pytest.approx(bound[joint], abs=1e-5)
        assert fault.bound == pytest.approx(bound[joint])


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_nowhere(plausible, value):
    assert plausible.of_place(with_joint(GR.home, 4, value)).joint == "a2"
    assert plausible.of_motion(with_joint(GR.home, 4, value), GR.home.tolist(), 1).joint == "a2"


@pytest.mark.parametrize("joint", range(9))
@pytest.mark.parametrize("cycles", [1, 7])
def test_a_joint_is_believed_as_far_as_it_can_have_moved_since(plausible, joint, cycles):
    resolution = RESOLUTION_M if LINEAR[joint] else RESOLUTION_RAD
    reach = VELOCITY_MARGIN * cycles * CELL.cycle_s * GR.max_velocity[joint] + resolution
    home = GR.home.tolist()
    for sign in (1, -1):
        near, far = (GR.home[joint] + sign * reach * share for share in (1 - 1e-6, 1 + 1e-6))
        assert plausible.of_motion(with_joint(GR.home, joint, near), home, cycles) is None
        fault = plausible.of_motion(with_joint(GR.home, joint, far), home, cycles)
        assert (fault.joint, fault.what) == (
            GR.joint_names[joint],
            f"cannot have moved so far in {cycles} cycles",
        )
        assert (fault.value, fault.bound) == (pytest.approx(reach, rel=1e-5), pytest.approx(reach))


def test_exactly_at_its_bounds_a_position_is_believed(plausible):
    assert plausible.of_place(plausible.lower) is None
    assert plausible.of_place(plausible.upper) is None
    furthest = [
        3 * reach + rounding for reach, rounding in zip(plausible.reach, plausible.resolution, strict=True)
    ]
    assert plausible.of_motion(furthest, [0.0] * 9, 3) is None


@pytest.mark.parametrize("joints", [6, 10])
def test_a_position_of_another_number_of_joints_is_an_error_and_never_half_looked_at(plausible, joints):
    with pytest.raises(ValueError, match="argument"):
        plausible.of_place([0.0] * joints)
