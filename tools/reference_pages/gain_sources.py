"""Where each gain of the camera controllers comes from; `docs/notes/gains.md` is written from this table.

Equations are those of the first paper. A gain that says "trial" was changed until the runs of `deltaq experiment` in
virtual time were good enough, so another value may be as good.
"""

from typing import NamedTuple

TRIAL = "trial"


class GainSource(NamedTuple):
    """Of one gain.

    Attributes:
        unit: of its value; "1" if it has none.
        source: the equation or section that it stands in, or the part of the programme.
        chosen: what its value was chosen by.
    """

    unit: str
    source: str
    chosen: str


FOLLOWER: dict[str, GainSource] = {
    "direction": GainSource("1/s", "k_p of (9)", TRIAL),
    "distance": GainSource("1/s", "k of (14), over the mobility", TRIAL),
    "min_mobility_m2": GainSource("m²/rad²", "(14), where its denominator vanishes", TRIAL),
    "roll": GainSource("1/s", "k_c of (15)", TRIAL),
    "repulsion": GainSource("m³ rad/s", "η of (12), as corrected", TRIAL),
    "repulsion_range_m": GainSource("m", "ρ₀ of (12)", TRIAL),
    "repulsion_min_m": GainSource("m", "(12), bounded where it grows without end", TRIAL),
    "emergency_on_m": GainSource("m", "(13)", "above the 5 cm that the lab's gate keeps"),
    "emergency_off_m": GainSource(
        "m", "(13), hysteresis", "above `emergency_on_m`, so that the two do not alternate"
    ),
    "limit_scale": GainSource("rad", "s_w of (10)", "(11) counted in degrees"),
    "damping": GainSource("1", "(7), near a singularity", TRIAL),
    "horizon_s": GainSource("s", "III-F", "five cycles of 12 ms"),
    "max_step_s": GainSource("s", "III-F, Runge-Kutta", "the horizon: one step"),
    "turn_rad_s2": GainSource("rad/s²", "(9), bounded", TRIAL),
    "zoom_m_s2": GainSource("m/s²", "(14), bounded", TRIAL),
    "spin_rad_s2": GainSource("rad/s²", "(15), bounded", TRIAL),
}

_SIGHT = "line of sight"

SIGHT: dict[str, GainSource] = {
    "clear_m": GainSource("m", _SIGHT, "half of a finger's width"),
    "share": GainSource("1 per cycle", _SIGHT, TRIAL),
    "most_m_s2": GainSource("m/s²", _SIGHT, "seeds 20 to 27: with 3 m/s² the angle was off by up to 2°"),
    "slow_m_s": GainSource("m/s", _SIGHT, TRIAL),
    "stalled_s": GainSource("s", _SIGHT, TRIAL),
    "weight": GainSource("1/mm²", _SIGHT, "seeds 20 to 27, among 3e-4, 1e-3, 3e-3 and 1e-2"),
}

_BARRIER, _EVASION, _ROOM = "barriers", "repulsion (12)", "joint margin, (11)"
_WEIGHT = "a decade or two from the next: order decides, not the value"

QP: dict[str, GainSource] = {
    "clear_of_others_m": GainSource("m", _BARRIER, TRIAL),
    "clear_of_structure_m": GainSource("m", _BARRIER, TRIAL),
    "clear_of_self_m": GainSource("m", _BARRIER, TRIAL),
    "barrier_range_m": GainSource("m", _BARRIER, TRIAL),
    "others_range_m": GainSource("m", _BARRIER, TRIAL),
    "barrier_share": GainSource("1 per cycle", _BARRIER, TRIAL),
    "others_share": GainSource(
        "1 per cycle", _BARRIER, "less than `barrier_share`: evasion begins early and gently"
    ),
    "reaction_s": GainSource("s", "braking distance of others", TRIAL),
    "others_brake_m_s2": GainSource(
        "m/s²", "braking distance of others", "what the scripted leader's stick asks for"
    ),
    "barrier_price": GainSource(
        "cost per m", _BARRIER, "above all tasks: at a tenth of it a camera that looks far off bought slack"
    ),
    "reserve_price": GainSource("cost per m", "braking distance of others", "between barriers and angle"),
    "evasion": GainSource("m³ rad/s", "η of (12)", TRIAL),
    "evasion_range_m": GainSource("m", "ρ₀ of (12)", "that of the paper's law here"),
    "evasion_min_m": GainSource("m", _EVASION, "that of the paper's law here"),
    "limit_scale": GainSource("rad", "s_w of (10)", "that of the paper's law here"),
    "room": GainSource("rad²/s or m²/s", _ROOM, TRIAL),
    "room_rate": GainSource("rad/s or m/s", _ROOM, TRIAL),
    "angle_weight": GainSource("1 per mm²", "tasks", "the unit of the others"),
    "evasion_weight": GainSource("1 per mrad²", "tasks", _WEIGHT),
    "distance_weight": GainSource("1 per mm²", "tasks", _WEIGHT),
    "room_weight": GainSource("1 per mrad²", "tasks", _WEIGHT),
    "posture_weight": GainSource("1 per mrad²", "tasks, nobody near", _WEIGHT),
    "roll_weight": GainSource("1 per mrad²", "tasks", _WEIGHT),
    "rest_weight": GainSource("1 per acceleration limit²", "tasks", _WEIGHT),
    "angle_share": GainSource("1 per cycle", "step of a task", TRIAL),
    "distance_share": GainSource("1 per cycle", "step of a task", TRIAL),
    "roll_share": GainSource("1 per cycle", "step of a task", TRIAL),
    "brake_share": GainSource("1", "step of a task", TRIAL),
    "zoom_m_s2": GainSource("m/s²", "step of a task", TRIAL),
    "spin_rad_s2": GainSource("rad/s²", "step of a task", "that of the paper's law here"),
}

_PLAN, _COST, _END = "horizon of courses", "cost of a step", "cost of a course's end"
_LED = "rows of the programme while a course leads"

ESCAPE: dict[str, GainSource] = {
    "step_s": GainSource("s", _PLAN, TRIAL),
    "steps": GainSource("1", _PLAN, "two seconds ahead, in steps of `step_s`"),
    "rivals": GainSource("1", _PLAN, "what a cycle of 12 ms has time for"),
    "range_m": GainSource("m", _COST, TRIAL),
    "near": GainSource("1", _COST, TRIAL),
    "close_m": GainSource("m", _COST, TRIAL),
    "close": GainSource("1", _COST, "between `near` and `contact`"),
    "contact_m": GainSource("m", _COST, "seeds from 100 on, among 0, 3 and 6 cm"),
    "contact": GainSource("1", _COST, "above all other costs of a step"),
    "view_rad": GainSource("rad", _COST, "below the degree that the figures ask for"),
    "askew": GainSource("1 per rad", _COST, TRIAL),
    "own_m": GainSource("m", _COST, TRIAL),
    "own": GainSource("1", _COST, TRIAL),
    "margin": GainSource("1", _END, TRIAL),
    "limit": GainSource("1", _END, TRIAL),
    "inner_m": GainSource("m", _END, "seeds from 100 on, on the model alone, among 0.5 and 0.8"),
    "inner": GainSource("1", _END, "seeds from 100 on, on the model alone, among 0 and 30"),
    "distance": GainSource("1 per m²", _END, TRIAL),
    "better": GainSource("1", "which course is held", TRIAL),
    "acts_above": GainSource("1", "when a course leads", TRIAL),
    "led_evasion_weight": GainSource("1 per mrad²", _LED, TRIAL),
    "led_weight": GainSource("1 per mm² or mrad²", _LED, "far below `led_evasion_weight`: the course leads"),
}
