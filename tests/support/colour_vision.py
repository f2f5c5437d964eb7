"""Colours as people see them who lack one kind of cone, and how far apart two colours are.

Simulation: Machado, Oliveira and Fernandes, A Physiologically-based Model for Simulation of Color Vision Deficiency,
2009, severity 1. Distance: Euclidean in CIELAB (D65); about 2 is just seen side by side.
"""

from itertools import combinations

import numpy as np

VISIONS = {
    "usual": np.eye(3),
    "protanopia": np.array([
        [0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998],
    ]),
    "deuteranopia": np.array([
        [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881],
    ]),
    "tritanopia": np.array([
        [1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900],
    ]),
}  # fmt: skip
_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_WHITE = np.array([0.95047, 1.0, 1.08883])


def linear(colour):
    """The linear RGB of `#rrggbb`, (3,)."""
    share = np.array([int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)])
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def lab(colour, vision):
    """CIELAB of a colour as somebody of that vision sees it, (3,)."""
    x = _XYZ @ np.clip(VISIONS[vision] @ linear(colour), 0, 1) / _WHITE
    f = np.where(x > 216 / 24389, np.cbrt(x), (24389 / 27 * x + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def nearest(colours, vision):
    """The least distance of two of the named colours, and their names."""
    return min(
        (float(np.linalg.norm(lab(first, vision) - lab(second, vision))), one, other)
        for (one, first), (other, second) in combinations(colours.items(), 2)
    )


def contrast(first, second):
    """Contrast of two colours as WCAG 2 counts it, from 1 to 21."""
    low, high = sorted(float(linear(colour) @ _XYZ[1]) for colour in (first, second))
    return (high + 0.05) / (low + 0.05)
