"""Endpoints as texts."""

import pytest

from deltaq_protocol.endpoint import Endpoint, InvalidEndpointError


@pytest.mark.parametrize(
    ("text", "is_loopback"),
    [
        ("tcp/127.0.0.1:7447", True),
        ("udp/127.9.9.9:1", True),
        ("tcp+udp/127.0.0.1:7447", True),
        ("tcp/localhost:65535", True),
        ("tcp/[::1]:7447", True),
        ("tcp/192.168.1.4:7447", False),
        ("tcp/0.0.0.0:7447", False),
        ("tcp/[fe80::1]:7447", False),
        ("tcp/localhost.example:7447", False),
    ],
)
def test_an_endpoint_is_read_written_back_and_classified_by_reach(text, is_loopback):
    endpoint = Endpoint.parse(text)
    assert str(endpoint) == text
    assert endpoint.is_loopback is is_loopback


def test_a_socket_gets_host_and_port():
    assert Endpoint.parse("udp/[::1]:7447").address == ("::1", 7447)


@pytest.mark.parametrize(
    ("text", "sockets"),
    [
        ("tcp/a:1", ("tcp",)),
        ("tls/a:1", ("tcp",)),
        ("udp/a:1", ("udp",)),
        ("tcp+udp/a:1", ("tcp", "udp")),
    ],
)
def test_an_endpoint_lists_the_sockets_of_its_listener(text, sockets):
    assert Endpoint.parse(text).sockets == sockets


@pytest.mark.parametrize(
    "text",
    [
        "",
        "udp+tcp/a:1",
        "127.0.0.1:7447",
        "tcp/127.0.0.1",
        "tcp/:1",
        "tcp/a b:1",
        "tcp/a:0",
        "tcp/a:65536",
        "quic/a:1",
    ],
)
def test_an_invalid_endpoint_is_reported_with_the_valid_forms(text):
    with pytest.raises(InvalidEndpointError, match=r"is no endpoint; write tcp/HOST:PORT"):
        Endpoint.parse(text)
