"""The Robot Server's socket: the KRC is answered whoever else speaks, and no error of the socket goes further."""

import re
import signal
import socket
import threading
import time
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import pytest
from krc_side import CELL, FR, XML, preparing, telegram

from deltaq_launch.private_cell import free_ports
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_services.robot_server.arrivals import Arrivals
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.crash_brake.record_maker import CrashRecordMaker
from deltaq_services.robot_server.crash_brake.watch import CrashWatch
from deltaq_services.robot_server.krc_file import crash_plan, preparation, sensor_codec
from deltaq_services.robot_server.krc_socket import MOST_READ, MOST_WAITING, KrcSocket
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.prepared_reply import TelegramOutcome
from deltaq_services.robot_server.rsi_driver import RsiDriver


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
        self.arrivals = Arrivals()

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


def test_of_telegrams_that_waited_the_newest_is_taken_and_the_others_are_counted(bench):
    bench.believe()
    for number in range(20):
        bench.krc.send(telegram(1048 + 12 * number))
    assert bench.server.read(0.3).ipoc == 1048 + 12 * 19
    assert bench.counters["telegrams_skipped"] == 19


def test_a_flood_from_others_hides_no_telegram(bench):
    bench.believe()
    bench.krc.send(telegram(1048))
    for _ in range(100):
        bench.other.send(telegram(9_000_000))
    assert bench.server.read(0.048).ipoc == 1048
    assert bench.counters["telegrams_second_krc"] == 100
    assert f"a second KRC at 127.0.0.1:{bench.other.getsockname()[1]}" in bench.server.detail


def test_rubbish_from_the_krcs_own_port_hides_no_telegram_before_it(bench):
    bench.believe()
    bench.krc.send(telegram(1048))
    for rubbish in (b"", b"<Rob", b"x" * 60_000, b"\x00" * 4097):
        bench.krc.send(rubbish)
    assert bench.server.read(0.048).ipoc == 1048
    assert bench.counters["telegrams_garbled"] == 4


def test_of_implausible_telegrams_the_first_is_told_with_joint_value_and_bound(bench, caplog):
    bench.believe()
    for count, off in enumerate((9.0, -9.0)):
        bench.krc.send(telegram(1048 + 12 * count, q=FR.home + off))
        assert bench.server.read(0.048 + 0.012 * count) is None
    assert bench.counters["telegrams_implausible"] == 2
    (told,) = caplog.messages
    assert re.fullmatch(
        r"first implausible telegram: a1 is above its limit and a margin: .*, allowed .*", told
    )


def test_a_flood_that_never_ends_is_left_after_a_bound(bench):
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


def test_it_says_by_how_much_the_ipoc_grows(bench):
    assert bench.server.detail == ""
    assert bench.believe().server.detail == "IPOC grows by 12 a cycle"


def test_an_address_that_nobody_knows_is_told():
    driver = FR.driver.model_copy(update={"krc_address": "no.such.krc.invalid"})
    with pytest.raises(ServiceUnreachableError, match=r"krc_address 'no\.such\.krc\.invalid' is not known"):
        KrcSocket(driver, 0.25, SimpleNamespace(), Counter())


def test_a_port_that_is_taken_is_told(bench):
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


IP_RECVERR = 11
"""ip(7): an unconnected socket is told that nobody was there, too."""

WAITS_S = 10.0
"""More than a datagram on the loopback takes."""


def expected(bench, records=None):
    """A believed KRC with its answer to the telegram that is expected; IPOC 1048."""
    bench.believe()
    server = RobotServer(CELL, "fr", process=1)
    server.take(Measurement(1036, FR.home, FR.home), 0.036)
    prepares = preparation(preparing(), server, bench.rsi, XML, records)
    prepared = prepares.after(bench.server.newest, False, 0.04)
    assert b"<IPOC>1048</IPOC>" in prepared.reply
    bench.server.prepare_to_answer(bench.arrivals)
    bench.krc.settimeout(WAITS_S)
    return prepared


def answer(bench, prepared):
    return bench.server.answer(prepared, 0.0, WAITS_S)


def test_nothing_is_prepared_unless_the_cell_wants_it(bench):
    assert preparation(CELL, RobotServer(CELL, "fr", process=1), bench.rsi, XML) is None


def test_the_expected_telegram_is_answered_with_the_prepared_reply_and_read_after(bench):
    prepared = expected(bench)
    bench.krc.send(telegram(1048))
    assert answer(bench, prepared) is TelegramOutcome.ANSWERED
    assert bench.krc.recv(4096) == prepared.reply
    bench.krc.send(telegram(1060))  # of the next cycle: it waits
    assert bench.server.read(0.048, alone=True).ipoc == 1048
    assert bench.server.read(0.06).ipoc == 1060


def test_values_that_are_no_joints_may_change(bench):
    prepared = expected(bench)
    bench.krc.send(telegram(1048).replace(b'X="0.0000"', b'X="-12.5"').replace(b'C="0.0000"', b'C="180.25"'))
    assert answer(bench, prepared) is TelegramOutcome.ANSWERED
    assert bench.krc.recv(4096) == prepared.reply


@pytest.mark.parametrize(
    "datagram",
    [
        telegram(1060),
        telegram(1048, delay=1),
        telegram(1048, q=FR.home + 0.2),
        telegram(1048, programmed=FR.home + 0.001),
        telegram(1048)[:-1],
        telegram(1048) + b" " * 4096,
        b"",
    ],
)
def test_any_other_datagram_gets_no_prepared_reply_and_is_left_to_be_read(bench, datagram):
    prepared = expected(bench)
    bench.krc.send(datagram)
    assert answer(bench, prepared) is TelegramOutcome.OTHER
    bench.server.read(0.048)
    assert bench.counters["telegrams_garbled"] == (0 if datagram.endswith(b">") else 1)


def test_two_telegrams_at_once_get_no_prepared_reply_and_the_newest_is_read(bench):
    prepared = expected(bench)
    for ipoc in (1048, 1060):
        bench.krc.send(telegram(ipoc))
    assert answer(bench, prepared) is TelegramOutcome.OTHER
    assert bench.server.read(0.048).ipoc == 1060
    assert bench.counters["telegrams_skipped"] == 1


def test_a_strangers_copy_of_the_expected_telegram_is_not_answered(bench):
    prepared = expected(bench)
    bench.other.send(telegram(1048))
    assert answer(bench, prepared) is TelegramOutcome.OTHER
    assert bench.server.read(0.048) is None
    assert bench.counters["telegrams_second_krc"] == 1


def test_what_the_gate_said_since_makes_a_prepared_reply_void(bench):
    prepared = expected(bench)
    bench.arrivals.one()
    bench.krc.send(telegram(1048))
    assert answer(bench, prepared) is TelegramOutcome.OTHER
    assert bench.server.read(0.048).ipoc == 1048


def test_what_the_gate_says_while_the_telegram_is_waited_for_ends_the_wait_with_nothing_read(bench):
    prepared = expected(bench)
    told = threading.Timer(0.05, bench.arrivals.one)
    told.start()
    assert answer(bench, prepared) is TelegramOutcome.NEWS
    told.join()
    bench.krc.send(telegram(1048))
    assert bench.server.read(0.048).ipoc == 1048


def test_what_was_read_before_the_reply_was_prepared_makes_it_not_void(bench):
    bench.arrivals.one()
    bench.arrivals.hear()
    prepared = expected(bench)
    bench.krc.send(telegram(1048))
    assert answer(bench, prepared) is TelegramOutcome.ANSWERED


def test_a_reply_that_was_prepared_before_another_was_sent_is_refused_by_the_last_check(bench):
    prepared = expected(bench)
    assert bench.rsi.bounds is not None
    bench.rsi.reply(FR.home, {})
    assert bench.rsi.bounds is None
    bench.krc.send(telegram(1048))
    assert answer(bench, prepared) is TelegramOutcome.OTHER
    assert bench.server.read(0.048).ipoc == 1048


@pytest.fixture
def recording(bench):
    """The same with a process that watches it, a reply that is ready, and what is left in memory."""
    plan = crash_plan(CELL, "fr", XML)
    with CrashWatch(plan, bench.server.socket, "fr") as watch:
        bench.server.watch = watch
        prepared = expected(bench, CrashRecordMaker(plan, bench.rsi, tuple(FR.driver.outputs)))
        yield bench, prepared, watch._memory
        bench.server.watch = None


def test_machine_code_leaves_the_record_that_python_would_leave(recording):
    bench, prepared, memory = recording
    peer = bench.krc.getsockname()
    bench.krc.send(telegram(1048))
    assert answer(bench, prepared) is TelegramOutcome.ANSWERED
    by_machine = memory.newest()
    assert (by_machine.record.ipoc, by_machine.record.correction) == (1048, prepared.correction)
    assert (by_machine.peer, by_machine.time_s, by_machine.was_sent) == (peer, bench.server.came_s, True)
    bench.server.watch.write(prepared.record, peer, bench.server.came_s + 1.0)
    assert memory.newest() == by_machine._replace(time_s=bench.server.came_s + 1.0, was_sent=False)
    bench.server.watch.sent()
    bench.server.read(bench.server.came_s)
    bench.krc.send(telegram(1048))
    assert answer(bench, prepared) is TelegramOutcome.ANSWERED
    assert memory.newest() == by_machine._replace(time_s=bench.server.came_s)


def test_nothing_is_prepared_of_which_no_record_can_be_left(bench):
    records = CrashRecordMaker(crash_plan(CELL, "fr", XML), bench.rsi, tuple(FR.driver.outputs))
    assert expected(bench, records).record is not None
    server = RobotServer(CELL, "fr", process=1)
    server.take(Measurement(1036, FR.home, FR.home), 0.036)
    records.body = lambda _: None  # as of a number that does not fit into it
    prepares = preparation(preparing(), server, bench.rsi, XML, records)
    assert prepares.after(bench.server.newest, False, 0.04) is None


def test_a_telegram_that_is_not_answered_leaves_no_record_nor_does_a_rehearsal(recording):
    bench, prepared, memory = recording
    assert bench.server.answer(prepared, 0.0, 0.001) is TelegramOutcome.NOTHING
    assert memory.newest() is None
    for sender, datagram in ((bench.other, telegram(1048)), (bench.krc, telegram(1060))):
        sender.send(datagram)
        assert answer(bench, prepared) is TelegramOutcome.OTHER
        assert memory.newest() is None


def test_a_prepared_reply_that_the_network_does_not_take_is_counted_as_any_other(recording):
    bench, prepared, memory = recording
    bench.krc.send(telegram(1048))
    assert answer(bench, replace(prepared, reply=b"x" * 70_000)) is TelegramOutcome.UNSENT
    assert bench.counters["replies_unsent"] == 1
    assert memory.newest().was_sent


def test_the_time_of_a_telegram_is_that_of_the_monotonic_clock(bench):
    prepared = expected(bench)
    bench.krc.send(telegram(1048))
    before_s = time.monotonic()
    assert answer(bench, prepared) is TelegramOutcome.ANSWERED
    assert before_s <= bench.server.came_s <= time.monotonic()


def test_no_telegram_is_waited_for_longer_than_asked(bench):
    prepared = expected(bench)
    assert bench.server.answer(prepared, 0.0, 0.0) is TelegramOutcome.NOTHING
    assert bench.server.read(0.048) is None


def test_an_error_of_an_earlier_reply_is_counted_and_ends_the_wait(bench):
    prepared = expected(bench)
    bench.server.socket.setsockopt(socket.IPPROTO_IP, IP_RECVERR, 1)
    bench.krc.close()
    bench.server.send(b"nobody is there")
    assert answer(bench, prepared) is TelegramOutcome.ERROR
    assert bench.counters["socket_errors"] == 1
    assert bench.server.read(0.048) is None


def test_a_signal_ends_the_wait_and_its_handler_has_run(bench):
    prepared = expected(bench)
    told = []
    before = signal.signal(signal.SIGALRM, lambda *_: told.append(1))
    try:
        signal.setitimer(signal.ITIMER_REAL, 1e-3)
        while not told:
            assert answer(bench, prepared) is TelegramOutcome.NOTHING
    finally:
        signal.signal(signal.SIGALRM, before)
    assert bench.counters["socket_errors"] == 0


def test_what_is_waited_for_is_rehearsed_without_a_trace(bench):
    prepared = expected(bench)
    assert bench.server.answer(prepared, 0.0, 0.001) is TelegramOutcome.NOTHING
    bench.krc.send(telegram(1048))
    assert answer(bench, prepared) is TelegramOutcome.ANSWERED
    assert bench.krc.recv(4096) == prepared.reply
    bench.krc.setblocking(False)
    with pytest.raises(BlockingIOError):
        bench.krc.recv(4096)


@pytest.mark.parametrize("due_in_s", [-1.0, 0.0, 0.02, 2.0 * WAITS_S])
def test_a_telegram_is_answered_before_and_after_it_is_due(bench, due_in_s):
    prepared = expected(bench)
    sent = threading.Timer(0.05, lambda: bench.krc.send(telegram(1048)))
    sent.start()
    assert bench.server.answer(prepared, due_in_s, WAITS_S) is TelegramOutcome.ANSWERED
    sent.join()
    assert bench.krc.recv(4096) == prepared.reply


def test_a_port_that_is_let_go_of_in_time_is_waited_for_and_one_line_says_so(bench, caplog):
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
