"""The command: one table of its verbs, and one of examples.

No file of verbs imports a heavy package (numpy, pydantic, zenoh, matplotlib) outside of its functions, so that help and
completion are quick.
"""

from collections.abc import Callable
from typing import Annotated, Any

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


VERBS: dict[str, dict[str, Callable[..., None] | str]] = {
    "Run a cell": {
        "up": up.up,
        "demo": demo.demo,
        "keys": installation.keys,
    },
    "Look at a running cell": {
        "status": watch.status,
        "topic": "Follow the streams of a running cell: their messages, their rates.",
        "topic echo": streams.echo,
        "topic hz": streams.hz,
        "recording": "Record a cell; replay, draw and report recordings.",
        "recording record": recordings.record,
        "recording replay": recordings.replay,
        "recording plot": recordings.plot,
        "recording report": recordings.report,
        "metrics": watch.metrics,
        "ros2": watch.ros2,
        "audit": watch.audit,
    },
    "Command a running cell": {
        "drive": drive.drive,
        "run": drive.run,
        "camera": "Follow a robot with a camera; change or show what the camera looks at.",
        "camera follow": operate.follow,
        "camera view": operate.view,
        "camera show": operate.show_view,
        "advise": advise.advise,
        "routine": "Inspection and maintenance routines on the equipment of a cell.",
        "routine list": routine.list_routines,
        "routine run": routine.run,
        "routine resume": routine.resume,
        "stop": operate.stop,
        "reset": operate.reset,
        "lease": operate.lease,
        "io": operate.io,
        "contact": operate.contact,
        "dry-run": operate.dry_run,
    },
    "Study and check": {
        "experiment": study.experiment,
        "fault": "Inject faults into a moving robot, and report which limits were kept.",
        "fault list": fault.list_faults,
        "fault inject": fault.inject,
        "fault table": fault.table,
        "fault run": fault.run,
        "fault search": fault.search,
        "fault impair": fault.impair,
        "bench": study.bench,
        "bench soak": fault.soak,
        "bench filters": study.filters,
        "check": installation.check,
        "schema": installation.schema,
        "doctor": installation.doctor,
    },
    "Real robots": {
        "krc": "Bring up a real KRC: its files, its telegrams, the lag of its drives.",
        "krc files": krc.write_krc_files,
        "krc sniff": krc.sniff,
        "krc echo": krc.echo,
        "krc lag": lag,
    },
}
"""The verbs by panel of the help: the function that runs each, or the help of a group, which precedes its verbs."""

_EXAMPLES = """
deltaq up
deltaq up --cell lab-4ms --record start.mcap --no-console
deltaq demo --open
deltaq demo --duration-s 20 --no-console --json
deltaq keys --cell lab --output identities --operator anna
deltaq keys --secret --output operator.token
deltaq status --watch
deltaq status --service sim --json
deltaq topic echo state --robot fr --count 3
deltaq topic echo proximity --count 1
deltaq topic hz
deltaq topic hz --duration-s 2 --json
deltaq recording record --output run.mcap --duration-s 5
deltaq recording record --output short.mcap --duration-s 5 --json
deltaq recording replay run.mcap
deltaq recording replay run.mcap --json
deltaq recording plot run.mcap
deltaq recording plot run.mcap --output paths.png
deltaq recording report run.mcap
deltaq recording report run.mcap --json
deltaq metrics
deltaq metrics --cell lab --port 9465
deltaq ros2
deltaq ros2 --accept-trajectories fr --domain-id 7
deltaq audit
deltaq audit --robot fr --lines 10 --json
deltaq drive --robot fr
deltaq drive --robot gr --mode decoupled --script steps.yaml
deltaq run turn.py:Turn --robot fr
deltaq run turn.py:Turn --robot fr --url tcp/127.0.0.1:7447
deltaq camera follow
deltaq camera follow --robot fr --leader gr --controller paper --duration-s 5
deltaq camera view --distance-m 0.9
deltaq camera view --target gr:0,0,0.04 --target=-0.4,-0.7,1.3
deltaq camera show
deltaq camera show --robot fr --json
deltaq advise --cell lab --offline --task peg
deltaq advise --cell dawm --offline --options 3 --criterion clearance=1 --json
deltaq routine list
deltaq routine list --cell lab --json
deltaq routine run turn valve_1 quarter_turns=1
deltaq routine run park --robot gr --json
deltaq routine resume
deltaq routine resume --robot gr --abort
deltaq stop
deltaq stop --url tcp/127.0.0.1:7447 --json
deltaq reset
deltaq reset --robot fr --json
deltaq lease --robot fr
deltaq lease --robot fr --release
deltaq io --robot gr
deltaq io --robot gr gripper=on
deltaq contact
deltaq contact --cell lab --json
deltaq dry-run --robot fr --dq 0.0001,0,0,0,0,0
deltaq dry-run --robot fr --dq 0,0,0,0,0,0.0001 --json
deltaq experiment tracking --duration-s 10 --figure tracking.png
deltaq experiment peg-and-valve --seeds 1 --mode decoupled
deltaq fault list
deltaq fault list --json
deltaq fault inject krc-hiccup --robot fr
deltaq fault inject krc-silent --robot gr --for-s 0.5 --json
deltaq fault table krc-hiccup
deltaq fault table krc-hiccup hli-dead --robot fr --json
deltaq fault run scenario.yaml
deltaq fault run scenario.yaml --seed 3 --junit faults.xml
deltaq fault search scenario.yaml --examples 5
deltaq fault search scenario.yaml --examples 5 --output shortest.yaml --json
deltaq fault impair --listen tcp/127.0.0.1:7460 --to tcp/127.0.0.1:7447 --delay-s 0.03 --duration-s 60
deltaq fault impair --listen udp/127.0.0.1:7461 --to udp/127.0.0.1:7462 --loss-share 0.1 --duration-s 2
deltaq bench --cycles 100
deltaq bench --live --duration-s 5 --json
deltaq bench soak --hours 0.01 --output soak
deltaq bench soak --hours 0.01 --output soak --seed 3 --json
deltaq bench filters --scenes 1 --cycles 100
deltaq bench filters none gate half.py:half --scenes 1 --cycles 100 --json
deltaq check --cell lab
deltaq check --cell lab --verbose
deltaq schema
deltaq schema increment
deltaq doctor
deltaq doctor --cell dawm --json
deltaq krc files --cell lab --robot fr --output krc
deltaq krc files --cell lab --robot fr --output first --limit-deg 2 --start here
deltaq krc sniff --port 49152
deltaq krc sniff --cell lab --robot fr --duration-s 2 --json
deltaq krc echo --robot fr
deltaq krc echo --cell lab --robot fr --duration-s 2 --json
deltaq krc lag --robot fr
deltaq krc lag --cell lab --robot gr --output gr-lag.png --json
"""


def _examples() -> dict[str, tuple[str, ...]]:
    """The examples of each verb: an example begins with the verb's name. A group shows one of each of two verbs."""
    names = [name for verbs in VERBS.values() for name in verbs]
    found: dict[str, tuple[str, ...]] = dict.fromkeys(names, ())
    for example in _EXAMPLES.split("\n")[1:-1]:
        meant = [name for name in names if f"{example} ".startswith(f"deltaq {name} ")]
        found[max(meant, key=len)] += (example,)
    for group in (name for name in names if not found[name]):
        found[group] = tuple(found[name][0] for name in names if name.startswith(f"{group} "))[:2]
    return found


EXAMPLES = _examples()
"""Two complete commands or more for each verb, for the end of its help."""


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
        heads = {name.partition(" ")[0] for name in verbs if " " in name}
        for name, does in verbs.items():
            group, _, own_name = name.rpartition(" ")
            epilog = _epilog(*EXAMPLES[name])
            if isinstance(does, str):
                groups[name] = _group(help=does, epilog=epilog, no_args_is_help=True)
            elif name in heads:
                groups[name] = _group(epilog=epilog, callback=does, invoke_without_command=True)
            else:
                parent = groups[group] if group else command
                of_panel = None if group else panel
                paragraphs = (does.__doc__ or "").split("\n\n")
                text = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
                parent.command(own_name, help=text, rich_help_panel=of_panel, epilog=epilog)(does)
                continue
            command.add_typer(groups[name], name=name, rich_help_panel=panel)
    return command


def _epilog(*examples: str) -> str:
    """The end of a help text; an empty line between two examples keeps each on lines of its own."""
    return "\n\n".join(("Examples:", *(f"[bold]{example}[/bold]" for example in examples)))


app = _command()
