"""The cell of two published arms, a UR10 and a Panda, as the how-to guide writes it.

As a program it compiles the inverse kinematics of arms that nobody wrote one for, which tests beside one another would
else compile at the same time.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

from pages import steps

from deltaq_cell.cell_model import CellModel

GUIDE = Path(__file__).parents[2] / "docs" / "how-to" / "bring-your-own-robot.md"


def description() -> str:
    """The text of the guide's cell."""
    page = GUIDE.read_text(encoding="utf-8")
    (text,) = (step.text for step in steps(page) if (step.kind, step.argument) == ("write", "arms.yaml"))
    return text


def cell() -> CellModel:
    """Its model."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "arms.yaml"
        file.write_text(description(), encoding="utf-8")
        return CellModel.load(file)


def main() -> None:
    """Follow a path of the hands of each arm."""
    from deltaq_controllers.inverse.tracking import ConstraintTracker

    for robot in cell().robots.values():
        tracker = ConstraintTracker(robot)
        tracker.track(robot.home[None, tracker.base], tracker.hands(robot.home), robot.home)


if __name__ == "__main__":
    main()
