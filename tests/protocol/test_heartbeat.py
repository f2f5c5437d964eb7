"""Signs of life as a container's health check and systemd read them: the script and the socket are the real ones."""

import os
import resource
import socket
from pathlib import Path

import pytest
from installed import ROOT
from ran import ran

from deltaq_protocol import heartbeat
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.heartbeat import HEALTH_FILE, NOTIFY_SOCKET, Heartbeat

HEALTHY = ROOT / "deploy" / "healthy.sh"


def look(file: Path) -> tuple[int, str]:
    done = ran(["sh", str(HEALTHY), str(file)], check=False)
    return done.returncode, done.stdout.strip()


def test_a_running_service_is_healthy_and_its_text_is_shown(tmp_path: Path) -> None:
    file = tmp_path / "health"
    Heartbeat({HEALTH_FILE: str(file)}).beat(10.0, detail="2 robots; gr is\nheld $(touch /tmp/x) `x` \\ *")
    status, said = look(file)
    assert (status, said) == (0, "healthy: 2 robots; gr is held $(touch /tmp/x) `x` \\ * (0 s ago)")


def test_a_service_that_reports_a_failure_is_unhealthy(tmp_path: Path) -> None:
    file = tmp_path / "health"
    beats = Heartbeat({HEALTH_FILE: str(file)})
    beats.beat(10.0, detail="a long story " * 100)
    beats.beat(11.0, False, "the SIM is silent")
    assert look(file) == (1, "unhealthy: the SIM is silent (0 s ago)")
    assert file.read_bytes().count(b"\n") == 1


@pytest.mark.parametrize(("age_s", "status"), [(4, 0), (7, 1)])
def test_a_hanging_loop_is_unhealthy(
    tmp_path: Path, age_s: int, status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "health"
    clock = heartbeat.time.clock_gettime
    monkeypatch.setattr(heartbeat.time, "clock_gettime", lambda which: clock(which) - age_s)
    Heartbeat({HEALTH_FILE: str(file)}).beat(10.0)
    assert look(file)[0] == status


def test_a_missing_or_empty_heartbeat_file_is_unhealthy(tmp_path: Path) -> None:
    file = tmp_path / "health"
    assert look(file)[0] == 1
    Heartbeat({HEALTH_FILE: str(file)})  # a service that has not served yet
    assert look(file) == (1, f"{file}: no sign of life yet")


def test_a_health_check_costs_little_time(tmp_path: Path) -> None:
    file = tmp_path / "health"
    Heartbeat({HEALTH_FILE: str(file)}).beat(10.0)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    for _ in range(20):
        assert look(file)[0] == 0
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    each_s = (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime) / 20
    print(f"{each_s * 1e3:.2f} ms of a core each")
    assert each_s < 0.05, "an interpreter with its imports takes 0.8 s"


def test_the_heartbeat_comes_once_a_second_and_only_with_a_listener(tmp_path: Path) -> None:
    file = tmp_path / "health"
    beats = Heartbeat({HEALTH_FILE: str(file)})
    beats.beat(10.0, detail="first")
    beats.beat(10.9, detail="second")
    assert look(file)[1].startswith("healthy: first")
    beats.beat(11.0, detail="third")
    assert look(file)[1].startswith("healthy: third")
    assert not Heartbeat({}).is_due(1e12)


def test_an_unwritable_heartbeat_file_is_reported_and_a_link_is_not_followed(tmp_path: Path) -> None:
    link = tmp_path / "health"
    link.symlink_to(tmp_path / "victim")
    for file in (link, tmp_path / "none" / "health"):
        with pytest.raises(DeltaqError, match="cannot be written"):
            Heartbeat({HEALTH_FILE: str(file)})
    assert not (tmp_path / "victim").exists()


@pytest.mark.parametrize("kind", ["file", "abstract"])
def test_systemd_is_notified_of_readiness_and_then_of_each_heartbeat(tmp_path: Path, kind: str) -> None:
    name = str(tmp_path / "notify") if kind == "file" else f"@deltaq-{os.getpid()}-notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind("\0" + name[1:] if kind == "abstract" else name)
        systemd.settimeout(300)
        beats = Heartbeat({NOTIFY_SOCKET: name})
        beats.beat(10.0, detail="2 robots")
        beats.beat(11.0, False, "the SIM is\nREADY=0 silent")
        beats.close()
        beats.beat(12.0)
        assert systemd.recv(1000) == b"READY=1\nWATCHDOG=1\nSTATUS=2 robots\n"
        assert systemd.recv(1000) == b"WATCHDOG=1\nSTATUS=the SIM is READY=0 silent\n"


def test_a_lost_or_blocked_supervisor_does_not_block_the_service(tmp_path: Path) -> None:
    name = str(tmp_path / "notify")
    Heartbeat({NOTIFY_SOCKET: name}).beat(10.0)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(name)
        beats = Heartbeat({NOTIFY_SOCKET: name})
        for second in range(5000):
            beats.beat(float(second))
    beats.beat(1e6)
    beats.close()
