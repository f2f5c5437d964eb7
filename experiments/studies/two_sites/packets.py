"""A link between two network namespaces that loses and delays packets, as a wide-area network does: two TUN devices.

What it carries are whole IP packets, so TCP notices loss and does about it what it does on any network. The kernel's
`netem` does the same where it is built in; this needs a TUN device and the right to make one.
"""

import asyncio
import ctypes
import fcntl
import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Self

from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.blocking import Background
from deltaq_protocol.errors import DeltaqError
from deltaq_testing.impairment.udp import Pump

DEVICE = "wan"
"""Name of the device in both namespaces."""
_MTU = 1500
_TUN, _NO_HEADER, _SET_DEVICE = 0x0001, 0x1000, 0x400454CA  # linux/if_tun.h
_NEW_NETWORK = 0x40000000  # of clone(2)
_NAMESPACES = Path("/run/netns")


class PacketLinkError(DeltaqError):
    """A link that cannot be made here."""


class PacketLink:
    """Carries packets between the devices of two namespaces, in an event loop; an async context manager.

    Args:
        near: name of a namespace, as `ip netns` has it.
        far: the other one's.
        seed: of the random numbers.

    Attributes:
        ways: there and back, from when it is entered.

    Raises:
        PacketLinkError: on entering, if this user may not make such devices.
    """

    def __init__(self, near: str, far: str, seed: int = 0) -> None:
        self._names, self._seed = (near, far), seed

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()
        self._loop, self._devices = loop, [_device_in(name) for name in self._names]
        near, far = self._devices
        self.ways = (Pump(loop, _into(far), self._seed), Pump(loop, _into(near), self._seed + 1))
        for device, way in zip(self._devices, self.ways, strict=True):
            loop.add_reader(device, _take, device, way)
        return self

    async def __aexit__(self, *_: object) -> None:
        for device, way in zip(self._devices, self.ways, strict=True):
            self._loop.remove_reader(device)
            way.close()
            os.close(device)

    def impair(self, faults: LinkFaults) -> None:
        """Set the faults from now on, in both directions."""
        for way in self.ways:
            way.impair(faults)


@contextmanager
def packet_link(near: str, far: str, seed: int = 0) -> Iterator[PacketLink]:
    """A `PacketLink` in an event loop of its own, for callers that have none; arguments and errors are the same."""
    background = Background()
    try:
        with background.entered(PacketLink(near, far, seed)) as link:
            yield link
    finally:
        background.close()


@contextmanager
def within(namespace: str) -> Iterator[None]:
    """This thread is in that network namespace within the block.

    Raises:
        PacketLinkError: if it may not be.
    """
    with Path("/proc/thread-self/ns/net").open("rb") as before:
        _enter(_NAMESPACES / namespace)
        try:
            yield
        finally:
            _enter_descriptor(before.fileno(), "the network that it came from")


def _enter(namespace: Path) -> None:
    try:
        with namespace.open("rb") as opened:
            _enter_descriptor(opened.fileno(), str(namespace))
    except OSError as error:
        raise PacketLinkError(f"{namespace}: {error.strerror}") from error


def _enter_descriptor(descriptor: int, name: str) -> None:
    # os.setns is there from Python 3.12 on
    if ctypes.CDLL(None, use_errno=True).setns(descriptor, _NEW_NETWORK):
        raise PacketLinkError(f"{name} cannot be entered: {os.strerror(ctypes.get_errno())}; this needs root")


def _device_in(namespace: str) -> int:
    with within(namespace):
        try:
            device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
            fcntl.ioctl(device, _SET_DEVICE, struct.pack("16sH", DEVICE.encode(), _TUN | _NO_HEADER))
        except OSError as error:
            raise PacketLinkError(
                f"no TUN device in {namespace}: {error.strerror}; this needs root"
            ) from error
    return device


def _take(device: int, way: Pump) -> None:
    with suppress(BlockingIOError):
        while packet := os.read(device, _MTU):
            way.put(packet)


def _into(device: int) -> Callable[[bytes], None]:
    def deliver(packet: bytes) -> None:
        with suppress(OSError):  # the device is down, or full: the packet is lost
            os.write(device, packet)

    return deliver
