"""The console's recordings: nothing outside the folder is opened, and nothing is driven from behind a recording."""

import asyncio
import json
from contextlib import asynccontextmanager
from urllib.parse import quote

import pytest
from console_bench import BODIES, CELL, ConsoleBench

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import driving
from deltaq_services.console.core import ConsoleCore
from deltaq_services.console.messages import AckOutcome
from deltaq_services.console.outputs import ToDriver, ToRecorder
from deltaq_services.console.recordings import NoSuchRecordingError, RecorderProcess, RecordingFolder
from deltaq_services.console.settings import NoFolderError, Settings
from deltaq_services.console.shell import Console
from deltaq_services.console.web import application, listening_socket, server_of
from deltaq_services.recorder.writer import RecordingWriter
from deltaq_testing.private_cell import free_ports, write_private_cell

TOKEN = "0123456789abcdef-desk"
REFUSED, ASKED, DONE = AckOutcome.REFUSED, AckOutcome.ASKED, AckOutcome.DONE
OUTSIDE = [
    "../secret.mcap", "..", ".", "", "/etc/passwd", "a/b.mcap", "..\\secret.mcap", ".hidden.mcap", "link.mcap",
    "folder.mcap", "notes.txt", "missing.mcap", "run.mcap\0", "run.mcap/", "run.mcap.", "~/run.mcap",
    "x" * 300 + ".mcap", "../" + "inside/run.mcap",
]  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    """A folder with one recording, and around it what must not be opened."""
    inside = tmp_path / "inside"
    inside.mkdir()
    (tmp_path / "secret.mcap").write_text("secret")
    (inside / "run.mcap").write_text("recorded")
    (inside / "notes.txt").write_text("notes")
    (inside / ".hidden.mcap").write_text("hidden")
    (inside / "folder.mcap").mkdir()
    (inside / "link.mcap").symlink_to(tmp_path / "secret.mcap")
    return inside


@pytest.mark.parametrize("name", OUTSIDE)
def test_only_recordings_in_the_folder_are_opened(folder, name):
    with pytest.raises(NoSuchRecordingError, match="no recording"):
        RecordingFolder(folder).file(name)


def test_only_recordings_are_listed(folder):
    listed = RecordingFolder(folder)
    assert [each["name"] for each in listed.listed()] == ["run.mcap"]
    assert listed.file("run.mcap").read_text() == "recorded"
    assert RecordingFolder(folder / "gone").listed() == []


def test_a_missing_folder_is_reported_at_the_start(tmp_path):
    with pytest.raises(NoFolderError, match="there is no such folder"):
        Settings("lab", True, "127.0.0.1", free_ports(1)[0], recordings=tmp_path / "nowhere")


@asynccontextmanager
async def served(tmp_path, folder, token=""):
    cell = CellModel.load(write_private_cell(tmp_path))
    settings = Settings("lab", True, "127.0.0.1", cell.description.console_port, token, recordings=folder)
    console = Console(cell, settings)
    server = server_of(application(console, settings))
    with listening_socket(settings) as listening:
        serving = asyncio.ensure_future(server.serve(sockets=[listening]))
        try:
            yield console, cell, settings.port
        finally:
            server.should_exit = True
            await asyncio.gather(serving, return_exceptions=True)


async def get(port, path, **headers):
    """Status and body of an answer to exactly this path."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    lines = [f"GET {path} HTTP/1.1", f"Host: 127.0.0.1:{port}", "Connection: close"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    writer.write(("\r\n".join(lines) + "\r\n\r\n").encode())
    answer = (await reader.read()).decode(errors="replace")
    writer.close()
    return int(answer.split()[1]), answer.partition("\r\n\r\n")[2]


@pytest.mark.long
async def test_no_address_leads_out_of_the_folder(tmp_path, folder):
    async with served(tmp_path, folder) as (_, _, port):
        names = [
            "../secret.mcap",
            "%2e%2e/secret.mcap",
            "..%2fsecret.mcap",
            "..%252fsecret.mcap",
            "%2fetc%2fpasswd",
        ]
        names += ["link.mcap", ".hidden.mcap", "folder.mcap", "notes.txt", "run.mcap%00", "....//secret.mcap"]
        for name in [*names, *(quote(name, safe="") for name in OUTSIDE if name)]:
            status, body = await get(port, f"/recordings/{name}")
            # at most it leads to the same name without the slash behind it
            assert status in (307, 400, 404), name
            assert "secret" not in body.replace("secret.mcap", "")
            assert "root:" not in body


@pytest.mark.long
async def test_recordings_are_for_the_console_s_own_page(tmp_path, folder):
    async with served(tmp_path, folder) as (_, _, port):
        for path in ("/recordings", "/recordings/run.mcap"):
            assert (await get(port, path, Sec_Fetch_Site="cross-site"))[0] == 403
            assert (await get(port, path, Sec_Fetch_Site="same-site"))[0] == 403
        status, body = await get(port, "/recordings", Sec_Fetch_Site="same-origin")
        assert (status, [each["name"] for each in json.loads(body)]) == (200, ["run.mcap"])


@pytest.mark.long
async def test_recordings_need_the_consoles_token_if_it_has_one(tmp_path, folder):
    async with served(tmp_path, folder, TOKEN) as (console, _, port):
        for path in ("/recordings", "/recordings/run.mcap"):
            for shown in ({}, {"Authorization": "Bearer guessed"}, {"Authorization": f"Basic {TOKEN}"}):
                status, body = await get(port, path, **shown)
                assert (status, "token" in body, "recorded" in body) == (403, True, False)
        assert console.core.counters["tokens_wrong"] == 2
        status, body = await get(port, "/recordings", Authorization=f"Bearer {TOKEN}")
        assert (status, [each["name"] for each in json.loads(body)]) == (200, ["run.mcap"])


@pytest.mark.long
async def test_an_invalid_recording_is_reported_and_one_file_is_read_at_a_time(tmp_path, folder):
    async with served(tmp_path, folder) as (console, cell, port):
        RecordingWriter(folder / "empty.mcap", cell.description_message(), "live").close()
        asked = [asyncio.ensure_future(get(port, f"/recordings/{name}.mcap")) for name in ("run", "empty")]
        answers = sorted([await each for each in asked])
        assert [status for status, _ in answers] == [422, 503]
        assert "try again" in answers[1][1]
        status, body = await get(port, "/recordings/empty.mcap")
        assert (status, "nothing to show" in body) == (422, True)
        assert str(tmp_path) not in body, "where the folder lies is nobody's business"
        assert console.core.health()


def test_while_a_recording_is_shown_only_a_stop_is_accepted():
    bench = ConsoleBench()
    bench.states()
    desk = bench.browser("desk")
    desk.send("ping")
    desk.takes()
    bench.outputs.clear()
    assert desk.send("replay", shown=True).outcome is DONE
    assert bench.outputs[0] == ToDriver("fr", driving.GiveCommand()), "what it drives rests"
    assert isinstance(bench.outputs[1].request, driving.Release), "and is free for others"
    bench.driver_answers("fr")
    bench.outputs.clear()
    for kind, fields in (
        ("jog", {"robot": "fr", "wish": [0.1, 0, 0, 0, 0, 0]}),
        ("mode", {"robot": "fr", "mode": "coupled"}),
        ("reset", {"robot": "fr"}),
        ("lease", {"robot": "gr", "action": "take"}),
        ("dry_run", {"robot": "fr", "dq": [0, 0, 0, 0, 0, 0]}),
        ("record", {"action": "start"}),
    ):
        ack = desk.send(kind, **fields)
        assert (ack.outcome, "a recording is shown" in ack.text) == (REFUSED, True), kind
    assert not bench.driver_requests("fr")
    assert not bench.driver_requests("gr")
    assert desk.send("stop").outcome is ASKED
    assert bench.asked("stop")
    desk.send("replay", shown=False)
    assert "take it" in desk.send("jog", robot="fr", wish=[0.1, 0, 0, 0, 0, 0]).text
    desk.takes()
    assert desk.send("jog", robot="fr", wish=[0.1, 0, 0, 0, 0, 0]).outcome is DONE


def test_a_recording_in_one_browser_does_not_restrict_others():
    bench = ConsoleBench()
    bench.states()
    desk, bert = bench.browser("desk"), bench.browser("bert")
    for browser in (desk, bert):
        browser.send("ping")
    desk.send("replay", shown=True)
    bert.takes()
    assert bert.send("jog", robot="fr", wish=[0.1, 0, 0, 0, 0, 0]).outcome is DONE


@pytest.fixture
def recording_bench():
    bench = ConsoleBench()
    bench.core = ConsoleCore(CELL, BODIES, token_needed=False, has_recordings=True)
    return bench


def test_without_a_folder_recording_is_refused_and_not_offered():
    bench = ConsoleBench()
    desk = bench.browser()
    assert desk.send("ping")
    ack = desk.send("record", action="start")
    assert (ack.outcome, "--recordings" in ack.text) == (REFUSED, True)
    assert desk.status().recording is None


def test_one_recording_is_written_at_a_time_and_its_end_reported(recording_bench):
    bench = recording_bench
    desk = bench.browser()
    desk.send("ping")
    assert "nothing is being recorded" in desk.send("record", action="stop").text
    assert desk.send("record", action="start").outcome is DONE
    (begun,) = [output for output in bench.outputs if isinstance(output, ToRecorder)]
    assert begun.file == "lab-19700101-001640.mcap"
    assert "already" in desk.send("record", action="start").text
    view = desk.status(1.0).recording
    assert (view.file, view.since_s) == (begun.file, None), "it is not said to be written before it is"
    bench.core.desk.began(bench.now_s)
    assert desk.status(1.0).recording.since_s == bench.now_s - 1.0
    assert desk.send("record", action="stop").outcome is DONE
    assert bench.outputs.count(ToRecorder(None)) == 1
    bench.core.recorder_ended("", bench.now_s)
    status = desk.status(1.0)
    assert (status.recording.file, status.recording.text) == ("", f"{begun.file} was recorded")
    assert desk.send("record", action="start").outcome is DONE


def test_a_dead_recorder_is_reported_and_another_recording_can_begin(recording_bench):
    desk = recording_bench.browser()
    desk.send("ping")
    desk.send("record", action="start")
    recording_bench.core.recorder_ended("No space left on device", recording_bench.now_s)
    assert "No space left" in desk.status(1.0).recording.text
    assert any("No space left" in text for text in desk.events("recording"))
    assert desk.send("record", action="start").outcome is DONE


def test_an_observer_records_nothing(recording_bench):
    observer = recording_bench.browser(operator=False)
    observer.send("ping")
    assert "observer" in observer.send("record", action="start").text


@pytest.mark.long
async def test_a_recorder_that_cannot_start_reports_the_reason(tmp_path):
    """There is no HLI; and one that is ended before it wrote is not said to have recorded."""
    told = asyncio.Queue()
    cell = str(write_private_cell(tmp_path))
    recorder = RecorderProcess(cell, lambda: told.put_nowait("began"), told.put_nowait)
    recorder.start(tmp_path / "run.mcap")
    await recorder.end()
    async with asyncio.timeout(300):
        assert "before anything was written" in await told.get()
        recorder.start(tmp_path / "run.mcap")
        assert "is the cell up" in await told.get()
    assert not (tmp_path / "run.mcap").exists()
