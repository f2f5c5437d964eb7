"""Samples in the order in which they were published: over a link of datagrams one may overtake another."""

from __future__ import annotations

from collections.abc import Callable

import zenoh


def in_order(put: Callable[[zenoh.Sample], None]) -> Callable[[zenoh.Sample], None]:
    """Hand samples of one stream on to `put`, but for those that come after a newer one of the same publisher.

    They are told by zenoh's time stamps, which sessions with a link of datagrams give; those without come in order.
    """
    newest: zenoh.Timestamp | None = None

    def put_if_newer(sample: zenoh.Sample) -> None:
        nonlocal newest
        published = sample.timestamp
        if published is not None:
            if (
                newest is not None
                and published.get_id() == newest.get_id()
                and published.get_time() < newest.get_time()
            ):
                return
            newest = published
        put(sample)

    return put_if_newer
