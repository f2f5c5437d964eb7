"""Who did what, as a real HLI writes it: strangers first."""

import asyncio
import contextlib
import os
import stat
from collections import Counter
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from audited import CONTROLLER, OPERATOR, Audited, audited
from certificate import certificate
from json_client import JsonClient, json_client
from open_stranger import OpenStranger
from small_cell import small_cell

from deltaq_protocol import connect, topics
from deltaq_protocol.audit import LONGEST_TEXT, AuditEntry, AuditKind, AuditOutcome
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.messages import Increment, LeaseAction, LeaseRequest
from deltaq_protocol.proof import Prover
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.audit import (
    LONGEST_QUIET_S,
    MANY,
    MOST_BYTES,
    MOST_FILES,
    MOST_GROUPS,
    NEW_GROUPS_S,
    Audit,
    AuditFile,
    AuditFileError,
    CountedDeed,
    DeedGroups,
    default_audit_file,
    older,
)
from deltaq_services.hli.commands import Deed
from deltaq_services.hli.line_encryption import line_encryption
from deltaq_services.outputs import ClientOrigin

WRONG = "a wrong token, 9876543210"


@pytest.fixture
async def running(tmp_path: Path) -> AsyncIterator[Audited]:
    async with audited(tmp_path / "audit.jsonl") as now:
        yield now


def address_of(client: JsonClient) -> str:
    host, port = client.writer.get_extra_info("sockname")
    return f"{host}:{port}"


# --- strangers ------------------------------------------------------------------------------------------


async def test_refused_attempts_over_a_line_are_logged_with_address_and_proved_role(
    running: Audited,
) -> None:
    async with json_client(running.port, "mallory") as client:
        where = {"client": "mallory", "address": address_of(client), "role": "observer"}
        for action in ("acquire", "take"):
            reply = await client.ask("lease", type="lease", robot="fr", action=action)
            assert reply["code"] == "not_permitted"
        error = await client.ask("done", type="reset", robot="fr")
        assert error["code"] == "not_permitted"
        await client.ask("done", type="contact", contact="gripper_on_valves", allowed=True)
        await client.ask("io", type="io", robot="gr", outputs={"gripper": True})
        client.send(type="increment", robot="fr", seq=1, cycle=running.peer.cycle, dq=[0.0] * 6)
        await client.receive("verdict")
        await client.ask("error", type="reset", robot="fr", nonsense=1)

        no_lease = await running.entry("lease_refused", "refused", robot="fr", code="not_permitted", **where)
        assert no_lease["text"].startswith("acquire: ")
        reset = await running.entry("reset", "refused", robot="fr", code="not_permitted", **where)
        assert reset["text"] == error["message"]
        await running.entry("contact", "refused", robot=None, code="not_permitted", **where)
        await running.entry("outputs", "refused", robot="gr", code="lease_not_held", **where)
        await running.entry("increment", "refused", robot="fr", code="lease_not_held", **where)
        malformed = await running.entry("message", "refused", code="malformed", **where)
        assert malformed["text"] == "nonsense: Extra inputs are not permitted"
        assert len(await running.counted("lease_refused", 2)) == 2
    await running.entry("disconnected", "done", **where)


async def test_wrong_tokens_other_versions_and_no_hello_are_named(running: Audited) -> None:
    async with json_client(running.port, None) as client:
        await client.ask("welcome", type="hello", protocol=1, client="guesser", token=WRONG)
        refused = {"code": "not_permitted", "client": "guesser", "role": "observer"}
        await running.entry("connected", "refused", address=address_of(client), **refused)
    async with json_client(running.port, None) as client:
        await client.ask("welcome", type="hello", protocol=99, client="from the future")
        other = await running.entry("connected", "refused", code="protocol_version")
        assert (other["address"], "99" in other["text"]) == (address_of(client), True)
    async with json_client(running.port, None) as client:
        await client.ask("done", type="reset", robot="fr")
        early = await running.entry("message", "refused", code="not_permitted", client="")
        assert (early["address"], early["text"]) == (address_of(client), "reset before the hello")


async def test_refused_attempts_over_zenoh_are_logged_and_counted(running: Audited) -> None:
    stranger = await asyncio.to_thread(OpenStranger, running.peer.cell.hli, "small")
    asked = LeaseRequest(robot="fr", action=LeaseAction.RELEASE, client="mallory", lease="guessed")
    proof = Prover("a guess").prove(topics.LEASE.key("small", robot="fr"), b"another message", b"n" * 8)
    await asyncio.to_thread(stranger.ask, topics.LEASE, asked, proof, "fr")
    await running.entry("lease_refused", "refused", client="mallory", address="zenoh", role="observer")
    increment = Increment(robot="fr", seq=1, cycle=1, dq=(0.0,) * 6, lease="guessed")
    for _ in range(30):
        await asyncio.to_thread(stranger.say, topics.INCREMENT, increment, proof, robot="fr")
    lines = await running.counted("increment", 30)
    assert sum(entry["count"] for entry in lines) == 30
    assert {(entry["address"], entry["code"]) for entry in lines} == {("zenoh", "lease_not_held")}
    await asyncio.to_thread(stranger.close)


async def test_a_client_name_cannot_break_a_line_or_a_terminal(running: Audited) -> None:
    name = 'x"}\n{"what":"stop","client":"root"}\x1b[2J\u202e\x7f'
    async with json_client(running.port, name) as client:
        await client.ask("done", type="reset", robot="fr")
        entry = await running.entry("reset", "refused")
    assert entry["client"] == r'x"}\n{"what":"stop","client":"root"}\x1b[2J\u202e\x7f'
    assert running.file.read_bytes().isascii()
    assert not set(running.file.read_bytes()) & ({*range(32), 127} - {10})


async def test_a_client_in_the_clear_at_an_encrypted_line_is_named(tmp_path: Path) -> None:
    encryption = line_encryption(small_cell(), certificate(tmp_path))
    async with audited(tmp_path / "audit.jsonl", encryption) as running:
        reader, writer = await asyncio.open_connection("127.0.0.1", running.port)
        client = JsonClient(reader, writer)
        client.send(type="describe")
        await client.ended()
        refused = await running.entry("connected", "refused", code="malformed", address=address_of(client))
        assert refused["text"].startswith("no encryption was agreed on: ")
        assert running.hli.status().hli["tcp_unencrypted"] == 1
        writer.close()


async def test_a_stop_in_the_clear_at_an_encrypted_line_is_named_with_its_address(tmp_path: Path) -> None:
    encryption = line_encryption(small_cell(), certificate(tmp_path))
    async with audited(tmp_path / "audit.jsonl", encryption) as running:
        reader, writer = await asyncio.open_connection("127.0.0.1", running.port)
        client = JsonClient(reader, writer)
        await client.ask("done", type="stop")
        await running.entry("stop", "done", address=address_of(client))
        assert "tcp_unencrypted" not in running.hli.status().hli
        writer.close()


# --- what is done -----------------------------------------------------------------------------------------


async def test_actions_are_logged_with_their_results(running: Audited) -> None:
    async with (
        json_client(running.port, "driver", token=CONTROLLER) as driver,
        json_client(running.port, "chief", token=OPERATOR) as chief,
    ):
        drives = {"client": "driver", "address": address_of(driver), "role": "controller"}
        leads = {"client": "chief", "address": address_of(chief), "role": "operator"}
        await running.entry("connected", "done", **drives)
        assert (await driver.ask("lease", type="lease", robot="gr", action="acquire"))["granted"]
        await running.entry("lease_granted", "done", robot="gr", **drives)
        await driver.ask("io", type="io", robot="gr", outputs={"gripper": True})
        await running.entry("outputs", "done", robot="gr", text="gripper on", **drives)
        assert (await chief.ask("lease", type="lease", robot="gr", action="take"))["granted"]
        taken = await running.entry("lease_taken_over", "done", robot="gr", **leads)
        assert taken["text"] == f"from driver, {drives['address']}"
        await chief.ask("lease", type="lease", robot="gr", action="release")
        await running.entry("lease_released", "done", robot="gr", **leads)
        await driver.ask("done", type="stop")
        await running.entry("stop", "asked", **drives)
        await running.entry("stop", "done", text="every robot: operator_stop", **drives)
        running.peer.refuses = ReasonCode.CAUSE_STANDS
        error = await chief.ask("done", type="reset", robot="fr")
        await running.entry("reset", "refused", code="cause_stands", text=error["message"], **leads)
        running.peer.obeys = False
        error = await chief.ask("done", type="contact", contact="gripper_on_valves", allowed=True)
        await running.entry("contact", "asked", text="gripper_on_valves allowed", **leads)
        await running.entry("contact", "unconfirmed", code="unreachable", text=error["message"], **leads)
        assert (await driver.ask("lease", type="lease", robot="fr", action="acquire"))["granted"]
    await running.entry("lease_lost", "done", robot="fr", text="the connection ended", **drives)
    times = [entry["time_s"] for entry in running.entries()]
    assert times == sorted(times)


async def test_actions_over_zenoh_are_logged_and_an_expired_lease_is_that_of_its_holder(
    running: Audited,
) -> None:
    where = {"address": "zenoh"}
    async with connect(running.peer.cell.hli, client="script", token=OPERATOR) as cell:
        async with cell.lease("gr") as robot:
            await robot.io({"gripper": True})
        with contextlib.suppress(RefusedError):
            await cell.reset("fr")
        await cell.stop()
    operator = {"client": "script", "role": "operator"} | where
    await running.entry("lease_granted", "done", robot="gr", **operator)
    await running.entry("outputs", "done", robot="gr", **operator)
    await running.entry("lease_released", "done", robot="gr", **operator)
    await running.entry("reset", "done", robot="fr", **operator)
    # anybody may stop: nothing is proved
    await running.entry("stop", "done", client="script", role="observer", **where)
    async with json_client(running.port, "silent", token=CONTROLLER) as client:
        await client.ask("lease", type="lease", robot="fr", action="acquire")
        expired = await running.entry("lease_expired", "done", robot="fr", client="silent")
        assert (expired["address"], expired["role"]) == (address_of(client), "controller")


async def test_no_secret_is_in_the_file(running: Audited) -> None:
    async with connect(running.peer.cell.hli, client="script", token=OPERATOR) as cell, cell.lease("fr"):
        lease = running.hli.core.leases.of("fr")
        assert lease is not None
        secrets = (OPERATOR, CONTROLLER, WRONG, lease.token)
        # a token in the wrong place, and fields of a message that is refused as a whole
        for fields in (
            {"client": f"my token is {OPERATOR}"[:64], "token": OPERATOR},
            {"client": "x", "token": WRONG},
            {"token": CONTROLLER},
            {"client": "y", "token": {"is": WRONG}},
            {"client": lease.token},
        ):
            async with json_client(running.port, None) as client:
                await client.ask("welcome", type="hello", protocol=1, **fields)
        async with json_client(running.port, "z") as client:
            client.send(type=WRONG)
            client.send(type="stop", token=OPERATOR)
            client.send(type="lease", robot="fr", action="take", token=WRONG, lease=[lease.token])
            await client.receive("done")
    await running.entry("lease_released", "done", robot="fr")
    text = running.file.read_text()
    assert "(a secret)" in text
    assert [secret for secret in secrets if secret in text] == []


async def test_recorders_get_every_entry_sealed_through_the_gates_process(running: Audited) -> None:
    async with json_client(running.port, "driver", token=CONTROLLER) as client:
        await client.ask("lease", type="lease", robot="fr", action="acquire")
        async with asyncio.timeout(300):
            while (entry := await running.peer.entries.get()).what is not AuditKind.LEASE_GRANTED:
                pass
    assert (entry.client, entry.role) == ("driver", "controller")


# --- a disk that fails ------------------------------------------------------------------------------------


async def test_a_full_disk_stops_nothing_is_counted_and_shown_in_the_health() -> None:
    async with audited(Path("/dev/full")) as running:
        async with json_client(running.port, "driver", token=CONTROLLER) as client:
            assert (await client.ask("lease", type="lease", robot="fr", action="acquire"))["granted"]
            cycle = await running.peer.turn()
            client.send(type="increment", robot="fr", seq=1, cycle=cycle, dq=[0.0] * 6)
            assert (await client.receive("verdict"))["outcome"] == "admitted"
        async with asyncio.timeout(300):
            while running.hli.status().hli.get("audit_lines_lost", 0) < 2:
                await asyncio.sleep(0.01)
            while "audit log: No space left on device" not in (await running.peer.health.get()).detail:
                pass


# --- what needs no server ---------------------------------------------------------------------------------


def test_texts_of_clients_are_shortened_and_every_entry_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "audit.jsonl"
    published: list[AuditEntry] = []
    audit = Audit(file, published.append, lambda: ("s3cret",), lambda: 5.0)
    origin = ClientOrigin("\n" * 10_000, "\ud800" * 10_000, "observer")
    for text in ("ü\r\n" * 10_000, "s3cret" * 10_000, "\x00"):
        audit.tell(Deed(AuditKind.MESSAGE, AuditOutcome.REFUSED, origin, text, text=text))
    audit.close()
    lines = file.read_bytes().splitlines()
    assert [AuditEntry.model_validate_json(line) for line in lines] == published
    assert len(published) == 3
    assert all(len(entry.text) <= LONGEST_TEXT and entry.text.isprintable() for entry in published)
    assert max(map(len, lines)) < 4096
    assert b"s3cret" not in file.read_bytes()


def test_recorders_get_a_bounded_rate_and_the_file_has_every_entry(tmp_path: Path) -> None:
    published: list[AuditEntry] = []
    audit = Audit(tmp_path / "audit.jsonl", published.append, tuple, lambda: 5.0)
    for kind in AuditKind:
        for number in range(10):
            audit.tell(Deed(kind, AuditOutcome.DONE, ClientOrigin(str(number))))
    audit.close()
    assert (len(published), audit.unpublished, audit.lines) == (
        20,
        10 * len(AuditKind) - 20,
        10 * len(AuditKind),
    )
    assert len((tmp_path / "audit.jsonl").read_bytes().splitlines()) == 10 * len(AuditKind)


# The file of the audit log: a disk that fails first.


def line(number: int) -> bytes:
    return b'{"number":%04d}\n' % number


def written(path: Path, numbers: range, **bounds: int) -> AuditFile:
    """A closed file to which these lines were written."""
    file = AuditFile(path, **bounds)
    for number in numbers:
        file.write(line(number))
    file.close()
    return file


def test_a_full_disk_loses_and_counts_lines_with_a_reason() -> None:
    file = written(Path("/dev/full"), range(50))
    assert file.lost == 50
    assert file.fault == os.strerror(28)


def test_a_pipe_without_a_reader_delays_no_caller(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    file = AuditFile(pipe)
    for _ in range(3000):
        file.write(b"x" * 99 + b"\n")
    file.close()  # a pipe holds 64 KiB
    assert 3000 - 64 * 1024 // 100 - 1 <= file.lost < 3000


def test_a_missing_folder_loses_lines_until_it_returns_and_is_logged_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "state"
    folder.mkdir()
    path = folder / "audit.jsonl"
    file = AuditFile(path)
    path.unlink()
    folder.rmdir()
    file.write(line(1))
    file.write(line(2))
    while file.lost < 2:
        pass
    assert "No such file" in file.fault
    folder.mkdir()
    file.write(line(3))
    file.close()
    assert (path.read_bytes(), file.lost, file.fault) == (line(3), 2, "")
    assert caplog.messages == [
        f"the audit log {path} loses lines: No such file or directory",
        f"the audit log {path} is written again; it lost 2 lines",
    ]


@pytest.mark.parametrize("torn", [b'{"numb', b'{"number":0001}', b'{"number":0001}\n{"nu'])
def test_a_torn_line_is_ended_and_earlier_lines_stay_unchanged(tmp_path: Path, torn: bytes) -> None:
    path = tmp_path / "audit.jsonl"
    path.touch(0o600)
    path.write_bytes(torn)
    written(path, range(2, 4))
    assert path.read_bytes() == torn + b"\n" + line(2) + line(3)


def test_rotation_keeps_a_bounded_number_of_the_newest_files(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    written(path, range(100), most_bytes=160, most_files=3)
    files = [path, *older(path, 3)]
    assert sorted(tmp_path.iterdir()) == sorted(files)
    assert all(0 < file.stat().st_size <= 160 for file in files)
    kept = b"".join(file.read_bytes() for file in reversed(files))
    assert kept == b"".join(line(number) for number in range(70, 100))


def test_one_file_alone_is_bounded_too(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    written(path, range(25), most_bytes=160, most_files=1)
    assert path.read_bytes() == b"".join(line(number) for number in range(20, 25))
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_was_moved_away_is_created_again(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    written(path, range(1))
    file = AuditFile(path)
    path.rename(tmp_path / "moved")
    file.write(line(1))
    file.close()
    assert (path.read_bytes(), (tmp_path / "moved").read_bytes()) == (line(1), line(0))


def test_the_log_is_private_to_its_owner_with_any_umask(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    before = os.umask(0)
    try:
        written(path, range(30), most_bytes=160, most_files=2)
    finally:
        os.umask(before)
    assert {stat.S_IMODE(file.stat().st_mode) for file in tmp_path.iterdir()} == {0o600}


def test_a_log_readable_by_others_or_unopenable_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    path.touch()
    path.chmod(0o644)
    with pytest.raises(AuditFileError, match=r"audit\.jsonl has mode 0644 .* `chmod 600 "):
        AuditFile(path)
    with pytest.raises(AuditFileError, match=r"nowhere/x cannot be written: No such file"):
        AuditFile(tmp_path / "nowhere" / "x")


def test_by_default_the_log_is_in_the_state_folder_of_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert default_audit_file("lab") == tmp_path / "state" / "deltaq" / "audit-lab.jsonl"
    assert stat.S_IMODE((tmp_path / "state" / "deltaq").stat().st_mode) == 0o700
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/nowhere")
    with pytest.raises(AuditFileError, match="/proc/nowhere/deltaq cannot be made"):
        default_audit_file("lab")


# Equal deeds are counted, so that a flood of refused attempts fills no disk.


def refused(client: str = "stranger", address: str = "10.0.0.9:4711", role: str = "observer") -> Deed:
    origin = ClientOrigin(client, address, role)
    return Deed(
        AuditKind.LEASE_REFUSED, AuditOutcome.REFUSED, origin, "fr", ReasonCode.NOT_PERMITTED, "acquire"
    )


def flooded(groups: DeedGroups, deeds: list[Deed], each_s: float) -> list[CountedDeed]:
    """What is told of deeds that come one by one, the rest included."""
    told: list[CountedDeed] = []
    for number, deed in enumerate(deeds):
        now_s = number * each_s
        told += groups.add(deed, now_s) + groups.due(now_s)
    return told + groups.rest()


def test_a_flood_of_equal_attempts_gives_few_lines_with_complete_counts() -> None:
    told = flooded(DeedGroups(), [refused()] * 100_000, each_s=0.001)
    assert sum(counted.count for counted in told) == 100_000
    assert len(told) <= 10  # 100 s: at 0, 1, 3, 7, 15, 31, 61, 91, and the rest


def test_reconnecting_attempts_are_one_group_with_the_newest_port() -> None:
    deeds = [refused(address=f"[fe80::1]:{port}") for port in range(10_000, 20_000)]
    told = flooded(DeedGroups(), deeds, each_s=0.00005)
    assert [counted.count for counted in told] == [1, 9_999]
    assert told[-1].deed.origin.address == "[fe80::1]:19999"


@pytest.mark.long
def test_a_flood_of_invented_names_is_bounded_and_counted_without_loss_of_other_lines() -> None:
    groups = DeedGroups()
    strangers = [refused(client=f"stranger-{number}") for number in range(100_000)]
    told = flooded(groups, strangers, each_s=0.001)
    assert sum(counted.count for counted in told) == 100_000
    assert len(told) < 2 * MOST_GROUPS + 2 * 100 * NEW_GROUPS_S + 10
    assert {counted.deed.origin.client for counted in told} >= {"stranger-0", MANY}
    (operator,) = groups.add(refused("the operator", role="operator"), 100.0)
    assert operator.deed.origin.client == "the operator"
    stop = Deed(AuditKind.STOP, AuditOutcome.ASKED, ClientOrigin("stranger-0", "10.0.0.9:4711", "observer"))
    assert groups.add(stop, 100.0) == [CountedDeed(stop, 100.0, 1)]


@pytest.mark.by_day(2)
@pytest.mark.long
@pytest.mark.parametrize("names", [1, MOST_GROUPS, 10 * MOST_GROUPS, 10_000])
def test_the_worst_flood_displaces_no_entry_within_hours(names: int) -> None:
    hours, each_s = 1.0, 0.02
    groups, lines = DeedGroups(), 0
    for number in range(int(hours * 3600 / each_s)):
        now_s = number * each_s
        told = groups.add(refused(f"stranger-{number % names}"), now_s) + groups.due(now_s)
        lines += len(told)
    line_bytes, kinds = 400, 15
    assert lines / hours * line_bytes * kinds < MOST_BYTES * MOST_FILES / 8.0  # a shift of eight hours


def test_output_changes_are_counted_by_their_setting() -> None:
    groups, told = DeedGroups(), list[CountedDeed]()
    origin = ClientOrigin("driver", "10.0.0.7:1", "controller")
    for number in range(1000):
        text = "gripper on" if number % 2 else "gripper off"
        deed = Deed(AuditKind.OUTPUTS, AuditOutcome.DONE, origin, "gr", text=text)
        told += groups.add(deed, number * 0.1) + groups.due(number * 0.1)
    counts: Counter[str] = Counter()
    for counted in told + groups.rest():
        counts[counted.deed.text] += counted.count
    assert counts == {"gripper on": 500, "gripper off": 500}


def test_different_actions_are_reported_separately_and_at_once() -> None:
    groups, deeds = DeedGroups(), [refused(), refused("another"), refused(address="10.0.0.8:1")]
    assert [groups.add(deed, 0.0)[0].deed for deed in deeds] == deeds


def test_a_repeated_line_is_sent_at_once_and_again_with_its_count() -> None:
    groups = DeedGroups()
    assert groups.add(refused(), 0.0)
    assert groups.due(1.5) == []
    assert groups.add(refused(), 2.0) == [CountedDeed(refused(), 2.0, 1)]


def test_an_entry_of_many_has_the_time_of_the_newest() -> None:
    groups = DeedGroups()
    groups.add(refused(), 0.0)
    groups.add(refused(), 0.4, count=7)
    assert groups.due(0.9) == []
    assert groups.due(1.2) == [CountedDeed(refused(), 0.4, 7)]


def test_no_memory_is_kept_of_closed_connections() -> None:
    groups = DeedGroups()
    flooded(groups, [refused(client=str(number)) for number in range(1000)], each_s=0.001)
    assert groups.due(2 * LONGEST_QUIET_S) == []
    counts: Counter[str] = Counter(counted.deed.origin.client for counted in groups.rest())
    assert not counts
