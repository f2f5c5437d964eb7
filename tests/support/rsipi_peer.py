"""A program that moves a robot with RSIPI, an RSI client by others: `rsipi_peer.py RSI_EthernetConfig.xml`.

Corrects A1 by 5 and A3 by -3 degrees and prints what it saw as one JSON object.
"""

import json
import sys
import time

from RSIPI import RSIAPI

PATIENCE_S = 300.0


def main(config_file: str) -> None:
    # absolute corrections, at most a quarter of a degree further each cycle
    api = RSIAPI(config_file, rsi_mode="absolute", max_joint_rate=0.25, cycle_time=0.012)
    api.start()
    try:
        if not api.wait_for_connection(timeout=PATIENCE_S):
            raise SystemExit("no telegram came")
        start = api.motion.get_current_joints()
        api.motion.update_joints(A1=5.0, A3=-3.0)
        deadline = time.monotonic() + PATIENCE_S
        while abs(api.motion.get_current_joints()["A1"] - start["A1"] - 5.0) > 1e-3:
            if time.monotonic() > deadline:
                raise SystemExit(f"A1 did not arrive: {api.motion.get_current_joints()}")
            time.sleep(0.02)
        end, pose = api.motion.get_current_joints(), api.motion.get_current_pose()
    finally:
        api.stop()
    print(json.dumps({"start": start, "end": end, "pose": pose}))


if __name__ == "__main__":
    main(sys.argv[1])
