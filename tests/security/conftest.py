"""What the attacks on the guarded realm share."""

import pytest

from deltaq_protocol import session


@pytest.fixture
def lasting_links(monkeypatch):
    """Links of this process's sessions that no pause of the machine closes.

    What is published while a link is down is lost, and a realm in lockstep would wait for it for ever.
    """
    monkeypatch.setattr(session, "LINK_LEASE_MS", 3_600_000)
