"""A cell that is read once, and the cores that begin from it as often as they die."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import RsiDescription
from deltaq_cell.find import find_cell, resolve_near
from deltaq_emulator.krc import Krc
from deltaq_emulator.profiles import profile_for
from deltaq_emulator.settings import KrcSettings
from deltaq_protocol.messages import Description, ToolPose
from deltaq_protocol.rsi import load_ethernet_xml
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.rsi_driver import RsiDriver
from deltaq_services.robot_server.shell import sensor_codec
from deltaq_verification.faults.catalogue import UnknownFaultError


@dataclass(frozen=True)
class CellFactory:
    """A cell whose robots are all driven over RSI.

    Attributes:
        model: of the cell.
        told: what clients are told about it.
        file: its YAML file.
    """

    model: CellModel
    description: Description
    file: Path

    @classmethod
    def load(cls, cell_name: str | Path) -> CellFactory:
        """Read a cell.

        Raises:
            UnknownFaultError: if a robot has no KRC that could be emulated.
        """
        model = CellModel.load(cell_name)
        for name, robot in model.description.robots.items():
            if not isinstance(robot.driver, RsiDescription):
                raise UnknownFaultError(
                    f"robots.{name}.driver is {robot.driver.kind!r}; faults are injected in cells whose robots are "
                    "all driven over RSI: use such a cell, e.g. --cell lab"
                )
        return cls(model, model.description_message(), find_cell(cell_name))

    def check_robot(self, robot: str) -> None:
        """Raise `UnknownFaultError` if the cell does not have this robot."""
        if robot not in self.model.robots:
            raise UnknownFaultError(
                f"no robot {robot!r} in cell {self.model.description.cell}; it has {', '.join(self.model.robots)}"
            )

    def krc(self, robot: str) -> Krc:
        """An emulated controller, at home."""
        model, cycle_s = self.model.robots[robot], self.model.description.cycle_s
        driver = model.description.driver
        assert isinstance(driver, RsiDescription)  # `load` has seen to that
        T_base_world = np.linalg.inv(model.T_world_base)
        return Krc(
            model.description,
            cycle_s,
            load_ethernet_xml(self._ethernet_xml(driver)),
            profile_for(driver.krc, cycle_s),
            model.home,
            lambda q: T_base_world @ model.forward(q),
            KrcSettings.load(),
        )

    def server(self, robot: str, process: int) -> tuple[RobotServer, RsiDriver]:
        """A Robot Server's core and its driver, as a process of this number begins with them."""
        description = self.model.description
        driver = description.robots[robot].driver
        assert isinstance(driver, RsiDescription)  # `load` has seen to that
        codec = sensor_codec(description, robot, self._ethernet_xml(driver))
        server = RobotServer(description, robot, process)
        return server, RsiDriver(codec, description, robot, server.counters)

    def tool_pose(self, robot: str, q: tuple[float, ...]) -> ToolPose:
        """Pose of a robot's tool at `q` (n,) [rad or m]."""
        return self.model.robots[robot].tool_pose(q)

    def _ethernet_xml(self, driver: RsiDescription) -> Path:
        return resolve_near(self.file, driver.ethernet_xml)
