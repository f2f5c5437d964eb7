"""The table of counters: everything that a service counts, and what it means.

The reference is written from it; a test fails if a counter has no row. Braces mark a variable part, which is filled
in: such a name is one row. Counts run from the start of the process.
"""

from __future__ import annotations

from dataclasses import dataclass

HLI = "hli"
SIM = "sim"
ROBOT_SERVER = "robot_server"
CONSOLE = "console"


@dataclass(frozen=True, slots=True)
class Counted:
    """One row.

    Attributes:
        service: the service that counts it.
        name: as in the status, with its variable part in braces.
        meaning: what was counted.
    """

    service: str
    name: str
    meaning: str


COUNTERS: tuple[Counted, ...] = (
    Counted(HLI, "states", "states of robots, one for each cycle that was heard"),
    Counted(HLI, "states_ignored", "states of a robot, or with joints, that the cell does not have"),
    Counted(HLI, "increments", "increments received, valid or not"),
    Counted(HLI, "increments_unproven", "increments over zenoh that show no lease; they were not read"),
    Counted(
        HLI,
        "increments_too_many",
        "increments of a holder beyond those that are judged in a cycle; they were not read",
    ),
    Counted(
        HLI,
        "increments_repeated",
        "lost or overtaken increments that a later increment repeated for the jitter buffer",
    ),
    Counted(HLI, "increments_overtaken", "increments that came after a later increment had repeated them"),
    Counted(HLI, "requests", "increments passed on to the gate: at most one for each robot and cycle"),
    Counted(HLI, "refused", "increments that never reached the gate"),
    Counted(HLI, "refused_{code}", "increments that never reached the gate, for this reason"),
    Counted(
        HLI, "signs_of_life", "cycles without an increment to pass on, in which the gate got a heartbeat"
    ),
    Counted(HLI, "carried", "late increments whose motion later ones carried out"),
    Counted(HLI, "verdicts_{outcome}", "verdicts of the gate with this outcome"),
    Counted(HLI, "verdicts_ignored", "verdicts on a robot that the cell does not have"),
    Counted(
        HLI,
        "internal_errors",
        "messages that were refused after an unexpected error; one that concerns motion holds its robot",
    ),
    Counted(HLI, "malformed", "malformed messages of clients; each got an error if its sender is known"),
    Counted(HLI, "malformed_guarded", "malformed messages from the guarded realm"),
    Counted(
        HLI,
        "stale_guarded",
        "messages from the guarded realm that were sent to another process, by a process that another has replaced, "
        "or before one that has come",
    ),
    Counted(HLI, "version_mismatches", "clients that speak another version of the protocol"),
    Counted(
        HLI,
        "signs_of_life_of_another_cell",
        "heartbeats of a service that has read another description of the cell",
    ),
    Counted(HLI, "leases_granted", "leases that were granted, taken ones included"),
    Counted(HLI, "leases_taken", "leases that were taken from their holder"),
    Counted(HLI, "leases_expired", "leases that ran out because the holder was silent"),
    Counted(HLI, "leases_outdated", "leases ended because the gate knows of later ones"),
    Counted(HLI, "lease_refused_{code}", "lease requests refused for this reason"),
    Counted(HLI, "controllers_lost", "holders that vanished without releasing a robot that they had moved"),
    Counted(HLI, "stops", "stops that were requested"),
    Counted(HLI, "resets", "resets that were requested"),
    Counted(HLI, "dry_runs", "dry runs that were requested"),
    Counted(HLI, "views_asked", "requests for another view of a robot's camera"),
    Counted(HLI, "contacts_switched", "requests to allow or forbid a contact"),
    Counted(HLI, "commands_unanswered", "commands that the gate did not answer in time"),
    Counted(HLI, "commands_too_many", "commands refused because clients sent too many in a second"),
    Counted(HLI, "stops_sent_again", "stops sent once more because the gate had not answered them"),
    Counted(HLI, "zenoh_sessions_open", "zenoh sessions of clients that are open now"),
    Counted(HLI, "connections_lost", "TCP connections that ended"),
    Counted(HLI, "tcp_connections", "TCP connections that began"),
    Counted(HLI, "tcp_connections_open", "TCP connections that are open now"),
    Counted(
        HLI,
        "tcp_connections_given_way",
        "TCP connections closed before they were accepted, because too many came",
    ),
    Counted(
        HLI,
        "tcp_connections_refused",
        "TCP connections refused because all places were taken; a stop is still obeyed on them",
    ),
    Counted(
        HLI, "tokens_wrong", "wrong tokens in the hello of TCP clients; the log has each with its address"
    ),
    Counted(
        HLI,
        "tokens_not_compared",
        "tokens refused without a comparison because wrong ones came from the same address",
    ),
    Counted(
        HLI,
        "tokens_in_clear",
        "tokens that came from another machine over lines without TLS; none was compared, and each connection ended",
    ),
    Counted(HLI, "tcp_unencrypted", "TCP connections that ended because the TLS handshake failed"),
    Counted(
        HLI,
        "tcp_lines_slowed",
        "times that lines of TCP clients had to wait because too many came",
    ),
    Counted(HLI, "tcp_given_up", "TCP connections ended for a missing hello, long lines or malformed ones"),
    Counted(HLI, "tcp_not_reading", "TCP connections ended because their client did not read its answers"),
    Counted(
        HLI, "tcp_states_skipped", "states replaced by newer ones before a slow TCP client had read them"
    ),
    Counted(
        HLI,
        "{topic}_dropped",
        "messages of this topic dropped because they came too fast to be served",
    ),
    Counted(
        HLI, "failed", "messages that could not be served because of a fault of the HLI; its log has each"
    ),
    Counted(
        HLI,
        "attempts_refused_{what}_{code}",
        "attempts of clients that were refused for this reason, as the audit log names both",
    ),
    Counted(HLI, "audit_lines", "entries of the audit log that were handed to its file"),
    Counted(
        HLI,
        "audit_lines_lost",
        "entries of the audit log that could not be written to its file, e.g. because the disk is full",
    ),
    Counted(
        HLI,
        "audit_entries_unpublished",
        "entries of the audit log that were not published for recorders because there were too many",
    ),
    Counted(SIM, "{outcome}", "increments with this outcome"),
    Counted(SIM, "reason_{code}", "verdicts whose first reason is this one"),
    Counted(SIM, "command_{kind}", "commands of this kind that were obeyed"),
    Counted(SIM, "command_{code}", "commands not obeyed for this reason"),
    Counted(SIM, "missed_admissions_{robot}", "admissions that the Robot Server of this robot did not take"),
    Counted(SIM, "in_hand_{robot}", "increments that were carried over to the next cycle of this robot"),
    Counted(SIM, "unknown_state", "states of a robot, or with joints, that the cell does not have"),
    Counted(
        SIM,
        "states_of_another_cell_{robot}",
        "states of a Robot Server that has read another description of the cell",
    ),
    Counted(
        SIM,
        "impossible_states_{robot}",
        "states of this robot that the gate cannot have caused; each stops all robots",
    ),
    Counted(
        SIM,
        "internal_errors",
        "messages that were refused after an unexpected error; each holds the robot that it concerns",
    ),
    Counted(SIM, "unknown_request", "requests for a robot that the cell does not have"),
    Counted(
        SIM,
        "stale_messages",
        "messages that were sent to another process, by a process that another has replaced, or before one that has "
        "come",
    ),
    Counted(SIM, "invalid_messages", "messages that are malformed"),
    Counted(ROBOT_SERVER, "admissions", "admissions that were taken"),
    Counted(ROBOT_SERVER, "{refusal}", "admissions that were not taken, by reason, e.g. `admission_late`"),
    Counted(
        ROBOT_SERVER,
        "admission_while_not_ready",
        "admissions that came in a phase in which the robot must not move",
    ),
    Counted(ROBOT_SERVER, "braked_cycles", "cycles of the brake, because no admission was taken"),
    Counted(
        ROBOT_SERVER,
        "braked_cycles_{cause}",
        "the same by what caused them: `no_admission`, since none had come by then; one that was not taken, e.g. "
        "`admission_unchained`; or the reason for which the robot is held",
    ),
    Counted(ROBOT_SERVER, "held_{reason}", "times that the robot was held for this reason"),
    Counted(
        ROBOT_SERVER,
        "supervision_of_another_cell",
        "heartbeats of a gate that has read another description of the cell",
    ),
    Counted(
        ROBOT_SERVER,
        "internal_errors",
        "messages, cycles and telegrams that failed with an unexpected error; each holds the robot",
    ),
    Counted(ROBOT_SERVER, "krc_silent", "times that the KRC sent nothing for longer than it may"),
    Counted(ROBOT_SERVER, "modes_refused", "sessions of a KRC that does not take corrections as offsets"),
    Counted(
        ROBOT_SERVER,
        "motion_stops",
        "times that the KRC was ordered to end a motion that went on although its setpoint rested",
    ),
    Counted(ROBOT_SERVER, "replies_refused", "replies that the last check refused"),
    Counted(ROBOT_SERVER, "replies_unsent", "replies that the socket could not send"),
    Counted(ROBOT_SERVER, "socket_errors", "errors while reading the socket"),
    Counted(
        ROBOT_SERVER,
        "{sender}",
        "datagrams of other senders than the KRC, by sender, e.g. `telegrams_second_krc`",
    ),
    Counted(ROBOT_SERVER, "telegrams_implausible", "telegrams whose values cannot be true"),
    Counted(ROBOT_SERVER, "reply_missed", "cycles whose reply the KRC did not take"),
    Counted(ROBOT_SERVER, "session_restarted", "RSI sessions that restarted"),
    Counted(ROBOT_SERVER, "telegrams_garbled", "datagrams that are no telegram of this robot"),
    Counted(ROBOT_SERVER, "telegrams_skipped", "telegrams skipped because a newer one had come"),
    Counted(
        ROBOT_SERVER,
        "stale_{message}",
        "messages of this type that were sent to another process, by a process that another has replaced, or before "
        "one that has come",
    ),
    Counted(ROBOT_SERVER, "invalid_{message}", "malformed messages of this type"),
    Counted(CONSOLE, "clients", "browsers that were let in"),
    Counted(CONSOLE, "clients_refused", "browsers refused because all places were taken"),
    Counted(CONSOLE, "turned_away", "WebSockets of a foreign page, or with a wrong token"),
    Counted(CONSOLE, "messages", "messages of browsers, valid or not"),
    Counted(CONSOLE, "malformed", "messages of browsers that are not valid commands"),
    Counted(CONSOLE, "malformed_heard", "messages of the HLI that could not be understood"),
    Counted(CONSOLE, "internal_errors", "messages and ticks that failed with an unexpected error"),
    Counted(CONSOLE, "too_many", "commands beyond the number that a browser may send in a second"),
    Counted(CONSOLE, "repeated", "commands with an id that was used before"),
    Counted(CONSOLE, "expired", "commands that came too late to be carried out"),
    Counted(CONSOLE, "refused", "commands refused for another reason"),
    Counted(CONSOLE, "refused_by_driver", "requests that a robot's driver did not carry out"),
    Counted(CONSOLE, "stops", "stops that were pressed"),
    Counted(CONSOLE, "tokens_wrong", "wrong tokens that were shown; the log has each with its address"),
    Counted(
        CONSOLE,
        "tokens_not_compared",
        "tokens refused without a comparison because wrong ones came from the same address",
    ),
)
"""The table."""
