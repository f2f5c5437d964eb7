import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import RSIPI
import yaml
from networks import own_network
from ran import ran

from deltaq_cell.description import RobotDescription, RsiDescription
from deltaq_cell.load import find_cell, load_cell, resolve_near
from deltaq_protocol.rsi import AxisMap, SensorCodec, load_ethernet_xml
from deltaq_testing.private_cell import free_ports, write_private_cell

pytestmark = pytest.mark.service

PATIENCE_S = 300.0
PEER = Path(__file__).parents[1] / "support" / "rsipi_peer.py"
GIVEN_PORTS = (28152, 28153)
"""All that the system may give, and the first is the panel's: a link made before it would take it every second time."""
STARTS_AND_ENDS = f"""
from deltaq_emulator.__main__ import build
from deltaq_emulator.context import NOTHING
from deltaq_emulator.settings import SHIPPED, KrcSettings
from deltaq_emulator.shell import Emulator

krc, driver = build("lab", "fr", KrcSettings.load(SHIPPED), NOTHING)
for _ in range(20):
    Emulator("fr", krc, (driver.address, driver.port), (driver.address, {GIVEN_PORTS[0]})).close()
"""


class Emulated:
    """An emulator process, seen from outside: its panel and the PC's socket, which the test owns."""

    def __init__(self, cell: Path, robot: str) -> None:
        self.robot: RobotDescription = load_cell(cell).robots[robot]
        driver = self.robot.driver
        assert isinstance(driver, RsiDescription)
        assert driver.control_port is not None
        self.server = (driver.address, driver.port)
        self._panel_address = (driver.address, driver.control_port)
        self.codec = SensorCodec(
            load_ethernet_xml(resolve_near(find_cell(cell), driver.ethernet_xml)),
            AxisMap.of(self.robot.joint_names, self.robot.units, driver.krc),
            driver.inputs,
            driver.outputs,
        )
        self._panel = socket.socket(type=socket.SOCK_DGRAM)
        self._panel.settimeout(2 * PATIENCE_S)
        self.process: subprocess.Popen[str]

    def ask(self, **request: Any) -> dict[str, Any]:
        self._panel.sendto(json.dumps(request).encode(), self._panel_address)
        answer: dict[str, Any] = json.loads(self._panel.recv(65535))
        return answer

    def until(self, **awaited: Any) -> dict[str, Any]:
        """The status in the cycle in which all of this holds."""
        status = self.ask(op="await", within_s=PATIENCE_S, **awaited)
        assert status["ok"], status
        return status

    def close(self) -> None:
        self._panel.close()


@contextmanager
def running(cell: Path, robot: str, *arguments: str) -> Iterator[Emulated]:
    emulated = Emulated(cell, robot)
    command = [sys.executable, "-m", "deltaq_emulator", "--cell", str(cell), "--robot", robot, *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(f"ready: {robot} sends to 127.0.0.1:")
        emulated.process = process
        yield emulated
    finally:
        process.terminate()
        _, errors = process.communicate(timeout=PATIENCE_S)
        emulated.close()
    assert process.returncode == 0, errors
    assert errors == ""


@contextmanager
def pc(emulated: Emulated) -> Iterator[socket.socket]:
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(emulated.server)
        sock.settimeout(PATIENCE_S)
        yield sock


def silent(sock: socket.socket) -> bool:
    """Whether nothing more comes within the socket's timeout, apart from what is under way."""
    try:
        for _ in range(1000):
            sock.recv(4096)
    except TimeoutError:
        return True
    return False


@pytest.mark.parametrize("replies", ["none", "garbage"])
def test_telegrams_are_sent_at_a_fixed_rate_with_and_without_replies(tmp_path: Path, replies: str) -> None:
    with running(write_private_cell(tmp_path, "lab-4ms"), "fr") as emulated, pc(emulated) as sock:
        first = sock.recvfrom(4096)[0]
        begin_s = time.monotonic()
        before, began_s = emulated.ask(op="status"), time.monotonic()
        ipocs = []
        for _ in range(150):
            datagram, krc = sock.recvfrom(4096)
            ipocs.append(emulated.codec.decode(datagram).ipoc)
            if replies == "garbage":
                for _ in range(5):
                    sock.sendto(b"<Sen", krc)
        end_s = time.monotonic()
        after, ended_s = emulated.ask(op="status"), time.monotonic()
        # cycles that the machine held up are told, and only those may be missing
        passed = after["cycle"] - before["cycle"]
        slipped = after["counters"]["slipped"] - before["counters"]["slipped"]
        # each status is of a moment between its question and its answer, however far apart a busy machine puts them
        assert (end_s - began_s) / 0.004 - 10 < passed + slipped < (ended_s - begin_s) / 0.004 + 10
        assert set(np.diff([emulated.codec.decode(first).ipoc, *ipocs])) == {4}
        assert after["state"] == "RSI running"
        assert (after["counters"]["garbled"] > 0) == (replies == "garbage")


def test_the_growing_record_shows_the_moving_gantry(tmp_path: Path) -> None:
    record = tmp_path / "gr.csv"
    cell = write_private_cell(tmp_path)
    with running(cell, "gr", "--record", str(record)) as emulated, pc(emulated) as sock:
        start, moved = emulated.robot.home, 0.0
        is_there = False
        while not is_there:  # a reply of a busy machine may be late, and then it does not count
            datagram, krc = sock.recvfrom(4096)
            telegram = emulated.codec.decode(datagram)
            if telegram.q is not None:
                assert telegram.q_programmed is not None
                moved = min(moved + 0.0005, 0.02)
                correction = np.zeros(9)
                correction[0], correction[3] = moved, -moved
                sock.sendto(emulated.codec.encode(telegram.ipoc, correction, {"gripper": True}), krc)
                is_there = abs(telegram.q[0] - start[0] - 0.02) < 2e-5
        status = emulated.until(at_rest=True, cycles=2)  # the last correction counts from the next cycle on
        assert status["q"][0] == pytest.approx(start[0] + moved, abs=2e-5)
        assert status["outputs"] == {"gripper": True, "tool_changer": False}
        rows = record.read_text().splitlines()
        names = rows[0].split(",")
        q = np.array([[float(value) for value in row.split(",")[:-1]] for row in rows[1:-1]])
        first, fourth = q[:, names.index("q_1")], q[:, names.index("q_4")]
        assert first[0] == pytest.approx(start[0])
        assert first.max() - start[0] == pytest.approx(moved, abs=1e-4)
        assert fourth.min() == pytest.approx(start[3] - moved, abs=1e-4)
        assert np.diff(q[:, 0]).tolist() == [1.0] * (len(q) - 1)


def test_a_silent_pc_stops_rsi_until_the_operator_restarts_it(tmp_path: Path) -> None:
    with running(write_private_cell(tmp_path, "lab-4ms"), "fr") as emulated, pc(emulated) as sock:
        # silence counts from the first reply that came in time
        while not emulated.ask(op="status")["counters"]["accepted"]:
            for _ in range(5):
                datagram, krc = sock.recvfrom(4096)
                sock.sendto(emulated.codec.encode(emulated.codec.decode(datagram).ipoc, np.zeros(6)), krc)
        stopped = emulated.until(state="stopped")
        assert stopped["message"].startswith("KSS29002")
        refused = emulated.ask(op="restart")
        assert refused["ok"] is False
        assert "acknowledge" in refused["error"]
        last = stopped["ipoc"]
        assert emulated.ask(op="acknowledge")["state"] == "ready"
        assert emulated.ask(op="restart")["ok"]
        emulated.until(state="RSI running")
        ipoc = 0
        while ipoc <= last:
            ipoc = emulated.codec.decode(sock.recv(4096)).ipoc


def test_a_stalled_machine_is_distinguished_from_a_late_pc(tmp_path: Path) -> None:
    with running(write_private_cell(tmp_path, "lab-4ms"), "fr") as emulated, pc(emulated) as sock:
        datagram, krc = sock.recvfrom(4096)
        sock.sendto(emulated.codec.encode(emulated.codec.decode(datagram).ipoc, np.zeros(6)), krc)
        emulated.process.send_signal(signal.SIGSTOP)
        sock.settimeout(0.5)
        assert silent(sock)
        emulated.process.send_signal(signal.SIGCONT)
        counters = emulated.until(cycles=1)["counters"]
        assert counters["slipped"] >= 0.4 / 0.004
        assert counters["late_starts"] >= 1
        assert counters["latest_start_us"] >= 400_000


def test_faults_of_the_network_are_injected_while_it_runs(tmp_path: Path) -> None:
    with running(write_private_cell(tmp_path), "fr") as emulated, pc(emulated) as sock:
        sock.recv(4096)
        assert emulated.ask(op="fault", link="to_pc", drop=1.0)["ok"]
        dropped = emulated.until(cycles=5, state="RSI running")
        assert dropped["faults"]["to_pc"]["counts"]["dropped"] >= 5
        assert emulated.ask(op="fault", link="to_pc", corrupt=1.0)["ok"]
        corrupted = emulated.until(cycles=5)
        assert corrupted["faults"]["to_pc"]["counts"]["corrupted"] >= 5
        assert emulated.ask(op="fault")["faults"]["to_pc"]["drop"] == 0.0
        assert emulated.ask(op="explode")["ok"] is False


def test_forged_telegrams_come_from_addresses_of_their_own(tmp_path: Path) -> None:
    with running(write_private_cell(tmp_path), "fr") as emulated, pc(emulated) as sock:
        _, krc = sock.recvfrom(4096)
        forge = [{"address": "127.0.0.3"}, {"ipoc_shift": 5_000_000}]
        assert emulated.ask(op="fault", forge=forge)["ok"]
        from_whom: dict[tuple[str, int], set[int]] = {}
        while len(from_whom) < 3 or min(map(len, from_whom.values())) < 5:
            datagram, sender = sock.recvfrom(4096)
            from_whom.setdefault(sender, set()).add(emulated.codec.decode(datagram).ipoc)
        (twin,) = (sender for sender in from_whom if sender[0] == "127.0.0.3")
        (far,) = set(from_whom) - {krc, twin}
        assert from_whom[twin] <= from_whom[krc]
        assert from_whom[far] <= {(ipoc + 5_000_000) % 2**32 for ipoc in from_whom[krc]}
        status = emulated.ask(op="fault")
        assert (status["forged"], status["counters"]["forgeries_lost"]) == ([], 0)


def test_a_second_controller_sends_from_an_address_of_its_own(tmp_path: Path) -> None:
    cell = write_private_cell(tmp_path)
    panel = f"127.0.0.1:{free_ports(1)[0]}"
    with running(cell, "fr") as emulated, pc(emulated) as sock:
        senders = {sock.recvfrom(4096)[1][0]}
        with running(cell, "fr", "--address", "127.0.0.7", "--panel", panel):
            while len(senders) < 2:
                senders.add(sock.recvfrom(4096)[1][0])
        assert senders == {"127.0.0.1", "127.0.0.7"}


def test_the_link_of_an_emulator_never_takes_the_port_of_its_panel() -> None:
    network = own_network()
    if network is None:
        pytest.skip("no network namespace is allowed here, and the test sets which ports the system gives")
    given = ["sh", "-c", 'echo "$0" >/proc/sys/net/ipv4/ip_local_port_range && exec "$@"']
    ran([*network, *given, f"{GIVEN_PORTS[0]} {GIVEN_PORTS[1]}", sys.executable, "-c", STARTS_AND_ENDS])


def test_an_interrupt_ends_it_cleanly(tmp_path: Path) -> None:
    with running(write_private_cell(tmp_path), "fr") as emulated:
        emulated.process.send_signal(signal.SIGINT)
        assert emulated.process.wait(PATIENCE_S) == 0


CANNOT_BE_STARTED = (
    (["--robot", "xr"], "cell 'lab' has no robot 'xr'; it has fr, gr"),
    (["--cell", "lap"], "did you mean 'lab'?"),
    (["--settings", "none.yaml"], "none.yaml: cannot be read"),
    (["--context", "none.rsi.xml"], "none.rsi.xml: cannot be read"),
    (["--address", "192.0.2.1"], "cannot send from 192.0.2.1 to 127.0.0.1:"),
    (["--server", "here"], "'here' is not HOST:PORT"),
)
"""What is added to a start that would do, and what is said."""
STARTS = """
import json, sys
from deltaq_emulator.__main__ import main

for arguments in json.loads(sys.argv[1]):
    try:
        status = main(["--cell", "lab", "--robot", "fr", "--panel", sys.argv[2], *arguments])
    except SystemExit as ended:
        status = ended.code
    print(f"status {status}", file=sys.stderr)
"""


def test_a_failed_start_is_reported_in_one_line_with_status_2() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        panel, free = (f"127.0.0.1:{port}" for port in (taken.getsockname()[1], *free_ports(1)))
        tried = (*CANNOT_BE_STARTED, (["--panel", panel], f"cannot listen on {panel}: "))
        done = ran([sys.executable, "-c", STARTS, json.dumps([arguments for arguments, _ in tried]), free])
    assert "Traceback" not in done.stderr
    *said, rest = done.stderr.split("status 2\n")
    assert (len(said), rest) == (len(tried), "")
    for (_, message), text in zip(tried, said, strict=True):
        assert message in text


def test_the_published_client_rsipi_moves_the_robot_with_its_own_configuration(tmp_path: Path) -> None:
    cell = write_private_cell(tmp_path)
    driver = load_cell(cell).robots["fr"].driver
    assert isinstance(driver, RsiDescription)
    theirs = Path(RSIPI.context("joints")).read_text()
    ours = tmp_path / "rsipi_ethernet.xml"
    ours.write_text(
        theirs.replace("10.10.10.10", "127.0.0.1").replace(">64000<", f">{driver.port}<"), encoding="utf-8"
    )
    assert f">{driver.port}<" in ours.read_text()
    described = yaml.safe_load(cell.read_text())
    described["robots"]["fr"]["driver"] |= {"ethernet_xml": str(ours), "krc": "krc4", "stop": None}
    cell.write_text(yaml.safe_dump(described))
    with running(cell, "fr") as emulated:
        peer = ran([sys.executable, str(PEER), str(ours)])
        seen = json.loads(peer.stdout.splitlines()[-1])
        home = dict(zip(("A1", "A2", "A3", "A4", "A5", "A6"), np.rad2deg(emulated.robot.home), strict=True))
        assert seen["start"] == pytest.approx(home, abs=1e-4)
        assert seen["end"] == pytest.approx(home | {"A1": home["A1"] + 5, "A3": home["A3"] - 3}, abs=1e-3)
        assert seen["pose"]["Z"] > 500.0
        status = emulated.until(state="stopped")
        assert status["message"].startswith("KSS29002")
        assert status["text"].startswith("RSIPI")
        assert status["counters"]["accepted"] > 20
        wrong = {name: status["counters"][name] for name in ("garbled", "wrong_type", "future", "stale")}
        assert wrong == dict.fromkeys(wrong, 0)
        assert np.rad2deg(status["q"][0]) == pytest.approx(home["A1"] + 5, abs=1e-3)
