"""The smallest cell: one robot with one sliding joint, all its numbers powers of two so that sums are exact.

Time-outs are a few cycles long instead of dozens. They count cycles, so shorter ones show the same order of events
in fewer steps.
"""

from collections.abc import Sequence

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import CellDescription
from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles
from deltaq_protocol.messages import Outcome
from deltaq_services.sim.core import Sim
from deltaq_services.sim.gate import Decision
from deltaq_services.sim.tracker import Tracker

ROBOT = "slide"
CYCLE_S = 2.0**-7
STEP = 2.0**-14
"""Largest change of the increment between two cycles [m]."""
FASTEST = 4
"""Largest increment, in steps: so long, in cycles, is the longest brake."""
GATE_TIMEOUT_CYCLES = 1
KRC_TIMEOUT_CYCLES = 1
HLI_TIMEOUT_CYCLES = 1
LAG_S = CYCLE_S
"""The gate knows drives of so short a lag after two states."""
LEASE = 1
"""Epoch of the lease under which the HLI requests."""

IPOC_STEP = 8
"""By how much the IPOC grows in a cycle."""

_URDF = """
<robot name="slide">
  <link name="base"/>
  <link name="carriage">
    <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>
  </link>
  <joint name="x" type="prismatic">
    <parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""


_RSI = {
    "kind": "rsi",
    "address": "127.0.0.1",
    "port": 49152,
    "krc_address": "127.0.0.1",
    "krc": "krc4",
    "ethernet_xml": "never read",
}


def one_joint_cell(rsi: bool = False, lookahead_cycles: int = 1) -> CellDescription:
    """The description of the cell.

    Args:
        rsi: the robot has a KRC. Without one there is no mode to probe, which takes more cycles than are explored
            and is tested by itself.
        lookahead_cycles: of the gate.
    """
    joint = {
        "home_m": 0.0,
        "lower_m": -1.0,
        "upper_m": 1.0,
        "max_velocity_m_s": FASTEST * STEP / CYCLE_S,
        "max_acceleration_m_s2": STEP / CYCLE_S**2,
        "tracking_tolerance_m": 16 * STEP,
    }
    robot = {
        "model": "one joint",
        "server": "tcp/127.0.0.1:7451",
        "driver": _RSI if rsi else {"kind": "kinematic"},
        "joints": {"x": joint},
    }
    gate = {
        "servo_lag_s": LAG_S,
        "lookahead_cycles": lookahead_cycles,
        "max_request_age_s": CYCLE_S,
        "gate_timeout_s": GATE_TIMEOUT_CYCLES * CYCLE_S,
        "krc_timeout_s": KRC_TIMEOUT_CYCLES * CYCLE_S,
        "hli_timeout_s": HLI_TIMEOUT_CYCLES * CYCLE_S,
    }
    far = {"far": {"shape": {"kind": "sphere", "radius_m": 0.1}, "pose": {"position_m": [0, 9, 0]}}}
    fields = {"cell": "model", "cycle_s": CYCLE_S, "robots": {ROBOT: robot}, "gate": gate, "structure": far}
    return CellDescription.model_validate(fields)


class EveryIncrement:
    """Decides in the gate's place: admits whatever the limits of speed and acceleration allow.

    Bodies and positions can only take admissions away, so that what holds with these holds with fewer.
    """

    def decide(self, robot: Tracker, others: Sequence[Tracker], request: Array) -> Decision:
        """Admit a request within the limits; hold any other."""
        last, step = robot.ahead.dq, np.array([STEP])
        if np.all(np.abs(request) <= FASTEST * STEP) and np.all(np.abs(request - last) <= STEP):
            return Decision(Outcome.ADMITTED, 1.0, request, brake_cycles(request, step), (), None)
        brake = robot.brake()
        return Decision(Outcome.HELD, 0.0, brake, brake_cycles(brake, step), (), None)


def one_joint_sim(description: CellDescription) -> Sim:
    """The SIM of the cell, its geometry left out."""
    robots = {name: RobotModel(robot, name, urdf=_URDF) for name, robot in description.robots.items()}
    sim = Sim(CellModel.of(description, robots), epoch=1)
    sim.gate = EveryIncrement()
    return sim
