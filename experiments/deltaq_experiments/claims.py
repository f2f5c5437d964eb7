"""The paper's claims beside our results: `python -m deltaq_experiments.claims` writes a page and its pictures.

Every row is one run in virtual time from its seed, so the page can be regenerated at any time with the same result.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from deltaq_experiments.figures import draw
from deltaq_experiments.options import Options
from deltaq_experiments.report import ExperimentOutcome

PAGE = Path("docs/explanation/camera-figures.md")
PICTURES = Path("docs/explanation/pictures")

Reading = Callable[[dict[str, Any]], str]


@dataclass(frozen=True)
class Claim:
    """One row of the table.

    Attributes:
        experiment: module of this package.
        options: of the run.
        claim: the paper's claim, or a stricter one.
        holds: whether a report confirms it.
        reading: the relevant figures of a report.
        picture: name of the picture that is kept; empty for none.
    """

    experiment: str
    options: Options
    claim: str
    holds: Callable[[dict[str, Any]], bool]
    reading: Reading
    picture: str = ""

    @property
    def command(self) -> str:
        """How to run it by hand."""
        options = self.options
        words = ["deltaq experiment", self.experiment, "--controller", options.controller]
        if options.leader_speed_m_s != Options.leader_speed_m_s:
            words += ["--leader-speed-m-s", f"{options.leader_speed_m_s:g}"]
        if options.target != Options.target:
            words += ["--target", options.target]
        if options.seed != Options.seed:
            words += ["--seed", f"{options.seed}"]
        if options.settle_s != Options.settle_s:
            words += ["--settle-s", f"{options.settle_s:g}"]
        return " ".join(words)


def _tracking(report: dict[str, Any]) -> str:
    angle, distance = report["angle_deg"], report["distance_m"]
    largest = f"{angle['max']:.2f}° / {100 * distance['max']:.1f} cm"
    return f"{largest} (rms {angle['rms']:.2f}° / {100 * distance['rms']:.1f} cm)"


def _approach(report: dict[str, Any]) -> str:
    times = [start["time_to_1_deg_s"] for start in report["starts"]]
    said = ", ".join("never" if time is None else f"{time:.2f}" for time in times)
    rise = max(start["largest_rise_deg"] for start in report["starts"])
    return f"{said} s; largest rise on the way {rise:.2f}°"


def _zoom(report: dict[str, Any]) -> str:
    plateaus = ", ".join(
        f"{p['desired_m']:g} m: {p['largest_angle_deg']:.2f}°, "
        + (f"{100 * p['error_m']:.1f} cm" if p["reached"] else _missed(p))
        for p in report["plateaus"]
    )
    return f"{plateaus}; angle on the way at most {report['angle_deg']['max']:.1f}°"


def _missed(plateau: dict[str, Any]) -> str:
    return f"not reached, off by {100 * plateau['error_m']:.1f} cm ({plateau['why_not']})"


def _collision(report: dict[str, Any]) -> str:
    return (
        f"{report['contacts']} contacts, clearance {100 * report['clearance_m']['robots_min']:.1f} cm, angle at most "
        f"{report['angle_deg']['max']:.2f}°, below 1° in {100 * report['angle_below_1_deg_share']:.0f} % of cycles"
    )


def _within(angle_deg: float, distance_m: float) -> Callable[[dict[str, Any]], bool]:
    return lambda r: r["angle_deg"]["max"] <= angle_deg and r["distance_m"]["max"] <= distance_m


def _reached_in(time_s: float) -> Callable[[dict[str, Any]], bool]:
    return lambda r: (
        r["time_to_1_deg_s"] is not None
        and r["time_to_1_deg_s"] <= time_s
        and all(start["largest_rise_deg"] < 0.05 for start in r["starts"])
    )


def _plateaus(report: dict[str, Any]) -> bool:
    return all(p["reached"] or p["why_not"] for p in report["plateaus"]) and all(
        p["reached"] for p in report["plateaus"][:-1]
    )


def _kept_clear(least_m: float) -> Callable[[dict[str, Any]], bool]:
    return lambda r: (
        r["contacts"] == 0 and r["clearance_m"]["robots_min"] >= least_m and r["angle_deg"]["max"] <= 1.0
    )


def _no_contact(report: dict[str, Any]) -> bool:
    return bool(report["contacts"] == 0)


BARRIER_LESS_1_CM = 0.09
"""The programme keeps other robots 10 cm away, twice the gate's stop distance."""

FIRST_ATTACK_S = 1.0
"""By then the camera looks at its focus, and the first attack has just begun [s]."""


def _attack(claim: str, picture: str = "", **options: Any) -> Claim:
    """An attack that `qp` evades while it keeps the view."""
    return Claim(
        "collision",
        Options(controller="qp", settle_s=FIRST_ATTACK_S, **options),
        claim,
        _kept_clear(BARRIER_LESS_1_CM),
        _collision,
        picture,
    )


CLAIMS = (
    Claim(
        "approach", Options(), "Fig. 8: monotone; below 1° in 2 s", _reached_in(2.0), _approach, "fig-8-paper"
    ),
    Claim(
        "approach",
        Options(controller="qp"),
        "monotone; below 1° in 0.6 s",
        _reached_in(0.6),
        _approach,
        "fig-8-qp",
    ),
    Claim("approach", Options(seed=2), "the same from other starts", _reached_in(2.0), _approach),
    Claim(
        "approach",
        Options(controller="qp", seed=2),
        "the same from starts of which one runs A3 into its limit",
        _reached_in(0.6),
        _approach,
    ),
    Claim("tracking", Options(), "Fig. 9: ±1°, ±2 cm", _within(1.0, 0.021), _tracking, "fig-9-paper"),
    Claim(
        "tracking",
        Options(controller="predictive"),
        "the paper's future work (VII-B): 0.1°, 0.3 cm",
        _within(0.1, 0.003),
        _tracking,
    ),
    Claim("tracking", Options(controller="qp"), "0.1°, 0.3 cm", _within(0.1, 0.003), _tracking, "fig-9-qp"),
    Claim(
        "tracking",
        Options(controller="qp", leader_speed_m_s=0.5),
        "at 0.5 m/s: 0.1°, 0.3 cm",
        _within(0.1, 0.003),
        _tracking,
    ),
    Claim(
        "tracking",
        Options(controller="qp", leader_speed_m_s=1.0),
        "at 1 m/s: 0.2°, 1 cm",
        _within(0.2, 0.01),
        _tracking,
    ),
    Claim(
        "zoom",
        Options(),
        "Fig. 10: the distance is kept but where F_rep or a limit stands in the way; the angle is unaffected",
        _plateaus,
        _zoom,
        "fig-10-paper",
    ),
    Claim(
        "zoom",
        Options(controller="predictive"),
        "the same, the focus carried ahead: within 1 cm where it can be reached",
        _plateaus,
        _zoom,
    ),
    Claim(
        "zoom",
        Options(controller="qp"),
        "within 1 cm where it can be reached, and said where not",
        _plateaus,
        _zoom,
        "fig-10-qp",
    ),
    Claim(
        "collision",
        Options(settle_s=FIRST_ATTACK_S),
        "Fig. 11: no contact; the distance gives way, the angle does not",
        _no_contact,
        _collision,
        "fig-11-paper",
    ),
    _attack("no contact, 9 cm kept, 1°", picture="fig-11-qp"),
    _attack("the same", seed=1),
    *(_attack("the same at the wrist", target="wrist", seed=seed) for seed in (0, 1)),
    *(_attack("the same at the lens, 0.5 m/s", leader_speed_m_s=0.5, seed=seed) for seed in (0, 2)),
    *(
        _attack("the same at the lens, 0.75 m/s", leader_speed_m_s=0.75, seed=seed)
        for seed in (0, 1, 4, 6, 9)
    ),
    Claim(
        "collision",
        Options(controller="qp", leader_speed_m_s=0.75, target="elbow", settle_s=FIRST_ATTACK_S),
        "cornered: the gate stops the leader, never a contact",
        _no_contact,
        _collision,
    ),
)


def page(rows: list[tuple[Claim, dict[str, Any]]]) -> str:
    """The page: a table with a row for each claim and its report, and the pictures."""
    lines = [
        "# The paper's figures, and ours",
        "",
        "Written by `make figures`, `python -m deltaq_experiments.claims`. One run a row, virtual time, 12 ms cycle,",
        "60 ms latency, leader at 0.25 m/s and seed 0 unless said otherwise, largest values after `--settle-s`, 5 s if",
        "it is not there.",
        "[The camera follower](camera-follower.md) explains what the controllers do.",
        "",
        "| run | claimed | came out | holds |",
        "| --- | --- | --- | --- |",
    ]
    for claim, report in rows:
        holds = "yes" if claim.holds(report) else "**no**"
        lines.append(f"| `{claim.command}` | {claim.claim} | {claim.reading(report)} | {holds} |")
    for claim, _ in rows:
        if claim.picture:
            lines += ["", f"![{claim.claim}](pictures/{claim.picture}.png)", "", f"`{claim.command}`"]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Run all of them and write the page; returns 1 if a joint passed a limit."""
    parser = argparse.ArgumentParser(prog="python -m deltaq_experiments.claims", description=__doc__)
    parser.add_argument("--root", type=Path, default=Path(), help="where docs/ lies (default: here)")
    root: Path = parser.parse_args().root
    (root / PICTURES).mkdir(parents=True, exist_ok=True)
    rows, violated = [], False
    for claim in CLAIMS:
        outcome: ExperimentOutcome = import_module(f"deltaq_experiments.{claim.experiment}").run(
            claim.options
        )
        report = outcome.report.model_dump(mode="json")
        rows.append((claim, report))
        violated |= any(report["limits"].values())
        print(f"{claim.command}: {claim.reading(report)}", flush=True)
        if claim.picture:
            draw(outcome.panels, claim.command, root / PICTURES / f"{claim.picture}.png")
    (root / PAGE).write_text(page(rows), encoding="utf-8")
    return int(violated)


if __name__ == "__main__":
    raise SystemExit(main())
