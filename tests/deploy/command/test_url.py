"""Verbs that look at a running cell or command it, told its address and nothing else."""

import json
from collections.abc import Iterator

import pytest
from commands import deltaq
from served import Server
from small_cell import endpoint

VERBS = {
    "status": ("status",),
    "watch": ("status", "--watch", "--count", "1"),
    "hz": ("topic", "hz", "--duration-s", "2"),
    "echo": ("topic", "echo", "state", "--robot", "fr", "--count", "2"),
    "lease": ("lease", "--robot", "fr"),
    "stop": ("stop",),
    "reset": ("reset", "--robot", "fr"),
    "reset all": ("reset",),
}


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """A cell whose file no user has."""
    with Server() as running:
        yield running


@pytest.mark.by_day(1)
@pytest.mark.parametrize("verb", VERBS.values(), ids=VERBS.keys())
def test_without_a_listener_one_line_names_the_command_to_start(verb: tuple[str, ...]) -> None:
    nowhere = endpoint()
    done = deltaq(*verb, "--url", nowhere)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (3, "", 1)
    assert done.stderr.startswith(f"deltaq: no server answers at {nowhere}; is the cell up (`deltaq up`)")
    assert ".rs:" not in done.stderr


@pytest.mark.parametrize("verb", VERBS.values(), ids=VERBS.keys())
def test_an_invalid_address_is_wrong_usage(verb: tuple[str, ...]) -> None:
    done = deltaq(*verb, "--url", "127.0.0.1")
    assert done.returncode == 2
    assert "'127.0.0.1' is no endpoint; write tcp/HOST:PORT" in done.stderr


@pytest.mark.long
def test_an_unknown_robot_is_answered_with_the_known_ones(server: Server) -> None:
    for verb in (("topic", "echo", "state"), ("lease",), ("reset",)):
        done = deltaq(*verb, "--robot", "rf", "--url", server.description.hli)
        assert done.returncode == 2, verb
        assert "no robot 'rf' in cell small; it has fr, gr" in done.stderr


@pytest.mark.service
@pytest.mark.parametrize("verb", VERBS.values(), ids=VERBS.keys())
def test_commands_need_only_the_address(server: Server, verb: tuple[str, ...]) -> None:
    json_too = () if "echo" in verb else ("--json",)
    done = deltaq(*verb, *json_too, "--url", server.description.hli)
    assert done.returncode == 0, done.stderr
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(told) == (2 if "echo" in verb else 1)
    if "status" in verb or "hz" in verb:
        assert told[0]["cell"] == "small"
    if "hz" in verb:
        assert told[0]["topics"]["deltaq/small/fr/state"]["count"] > 10


@pytest.mark.service
def test_status_over_an_address_shows_the_units_of_the_remote_cell(server: Server) -> None:
    assert "5.7°" in deltaq("status", "--url", server.description.hli).stdout  # 0.1 rad
