# /// script
# requires-python = ">=3.11"
# dependencies = ["deltaq"]
# ///
"""Turn A1 of the floor robot by 10 degrees at 30 degrees/s, without waiting for verdicts."""

import math
import sys

from deltaq_protocol.blocking import connect
from deltaq_protocol.in_flight import InFlight

address = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with connect(address, client="example") as cell, cell.lease("fr") as robot:
    step = math.radians(30) * cell.description.cycle_s  # [rad] in one cycle
    target = None
    in_flight = InFlight()
    for state in robot.states():
        if state.phase == "held":
            sys.exit(f"fr is held: {state.reason}; when it is safe, `deltaq reset --robot fr`")
        target = state.q_cmd[0] + math.radians(10) if target is None else target
        if abs(target - state.q_cmd[0]) < math.radians(0.05):
            break
        for verdict in robot.new_verdicts():
            in_flight.take(verdict)
            if verdict.outcome != "admitted":
                print(verdict.outcome, *[reason.code for reason in verdict.reasons])
        for cycle in in_flight.cycles_to_answer(state):
            left = target - in_flight.ahead(state).q_cmd[0]  # what is sent already counts
            dq = [max(-step, min(step, 0.2 * left)), 0, 0, 0, 0, 0]
            in_flight.sent(robot.send(dq, cycle), dq, cycle)
    print(f"A1 is at {math.degrees(state.q_cmd[0]):.2f} deg")
