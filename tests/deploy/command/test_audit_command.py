"""`deltaq up --audit`, and `deltaq audit` that shows what was written."""

import json
import os
import signal
import socket
import subprocess
from pathlib import Path

import pytest
from commands import PROGRAM, deltaq

from deltaq_cell.load import load_cell
from deltaq_deploy.command.up import audit_file_of
from deltaq_protocol.audit import AuditEntry, AuditKind, AuditOutcome
from deltaq_services.hli.audit import as_line
from deltaq_testing.private_cell import write_private_cell


def entry(number: int, client: str, robot: str | None = None) -> bytes:
    return as_line(
        AuditEntry(
            time_utc=f"2026-01-01T00:00:0{number}.000+00:00", time_s=float(number), what=AuditKind.RESET,
            outcome=AuditOutcome.REFUSED, robot=robot, client=client, address="10.0.0.9:4711", role="observer",
            text="[bold]reset[/bold]",
        )
    )  # fmt: skip


@pytest.mark.long
def test_audit_without_a_log_says_so(tmp_path: Path) -> None:
    done = deltaq("audit", str(tmp_path / "none.jsonl"))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"deltaq: there is no audit log {tmp_path / 'none.jsonl'}")


@pytest.mark.long
def test_audit_reads_the_newest_rows_across_rotated_files_and_skips_torn_lines(tmp_path: Path) -> None:
    log = tmp_path / "audit.jsonl"
    (tmp_path / "audit.jsonl.2").write_bytes(entry(1, "first") + entry(2, "stranger"))
    (tmp_path / "audit.jsonl.1").write_bytes(b'{"torn\n' + entry(3, "stranger", "fr"))
    log.write_bytes(entry(4, "chief", "fr") + b'{"half')
    done = deltaq("audit", str(log), "--json", "--lines", "3")
    assert [json.loads(line)["time_s"] for line in done.stdout.splitlines()] == [2.0, 3.0, 4.0]
    assert done.stderr.startswith("invalid lines: 2;")
    done = deltaq("audit", str(log), "--json", "--client", "stranger", "--robot", "fr")
    assert [json.loads(line)["time_s"] for line in done.stdout.splitlines()] == [3.0]
    table = deltaq("audit", str(log)).stdout
    assert "10.0.0.9:4711" in table
    assert "[bold]reset[/bold]" in table, "a stranger's text is no markup"


def test_a_cell_starts_without_an_audit_log_if_none_can_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/nowhere")
    file, why = audit_file_of("", "lab")
    assert file is None
    assert "cannot be made" in why
    assert audit_file_of("here.jsonl", "lab") == (Path.cwd() / "here.jsonl", "")


@pytest.mark.service
@pytest.mark.parametrize("arguments", [(), ("--audit", "named.jsonl"), ("--no-audit",)], ids=str)
def test_up_names_the_log_and_audit_shows_the_clients(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    cell_file = write_private_cell(tmp_path)
    cell = load_cell(str(cell_file))
    environment = os.environ | {"XDG_STATE_HOME": str(tmp_path / "state")}
    command = [PROGRAM, "up", "--only", "hli", "--cell", str(cell_file), *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, cwd=tmp_path, env=environment
    ) as running:
        assert running.stdout is not None
        said = ""
        awaited = ["JSON lines at", *(["the audit log is"] if arguments != ("--no-audit",) else [])]
        while not all(text in said for text in awaited):
            said += running.stdout.readline()
        with socket.create_connection((cell.tcp_address, cell.tcp_port)) as line:
            line.sendall(b'{"type":"hello","protocol":1,"client":"visitor"}\n')
            assert b"welcome" in line.recv(65536)
        running.send_signal(signal.SIGINT)
        rest, _ = running.communicate(timeout=300)
    logs = sorted(tmp_path.rglob("*.jsonl"))
    if arguments == ("--no-audit",):
        assert logs == []
        assert "audit" not in said + rest
        return
    named = (
        tmp_path / "named.jsonl" if arguments else tmp_path / "state" / "deltaq" / f"audit-{cell.cell}.jsonl"
    )
    assert logs == [named]
    assert f"the audit log is {named}" in said + rest
    done = deltaq("audit", str(named), "--json")
    entries = [json.loads(line) for line in done.stdout.splitlines()]
    assert [(entry["what"], entry["client"]) for entry in entries][:1] == [("connected", "visitor")]
