"""Samples in the order in which they were published: over a link of datagrams one may overtake another."""

from __future__ import annotations

from collections.abc import Callable

import zenoh


def in_order(put: Callable[[zenoh.Sample], None]) -> Callable[[zenoh.Sample], None]:
    """Pass samples of one stream on to `put`, except a sample that comes after a newer one of its publisher.

    Zenoh's time stamps show the order; sessions with a datagram link set them. Samples without a stamp come in order.
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
