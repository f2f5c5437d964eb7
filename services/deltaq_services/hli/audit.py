"""The audit log: stamps what the core tells, writes it to a file, and publishes it for recorders."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path

from deltaq_protocol.audit import LONGEST_ADDRESS, LONGEST_NAME, LONGEST_TEXT, AuditEntry, AuditOutcome
from deltaq_services.hli.audit_file import AuditFile
from deltaq_services.hli.deed_groups import CountedDeed, DeedGroups
from deltaq_services.hli.deeds import Deed
from deltaq_services.pace import Pace
from deltaq_services.rate_limit import RateLimit

MOST_PUBLISHED_S = 20.0
"""Entries a second that are published, and at once: they go through the gate's process."""
_LOOK_PERIOD_S = 0.2
_HIDDEN = "(a secret)"


class Audit:
    """Takes deeds.

    Args:
        file: the log's file; None: nothing is written, but entries are still published.
        publish: sends an entry to recorders.
        secrets: returns the texts that no entry may contain at present.
        now: monotonic time [s].

    Attributes:
        counters: attempts that were refused, by what was tried and why.
        lines: entries that were handed to the file.
        unpublished: entries that were too many for recorders.

    Raises:
        AuditFileError: if the file cannot be written to.
    """

    def __init__(
        self,
        file: Path | None,
        publish: Callable[[AuditEntry], None],
        secrets: Callable[[], Iterable[str]],
        now: Callable[[], float],
    ) -> None:
        self._file = None if file is None else AuditFile(file)
        self._publish, self._secrets, self._now = publish, secrets, now
        self._groups = DeedGroups()
        self._pace = Pace(_LOOK_PERIOD_S)
        self._rate = RateLimit(MOST_PUBLISHED_S)
        self._is_closed = False
        self.counters: Counter[str] = Counter()
        self.lines = 0
        self.unpublished = 0

    def tell(self, deed: Deed, count: int = 1) -> None:
        """Take a deed, or several equal ones; after `close` nothing is told any more."""
        if deed.outcome is AuditOutcome.REFUSED:
            self.counters[f"attempts_refused_{deed.what}_{deed.code or 'unknown'}"] += count
        if not self._is_closed:
            self._say(self._groups.add(deed, self._now(), count))

    def tick(self) -> None:
        """Write and publish the deeds that were counted for long enough; to be called often."""
        now_s = self._now()
        if self._pace.due(now_s):
            self._say(self._groups.due(now_s))

    def close(self) -> None:
        """Tell what is counted, and complete the file."""
        self._say(self._groups.rest())
        self._is_closed = True
        if self._file is not None:
            self._file.close()

    @property
    def lost(self) -> int:
        """Lines that the file did not take."""
        return 0 if self._file is None else self._file.lost

    @property
    def fault(self) -> str:
        """Why the newest line could not be written, for people; empty if it was."""
        if self._file is None or not self._file.fault:
            return ""
        return f"audit log: {self._file.fault}, {self._file.lost} lines lost"

    def _say(self, told: list[CountedDeed]) -> None:
        for counted in told:
            entry = self._entry(counted)
            if self._file is not None:
                self.lines += 1
                self._file.write(as_line(entry))
            if self._rate.take(self._now()):
                self._publish(entry)
            else:
                self.unpublished += 1

    def _entry(self, counted: CountedDeed) -> AuditEntry:
        deed = counted.deed
        wall_s = time.time() - (self._now() - counted.time_s)
        return AuditEntry(
            time_utc=datetime.fromtimestamp(wall_s, UTC).isoformat(timespec="milliseconds"),
            time_s=counted.time_s,
            what=deed.what,
            outcome=deed.outcome,
            robot=None if deed.robot is None else self._shown(deed.robot, LONGEST_NAME),
            client=self._shown(deed.origin.client, LONGEST_NAME),
            address=self._shown(deed.origin.address, LONGEST_ADDRESS),
            role=deed.origin.role,
            identity=self._shown(deed.origin.identity, LONGEST_NAME),
            code=deed.code,
            text=self._shown(deed.text, LONGEST_TEXT),
            count=counted.count,
        )

    def _shown(self, text: str, most: int) -> str:
        """A stranger's text, without secrets, on one line, as a terminal may show it."""
        for secret in self._secrets():
            text = text.replace(secret, _HIDDEN)
        shown = "".join(char if char.isprintable() else repr(char)[1:-1] for char in text[: most + 1])
        return shown if len(shown) <= most else shown[: most - 1] + "…"


def as_line(entry: AuditEntry) -> bytes:
    """An entry as a line of JSON, in ASCII: no terminal takes it for anything else than text."""
    fields = entry.model_dump(mode="json")
    return json.dumps(fields, separators=(",", ":")).encode("ascii") + b"\n"
