"""A cell that is read once, and the cores that begin from it as often as their processes start."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import RsiDescription
from deltaq_cell.find import find_cell, resolve_near
from deltaq_emulator.krc import Krc
from deltaq_emulator.settings import KrcSettings, profile_for
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Description, ToolPose
from deltaq_protocol.rsi import load_ethernet_xml
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.rsi_driver import RsiDriver, sensor_codec


@dataclass(frozen=True)
class LoadedCell:
    """A cell.

    Attributes:
        model: of the cell.
        description: the description for clients.
        file: its YAML file.
    """

    model: CellModel
    description: Description
    file: Path

    @classmethod
    def load(cls, cell_name: str | Path) -> LoadedCell:
        """Read a cell by name or file."""
        model = CellModel.load(cell_name)
        return cls(model, model.description_message(), find_cell(cell_name))

    def ethernet_xml(self, robot: str) -> Path | None:
        """The ethernet file of a robot's KRC; None for a kinematic robot."""
        driver = self.model.description.robots[robot].driver
        return resolve_near(self.file, driver.ethernet_xml) if isinstance(driver, RsiDescription) else None

    def krc(self, robot: str, q: Array, xml: Path) -> Krc:
        """Make an emulated controller with a loaded file, its robot at `q` (n,) [rad or m]."""
        model, cycle_s = self.model.robots[robot], self.model.description.cycle_s
        driver = model.description.driver
        assert isinstance(driver, RsiDescription)  # no other robot has such a file
        T_base_world = np.linalg.inv(model.T_world_base)
        return Krc(
            model.description,
            cycle_s,
            load_ethernet_xml(xml),
            profile_for(driver.krc, cycle_s),
            q,
            lambda q: T_base_world @ model.forward(q),
            KrcSettings.load(),
        )

    def server(self, robot: str, process: int) -> RobotServer:
        """A Robot Server's core, as a process of this number begins with it."""
        return RobotServer(self.model.description, robot, process)

    def driver(self, xml: Path, server: RobotServer) -> RsiDriver:
        """The driver of a Robot Server, for a KRC that has loaded a file."""
        description = self.model.description
        codec = sensor_codec(description, server.robot, xml)
        return RsiDriver(codec, description, server.robot, server.counters)

    def tool_pose(self, robot: str, q: tuple[float, ...], tool: str = "tool") -> ToolPose:
        """Pose of a robot's tool at `q` (n,) [rad or m]."""
        return self.model.robots[robot].tool_pose(q, tool)
