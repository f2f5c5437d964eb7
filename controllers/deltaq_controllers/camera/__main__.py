"""Compile the camera's laws: `python -m deltaq_controllers.camera`, so that the first start need not."""

from __future__ import annotations

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.camera.controllers import NAMES, camera_controller_named
from deltaq_controllers.camera.scene import Scene


def main() -> int:
    """Make every controller once, which compiles what it needs."""
    print("compiling the camera's laws, once: this takes some ten seconds", flush=True)
    scene = Scene(CellModel.load("lab"), robot_name="fr", leader_name="gr", latency_s=0.06)
    for name in NAMES:
        camera_controller_named(name, scene, distance_m=1.25)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
