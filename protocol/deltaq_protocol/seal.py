"""Seals on the messages of the guarded realm: who made a message, as which of its messages, and for which processes.

A sealed message is `MACs (32 bytes each) | sender (8) | number (8) | count (1) | receivers (8 each) | message`. A MAC
is BLAKE2b (RFC 7693, 2.9) over the zenoh key and all that follows the MACs, so that a message is invalid under another
zenoh key; fields of the message itself bind it to gate epoch, lease epoch, sequence and cycle. With one key for the
realm there is one MAC; with an identity for each service there is one for each listener, in the order of the table of
who says what (`deltaq_protocol.sayings`), with the key of its speaker and that listener (`deltaq_protocol.seal_keys`).

Sender and receivers are processes, each by a random number of its own. A process acts only upon what names it as a
receiver: a message that was recorded before it began cannot. So its random number is a challenge, and who names it has
answered: such a sender is known, and all that is sealed from then on names it. A sender that has not answered yet, or
was recorded and never will, is named in one greeting. Numbers of a sender only grow, and each is valid once; a sender
that another has taken the place of is not heard again. No clock is involved.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from hashlib import blake2b
from hmac import compare_digest

from deltaq_protocol.errors import ProtocolError
from deltaq_protocol.seal_keys import SealKeys

MAC_BYTES = 32
_LENGTH_BYTES = 8
_PROCESS_BYTES = 8
_NUMBER_BYTES = 8
# places behind the MACs
_NUMBER = _PROCESS_BYTES
_COUNT = _NUMBER + _NUMBER_BYTES
_RECEIVERS = _COUNT + 1
_MOST_RECEIVERS = 255
MAX_SEALED_BYTES = 16 * 1024
"""Longest sealed message, many times what services send: nobody shall keep one busy with the MACs of long ones."""
_NEWCOMERS = 32
"""Senders under one zenoh key that a greeting names, though they have not shown that they know this process. Where more
were heard, which takes recordings of many, each has the same chance, whoever was heard first or oftener."""
_LOT_BYTES = 8


class ForgedMessageError(ProtocolError):
    """A message without the right seal, a duplicate, or one of a process that another has taken the place of."""


class UnboundMessageError(ProtocolError):
    """A message that its speaker made, but not for this process: its sender has not heard of it, or is gone."""


class _Link:
    """The senders heard under one zenoh key: the present one, and those that claim to be its successor.

    Attributes:
        sender: the process that has shown that it knows this one; empty if none has.
        number: of its newest message.
        newcomers: those heard since the last greeting that have shown nothing, each with its lot.
    """

    def __init__(self) -> None:
        self.sender = b""
        self.number = 0
        self.newcomers: dict[bytes, bytes] = {}


class Seal:
    """Seals what a process publishes and opens what it receives; one for each process, used by one thread.

    Args:
        keys: of this process.

    Attributes:
        passed_over: how often a sender that has shown nothing found no place in the next greeting.
    """

    def __init__(self, keys: SealKeys) -> None:
        self._keys = keys
        self._process = secrets.token_bytes(_PROCESS_BYTES)
        self._number = 0
        self._links: dict[str, _Link] = {}
        # processes whose place another has taken, by speaker; by key for greetings, which move nothing: who has the
        # identity of a listener can greet that listener in a speaker's place, and must not silence the speaker
        self._ended: dict[str, set[bytes]] = {}
        self._known: list[bytes] = []
        self._receivers = _named([])
        self._draw = secrets.token_bytes(_LOT_BYTES)
        self.passed_over = 0

    def close(self, zenoh_key: str, message: bytes) -> bytes:
        """The bytes to publish under `zenoh_key` for a message, valid for every process that is known."""
        return self._closed(zenoh_key, message, self._receivers)

    def greet(self, zenoh_key: str, message: bytes) -> bytes:
        """The same, valid also for those heard since the last greeting that have not shown that they know this process.

        It is named to each of them here and nowhere else, so that recordings make no other message longer, and no
        sender is kept from being known by those that were recorded.
        """
        receivers = _named(list(dict.fromkeys([*self._known, *self._newcomers()]))[:_MOST_RECEIVERS])
        for link in self._links.values():
            link.newcomers.clear()
        self._draw = secrets.token_bytes(_LOT_BYTES)
        return self._closed(zenoh_key, message, receivers)

    def open(self, zenoh_key: str, sealed: bytes) -> bytes:
        """The message that came under `zenoh_key`, to be acted upon.

        Raises:
            ForgedMessageError: it was not published by a process that may publish there, it is not newer than the
                last, or it is from a process whose successor was heard.
            UnboundMessageError: it was not made for this process; a greeting makes this process known to its sender.
        """
        opened, speaker = self._opened(zenoh_key, sealed)
        return self._taken(zenoh_key, opened, speaker)

    def meet(self, zenoh_key: str, sealed: bytes) -> bool:
        """Register the sender of a greeting; returns whether it was made for this process, and so is known from now on.

        Raises:
            ForgedMessageError: as `open` does.
        """
        opened, _ = self._opened(zenoh_key, sealed)
        try:
            self._taken(zenoh_key, opened, zenoh_key)
        except UnboundMessageError:
            return False
        return True

    def read(self, zenoh_key: str, sealed: bytes) -> bytes:
        """The message, for a process that only watches; it may be old or for another process. Any thread may call it.

        Raises:
            ForgedMessageError: it was not published by a process that may publish under `zenoh_key`, or it is too long;
                under an identity also if no message there is for this identity.
        """
        opened, _ = self._opened(zenoh_key, sealed)
        return _message(opened)

    def _taken(self, zenoh_key: str, opened: bytes, group: str) -> bytes:
        """The message, if it is newer than the last and its sender is none of the group's that have ended."""
        message = _message(opened)
        link = self._links.get(zenoh_key) or self._links.setdefault(zenoh_key, _Link())
        sender = opened[:_NUMBER]
        if sender in self._ended.get(group, ()):
            raise ForgedMessageError(f"{zenoh_key}: from a process that another has taken the place of")
        if not self._is_receiver(opened):
            if sender not in self._known:
                self._admit(link, sender)
            raise UnboundMessageError(f"{zenoh_key}: not made for this process, but for another or before it")
        number = int.from_bytes(opened[_NUMBER:_COUNT], "big")
        if sender != link.sender:
            if link.sender:
                self._ended.setdefault(group, set()).add(link.sender)
            link.sender, link.number = sender, 0
            # more cannot be named; the services of a cell are fewer
            self._known = sorted({link.sender for link in self._links.values()} - {b""})[:_MOST_RECEIVERS]
            self._receivers = _named(self._known)
        if number <= link.number:
            raise ForgedMessageError(
                f"{zenoh_key}: number {number} again, the newest so far is {link.number}"
            )
        link.number = number
        return message

    def _opened(self, zenoh_key: str, sealed: bytes) -> tuple[bytes, str]:
        """The bytes behind the MACs, after the MAC for this process was verified, and the service that made them."""
        if len(sealed) > MAX_SEALED_BYTES:
            raise ForgedMessageError(
                f"{zenoh_key}: {len(sealed)} bytes, at most {MAX_SEALED_BYTES} are sealed"
            )
        heard = self._keys.heard(zenoh_key)
        if heard is None:
            raise ForgedMessageError(f"{zenoh_key}: nothing is said there to this identity")
        at, behind = heard.place * MAC_BYTES, heard.macs * MAC_BYTES
        opened = sealed[behind:]
        mac = sealed[at : at + MAC_BYTES]
        if len(opened) < _RECEIVERS or not compare_digest(mac, _mac(heard.key, _text(zenoh_key, opened))):
            raise ForgedMessageError(f"{zenoh_key}: {len(sealed)} bytes without the seal of {heard.speaker}")
        return opened, heard.speaker

    def _is_receiver(self, opened: bytes) -> bool:
        at = opened.find(self._process, _RECEIVERS, _RECEIVERS + _PROCESS_BYTES * opened[_COUNT])
        return at >= 0 and (at - _RECEIVERS) % _PROCESS_BYTES == 0

    def _closed(self, zenoh_key: str, message: bytes, receivers: bytes) -> bytes:
        self._number += 1
        number = self._number.to_bytes(_NUMBER_BYTES, "big")
        sealed = b"".join((self._process, number, receivers, message))
        text = _text(zenoh_key, sealed)
        return b"".join([_mac(key, text) for key in self._keys.said(zenoh_key)]) + sealed

    def _admit(self, link: _Link, sender: bytes) -> None:
        """Name a sender in the next greeting, if its lot is among the first."""
        link.newcomers[sender] = blake2b(sender, digest_size=_LOT_BYTES, key=self._draw).digest()
        if len(link.newcomers) > _NEWCOMERS:
            del link.newcomers[max(link.newcomers, key=link.newcomers.__getitem__)]
            self.passed_over += 1

    def _newcomers(self) -> Iterator[bytes]:
        """Of each key those drawn first, in turn: no key's may take the places of another's."""
        drawn = [
            (place, lot, sender)
            for link in self._links.values()
            for place, (lot, sender) in enumerate(sorted((lot, who) for who, lot in link.newcomers.items()))
        ]
        return (sender for _, _, sender in sorted(drawn))


def _named(receivers: list[bytes]) -> bytes:
    return bytes([len(receivers)]) + b"".join(receivers)


def _message(opened: bytes) -> bytes:
    return opened[_RECEIVERS + _PROCESS_BYTES * opened[_COUNT] :]


def _text(zenoh_key: str, opened: bytes) -> bytes:
    name = zenoh_key.encode()
    # its length first, so that no byte can pass from the key into the message
    return b"".join((len(name).to_bytes(_LENGTH_BYTES, "big"), name, opened))


def _mac(key: bytes, text: bytes) -> bytes:
    return blake2b(text, digest_size=MAC_BYTES, key=key, person=b"deltaq guarded").digest()
