"""The Robot Server's socket: the KRC is answered whoever else speaks, and no error of the socket goes further."""

import re
import socket
import subprocess
import sys
import threading
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from krc_side import CELL, FR, XML, telegram

import deltaq_deploy
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_services.robot_server.krc_socket import MOST_READ, MOST_WAITING, KrcSocket
from deltaq_services.robot_server.rsi_driver import RsiDriver, sensor_codec
from deltaq_testing.private_cell import free_ports, write_private_cell


class Bench:
    """A Robot Server's socket on a port of its own, and a KRC that may be joined by others."""

    def __init__(self):
        self.counters = Counter()
        self.rsi = RsiDriver(sensor_codec(CELL, "fr", XML), CELL, "fr", self.counters)
        driver = FR.driver.model_copy(update={"port": free_ports(1)[0]})
        self.server = KrcSocket(driver, 0.25, self.rsi, self.counters)
        self.senders = [socket.socket(type=socket.SOCK_DGRAM) for _ in range(2)]
        for sender in self.senders:
            sender.connect((driver.address, driver.port))
        self.krc, self.other = self.senders

    def believe(self):
        for count in range(4):
            self.krc.send(telegram(1000 + 12 * count))
            self.server.read(0.012 * count)
        return self


@pytest.fixture
def bench():
    bench = Bench()
    with bench.server:
        yield bench
    for sender in bench.senders:
        sender.close()


def test_of_waiting_telegrams_the_newest_is_taken_and_the_others_counted(bench):
    bench.believe()
    for number in range(20):
        bench.krc.send(telegram(1048 + 12 * number))
    assert bench.server.read(0.3).ipoc == 1048 + 12 * 19
    assert bench.counters["telegrams_skipped"] == 19


def test_a_flood_of_foreign_datagrams_hides_no_telegram(bench):
    bench.believe()
    bench.krc.send(telegram(1048))
    for _ in range(100):
        bench.other.send(telegram(9_000_000))
    assert bench.server.read(0.048).ipoc == 1048
    assert bench.counters["telegrams_second_krc"] == 100
    assert f"a second KRC at 127.0.0.1:{bench.other.getsockname()[1]}" in bench.server.detail


def test_garbage_from_the_port_of_the_krc_hides_no_earlier_telegram(bench):
    bench.believe()
    bench.krc.send(telegram(1048))
    for rubbish in (b"", b"<Rob", b"x" * 60_000, b"\x00" * 4097):
        bench.krc.send(rubbish)
    assert bench.server.read(0.048).ipoc == 1048
    assert bench.counters["telegrams_garbled"] == 4


def test_the_first_implausible_telegram_is_logged_with_joint_value_and_bound(bench, caplog):
    bench.believe()
    for count, off in enumerate((9.0, -9.0)):
        bench.krc.send(telegram(1048 + 12 * count, q=FR.home + off))
        assert bench.server.read(0.048 + 0.012 * count) is None
    assert bench.counters["telegrams_implausible"] == 2
    (told,) = caplog.messages
    assert re.fullmatch(
        r"first implausible telegram: a1 is above its limit and a margin: .*, allowed .*", told
    )


def test_reading_an_endless_flood_ends_at_a_bound(bench):
    reads = []
    sender = bench.krc.getsockname()
    real = bench.server._sock
    bench.server._sock = SimpleNamespace(recvfrom=lambda *_: reads.append(1) or (b"flood", sender))
    assert bench.server.read(0.0) is None
    bench.server._sock = real
    assert len(reads) == MOST_WAITING
    assert bench.counters["telegrams_garbled"] == MOST_READ
    assert bench.counters["telegrams_skipped"] == MOST_WAITING - MOST_READ


def test_an_error_of_the_socket_is_counted_and_the_next_telegram_read(bench):
    real = bench.server._sock
    told = iter([ConnectionRefusedError(), OSError(101, "unreachable"), (telegram(1000), ("127.0.0.1", 9))])

    def recvfrom(*_):
        item = next(told, BlockingIOError())
        if isinstance(item, OSError):
            raise item
        return item

    bench.server._sock = SimpleNamespace(recvfrom=recvfrom)
    bench.server.read(0.0)
    bench.server._sock = real
    assert bench.counters["socket_errors"] == 2
    assert bench.server.peer.address == ("127.0.0.1", 9)


def test_a_reply_that_cannot_be_sent_is_counted(bench):
    bench.believe()
    bench.server.send(b"x" * 70_000)  # longer than a datagram can be
    assert bench.counters["replies_unsent"] == 1


def test_the_status_has_the_step_of_the_ipoc(bench):
    assert bench.server.detail == ""
    assert bench.believe().server.detail == "IPOC grows by 12 a cycle"


def test_an_unknown_address_is_reported():
    driver = FR.driver.model_copy(update={"krc_address": "no.such.krc.invalid"})
    with pytest.raises(ServiceUnreachableError, match=r"krc_address 'no\.such\.krc\.invalid' is not known"):
        KrcSocket(driver, 0.25, SimpleNamespace(), Counter())


def test_a_used_port_is_reported(bench):
    port = bench.krc.getpeername()[1]
    driver = FR.driver.model_copy(update={"port": port})
    with pytest.raises(ServiceUnreachableError, match=f"cannot listen for RSI on UDP 127.0.0.1:{port}"):
        KrcSocket(driver, 0.25, bench.rsi, Counter())


def test_a_socket_holds_fewer_telegrams_than_are_drained(bench):
    for _ in range(4 * MOST_WAITING):
        bench.krc.send(b"x" * 300)
    held = 0
    while True:
        try:
            bench.server._sock.recv(1000, socket.MSG_DONTWAIT)
        except BlockingIOError:
            break
        held += 1
    assert 0 < held < MOST_WAITING


def test_a_port_released_in_time_is_awaited_with_one_log_line(bench, caplog):
    caplog.set_level("INFO")
    driver = FR.driver.model_copy(update={"port": free_ports(1)[0]})
    holder = socket.socket(type=socket.SOCK_DGRAM)
    holder.bind((driver.address, driver.port))
    freed = threading.Timer(0.1, holder.close)
    freed.start()
    with KrcSocket(driver, 0.25, bench.rsi, Counter(), patience_s=30.0):
        freed.join()
    told = f"waits for UDP {driver.address}:{driver.port}: a robot may still be braked there"
    assert caplog.messages == [told]


# A Robot Server does not start on files of a KRC that cannot be safe.

KRC = Path(deltaq_deploy.__file__).parent / "krc"
PATIENCE_S = 300.0


def start(folder: Path, *edits: tuple[str, str]) -> subprocess.Popen[str]:
    text = (KRC / "fr_ethernet.xml").read_text(encoding="utf-8")
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    (folder / "mine_ethernet.xml").write_text(text, encoding="utf-8")
    cell = write_private_cell(folder)
    described = yaml.safe_load(cell.read_text(encoding="utf-8"))
    described["robots"]["fr"]["driver"]["ethernet_xml"] = "mine_ethernet.xml"
    cell.write_text(yaml.safe_dump(described), encoding="utf-8")
    command = [sys.executable, "-m", "deltaq_services.robot_server", "--cell", str(cell), "--robot", "fr"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.long
def test_unsafe_files_end_the_process_with_status_2_and_every_reason(tmp_path: Path) -> None:
    process = start(tmp_path, ('HOLDON="1"', 'HOLDON="0"'), ("ONLYSEND>FALSE", "ONLYSEND>TRUE"))
    try:
        output, errors = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()  # of one that serves after all nothing is left
        process.wait()
    assert process.returncode == 2
    assert "ready" not in output
    assert "error: the KRC's files are refused:" in errors
    assert "mine_ethernet.xml: CONFIG/ONLYSEND: is TRUE" in errors
    assert [f"RECEIVE/AK.A{i}: HOLDON is 0" in errors for i in range(1, 7)] == [True] * 6
    assert "Traceback" not in errors


@pytest.mark.service
def test_a_setting_that_worsens_an_outage_is_reported_without_ending_the_process(tmp_path: Path) -> None:
    process = start(tmp_path, ('<ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL" UNIT="0" />', ""))
    assert process.stdout is not None
    lines = []
    try:
        for line in process.stdout:
            lines.append(line)
            if line.startswith("ready: robot-server-fr"):
                break
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE_S)
    assert lines[0].startswith("warning: mine_ethernet.xml: SEND/DEF_Delay: is missing")
    assert lines[-1].startswith("ready")
