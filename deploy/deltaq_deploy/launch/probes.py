"""Health checks of single services, by the kind of probe in the table of services."""

import socket
import time
from dataclasses import dataclass
from typing import Any, assert_never
from urllib.request import urlopen

from pydantic import BaseModel

from deltaq_cell.description import CellDescription
from deltaq_deploy.launch.services import Probe, Service
from deltaq_protocol import topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.envelope import message_in
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError
from deltaq_protocol.guarded import Health
from deltaq_services.video_stream import newest_picture, video_socket

TIMEOUT_S = 3.0


class _Panel(BaseModel):
    """The part of an emulator's panel status that is used."""

    ok: bool
    state: str
    message: str | None = None


class _Web(BaseModel):
    """The part of a web service's health that is used."""

    healthy: bool
    detail: str


@dataclass(frozen=True)
class ProbeAnswer:
    """A service's report on itself."""

    healthy: bool
    detail: str


def probe(service: Service, cell: CellDescription) -> ProbeAnswer:
    """Ask a service for its health.

    Raises:
        ServiceUnreachableError: if it does not answer within `TIMEOUT_S`.
        DeltaqError: if it has no health check.
        GuardedRealmError: if it answers in a guarded realm that cannot be entered.
        RuntimeFolderError: if the folder of the sockets is not this user's alone.
    """
    if service.probe is None or service.endpoint is None:
        raise DeltaqError(f"{service.name} reports no health")
    try:
        match service.probe:
            case Probe.HEALTH_TOPIC:
                return _ask_health_topic(service.name, cell)
            case Probe.STATUS_QUERY:
                return _ask_hli(cell)
            case Probe.PANEL:
                return _ask_panel(service.endpoint)
            case Probe.WEB:
                return _ask_web(service.endpoint)
            case Probe.VIDEO:
                return _ask_video(service.endpoint, cell)
            case _:
                assert_never(service.probe)
    except (OSError, ValueError) as error:
        raise ServiceUnreachableError(
            f"{service.name} at {service.endpoint} did not answer within {TIMEOUT_S:g} s; is the cell up (`deltaq up`)?"
        ) from error


def _ask_health_topic(name: str, cell: CellDescription) -> ProbeAnswer:
    import zenoh

    from deltaq_services.guarded_realm import open_watching_session

    key = topics.HEALTH.key(cell.cell, service=name)
    channel: Any = zenoh.handlers.FifoChannel(4)
    with (
        open_watching_session(cell, name) as session,
        session.declare_subscriber(key, channel) as subscriber,
    ):
        deadline = time.monotonic() + TIMEOUT_S
        while (sample := subscriber.try_recv()) is None:
            if time.monotonic() > deadline:
                raise TimeoutError
            time.sleep(0.01)
        health = unpack(Health, message_in(sample.payload.to_bytes()))
        return ProbeAnswer(health.healthy, health.detail)


def _ask_hli(cell: CellDescription) -> ProbeAnswer:
    from deltaq_deploy.launch.cell_connection import connect

    with connect(cell, "deltaq status --service") as running:
        status = running.status()
    if status.gate_age_s is None or status.gate_age_s > topics.HEALTH.age_s(cell.cycle_s):
        return ProbeAnswer(False, "the SIM is silent")
    lagging = f", lagging: {'; '.join(status.lagging)}" if status.lagging else ""
    return ProbeAnswer(True, f"robots: {len(status.robots)}{lagging}")


def _ask_panel(endpoint: str) -> ProbeAnswer:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as panel:
        panel.settimeout(TIMEOUT_S)
        panel.connect(Endpoint.parse(endpoint).address)
        panel.send(b'{"op":"status"}')
        answer = _Panel.model_validate_json(panel.recv(65536))
    return ProbeAnswer(answer.ok, answer.message or answer.state)


def _ask_web(endpoint: str) -> ProbeAnswer:
    with urlopen(f"{endpoint}/health", timeout=TIMEOUT_S) as reply:
        answer = _Web.model_validate_json(reply.read(65536))
    return ProbeAnswer(answer.healthy, answer.detail)


def _ask_video(stream: str, cell: CellDescription) -> ProbeAnswer:
    message = newest_picture(video_socket(cell, stream), TIMEOUT_S)
    return ProbeAnswer(not message.words, message.words or "pictures come")
