"""Receipts: every verdict by which the gate held or refused is an entry in a chain of hashes.

A receipt is the SHA-256 of the receipt before it and of the verdict itself, as JSON without the fields that have
their default. One kept receipt proves later that no refusal before it was changed, added or removed; `deltaq
recording replay` verifies the whole chain of a recording.
"""

import hashlib

from deltaq_protocol.messages import Verdict


def first_receipt(fingerprint: str, epoch: int) -> str:
    """First hash of a SIM's chain: bound to the gate's code and configuration, and to its epoch."""
    return hashlib.sha256(f"{fingerprint} {epoch}".encode()).hexdigest()


def receipt_of(previous: str, verdict: Verdict) -> str:
    """The receipt of a verdict that follows the receipt `previous`."""
    text = verdict.model_dump_json(exclude={"receipt"}, exclude_defaults=True)
    return hashlib.sha256(f"{previous} {text}".encode()).hexdigest()


def with_receipt(previous: str, verdict: Verdict) -> Verdict:
    """The verdict with its receipt."""
    return verdict.model_copy(update={"receipt": receipt_of(previous, verdict)})
