"""Decisions on a stream of pictures: when each was taken, which are shown and how large, and the test pattern. Pure."""

import math
import zlib
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

Pixels = npt.NDArray[np.uint8]

MOST_WIDTH, MOST_HEIGHT = 1280, 720
"""Larger pictures are made smaller [px]."""
MOST_PER_S = 30.0
"""Further pictures are left out."""
_EVENNESS = 0.2
"""Share of the time between two pictures by which a source may be early."""
_DRIFT = 1e-4
"""Greatest difference between the rates of two clocks."""
_JUMP_S = 5.0
"""A picture that seems older comes from a source whose clock has begun anew."""
_LONGEST_RETRY_S = 8.0


def retry_s(attempt: int) -> float:
    """Time until a source is tried again, after so many attempts in vain [s]."""
    return min(0.5 * 2.0 ** min(attempt, 10), _LONGEST_RETRY_S)


def shown_size(width: int, height: int) -> tuple[int, int]:
    """The size in which a picture is shown, in even numbers [px]."""
    scale = min(1.0, MOST_WIDTH / width, MOST_HEIGHT / height)
    return max(2, int(width * scale) // 2 * 2), max(2, int(height * scale) // 2 * 2)


class CaptureClock:
    """When pictures were taken, on this machine's clock.

    As NTP does, it takes the least difference of the clocks for the shortest way: a picture that comes later than
    others was under way for longer. So the age of a picture that waited in a buffer is told. The shortest way itself,
    from lens to this process, is not seen.
    """

    def __init__(self) -> None:
        self._least_s = math.inf
        self._read_s = 0.0

    def taken_s(self, stamp_s: float, read_s: float) -> float:
        """When the picture was taken that the source stamps so, and that was read at that time [s]."""
        least_s, difference_s = self._least_s + _DRIFT * (read_s - self._read_s), read_s - stamp_s
        if difference_s > least_s + _JUMP_S:
            least_s = difference_s
        self._least_s, self._read_s = min(least_s, difference_s), read_s
        return stamp_s + self._least_s

    def due_s(self, stamp_s: float, now_s: float) -> float:
        """When a picture of a file is due, so that it plays as it was taken [s]."""
        return now_s if math.isinf(self._least_s) else stamp_s + self._least_s


class PictureLimit:
    """Leaves out pictures that come faster than `MOST_PER_S`."""

    def __init__(self) -> None:
        self._due_s = -math.inf

    def takes(self, captured_s: float) -> bool:
        """Whether the picture that was taken then is shown."""
        period_s = 1.0 / MOST_PER_S
        if self._due_s - 1.0 < captured_s < self._due_s - _EVENNESS * period_s:
            return False
        self._due_s = max(self._due_s, captured_s - period_s) + period_s
        return True


class Unchanged:
    """For how long pictures have been equal."""

    def __init__(self) -> None:
        self._sum: int | None = None
        self._since_s = self._seen_s = -math.inf

    def for_s(self, jpeg: bytes, captured_s: float) -> float:
        """For how long all pictures have been equal to this one, the newest [s]; nobody may have looked at some."""
        check = zlib.crc32(jpeg)
        if check != self._sum or captured_s - self._seen_s > 1.0:
            self._sum, self._since_s = check, captured_s
        self._seen_s = captured_s
        return captured_s - self._since_s


# The test pattern. Along its lower edge lies the time, for machines: cells that are white for 1, the least bit first.

CELLS = 48
_TIME_BITS, _GROUP_BITS, _OFFSET = 42, 6, 21
_BAND_PX, _DOT_PX, _SQUARE_PX = 24, 6, 48
_GLYPHS = {
    sign: np.pad(
        np.array([code >> 14 - dot & 1 for dot in range(15)], dtype=np.uint8).reshape(5, 3), ((0, 0), (0, 1))
    )
    for sign, code in zip(
        "0123456789:.",
        (0x7B6F, 0x2492, 0x73E7, 0x73CF, 0x5BC9, 0x79CF, 0x79EF, 0x7249, 0x7BEF, 0x7BCF, 0x0410, 0x0002),
        strict=True,
    )
}
"""Five rows of three dots each, and a gap."""


def stamped_bits(time_ms: int) -> npt.NDArray[np.bool_]:
    """The cells of a time since 1970 [ms], with a sum of its groups of six behind it."""
    groups = [time_ms >> shift & 63 for shift in range(0, _TIME_BITS, _GROUP_BITS)]
    code = time_ms | (sum(groups) + _OFFSET) % 64 << _TIME_BITS
    return np.array([code >> bit & 1 for bit in range(CELLS)], dtype=bool)


def stamp_of(luma: Pixels) -> int | None:
    """The time in a picture of the test pattern, by its (height, width) luma [ms]; None if it is not readable."""
    height, width = luma.shape
    middles = ((np.arange(CELLS) + 0.5) * width / CELLS).astype(int)
    code = sum(1 << bit for bit, value in enumerate(luma[height - _BAND_PX // 2, middles]) if value > 127)
    time_ms = code & (1 << _TIME_BITS) - 1
    return (
        time_ms if np.array_equal(stamped_bits(time_ms), [code >> bit & 1 for bit in range(CELLS)]) else None
    )


class MovingPattern:
    """Coloured bars, a square that moves, and a clock.

    Args:
        aspect: width by height.
    """

    def __init__(self, aspect: float) -> None:
        self.height = 480
        self.width = round(self.height * aspect / 2) * 2
        x = np.arange(self.width)
        bars = x * 8 // self.width
        self._luma: Pixels = np.tile((60 + 16 * bars).astype(np.uint8), (self.height, 1))
        self._luma[::40] = self._luma[:, ::40] = 40
        u, v = ((128 + 60 * wave(bars[::2] * np.pi / 4)).astype(np.uint8) for wave in (np.cos, np.sin))
        colour = np.vstack([np.tile(line, (self.height // 2, 1)) for line in (u, v)])
        self._colour: Pixels = colour.reshape(-1, self.width)

    def picture(self, time_s: float) -> Pixels:
        """The picture at a time of day [s], as (3/2 height, width) of planes with half as many colours."""
        luma = self._luma.copy()
        left = int(time_s % 4.0 / 4.0 * (self.width - _SQUARE_PX))
        luma[200 : 200 + _SQUARE_PX, left : left + _SQUARE_PX] = 235
        clock = datetime.fromtimestamp(time_s, UTC).strftime("%H:%M:%S.%f")[:-3]
        dots = np.kron(np.hstack([_GLYPHS[sign] for sign in clock]), np.ones((_DOT_PX, _DOT_PX), np.uint8))
        luma[16 : 16 + dots.shape[0], 16 : 16 + dots.shape[1]] = 16 + 219 * dots
        cell = np.arange(self.width) * CELLS // self.width
        luma[-_BAND_PX:] = np.where(stamped_bits(int(time_s * 1000.0)), 235, 16)[cell]
        return np.vstack([luma, self._colour])
