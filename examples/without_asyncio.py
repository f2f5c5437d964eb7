# /// script
# requires-python = ">=3.11"
# dependencies = ["deltaq"]
# ///
"""Turn A1 of the floor robot by 10 degrees at 30 degrees/s, as a plain script."""

import math
import sys

from deltaq_protocol.blocking import connect

address = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with connect(address, client="example") as cell, cell.lease("fr") as robot:
    step = math.radians(30) * cell.description.cycle_s  # [rad] in one cycle
    target = None
    for state in robot.states():
        if state.phase == "held":
            sys.exit(f"fr is held: {state.reason}; when it is safe, `deltaq reset --robot fr`")
        target = state.q_cmd[0] + math.radians(10) if target is None else target
        left = target - state.q_cmd[0]
        if abs(left) < math.radians(0.05):
            break
        verdict = robot.move([max(-step, min(step, 0.2 * left)), 0, 0, 0, 0, 0])
        if verdict.outcome != "admitted":
            print(verdict.outcome, *[reason.code for reason in verdict.reasons])
    print(f"A1 is at {math.degrees(state.q_cmd[0]):.2f} deg")
