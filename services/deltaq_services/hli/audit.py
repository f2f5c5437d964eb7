"""The audit log: stamps the core's entries, writes them to a file, and publishes them for recorders."""

from __future__ import annotations

import itertools
import json
import logging
import os
import queue
import stat
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from deltaq_protocol.audit import (
    LONGEST_ADDRESS,
    LONGEST_NAME,
    LONGEST_TEXT,
    AuditEntry,
    AuditKind,
    AuditOutcome,
)
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.commands import Deed
from deltaq_services.outputs import ClientOrigin
from deltaq_services.rate_limit import Pace, RateLimit

_log = logging.getLogger(__name__)

# Equal actions become one entry with a count, so that a flood of them fills no disk. Pure.
#
# The first of a group is reported at once; the following ones are counted and reported after 1 s and, while they
# keep coming, after 2, 4, 8, 16 and then 30 s. The number of groups of one kind, outcome and role is bounded; all
# further ones form one group. So a client that invents names cannot soon push the entries of others out of the
# files.

QUIET_S = 1.0
LONGEST_QUIET_S = 30.0
MOST_GROUPS = 20
"""Greatest number of groups of one kind, outcome and role."""
NEW_GROUPS_S = 0.2
"""Of these, new ones a second; at once there may be as many as at a time."""
MANY = "further groups"
"""The client's name in the group of all further ones."""


@dataclass(frozen=True, slots=True)
class CountedDeed:
    """The newest of some equal actions, its time [s], and their number."""

    deed: Deed
    time_s: float
    count: int


class _Key(NamedTuple):
    what: AuditKind
    outcome: AuditOutcome
    code: ReasonCode | None
    robot: str | None
    client: str
    host: str
    role: str
    identity: str
    text: str


_Kind = tuple[AuditKind, AuditOutcome, str]


@dataclass(slots=True)
class _Group:
    newest: Deed
    newest_s: float
    until_s: float
    quiet_s: float = QUIET_S
    count: int = 0

    def counted(self) -> CountedDeed:
        """The entry to report for it."""
        return CountedDeed(self.newest, self.newest_s, self.count)


class DeedGroups:
    """Groups equal actions."""

    def __init__(self) -> None:
        self._groups: dict[_Key, _Group] = {}
        self._new: dict[_Kind, RateLimit] = {}
        self._told_apart: Counter[_Kind] = Counter()

    def add(self, deed: Deed, now_s: float, count: int = 1) -> list[CountedDeed]:
        """Take an action, or several equal ones; returns the actions to report at once."""
        group = self._groups.get(_key(deed))
        if group is None and not self._may_begin(deed, now_s):
            others = ClientOrigin(client=MANY, role=deed.origin.role)
            deed = replace(deed, origin=others, robot=None, code=None, text="")
            group = self._groups.get(_key(deed))
        if group is None:
            self._groups[_key(deed)] = _Group(deed, now_s, now_s + QUIET_S)
            self._told_apart[_kind(deed)] += 1
            return [CountedDeed(deed, now_s, count)]
        group.newest, group.newest_s = deed, now_s
        group.count += count
        return []

    def due(self, now_s: float) -> list[CountedDeed]:
        """The groups whose time is over, as actions with their counts."""
        told: list[CountedDeed] = []
        for key, group in list(self._groups.items()):
            if now_s < group.until_s:
                continue
            if not group.count:
                del self._groups[key]
                self._told_apart[_kind(group.newest)] -= 1
                continue
            told.append(group.counted())
            group.count = 0
            group.quiet_s = min(2.0 * group.quiet_s, LONGEST_QUIET_S)
            group.until_s = now_s + group.quiet_s
        return told

    def rest(self) -> list[CountedDeed]:
        """The counted actions that were not reported yet; all groups are forgotten."""
        groups, self._groups = self._groups, {}
        self._told_apart.clear()
        return [group.counted() for group in groups.values() if group.count]

    def _may_begin(self, deed: Deed, now_s: float) -> bool:
        kind = _kind(deed)
        rate = self._new.get(kind)
        if rate is None:
            rate = self._new[kind] = RateLimit(NEW_GROUPS_S, MOST_GROUPS)
        return self._told_apart[kind] < MOST_GROUPS and rate.take(now_s)


def _kind(deed: Deed) -> _Kind:
    return deed.what, deed.outcome, deed.origin.role


def _key(deed: Deed) -> _Key:
    origin = deed.origin
    # a client that connects again has another port each time
    host = origin.address.rpartition(":")[0] or origin.address
    # refused actions are equal whatever the client wrote; each accepted action is one of its own
    text = "" if deed.outcome is AuditOutcome.REFUSED else deed.text
    return _Key(
        deed.what,
        deed.outcome,
        deed.code,
        deed.robot,
        origin.client,
        host,
        origin.role,
        origin.identity,
        text,
    )


# The file of the audit log: whole lines, appended, bounded in size, written in a thread of its own.
#
# Each line is one `write` at the end of the file, so a killed process leaves no torn earlier line. A line torn by a
# full disk or a power failure is completed when the next line comes. A killed process loses the lines that its
# thread had not written yet; a power failure loses those since the last `fdatasync`, about a second.

MOST_BYTES = 16 * 1024 * 1024
"""Of one file; then it becomes FILE.1, and that FILE.2."""
MOST_FILES = 8
MOST_WAITING = 4096
"""Lines that may wait for a slow disk."""
_SYNC_PERIOD_S = 1.0
_CLOSE_DEADLINE_S = 2.0
"""Time for a slow disk when the service ends."""
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class AuditFileError(DeltaqError):
    """A file that cannot hold the audit log."""


class AuditFile:
    """Appends lines.

    Args:
        path: path of the file; its folder must exist. A new file has mode 0600.
        most_bytes: largest size of one file [bytes].
        most_files: number of files that are kept, including the one that is being written.

    Raises:
        AuditFileError: the file cannot be opened for writing, or others may read it.
    """

    def __init__(self, path: Path, most_bytes: int = MOST_BYTES, most_files: int = MOST_FILES) -> None:
        self._path, self._most_bytes, self._most_files = path, most_bytes, most_files
        self._turned_away = 0
        self._failed = 0
        self._why = ""
        try:
            self._descriptor: int | None = _opened(path)
        except OSError as error:
            raise AuditFileError(
                f"the audit log {path} cannot be written: {error.strerror}; name another file, or none"
            ) from error
        about = os.fstat(self._descriptor)
        if stat.S_ISREG(about.st_mode) and (about.st_uid != os.geteuid() or about.st_mode & _OTHERS):
            os.close(self._descriptor)
            raise AuditFileError(
                f"the audit log {path} has mode {stat.S_IMODE(about.st_mode):04o} and belongs to user {about.st_uid}; "
                f"it must be the own file of user {os.geteuid()}: `chmod 600 {path}`, or name another"
            )
        self._waiting: queue.Queue[bytes | None] = queue.Queue(MOST_WAITING)
        self._thread = threading.Thread(target=self._run, name="audit", daemon=True)
        self._thread.start()

    @property
    def lost(self) -> int:
        """Lines that could not be written."""
        return self._turned_away + self._failed

    @property
    def fault(self) -> str:
        """Why the newest line could not be written; empty if it was."""
        return "the disk is too slow" if self._waiting.full() else self._why

    def write(self, line: bytes) -> None:
        """Append a line, which ends with a newline; returns at once."""
        try:
            self._waiting.put_nowait(line)
        except queue.Full:
            self._turned_away += 1

    def close(self) -> None:
        """Write the waiting lines, as far as the disk takes them in time."""
        try:
            self._waiting.put(None, timeout=_CLOSE_DEADLINE_S)
        except queue.Full:
            return
        self._thread.join(_CLOSE_DEADLINE_S)

    # --- in the thread ------------------------------------------------------------------------------

    def _run(self) -> None:
        sync_s: float | None = None
        while True:
            try:
                line = self._waiting.get(timeout=None if sync_s is None else sync_s - time.monotonic())
            except (queue.Empty, ValueError):  # or it was due before
                self._sync()
                sync_s = None
                continue
            if line is None:
                break
            self._try(line)
            if sync_s is None:
                sync_s = time.monotonic() + _SYNC_PERIOD_S
        self._sync()
        self._forget()

    def _try(self, line: bytes) -> None:
        try:
            self._append(line)
        except OSError as error:
            self._failed += 1
            if not self._why:
                _log.error("the audit log %s loses lines: %s", self._path, error.strerror or error)
            self._why = error.strerror or str(error)
            return
        if self._why:
            _log.warning("the audit log %s is written again; it lost %d lines", self._path, self.lost)
        self._why = ""

    def _append(self, line: bytes) -> None:
        descriptor = self._current()
        about = os.fstat(descriptor)
        if stat.S_ISREG(about.st_mode):
            if about.st_size and about.st_size + len(line) > self._most_bytes:
                self._rotate()
                descriptor = self._current()
            elif about.st_size and os.pread(descriptor, 1, about.st_size - 1) != b"\n":
                line = b"\n" + line  # a line was torn
        written = os.write(descriptor, line)
        if written < len(line):
            raise OSError(0, "only a part of a line could be written")

    def _current(self) -> int:
        """The open file, unless it was moved or deleted since."""
        if self._descriptor is not None and not _is_at(self._descriptor, self._path):
            self._forget()
        if self._descriptor is None:
            self._descriptor = _opened(self._path)
        return self._descriptor

    def _rotate(self) -> None:
        self._forget()
        names = [self._path, *older(self._path, self._most_files)]
        for newer, old in reversed(list(itertools.pairwise(names))):
            if newer.exists():
                newer.replace(old)
        if len(names) == 1:
            self._path.unlink()

    def _sync(self) -> None:
        try:
            if self._descriptor is not None:
                os.fdatasync(self._descriptor)
        except OSError:
            pass  # a device that keeps nothing; a disk that fails says so when it is written to

    def _forget(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


def older(path: Path, most_files: int = MOST_FILES) -> Iterator[Path]:
    """Names of the files that were written before `path`, the newest of them first."""
    return (path.with_name(f"{path.name}.{number}") for number in range(1, most_files))


def default_audit_file(cell: str) -> Path:
    """Where `deltaq up` keeps the audit log of a cell: with the user's state, which outlives a restart of the machine.

    Raises:
        AuditFileError: if the folder cannot be made, or the file is not this user's.
    """
    given = os.environ.get("XDG_STATE_HOME")
    folder = (Path(given) if given else Path.home() / ".local" / "state") / "deltaq"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise AuditFileError(f"{folder} cannot be made: {error.strerror}") from error
    file = folder / audit_file_name(cell)
    if file.exists() and not os.access(file, os.R_OK | os.W_OK):
        raise AuditFileError(f"{file} is there, and this user cannot write to it")
    return file


def audit_file_name(cell: str) -> str:
    """The default name of a cell's audit log."""
    return f"audit-{cell}.jsonl"


def _opened(path: Path) -> int:
    # non-blocking: a pipe without a reader is an error, and does not block the thread
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK
    return os.open(path, flags, 0o600)


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        there = path.stat()
    except OSError:
        return False
    ours = os.fstat(descriptor)
    return (ours.st_dev, ours.st_ino) == (there.st_dev, there.st_ino)


MOST_PUBLISHED_S = 20.0
"""Entries a second that are published, and at once: they go through the gate's process."""
_LOOK_PERIOD_S = 0.2
_HIDDEN = "(a secret)"


class Audit:
    """Takes actions for the audit log.

    Args:
        file: the log's file; None: nothing is written, but entries are still published.
        publish: sends an entry to recorders.
        secrets: returns the texts that no entry may contain at present.
        now: monotonic time [s].

    Attributes:
        counters: refused attempts, by action and reason.
        lines: entries that were handed to the file.
        unpublished: entries that recorders did not get because there were too many.

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
        """Take an action, or several equal ones; ignored after `close`."""
        if deed.outcome is AuditOutcome.REFUSED:
            self.counters[f"attempts_refused_{deed.what}_{deed.code or 'unknown'}"] += count
        if not self._is_closed:
            self._say(self._groups.add(deed, self._now(), count))

    def tick(self) -> None:
        """Write and publish the counted actions whose time is over; to be called often."""
        now_s = self._now()
        if self._pace.due(now_s):
            self._say(self._groups.due(now_s))

    def close(self) -> None:
        """Write the counted actions, and complete the file."""
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
        """Why the newest line could not be written, as text; empty if it was."""
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
        """Text of an unknown client as one printable line without secrets."""
        for secret in self._secrets():
            text = text.replace(secret, _HIDDEN)
        shown = "".join(char if char.isprintable() else repr(char)[1:-1] for char in text[: most + 1])
        return shown if len(shown) <= most else shown[: most - 1] + "…"


def as_line(entry: AuditEntry) -> bytes:
    """An entry as one line of ASCII JSON, safe to print on a terminal."""
    fields = entry.model_dump(mode="json")
    return json.dumps(fields, separators=(",", ":")).encode("ascii") + b"\n"
