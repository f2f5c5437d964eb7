"""The controller beside a flood: holds a robot's lease and swings its first joint.

As a process it speaks zenoh: `python -m deltaq_proofs.floods.holder CELL ROBOT`.
"""

from __future__ import annotations

import asyncio
import sys

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import connect
from deltaq_protocol.errors import DeltaqError
from deltaq_testing.faults.mover import Mover

_RETRY_S = 0.1


async def drive(cell_name: str, robot: str) -> None:
    """Move for ever, and take the lease again whenever it is lost."""
    model = CellModel.load(cell_name)
    cell, home = model.description, model.robots[robot].home
    async with connect(cell.hli, client="holder") as running:
        while True:
            try:
                async with running.lease(robot) as held:
                    mover = Mover(len(home), cell.cycle_s, float(home[0]))
                    async for state in held.states():
                        await held.send(mover.increment(state.q_cmd))
            except DeltaqError:
                await asyncio.sleep(_RETRY_S)


def main() -> None:
    """Run until a signal ends it."""
    print("ready: holder", flush=True)
    asyncio.run(drive(sys.argv[1], sys.argv[2]))


if __name__ == "__main__":
    main()
