"""`deltaq fault impair`."""

from __future__ import annotations

from typing import Annotated, Any

import typer


def impair(
    listen: Annotated[
        str,
        typer.Option(
            metavar="ENDPOINT", help="Address at which the relay listens; one party connects or sends here."
        ),
    ],
    to: Annotated[str, typer.Option(metavar="ENDPOINT", help="Address at which the other party listens.")],
    unit: Annotated[
        str,
        typer.Option(
            help="Unit that the faults affect: bytes, lines or messages over TCP, datagrams over UDP; "
            "bytes or datagrams if not given."
        ),
    ] = "",
    delay_s: Annotated[float, typer.Option(min=0.0, max=10.0, help="Delay of each unit.")] = 0.0,
    jitter_s: Annotated[
        float, typer.Option(min=0.0, max=10.0, help="Largest additional delay of each unit.")
    ] = 0.0,
    keep_order: Annotated[
        bool,
        typer.Option("--keep-order", help="Keep the order in spite of jitter; a byte stream always does."),
    ] = False,
    loss_share: Annotated[float, typer.Option(min=0.0, max=1.0, help="Fraction that is lost.")] = 0.0,
    duplicate_share: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Fraction that is duplicated.")
    ] = 0.0,
    reorder_share: Annotated[float, typer.Option(min=0.0, max=1.0, help="Fraction that is reordered.")] = 0.0,
    corrupt_share: Annotated[float, typer.Option(min=0.0, max=1.0, help="Fraction that is garbled.")] = 0.0,
    rate_bytes_s: Annotated[
        float | None, typer.Option(min=1.0, help="Bytes per second; for a byte stream only.")
    ] = None,
    stall: Annotated[
        bool, typer.Option("--stall", help="Let nothing pass, and lose nothing; for a byte stream only.")
    ] = False,
    cut: Annotated[
        bool, typer.Option("--cut", help="Break connections and refuse new ones; for a byte stream only.")
    ] = False,
    after_s: Annotated[float, typer.Option(min=0.0, help="Time until the faults begin.")] = 0.0,
    for_s: Annotated[
        float | None, typer.Option(min=0.0, help="Duration of the faults; to the end if not given.")
    ] = None,
    duration_s: Annotated[
        float | None, typer.Option(min=0.0, help="Duration of the relay; until Ctrl-C if not given.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 0,
) -> None:
    """Relay a link between two addresses, with delay, loss, duplicates, stalls or cuts.

    It ends with the program that started it.
    """
    import asyncio
    import contextlib

    from deltaq_launch.parent import while_parent_lives
    from deltaq_protocol.endpoint import Endpoint
    from deltaq_verification.impairment.relay import unit_of, wire_faults
    from deltaq_verification.impairment.schedule import impair_for_a_while

    if keep_order and not jitter_s:
        raise typer.BadParameter(
            "without --jitter-s none overtakes another; give one above 0", param_hint="--keep-order"
        )
    near, far = Endpoint.parse(listen), Endpoint.parse(to)
    chosen = unit_of(near, unit)
    asked: dict[str, Any] = {
        "delay_s": delay_s,
        "jitter_s": jitter_s,
        "keeps_order": keep_order,
        "drop": loss_share,
        "duplicate": duplicate_share,
        "reorder": reorder_share,
        "corrupt": corrupt_share,
        "rate_bytes_s": rate_bytes_s,
        "stalled": stall,
        "cut": cut,
    }
    faults = wire_faults(chosen, {name: value for name, value in asked.items() if value})
    with contextlib.suppress(KeyboardInterrupt):  # that is how a relay ends
        asyncio.run(
            while_parent_lives(
                impair_for_a_while(
                    near,
                    far,
                    chosen,
                    faults,
                    typer.echo,
                    after_s=after_s,
                    for_s=for_s,
                    duration_s=duration_s,
                    seed=seed,
                )
            )
        )
