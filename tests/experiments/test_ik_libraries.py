"""Public libraries beside the hands' modes: what they are given is the robot and the drive that ours get."""

from __future__ import annotations

import sys
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.hands import Hands
from deltaq_experiments.directions import judged
from deltaq_experiments.ik_libraries import LIBRARIES, followed, main, mjcf, run
from deltaq_protocol.arrays import Array

LAB, DAWM = CellModel.load("lab"), CellModel.load("dawm")
ROBOTS = {"fr": LAB.robots["fr"], "gr": LAB.robots["gr"], "dawm": DAWM.robots["dawm"]}
CYCLE_S = 0.012


@pytest.mark.parametrize("library", LIBRARIES)
def test_a_library_that_is_not_installed_is_named_with_what_to_do(
    library: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(
        ControllerError, match=f"{library} cannot be imported .* pip install pin-pink mink daqp"
    ):
        run(library, "lab", "fr")
    with pytest.raises(SystemExit):
        main(["--library", library, "--cell", "lab", "--robot", "fr"])
    assert "pip install" in capsys.readouterr().err


def test_a_library_that_there_is_none_is_named() -> None:
    with pytest.raises(ControllerError, match="no library 'punk'; there are pink, mink"):
        run("punk", "lab", "fr")


def hands_of(robot: RobotModel, q: Array) -> dict[str, Array]:
    """(4, 4) pose of each site of the robot's MuJoCo model at `q` (n,), by MuJoCo's rules."""
    angles, found = dict(zip(robot.joint_names, q.tolist(), strict=True)), {}

    def place(element: ElementTree.Element) -> Array:
        w, x, y, z = numbers(element, "quat")
        return pin.SE3(pin.Quaternion(w, x, y, z), numbers(element, "pos")).homogeneous

    def walk(element: ElementTree.Element, T: Array) -> None:
        for joint in element.findall("joint"):
            axis, moved = numbers(joint, "axis"), np.eye(4)
            by = angles.pop(joint.attrib["name"]) * axis
            if joint.attrib["type"] == "hinge":
                moved[:3, :3] = pin.exp3(by)
            else:
                moved[:3, 3] = by
            T = T @ moved
        for site in element.findall("site"):
            found[site.attrib["name"]] = T @ place(site)
        for body in element.findall("body"):
            walk(body, T @ place(body))

    def numbers(element: ElementTree.Element, name: str) -> Array:
        return np.array([float(part) for part in element.attrib[name].split()])

    (world,) = ElementTree.fromstring(mjcf(robot)).findall("worldbody")
    walk(world, np.eye(4))
    assert not angles, "every joint is there"
    return found


@pytest.mark.parametrize("name", ROBOTS)
def test_the_mujoco_model_has_the_hands_where_the_robot_has_them(name: str) -> None:
    robot, random = ROBOTS[name], np.random.default_rng(1)
    for _ in range(5):
        q = random.uniform(robot.lower, robot.upper)
        hands = hands_of(robot, q)
        assert set(hands) == set(robot.hands)
        for hand, pose in hands.items():
            np.testing.assert_allclose(pose, robot.forward(q, hand), atol=1e-9)


class Newton:
    """Follows poses by the plain pseudo-inverse."""

    def __init__(self, robot: RobotModel) -> None:
        self.q, self._hands = robot.home.copy(), Hands(robot)

    def step(self, poses: list[Array]) -> Array:
        self._hands.update(self.q)
        rotations, positions = (np.array([pose[:3, part] for pose in poses]) for part in (slice(3), 3))
        error = self._hands.error(rotations, positions)
        self.q = self.q + np.linalg.pinv(self._hands.jacobian) @ error
        return self.q


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "axis", "rate"),
    [("fr", "x", 0.1), ("gr", "rz", -0.2), ("dawm", "left.y", 0.1), ("dawm", "rx", 0.2)],
)
def test_a_follower_is_led_along_the_axis_that_is_told(name: str, axis: str, rate: float) -> None:
    robot = ROBOTS[name]
    way, seconds = followed(robot, Newton(robot), {axis: rate}, 0.5, CYCLE_S)
    gone = judged(robot, {axis: rate}, way, 0.5)
    assert gone.share == pytest.approx(1.0, abs=0.02)
    assert gone.off_line_mm < 0.5
    assert gone.off_line_deg < 0.1
    assert len(seconds) == len(way) - 1
