"""The log of a process: lines of text, or one JSON object a line for log collectors.

`DELTAQ_LOG_FORMAT=json` chooses the second for every service, controller and emulator. Modules log with the standard
library; further fields of a line are given as `extra={"fields": {...}}`.
"""

import json
import logging
import math
import os
import sys
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from enum import StrEnum
from functools import partial
from types import TracebackType
from typing import Any, TextIO

from deltaq_protocol.errors import DeltaqError

FORMAT = "DELTAQ_LOG_FORMAT"
"""Environment variable: `text`, which is the default, or `json`."""
RESULT = "result"
"""Text of the line whose fields are the result of a program."""
_OURS = ("__main__", "deltaq_controllers", "deltaq_emulator", "deltaq_protocol", "deltaq_services")
_BEGINNING = '{"time": '


class LogFormat(StrEnum):
    """How lines look."""

    TEXT = "text"
    JSON = "json"


class LogFormatError(DeltaqError):
    """An unknown log format."""


def log_format(environment: Mapping[str, str] = os.environ) -> LogFormat:
    """The format that the environment asks for; raises as `log_format_named`."""
    return log_format_named(environment.get(FORMAT) or LogFormat.TEXT)


def log_format_named(name: str) -> LogFormat:
    """The format of a name.

    Raises:
        LogFormatError: if there is none of that name.
    """
    try:
        return LogFormat(name)
    except ValueError:
        raise LogFormatError(f"no log format {name!r}; there are {', '.join(LogFormat)}") from None


def configure(service: str, robot: str | None = None) -> None:
    """Configure logging of this process: messages to standard output, errors to standard error.

    Args:
        service: kind of this process.
        robot: the robot that it serves, if any.

    Raises:
        LogFormatError: if the environment names an unknown format.
    """
    formatter: logging.Formatter
    if log_format() is LogFormat.JSON:
        formatter = _JsonLines(service, robot)
        sys.excepthook = partial(_log_uncaught, logging.getLogger("__main__"), sys.excepthook)
    else:
        formatter = _Text()
    handlers = _to(sys.stdout, formatter, _is_told), _to(sys.stderr, formatter, lambda r: not _is_told(r))
    logging.basicConfig(level=logging.WARNING, handlers=handlers, force=True)
    logging.captureWarnings(True)
    for name in _OURS:
        logging.getLogger(name).setLevel(logging.INFO)


def say_result(result: Mapping[str, Any]) -> None:
    """Print the result of a program, one JSON object a line, in either format."""
    if log_format() is LogFormat.JSON:
        logging.getLogger("__main__").info(RESULT, extra={"fields": result})
    else:
        print(json.dumps(result), flush=True)


def json_line(
    service: str,
    message: str,
    level: str = "info",
    *,
    robot: str | None = None,
    time_s: float | None = None,
    fields: Mapping[str, Any] | None = None,
) -> str:
    """A line of the JSON format; `time_s` is on the wall clock, now if it is None."""
    time = datetime.now(UTC) if time_s is None else datetime.fromtimestamp(time_s, UTC)
    told = {
        "time": time.isoformat(timespec="microseconds").replace("+00:00", "Z"),
        "level": level,
        "service": service,
        "robot": robot,
        "message": message,
        "fields": _plain(fields or {}),
    }
    return json.dumps(told)  # in ASCII: no character of a stranger's reaches a terminal, or ends a line


def read_json_line(line: str) -> dict[str, Any] | None:
    """The object in a line of the JSON format; None for any other line."""
    if not line.startswith(_BEGINNING):
        return None
    try:
        told = json.loads(line)
    except ValueError:
        return None
    return told if isinstance(told.get("message"), str) and isinstance(told.get("fields"), dict) else None


def message_of(line: str) -> str:
    """The contents of a line in either format."""
    told = read_json_line(line)
    return line if told is None else str(told["message"])


class _JsonLines(logging.Formatter):
    def __init__(self, service: str, robot: str | None) -> None:
        super().__init__()
        self._service, self._robot = service, robot

    def format(self, record: logging.LogRecord) -> str:
        fields = dict(getattr(record, "fields", {}))
        if record.exc_info:
            fields["exception"] = self.formatException(record.exc_info)
        level, message = record.levelname.lower(), record.getMessage()
        return json_line(
            self._service, message, level, robot=self._robot, time_s=record.created, fields=fields
        )


class _Text(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        text = super().format(record)
        return text if record.levelno < logging.WARNING else f"{record.levelname.lower()}: {text}"


def _to(
    stream: TextIO, formatter: logging.Formatter, takes: Callable[[logging.LogRecord], bool]
) -> logging.Handler:
    handler = logging.StreamHandler(stream)
    handler.setFormatter(formatter)
    handler.addFilter(takes)
    return handler


def _is_told(record: logging.LogRecord) -> bool:
    return record.levelno < logging.ERROR


def _log_uncaught(
    logger: logging.Logger,
    otherwise: Callable[..., Any],
    kind: type[BaseException],
    error: BaseException,
    trace: TracebackType | None,
) -> None:
    if issubclass(kind, KeyboardInterrupt):
        otherwise(kind, error, trace)
    else:
        logger.critical("ended by %s: %s", kind.__name__, error, exc_info=(kind, error, trace))


def _plain(value: Any) -> Any:
    """A value that JSON can express: not-a-number becomes null, and an unknown type its text."""
    match value:
        case Mapping():
            return {str(name): _plain(one) for name, one in value.items()}
        case list() | tuple():
            return [_plain(one) for one in value]
        case float() if not math.isfinite(value):
            return None
        case None | bool() | int() | float() | str():
            return value
    return str(value)
