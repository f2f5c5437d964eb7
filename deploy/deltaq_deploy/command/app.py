"""The command: one table of its verbs, each with two examples.

No file of verbs imports a heavy package (numpy, pydantic, zenoh, matplotlib) outside of its functions, so that help and
completion are quick.
"""

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperGroup

from deltaq_deploy.command import (
    advise,
    demo,
    drive,
    fault,
    installation,
    krc,
    operate,
    recordings,
    routine,
    streams,
    study,
    up,
    watch,
)
from deltaq_deploy.command.krc_lag import lag
from deltaq_deploy.launch import USAGE

RENAMED = {
    "top": "status --watch",
    "health": "status --service",
    "echo": "topic echo",
    "hz": "topic hz",
    "record": "recording record",
    "replay": "recording replay",
    "plot": "recording plot",
    "report": "recording report",
    "follow": "camera follow",
    "view": "camera view",
    "key": "keys --secret",
    "soak": "bench soak",
    "peg-and-valve": "experiment peg-and-valve",
    "bench advisor": "advise --offline",
}
"""Former verbs, and the present ones."""


class Verbs(TyperGroup):
    """typer's group. It also names the new verb for a former one, and an option's invalid value."""

    def invoke(self, ctx: Any) -> Any:  # typer keeps the class of its contexts to itself
        """Run a verb.

        Raises:
            typer.BadParameter: an option has an invalid value.
        """
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            from pydantic import ValidationError

            # a verb of a group passes here once more than others
            if ctx.parent is None and isinstance(error.__cause__, ValidationError):
                first, *_ = error.__cause__.errors()
                error.message = f"{error.message}, got {first['input']!r}"
            raise

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the requested verb.

        Raises:
            typer.Exit: the verb has another name now; standard error shows it.
        """
        asked = " ".join(([] if ctx.parent is None else [ctx.info_name]) + args[:1])
        if args and args[0] not in self.commands and (present := RENAMED.get(asked)):
            typer.echo(f"deltaq: `deltaq {asked}` is now `deltaq {present}`", err=True)
            raise typer.Exit(USAGE)
        return super().resolve_command(ctx, args)


class Verb(NamedTuple):
    """One verb of the command, or of a group of verbs.

    Attributes:
        name: as typed; a verb of a group has the group's name before its own.
        does: the function that runs it; for a group its help text, or the function for the group alone.
        examples: two complete commands, for the end of its help.
    """

    name: str
    does: Callable[..., None] | str
    examples: tuple[str, str]


RUN = "Run a cell"
WATCH = "Look at a running cell"
COMMAND = "Command a running cell"
STUDY = "Study and check"
REAL = "Real robots"

VERBS: dict[str, tuple[Verb, ...]] = {
    RUN: (
        Verb("up", up.up, ("deltaq up", "deltaq up --cell lab-4ms --record start.mcap --no-console")),
        Verb("demo", demo.demo, ("deltaq demo --open", "deltaq demo --duration-s 20 --no-console --json")),
        Verb(
            "keys",
            installation.keys,
            (
                "deltaq keys --cell lab --output identities --operator anna",
                "deltaq keys --secret --output operator.token",
            ),
        ),
    ),
    WATCH: (
        Verb("status", watch.status, ("deltaq status --watch", "deltaq status --service sim --json")),
        Verb(
            "topic",
            "Follow the streams of a running cell: their messages, their rates.",
            ("deltaq topic echo state --robot gr --count 1", "deltaq topic hz --duration-s 2"),
        ),
        Verb(
            "topic echo",
            streams.echo,
            ("deltaq topic echo state --robot fr --count 3", "deltaq topic echo proximity --count 1"),
        ),
        Verb("topic hz", streams.hz, ("deltaq topic hz", "deltaq topic hz --duration-s 2 --json")),
        Verb(
            "recording",
            "Record a cell; replay, draw and report recordings.",
            (
                "deltaq recording record --output run.mcap --duration-s 5",
                "deltaq recording report run.mcap --json",
            ),
        ),
        Verb(
            "recording record",
            recordings.record,
            (
                "deltaq recording record --output run.mcap --duration-s 5",
                "deltaq recording record --output short.mcap --duration-s 5 --json",
            ),
        ),
        Verb(
            "recording replay",
            recordings.replay,
            ("deltaq recording replay run.mcap", "deltaq recording replay run.mcap --json"),
        ),
        Verb(
            "recording plot",
            recordings.plot,
            ("deltaq recording plot run.mcap", "deltaq recording plot run.mcap --output paths.png"),
        ),
        Verb(
            "recording report",
            recordings.report,
            ("deltaq recording report run.mcap", "deltaq recording report run.mcap --json"),
        ),
        Verb("metrics", watch.metrics, ("deltaq metrics", "deltaq metrics --cell lab --port 9465")),
        Verb("ros2", watch.ros2, ("deltaq ros2", "deltaq ros2 --accept-trajectories fr --domain-id 7")),
        Verb("audit", watch.audit, ("deltaq audit", "deltaq audit --robot fr --lines 10 --json")),
    ),
    COMMAND: (
        Verb(
            "drive",
            drive.drive,
            ("deltaq drive --robot fr", "deltaq drive --robot gr --mode decoupled --script steps.yaml"),
        ),
        Verb(
            "run",
            drive.run,
            (
                "deltaq run turn.py:Turn --robot fr",
                "deltaq run turn.py:Turn --robot fr --url tcp/127.0.0.1:7447",
            ),
        ),
        Verb(
            "camera",
            "Follow a robot with a camera; change or show what the camera looks at.",
            ("deltaq camera follow --duration-s 5", "deltaq camera view --distance-m 0.9"),
        ),
        Verb(
            "camera follow",
            operate.follow,
            (
                "deltaq camera follow",
                "deltaq camera follow --robot fr --leader gr --controller paper --duration-s 5",
            ),
        ),
        Verb(
            "camera view",
            operate.view,
            (
                "deltaq camera view --distance-m 0.9",
                "deltaq camera view --target gr:0,0,0.04 --target=-0.4,-0.7,1.3",
            ),
        ),
        Verb(
            "camera show", operate.show_view, ("deltaq camera show", "deltaq camera show --robot fr --json")
        ),
        Verb(
            "advise",
            advise.advise,
            (
                "deltaq advise --cell dawm --offline",
                "deltaq advise --cell dawm --offline --options 3 --criterion clearance=1 --json",
            ),
        ),
        Verb(
            "routine",
            "Inspection and maintenance routines on the equipment of a cell.",
            ("deltaq routine list", "deltaq routine run turn valve_1 quarter_turns=1"),
        ),
        Verb(
            "routine list",
            routine.list_routines,
            ("deltaq routine list", "deltaq routine list --cell lab --json"),
        ),
        Verb(
            "routine run",
            routine.run,
            ("deltaq routine run turn valve_1 quarter_turns=1", "deltaq routine run park --robot gr --json"),
        ),
        Verb(
            "routine resume",
            routine.resume,
            ("deltaq routine resume", "deltaq routine resume --robot gr --abort"),
        ),
        Verb("stop", operate.stop, ("deltaq stop", "deltaq stop --url tcp/127.0.0.1:7447 --json")),
        Verb("reset", operate.reset, ("deltaq reset", "deltaq reset --robot fr --json")),
        Verb("lease", operate.lease, ("deltaq lease --robot fr", "deltaq lease --robot fr --release")),
        Verb("io", operate.io, ("deltaq io --robot gr", "deltaq io --robot gr gripper=on")),
        Verb("contact", operate.contact, ("deltaq contact", "deltaq contact --cell lab --json")),
        Verb(
            "dry-run",
            operate.dry_run,
            (
                "deltaq dry-run --robot fr --dq 0.0001,0,0,0,0,0",
                "deltaq dry-run --robot fr --dq 0,0,0,0,0,0.0001 --json",
            ),
        ),
    ),
    STUDY: (
        Verb(
            "experiment",
            study.experiment,
            (
                "deltaq experiment tracking --duration-s 10 --figure tracking.png",
                "deltaq experiment peg-and-valve --seeds 1 --mode decoupled",
            ),
        ),
        Verb(
            "fault",
            "Inject faults into a moving robot, and report which limits were kept.",
            ("deltaq fault list", "deltaq fault table krc-hiccup --robot fr"),
        ),
        Verb("fault list", fault.list_faults, ("deltaq fault list", "deltaq fault list --json")),
        Verb(
            "fault inject",
            fault.inject,
            (
                "deltaq fault inject krc-hiccup --robot fr",
                "deltaq fault inject krc-silent --robot gr --for-s 0.5 --json",
            ),
        ),
        Verb(
            "fault table",
            fault.table,
            ("deltaq fault table krc-hiccup", "deltaq fault table krc-hiccup hli-dead --robot fr --json"),
        ),
        Verb(
            "fault run",
            fault.run,
            ("deltaq fault run scenario.yaml", "deltaq fault run scenario.yaml --seed 3 --junit faults.xml"),
        ),
        Verb(
            "fault search",
            fault.search,
            (
                "deltaq fault search scenario.yaml --examples 5",
                "deltaq fault search scenario.yaml --examples 5 --output shortest.yaml --json",
            ),
        ),
        Verb(
            "fault impair",
            fault.impair,
            (
                "deltaq fault impair --listen tcp/127.0.0.1:7460 --to tcp/127.0.0.1:7447 --delay-s 0.03"
                " --duration-s 60",
                "deltaq fault impair --listen udp/127.0.0.1:7461 --to udp/127.0.0.1:7462 --loss-share 0.1"
                " --duration-s 2",
            ),
        ),
        Verb(
            "bench", study.bench, ("deltaq bench --cycles 100", "deltaq bench --live --duration-s 5 --json")
        ),
        Verb(
            "bench soak",
            fault.soak,
            (
                "deltaq bench soak --hours 0.01 --output soak",
                "deltaq bench soak --hours 0.01 --output soak --seed 3 --json",
            ),
        ),
        Verb(
            "bench filters",
            study.filters,
            (
                "deltaq bench filters --scenes 1 --cycles 100",
                "deltaq bench filters none gate half.py:half --scenes 1 --cycles 100 --json",
            ),
        ),
        Verb("check", installation.check, ("deltaq check --cell lab", "deltaq check --cell lab --verbose")),
        Verb("schema", installation.schema, ("deltaq schema", "deltaq schema increment")),
        Verb("doctor", installation.doctor, ("deltaq doctor", "deltaq doctor --cell dawm --json")),
    ),
    REAL: (
        Verb(
            "krc",
            "Bring up a real KRC: its files, its telegrams, the lag of its drives.",
            ("deltaq krc files --cell lab --robot fr --output krc", "deltaq krc sniff --port 49152"),
        ),
        Verb(
            "krc files",
            krc.write_krc_files,
            (
                "deltaq krc files --cell lab --robot fr --output krc",
                "deltaq krc files --cell lab --robot fr --output first --limit-deg 2 --start here",
            ),
        ),
        Verb(
            "krc sniff",
            krc.sniff,
            ("deltaq krc sniff --port 49152", "deltaq krc sniff --cell lab --robot fr --duration-s 2 --json"),
        ),
        Verb(
            "krc echo",
            krc.echo,
            ("deltaq krc echo --robot fr", "deltaq krc echo --cell lab --robot fr --duration-s 2 --json"),
        ),
        Verb(
            "krc lag",
            lag,
            ("deltaq krc lag --robot fr", "deltaq krc lag --cell lab --robot gr --output gr-lag.png --json"),
        ),
    ),
}


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"deltaq {version('deltaq')}")
        raise typer.Exit


def _common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version, and exit."
        ),
    ] = False,
) -> None:
    pass


def _group(**options: Any) -> typer.Typer:
    return typer.Typer(cls=Verbs, pretty_exceptions_enable=False, rich_markup_mode="rich", **options)


def _command() -> typer.Typer:
    command = _group(
        help="A networked control server for industrial manipulators: any controller, one safety gate.",
        epilog=_epilog("deltaq demo", "deltaq status --watch"),
        no_args_is_help=True,
        callback=_common,
    )
    groups: dict[str, typer.Typer] = {}
    for panel, verbs in VERBS.items():
        heads = {verb.name.partition(" ")[0] for verb in verbs if " " in verb.name}
        for name, does, examples in verbs:
            group, _, own_name = name.rpartition(" ")
            epilog = _epilog(*examples)
            if name not in heads:
                parent = groups[group] if group else command
                of_panel = None if group else panel
                paragraphs = (does.__doc__ or "").split("\n\n")
                text = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
                parent.command(own_name, help=text, rich_help_panel=of_panel, epilog=epilog)(does)  # type: ignore[type-var]
                continue
            if isinstance(does, str):
                groups[name] = _group(help=does, epilog=epilog, no_args_is_help=True)
            else:
                groups[name] = _group(epilog=epilog, callback=does, invoke_without_command=True)
            command.add_typer(groups[name], name=name, rich_help_panel=panel)
    return command


def _epilog(*examples: str) -> str:
    """The end of a help text; an empty line between two examples keeps each on lines of its own."""
    return "\n\n".join(("Examples:", *(f"[bold]{example}[/bold]" for example in examples)))


app = _command()
