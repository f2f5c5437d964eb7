"""What a part of a core remembers, as plain values that can be compared."""

from collections import Counter
from dataclasses import fields, is_dataclass

import numpy as np

from deltaq_protocol.guarded import ServerState
from deltaq_services.containment import Containment, Part


def remembered(part):
    """All that a snapshot holds. Counters are left out, and so are they of the state that a Robot Server publishes."""
    told = {}
    for name, value in vars(part).items():
        if not (name in part.aside or callable(value) or isinstance(value, Counter | Containment)):
            told[name] = _plain(value)
    return told


def _plain(value):
    if isinstance(value, Part):
        return remembered(value)
    if isinstance(value, ServerState):
        return value.model_copy(update={"counters": {}})
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    return (
        [_plain(one) for one in value]
        if isinstance(value, list | tuple) or hasattr(value, "popleft")
        else value
    )
