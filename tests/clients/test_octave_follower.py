"""The paper's camera follower in GNU Octave, against a cell of real processes at 12 ms.

It is judged by the states that the cell published, and by forward kinematics of the tests' own.
"""

import json
import math
import socket
import threading
from typing import Any

import numpy as np
import octave
import pytest
from urdf_kinematics import UrdfKinematics

from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.services import Role, Service

pytestmark = [
    pytest.mark.live,
    pytest.mark.long,
    pytest.mark.skipif(bool(octave.why_no_octave()), reason=octave.why_no_octave()),
]

SETTLES_S = 5.0
FOLLOWS_S = 8.0
LARGEST_DEG = 1.5
KEPT_S = 0.25
"""On a machine that is too busy a robot brakes for want of an increment; so long after that it is judged again."""


class Recording(threading.Thread):
    """The states of all robots, over a connection of its own."""

    def __init__(self, tcp_port: int) -> None:
        super().__init__(daemon=True)
        self.states: list[dict[str, Any]] = []
        self._sock = socket.create_connection(("127.0.0.1", tcp_port), timeout=300)

    def run(self) -> None:
        self._sock.sendall(b'{"type":"hello","protocol":1,"client":"recording"}\n')
        with self._sock.makefile("r", encoding="utf-8") as lines:
            for line in lines:
                message = json.loads(line)
                if message["type"] == "state":
                    self.states.append(message)

    def end(self) -> list[dict[str, Any]]:
        self._sock.shutdown(socket.SHUT_RDWR)
        self.join()
        self._sock.close()
        return self.states


@pytest.mark.nightly
def test_octave_keeps_the_camera_on_the_moving_leader(ready_stack):
    stack = ready_stack
    leader = ("-m", "deltaq_controllers.leader", "--url", stack.cell.hli)
    with Launcher([Service("leader", Role.LEADER, leader)], print) as launcher:
        launcher.start()
        recording = Recording(stack.cell.tcp_port)
        recording.start()
        program = f"camera_follower('127.0.0.1', {stack.cell.tcp_port}, {SETTLES_S + FOLLOWS_S})"
        done = octave.run(program)
        states = recording.end()
    robots, urdf = stack.cell.robots, {name: robot.urdf for name, robot in stack.model.robots.items()}
    assert done.returncode == 0, done.stderr
    judged = view_angles_deg(states, robots, urdf)
    angles = np.array([angle for angle, _ in judged])
    kept = np.array([angle for angle, since_s in judged if since_s > KEPT_S])
    told = (
        f"rms {np.sqrt(np.mean(angles**2)):.2f} deg, median {np.median(angles):.2f}, max {angles.max():.2f}; of "
        f"{len(kept)} of {len(angles)} cycles that no brake came shortly before: max {kept.max(initial=0):.2f}\n"
        f"{done.stdout}"
    )
    print(told)
    assert len(angles) > 0.9 * FOLLOWS_S / stack.cell.cycle_s, told
    assert np.median(angles) < LARGEST_DEG / 3, told
    assert kept.max(initial=0.0) < LARGEST_DEG, told


def view_angles_deg(states, robots, urdf):
    """Angle between the camera's axis and the leader's tool in each cycle, and the time since a robot braked [s]."""
    kinematics = {name: UrdfKinematics(robots[name], urdf[name]) for name in robots}
    following = [state for state in states if state["robot"] == "fr" and state["phase"] == "engaged"]
    begin_s, end_s = following[0]["time_s"] + SETTLES_S, following[-1]["time_s"]
    focus, places, angles, braked_s = None, [], [], begin_s
    for state in states:
        if state["phase"] != "engaged":
            braked_s = max(braked_s, state["time_s"])
        if not begin_s <= state["time_s"] <= end_s:
            continue
        description = robots[state["robot"]]
        if state["robot"] == "gr":
            focus = kinematics["gr"].at(state["q"], description.tool.frame)[:3, 3]
            places.append(focus)
        elif focus is not None:
            T_world_camera = kinematics["fr"].at(state["q"], description.camera.pose)
            to = focus - T_world_camera[:3, 3]
            cosine = float(T_world_camera[:3, 2] @ to / np.linalg.norm(to))
            angles.append((math.degrees(math.acos(min(1.0, cosine))), state["time_s"] - braked_s))
    travelled = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    # on a machine that is too busy the leader brakes most of the time as well
    assert travelled > 0.1, "the leader hardly moved"
    return angles
