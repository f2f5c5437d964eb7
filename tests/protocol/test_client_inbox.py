"""What lies between zenoh's threads and the loop: bounded, in order, and it outlives what it carries."""

import asyncio
import logging
import threading

import pytest

from deltaq_protocol.inbox import ClientInbox
from deltaq_protocol.wire import Newest


def flood(inbox: ClientInbox[int], items: int) -> None:
    """Put from another thread while this one, the loop's, is busy."""
    thread = threading.Thread(target=lambda: [inbox.put(item) for item in range(items)])
    thread.start()
    thread.join()


async def settled() -> None:
    """Let the loop turn until it has nothing more to do."""
    for _ in range(100):
        await asyncio.sleep(0)


async def test_a_full_inbox_drops_the_oldest_and_counts() -> None:
    taken: list[int] = []
    inbox = ClientInbox(asyncio.get_running_loop(), taken.append, capacity=256)
    flood(inbox, 100_000)
    await settled()
    assert taken == list(range(100_000 - 256, 100_000))
    assert inbox.dropped == 100_000 - 256


async def test_with_a_capacity_of_one_only_the_newest_is_taken() -> None:
    taken: list[int] = []
    inbox = ClientInbox(asyncio.get_running_loop(), taken.append, capacity=1)
    flood(inbox, 1000)
    await settled()
    assert taken == [999]


async def test_a_flood_lets_other_tasks_of_the_loop_run() -> None:
    taken: list[int] = []
    inbox = ClientInbox(asyncio.get_running_loop(), taken.append, capacity=256)
    flood(inbox, 256)
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert 0 < len(taken) < 256
    await settled()
    assert len(taken) == 256


async def test_a_failing_item_is_counted_and_logged_and_the_next_one_is_processed(
    caplog: pytest.LogCaptureFixture,
) -> None:
    taken: list[float] = []
    inbox = ClientInbox[int](asyncio.get_running_loop(), lambda item: taken.append(1 / item), capacity=8)
    with caplog.at_level(logging.ERROR):
        flood(inbox, 3)
        await settled()
    assert (taken, inbox.failed) == ([1.0, 0.5], 1)
    assert "ZeroDivisionError" in caplog.text


async def test_a_closed_inbox_processes_nothing() -> None:
    taken: list[int] = []
    inbox = ClientInbox(asyncio.get_running_loop(), taken.append, capacity=8)
    inbox.put(1)
    inbox.close()
    inbox.put(2)
    await settled()
    assert taken == []


def test_putting_into_the_inbox_of_a_closed_loop_is_harmless() -> None:
    loop = asyncio.new_event_loop()
    inbox = ClientInbox[int](loop, print, capacity=8)
    loop.close()
    inbox.put(1)


def text_of_a_number(sample: str) -> int | None:
    return int(sample) if sample.isdigit() else None


def newest_of(decoded: list[str]) -> Newest[str, int]:
    """A holder that keeps a list of what it decoded."""

    def decode(sample: str) -> int | None:
        decoded.append(sample)
        return text_of_a_number(sample)

    return Newest(asyncio.get_running_loop(), decode)


async def test_every_waiter_wakes_with_the_newest_value() -> None:
    newest = newest_of([])
    waiting = [asyncio.create_task(newest.after(0, 10.0)) for _ in range(3)]
    await settled()
    newest.put("1")
    newest.put("2")
    assert await asyncio.gather(*waiting) == [(2, 2)] * 3
    assert await newest.after(1, 10.0) == (2, 2)


async def test_a_reader_of_the_newest_value_waits_until_its_deadline() -> None:
    newest = newest_of([])
    newest.put("1")
    with pytest.raises(TimeoutError):
        await newest.after(1, 0.01)


async def test_a_sample_without_a_value_wakes_no_waiter_and_keeps_the_last_value() -> None:
    newest = newest_of([])
    newest.put("1")
    assert newest.value == 1
    newest.put("none")
    assert newest.read() == (1, 1)
    with pytest.raises(TimeoutError):
        await newest.after(1, 0.01)
    waiting = asyncio.create_task(newest.after(1, 10.0))
    await settled()
    newest.put("nor this")
    await settled()
    assert not waiting.done()
    newest.put("4")
    assert await waiting == (4, 4)


async def test_a_sample_is_decoded_once_and_only_when_it_is_read() -> None:
    decoded: list[str] = []
    newest = newest_of(decoded)
    for number in range(1000):
        newest.put(str(number))
    await settled()
    assert decoded == []
    assert (newest.value, newest.value) == (999, 999)
    assert decoded == ["999"]


async def test_the_loop_is_not_woken_for_an_unawaited_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = asyncio.get_running_loop()
    woken: list[object] = []
    newest = newest_of([])
    monkeypatch.setattr(loop, "call_soon_threadsafe", woken.append)
    newest.put("1")
    assert woken == []
    waiting = asyncio.create_task(newest.after(1, 10.0))
    await settled()
    newest.put("2")
    assert len(woken) == 1
    waiting.cancel()


async def test_a_waiting_thread_gets_the_value_of_another_thread() -> None:
    newest = newest_of([])
    began = threading.Event()

    def wait() -> tuple[int, int]:
        began.set()
        return newest.wait_after(0, 10.0)

    waiting = asyncio.create_task(asyncio.to_thread(wait))
    await asyncio.to_thread(began.wait)
    for sample in ("none", "2"):
        threading.Thread(target=newest.put, args=(sample,)).start()
    assert await waiting == (2, 2)


async def test_a_waiting_thread_gives_up_at_its_deadline() -> None:
    newest = newest_of([])
    newest.put("1")
    with pytest.raises(TimeoutError):
        newest.wait_after(1, 0.01)


def test_putting_the_newest_value_for_a_closed_loop_is_harmless() -> None:
    loop = asyncio.new_event_loop()
    newest = Newest[str, int](loop, text_of_a_number)
    waiting = loop.create_task(newest.after(0, 10.0))
    loop.run_until_complete(settled())
    waiting.cancel()
    loop.close()
    newest.put("1")
    assert newest.value == 1
