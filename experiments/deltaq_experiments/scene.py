"""The two robots of the paper's experiments, and the camera controller that is tried on them."""

from __future__ import annotations

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.camera.aim import TOOL
from deltaq_controllers.camera.controllers import FocusController, camera_controller_named
from deltaq_controllers.camera.scene import Scene
from deltaq_experiments.options import Options
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError

FOLLOWER, LEADER = "fr", "gr"
VIEW_DISTANCE_M = 1.25

LOOP_CYCLES = 3
"""Cycles from a measurement to the drives: the answer, its transport to the controller, the drives' sampling."""


def load(options: Options, experiment: str) -> CellModel:
    """The cell of an experiment.

    Raises:
        DeltaqError: if it has no such robots.
    """
    cell = CellModel.load(options.cell)
    require_both(cell, f"{experiment} experiment")
    return cell


def require_both(cell: CellModel, purpose: str) -> None:
    """Refuse a cell without the two robots.

    Raises:
        DeltaqError: that says what they are for.
    """
    if not {FOLLOWER, LEADER} <= set(cell.robots):
        raise DeltaqError(
            f"the {purpose} needs robots {FOLLOWER} and {LEADER}, cell {cell.description.cell} has "
            f"{', '.join(cell.robots)}"
        )


def camera_scene(cell: CellModel, options: Options) -> Scene:
    """Who looks at what, but for a fixed point."""
    return Scene(cell, FOLLOWER, LEADER, options.aim_offset_m)


def camera_controller(
    cell: CellModel,
    name: str = "paper",
    distance_m: float = VIEW_DISTANCE_M,
    focus: Array | None = None,
    aim_offset_m: tuple[float, float, float] = TOOL,
) -> FocusController:
    """The camera controller of that name, looking at a point of the leader's tool or at a fixed point.

    Raises:
        DeltaqError: if there is none of that name.
    """
    scene = Scene(cell, FOLLOWER, LEADER, aim_offset_m)
    return camera_controller_named(name, scene, distance_m, focus)


def aim_arguments(options: Options) -> list[str]:
    """Arguments of `deltaq_controllers.camera_follower` that say what is looked at."""
    if options.aim_offset_m == TOOL:
        return []
    return ["--aim-offset-m", *(f"{part:g}" for part in options.aim_offset_m)]


def added_delay_cycles(cell: CellModel, latency_s: float) -> int:
    """Cycles by which the leader's measurement must be held back so that the whole latency is `latency_s`."""
    lag = cell.robots[FOLLOWER].description.servo_lag
    cycle_s = cell.description.cycle_s
    own_s = LOOP_CYCLES * cycle_s + lag.dead_time_s + 2 * lag.damping / lag.natural_frequency_rad_s
    cycles = round((latency_s - own_s) / cycle_s)
    if cycles < 0:
        raise DeltaqError(
            f"--latency-s {latency_s:g} is below what the loop has by itself, {own_s:.3f} s: the drives' lag and "
            f"{LOOP_CYCLES} cycles; ask for at least that, or set a shorter servo_lag in the cell"
        )
    return cycles
