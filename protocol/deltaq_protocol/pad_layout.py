"""What each part of a gamepad does, at the console and in `deltaq drive` alike: both take their layout from here."""

from dataclasses import dataclass
from enum import StrEnum

VIEW_STEP_M = 0.1
"""By how much a press of the cross changes the view distance [m]."""
VIEW_RANGE_M = (0.4, 2.5)
"""Between which view distances a gamepad chooses [m]."""


class PadFunction(StrEnum):
    """Function of a gamepad control; only the console has `robot` and `picture`."""

    MOVE = "move"
    TURN = "turn"
    STOP = "stop"
    MODE = "mode"
    FRAME = "frame"
    HAND = "hand"
    OUTPUT = "output"
    ON = "on"
    OFF = "off"
    NEARER = "nearer"
    FARTHER = "farther"
    PREVIOUS = "previous"
    NEXT = "next"
    ROBOT = "robot"
    PICTURE = "picture"


@dataclass(frozen=True)
class PadControl:
    """A button or a trigger.

    Attributes:
        name: its name by SDL.
        standard: its place in the standard mapping of browsers (W3C, Gamepad, section 12).
        function: its function.
        words: its function as text, short enough for a drawing.
    """

    name: str
    standard: int
    function: PadFunction
    words: str


PAD_LAYOUT = (
    PadControl("left_shoulder", 4, PadFunction.MOVE, "hold: move"),
    PadControl("right_shoulder", 5, PadFunction.TURN, "hold: turn"),
    PadControl("left_trigger", 6, PadFunction.OFF, "output off"),
    PadControl("right_trigger", 7, PadFunction.ON, "output on"),
    PadControl("back", 8, PadFunction.ROBOT, "next robot"),
    PadControl("start", 9, PadFunction.OUTPUT, "next output"),
    PadControl("y", 3, PadFunction.MODE, "next mode"),
    PadControl("x", 2, PadFunction.FRAME, "world / tool"),
    PadControl("a", 0, PadFunction.HAND, "next hand"),
    PadControl("b", 1, PadFunction.STOP, "stop"),
    PadControl("up", 12, PadFunction.NEARER, "view nearer"),
    PadControl("down", 13, PadFunction.FARTHER, "view farther"),
    PadControl("left", 14, PadFunction.PREVIOUS, "joint or option −, slower"),
    PadControl("right", 15, PadFunction.NEXT, "joint or option +, faster"),
    PadControl("left_stick", 10, PadFunction.PICTURE, "large picture"),
)
"""Every button that does something.

The sticks count only while `move` or `turn` is held: the left one goes along, or turns about, x (ahead) and y (left),
the right one z (ahead). In modes of joints the left stick drives the chosen joint, in those of ways it goes there.
"""
