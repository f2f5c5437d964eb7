"""How a tube is certified: all of it or not at all, and with the pair that has the least room."""

import numpy as np
import pytest
from gate_bench import (
    CELL,
    FR_BESIDE_GR,
    GR_BESIDE_FR,
    HOME,
    PROXIMITY,
    STOP_M,
    above_the_floor,
    at_rest,
    one_joint,
    with_room,
)
from spans import exact_drives

from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_services.sim.certificate import Certifier
from deltaq_services.sim.compiled_certificate import CompiledCertifier
from deltaq_services.sim.tube import Windows

BESIDE = {"fr": FR_BESIDE_GR, "gr": GR_BESIDE_FR}


def standing(name, q):
    return at_rest(name, q).standing()


def path(start, end, count=40):
    """Windows of a robot whose drives do not lag, along a straight line."""
    return Windows(np.linspace(start, end, count), exact_drives(0, len(start)), 0, count - 1)


@pytest.fixture(params=[Certifier, CompiledCertifier])
def certifier(request):
    return request.param


@pytest.fixture
def certify(certifier):
    return lambda robot, tube, *others: certifier(PROXIMITY).certify(robot, tube, list(others))


@pytest.fixture
def fails_again(certifier):
    """Whether those bodies alone at which a certificate failed let it fail once more."""
    return lambda failed, robot, tube, *others: (
        not certifier(PROXIMITY).judge(robot, tube, list(others), [failed.failing])
    )


LOW, HIGH = above_the_floor(-1e-3), above_the_floor(-1e-3) - one_joint("fr", 1, 0.2)
NEAR = with_room(-1e-3, "gr", BESIDE, 4)
FAR = NEAR - one_joint("gr", 4, 0.1)


@pytest.mark.parametrize(("start", "end"), [(LOW, HIGH), (HIGH, LOW)])
def test_a_path_that_begins_or_ends_too_near_to_the_structure_is_not_certified(
    certify, fails_again, start, end
):
    middle = (start + end) / 2
    assert certify("fr", path(middle, HIGH)).holds is True
    failed = certify("fr", path(start, end))
    assert failed.holds is False
    assert failed.binding.nearest.pair == ("fr/link_3", "structure/floor")
    assert failed.binding.room_m < 0
    assert failed.failing.other is None
    assert fails_again(failed, "fr", path(start, end))
    assert not fails_again(failed, "fr", path(middle, HIGH))


@pytest.mark.parametrize(("start", "end"), [(NEAR, FAR), (FAR, NEAR)])
def test_a_path_with_an_end_too_near_to_another_robot_is_not_certified(certify, fails_again, start, end):
    beside = standing("fr", FR_BESIDE_GR)
    middle = (start + end) / 2
    assert certify("gr", path(middle, FAR), ("fr", beside)).holds is True
    assert certify("fr", beside, ("gr", path(middle, FAR))).holds is True
    for asked in (
        ("gr", path(start, end), ("fr", beside)),
        ("fr", beside, ("gr", path(start, end))),
    ):
        failed = certify(*asked)
        assert failed.holds is False
        assert failed.failing.other == asked[2][0]
        assert fails_again(failed, *asked)
        assert set(failed.binding.nearest.pair) == {"fr/link_1", "gr/link_3"}
        assert failed.binding.room_m < 0


def there_and_back(start, far, end):
    """Windows of a robot that goes away and comes back to somewhere else."""
    points = np.vstack([np.linspace(start, far, 20), np.linspace(far, end, 20)])
    return Windows(points, exact_drives(0, len(start)), 0, len(points) - 1)


def test_each_near_part_of_a_path_is_checked(certify):
    clear_low, clear_near = LOW - one_joint("fr", 1, 0.005), NEAR - one_joint("gr", 4, 0.005)
    beside = standing("fr", FR_BESIDE_GR)
    assert certify("fr", there_and_back(clear_low, HIGH, clear_low)).holds is True
    assert certify("fr", there_and_back(LOW, HIGH, clear_low)).holds is False
    assert certify("fr", there_and_back(clear_low, HIGH, LOW)).holds is False
    assert certify("gr", there_and_back(clear_near, FAR, clear_near), ("fr", beside)).holds is True
    for path_near in (there_and_back(NEAR, FAR, clear_near), there_and_back(clear_near, FAR, NEAR)):
        assert certify("gr", path_near, ("fr", beside)).holds is False
        assert certify("fr", beside, ("gr", path_near)).holds is False


@pytest.mark.parametrize("end_clear", [0.005, 0.1])
@pytest.mark.parametrize("turn", [0.4, -0.4])
def test_the_last_checked_part_of_a_path_counts(certify, turn, end_clear):
    """Another joint goes further, one way or the other, so that the end that is too near is divided first or last."""
    turned, rolled = one_joint("fr", 0, turn), one_joint("gr", 8, turn)
    low, clear = LOW - one_joint("fr", 1, 0.004), LOW - one_joint("fr", 1, end_clear)
    assert certify("fr", path(low, clear + turned)).holds is True
    assert certify("fr", path(LOW, clear + turned)).holds is False
    beside = standing("fr", FR_BESIDE_GR)
    near, far = NEAR - one_joint("gr", 4, 0.004), NEAR - one_joint("gr", 4, end_clear)
    assert certify("gr", path(near, far + rolled), ("fr", beside)).holds is True
    assert certify("gr", path(NEAR, far + rolled), ("fr", beside)).holds is False
    assert certify("fr", beside, ("gr", path(NEAR, far + rolled))).holds is False


@pytest.mark.parametrize("order", [1, -1])
def test_a_part_waiting_during_a_division_still_counts(certify, order):
    """The other part comes back with its gripper turned: near enough for two divisions, and never too near."""
    far, turned = NEAR - one_joint("gr", 4, 0.3), NEAR - one_joint("gr", 4, 0.005) + one_joint("gr", 8, 0.05)
    beside = standing("fr", FR_BESIDE_GR)
    for start, is_certified in ((NEAR - one_joint("gr", 4, 0.005), True), (NEAR, False)):
        there_and_turned = there_and_back(*(start, far, turned)[::order])
        assert certify("gr", there_and_turned, ("fr", beside)).holds is is_certified
        assert certify("fr", beside, ("gr", there_and_turned)).holds is is_certified


@pytest.mark.parametrize("order", [1, -1])
def test_a_path_that_brings_a_robot_too_near_to_itself_is_not_certified(certify, order):
    folded = np.array((0.202, -0.063, 2.412, -1.8, -1.435, -1.305))  # the camera at its own base
    open_wide = folded - one_joint("fr", 1, 1.2)
    assert certify("fr", standing("fr", open_wide)).holds is True
    failed = certify("fr", path(*(folded, open_wide)[::order]))
    assert failed.holds is False
    assert set(failed.binding.nearest.pair) == {"fr/tool_camera", "fr/base"}


def test_each_candidate_trajectory_of_another_robot_counts(certify):
    near, far = ("gr", standing("gr", NEAR)), ("gr", standing("gr", FAR))
    beside = standing("fr", FR_BESIDE_GR)
    assert certify("fr", beside, far, far).holds is True
    assert certify("fr", beside, near, far).holds is False
    assert certify("fr", beside, far, near).holds is False


def test_a_certificate_that_holds_has_no_open_pairs(certifier):
    beside, far = standing("fr", FR_BESIDE_GR), standing("gr", FAR)
    assert certifier(PROXIMITY).alone("fr", beside, PROXIMITY.alone["fr"]).failing is None
    assert (
        certifier(PROXIMITY).between("fr", beside, "gr", far, PROXIMITY.between["fr", "gr"]).failing is None
    )


def test_the_structure_is_reported_before_the_other_robot(certify):
    low = standing("fr", LOW)
    assert certify("fr", low, ("gr", standing("gr", HOME["gr"]))).binding.nearest.pair[1] == "structure/floor"


def test_a_certificate_names_the_checked_pair_with_the_least_clearance(certify):
    beside = standing("fr", FR_BESIDE_GR)
    close = standing("gr", with_room(5e-4, "gr", BESIDE, 4))
    for binding in (
        certify("fr", beside, ("gr", close)).binding,
        certify("fr", beside, ("gr", close), ("gr", standing("gr", FAR))).binding,
        certify("fr", beside, ("gr", standing("gr", FAR)), ("gr", close)).binding,
    ):
        assert set(binding.nearest.pair) == {"fr/link_1", "gr/link_3"}
        assert binding.stop_distance_m == STOP_M
        assert binding.room_m == pytest.approx(5e-4, abs=2e-5)
    alone = certify("fr", beside, ("gr", standing("gr", HOME["gr"]))).binding
    assert not any(name.startswith("gr") for name in alone.nearest.pair)


def test_a_divided_path_names_the_pair_of_its_first_query(certify):
    whole = path(NEAR - one_joint("gr", 4, 0.01), FAR)
    beside = ("fr", standing("fr", FR_BESIDE_GR))
    divided = certify("gr", whole, beside)
    assert divided.holds
    assert set(divided.binding.nearest.pair) == {"fr/base", "gr/tool_gripper"}  # inflated by all of the path


def test_omitted_pairs_are_neither_checked_nor_reported(certifier):
    low, gr = standing("fr", LOW), standing("gr", HOME["gr"])
    proximity = CompiledProximity(CELL)

    def certify_low():
        return certifier(proximity).certify("fr", low, [("gr", gr)])

    assert certify_low().holds is False
    proximity.leave_out([("fr/link_3", "structure/floor")])
    assert certify_low().holds is True
    proximity.leave_out(
        (one.name, other.name)
        for group in [*proximity.alone["fr"], *proximity.between["fr", "gr"]]
        for one, other in group.pairs
    )
    none_left = certify_low()
    assert (none_left.holds, none_left.binding) == (True, None)
    proximity.alone["fr"], proximity.between["fr", "gr"] = [], []  # a cell that has no such bodies at all
    without_bodies = certify_low()
    assert (without_bodies.holds, without_bodies.binding) == (True, None)


def corner(first, second, third):
    """One window around a corner, which no division along it makes narrow."""
    return Windows(np.array([first, second, third]), exact_drives(2, len(first)), 2, 2)


def test_an_indivisible_piece_is_certified_as_it_is_or_not_at_all(certify, fails_again):
    beside = standing("fr", FR_BESIDE_GR)
    around = corner(FAR, NEAR, NEAR + one_joint("gr", 0, 0.05))
    failed = certify("gr", around, ("fr", beside))
    assert failed.holds is False
    assert failed.binding.nearest.distance_m > STOP_M  # in its middle there is room
    assert set(failed.binding.nearest.pair) == {"fr/link_1", "gr/link_3"}
    assert failed.failing.other == "fr"
    assert fails_again(failed, "gr", around, ("fr", beside))
    turning = path(FR_BESIDE_GR, FR_BESIDE_GR + one_joint("fr", 0, 1e-3))
    assert certify("gr", around, ("fr", turning)).holds is False
    assert certify("fr", turning, ("gr", around)).holds is False


def test_of_two_tubes_the_divisible_one_is_divided(certify):
    near = NEAR - one_joint("gr", 4, 0.005)
    mine = path(near, near - one_joint("gr", 4, 0.1))
    wrist = corner(
        FR_BESIDE_GR,
        FR_BESIDE_GR + one_joint("fr", 4, 0.3),
        FR_BESIDE_GR + one_joint("fr", 4, 0.3) + one_joint("fr", 5, 0.3),
    )
    assert certify("gr", mine, ("fr", wrist)).holds is True
    assert certify("fr", wrist, ("gr", mine)).holds is True


def test_a_budget_is_the_number_of_dividing_queries():
    low = LOW - one_joint("fr", 1, 0.005)
    divided_once = path(low, low - one_joint("fr", 1, 0.17))
    assert not Certifier(PROXIMITY, budget=0).certify("fr", divided_once, []).holds
    assert Certifier(PROXIMITY, budget=1).certify("fr", divided_once, []).holds


def test_all_tubes_of_one_certifier_share_its_budget():
    low = LOW - one_joint("fr", 1, 0.005)
    divided_once = path(low, low - one_joint("fr", 1, 0.17))
    certifier = Certifier(PROXIMITY, budget=1)
    assert certifier.certify("fr", standing("fr", HOME["fr"]), []).holds  # one look is enough
    assert not certifier.certify("fr", divided_once, []).holds
