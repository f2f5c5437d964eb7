"""What a process logs, as people and as programs read it: from processes of their own, as services are."""

import json
import subprocess
import sys
from datetime import UTC, datetime, timedelta

import pytest
from ran import ran

from deltaq_protocol.log import LogFormat, LogFormatError, json_line, log_format, message_of, read_json_line

SAYS = """
import logging, warnings
from deltaq_protocol import log
log.configure("robot-server", "fr")
ours = logging.getLogger("deltaq_services.somewhere")
ours.info("ready: %s", "here", extra={"fields": {"port": 49152, "q": (0.1, float("nan")), "file": log}})
ours.debug("not told")
logging.getLogger("a.library").info("not told")
ours.warning("careful")
ours.error("two\\nlines \\x1b[31m and \\u2028 more")
"""


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    import os

    return ran([sys.executable, "-c", code], env=os.environ | environment, check=False)


@pytest.mark.long
def test_text_logs_write_lines_to_stdout_and_errors_to_stderr() -> None:
    done = run(SAYS, DELTAQ_LOG_FORMAT="")
    assert done.stdout == "ready: here\nwarning: careful\n"
    assert done.stderr == "error: two\nlines \x1b[31m and \u2028 more\n"


@pytest.mark.long
def test_json_logs_write_one_complete_object_a_line() -> None:
    done = run(SAYS, DELTAQ_LOG_FORMAT="json")
    told, _ = map(json.loads, done.stdout.splitlines())
    (failed,) = map(json.loads, done.stderr.splitlines())
    assert list(told) == ["time", "level", "service", "robot", "message", "fields"]
    assert (told["level"], told["service"], told["robot"]) == ("info", "robot-server", "fr")
    assert told["message"] == "ready: here"
    assert told["fields"]["q"] == [0.1, None]
    assert told["fields"]["port"] == 49152
    assert told["time"].endswith("Z")
    assert abs(datetime.fromisoformat(told["time"]) - datetime.now(UTC)) < timedelta(minutes=5)
    assert (failed["level"], failed["message"]) == ("error", "two\nlines \x1b[31m and \u2028 more")
    assert done.stderr.isascii()


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize(
    ("code", "level", "message"),
    [
        ("raise RuntimeError('lost')", "critical", "ended by RuntimeError: lost"),
        ("import warnings; warnings.warn('old')", "warning", "UserWarning: old"),
        (
            "import asyncio\nasync def f():\n asyncio.get_running_loop().call_soon(lambda: 1/0)\n"
            " await asyncio.sleep(0)\nasyncio.run(f())",
            "error",
            "Exception in callback",
        ),
    ],
)
def test_an_unexpected_error_is_one_line(code: str, level: str, message: str) -> None:
    done = run(f"from deltaq_protocol import log\nlog.configure('sim')\n{code}", DELTAQ_LOG_FORMAT="json")
    (told,) = map(json.loads, (done.stdout + done.stderr).splitlines())
    assert (told["level"], told["service"], told["robot"]) == (level, "sim", None)
    assert message in told["message"]
    assert level == "warning" or "Traceback" in told["fields"]["exception"]


@pytest.mark.long
def test_a_result_is_one_object_a_line_in_either_format() -> None:
    code = "from deltaq_protocol import log\nlog.configure('leader')\nlog.say_result({'cycles': 3})"
    assert json.loads(run(code, DELTAQ_LOG_FORMAT="text").stdout) == {"cycles": 3}
    told = json.loads(run(code, DELTAQ_LOG_FORMAT="json").stdout)
    assert (told["message"], told["fields"]) == ("result", {"cycles": 3})


@pytest.mark.long
def test_a_service_refuses_an_unknown_log_format() -> None:
    code = "from deltaq_services.process import run\nrun(lambda: None, 'sim')"
    done = run(code, DELTAQ_LOG_FORMAT="xml")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "error: no log format 'xml'; there are text, json\n"
    with pytest.raises(LogFormatError):
        log_format({"DELTAQ_LOG_FORMAT": "JSON "})
    assert log_format({}) is LogFormat.TEXT


def test_json_log_lines_are_parsed_and_other_lines_stay_unchanged() -> None:
    line = json_line("hli", "ready: here", fields={"a": {"b": [1]}})
    assert message_of(line) == "ready: here"
    told = read_json_line(line)
    assert told is not None
    assert told["fields"] == {"a": {"b": [1]}}
    for other in (
        "ready: here",
        '{"cycles": 3}',
        '{"time": 1}',
        '{"time": ',
        '{"time": 1, "message": "x"}',
        "",
    ):
        assert read_json_line(other) is None
        assert message_of(other) == other
