"""Spans of joint space, drawn at random and looked into."""

import daqp
import numpy as np

from deltaq_services.sim.tube import DriveBounds


def exact_drives(lag, joints=2, tolerance=0.0):
    """DriveBounds that are in the hull of their setpoints, and all lag alike."""
    return DriveBounds(lag, np.full(joints, tolerance), 0.0)


def is_inside(span, q, slack):
    """Whether some mean of a span's vertices is within its deviation of q (n,), and `slack` [rad or m]."""
    vertices, joints = span.offsets.shape
    means = np.vstack([np.ones(vertices), span.offsets.T])
    aside = span.deviation + slack
    lower = np.concatenate([np.zeros(vertices), [1.0], q - span.middle - aside])
    upper = np.concatenate([np.ones(vertices), [1.0], q - span.middle + aside])
    sense = np.zeros(vertices + 1 + joints, dtype=np.int32)
    flag = daqp.solve(np.eye(vertices), np.zeros(vertices), means, upper, lower, sense, primal_tol=1e-9)[2]
    return flag > 0


def draw_span(joints, random, lengths=(-2, -0.5), widths=(-4, -1.5)):
    """Half-widths, offsets and deviation of a span: long or short, thin or wide, of all joints or of a few."""
    length, width = 10.0 ** random.uniform(*lengths), 10.0 ** random.uniform(*widths)
    moving = random.uniform(size=joints) < random.uniform(0.2, 1.2)
    offsets = random.uniform(-1, 1, (int(random.integers(1, 5)), joints)) * length * moving
    offsets -= (offsets.min(axis=0) + offsets.max(axis=0)) / 2
    deviation = random.uniform(0, width, joints) * (random.uniform() < 0.8)
    return np.abs(offsets).max(axis=0) + deviation, offsets, deviation
