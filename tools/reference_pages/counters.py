"""The table of counters: all counters of all services, and their meaning.

The reference is written from it; a test fails if a counter has no row. Braces mark a variable part, which is filled
in: such a name is one row. Counts run from the start of the process.
"""

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
        meaning: the counted events.
    """

    service: str
    name: str
    meaning: str


_MEANINGS: dict[str, dict[str, str]] = {
    HLI: {
        "states": "states of robots, one for each received cycle",
        "states_ignored": "states of a robot, or with joints, that the cell does not have",
        "increments": "increments received, valid or not",
        "increments_unproven": "increments over zenoh that show no lease; they were not read",
        "increments_too_many": (
            "increments of a holder beyond those that are judged in a cycle; they were not read"
        ),
        "increments_repeated": (
            "lost or overtaken increments that a later increment repeated for the jitter buffer"
        ),
        "increments_overtaken": "increments that came after a later increment had repeated them",
        "requests": "increments passed on to the gate: at most one for each robot and cycle",
        "refused": "increments that never reached the gate",
        "refused_{code}": "increments that never reached the gate, for this reason",
        "signs_of_life": "heartbeats for the gate: at states without a waiting increment, unless each is taken at once",
        "carried": "late increments whose motion later ones carried out",
        "verdicts_{outcome}": "verdicts of the gate with this outcome",
        "verdicts_ignored": "verdicts on a robot that the cell does not have",
        "internal_errors": (
            "messages that were refused after an unexpected error; one that concerns motion holds its robot"
        ),
        "malformed": "malformed messages of clients; each got an error if its sender is known",
        "malformed_guarded": "malformed messages from the guarded realm",
        "stale_guarded": (
            "messages from the guarded realm to another process, from a replaced process, or older than one "
            "received already"
        ),
        "version_mismatches": "clients that speak another version of the protocol",
        "signs_of_life_of_another_cell": (
            "heartbeats of a service that has read another description of the cell"
        ),
        "leases_granted": "leases that were granted, taken ones included",
        "leases_taken": "leases that were taken from their holder",
        "leases_expired": "leases that ran out because the holder was silent",
        "leases_outdated": "leases ended because the gate knows of later ones",
        "lease_refused_{code}": "lease requests refused for this reason",
        "controllers_lost": "holders that vanished without releasing a robot that they had moved",
        "stops": "stops that were requested",
        "resets": "resets that were requested",
        "dry_runs": "dry runs that were requested",
        "views_asked": "requests for another view of a robot's camera",
        "tools_asked": "requests to couple or release a tool",
        "contacts_switched": "requests to allow or forbid a contact",
        "commands_unanswered": "commands that the gate did not answer in time",
        "commands_too_many": "commands refused because clients sent too many in a second",
        "stops_sent_again": "stops sent once more because the gate had not answered them",
        "zenoh_sessions_open": "zenoh sessions of clients that are open now",
        "connections_lost": "TCP connections that ended",
        "tcp_connections": "TCP connections that began",
        "tcp_connections_open": "TCP connections that are open now",
        "tcp_connections_given_way": (
            "TCP connections closed before they were accepted, because too many came"
        ),
        "tcp_connections_refused": (
            "TCP connections refused because all places were taken; a stop is still obeyed on them"
        ),
        "tokens_wrong": "wrong tokens in the hello of TCP clients; the log has each with its address",
        "tokens_not_compared": (
            "tokens refused without a comparison because wrong ones came from the same address"
        ),
        "tokens_in_clear": (
            "tokens from another machine over lines without TLS; they were not compared, and each connection was closed"
        ),
        "tcp_unencrypted": "TCP connections that ended because the TLS handshake failed",
        "tcp_lines_slowed": "times that lines of TCP clients had to wait because too many came",
        "tcp_given_up": "TCP connections ended for a missing hello, long lines or malformed ones",
        "tcp_not_reading": "TCP connections ended because their client did not read its answers",
        "tcp_states_skipped": "states replaced by newer ones before a slow TCP client had read them",
        "{topic}_dropped": "messages of this topic dropped because they came too fast to be served",
        "failed": "messages that could not be served because of a fault of the HLI; its log has each",
        "attempts_refused_{what}_{code}": (
            "refused attempts of clients, by action and reason, as in the audit log"
        ),
        "audit_lines": "entries of the audit log that were handed to its file",
        "audit_lines_lost": (
            "entries of the audit log that could not be written to its file, e.g. because the disk is full"
        ),
        "audit_entries_unpublished": (
            "entries of the audit log that were not published for recorders because there were too many"
        ),
    },
    SIM: {
        "{outcome}": "increments with this outcome",
        "reason_{code}": "verdicts whose first reason is this one",
        "command_{kind}": "commands of this kind that were obeyed",
        "command_{code}": "commands not obeyed for this reason",
        "missed_admissions_{robot}": "admissions that the Robot Server of this robot did not take",
        "in_hand_{robot}": "increments that were carried over to the next cycle of this robot",
        "unknown_state": "states of a robot, or with joints, that the cell does not have",
        "states_of_another_cell_{robot}": (
            "states of a Robot Server that has read another description of the cell"
        ),
        "impossible_states_{robot}": (
            "states of this robot that the gate cannot have caused; each stops all robots"
        ),
        "internal_errors": (
            "messages that were refused after an unexpected error; each holds the robot that it concerns"
        ),
        "unknown_request": "requests for a robot that the cell does not have",
        "stale_messages": (
            "messages to another process, from a replaced process, or older than one received already"
        ),
        "invalid_messages": "messages that are malformed",
    },
    ROBOT_SERVER: {
        "admissions": "admissions that were taken",
        "{refusal}": "admissions that were not taken, by reason, e.g. `admission_late`",
        "admission_while_not_ready": "admissions that came in a phase in which the robot must not move",
        "braked_cycles": "braked cycles, because no admission was taken",
        "braked_cycles_{cause}": (
            "the same by what caused them: `no_admission`, since none had come by then; one that was not "
            "taken, e.g. `admission_unchained`; or the reason for which the robot is held"
        ),
        "held_{reason}": "times that the robot was held for this reason",
        "supervision_of_another_cell": "heartbeats of a gate that has read another description of the cell",
        "internal_errors": (
            "messages, cycles and telegrams that failed with an unexpected error; each holds the robot"
        ),
        "krc_silent": "times that the KRC was silent for longer than permitted",
        "modes_refused": "sessions of a KRC that does not take corrections as offsets",
        "motion_stops": (
            "times that the KRC was ordered to end a motion that went on although its setpoint rested"
        ),
        "replies_refused": "replies that the last check refused",
        "replies_unsent": "replies that the socket could not send",
        "socket_errors": "errors while reading the socket",
        "{sender}": "datagrams of other senders than the KRC, by sender, e.g. `telegrams_second_krc`",
        "telegrams_implausible": "telegrams whose values cannot be true",
        "reply_missed": "cycles whose reply the KRC did not take",
        "session_restarted": "RSI sessions that restarted",
        "telegrams_garbled": "datagrams that are not telegrams of this robot",
        "telegrams_skipped": "telegrams skipped because a newer one was waiting",
        "stale_{message}": (
            "messages of this type to another process, from a replaced process, or older than one received already"
        ),
        "invalid_{message}": "malformed messages of this type",
    },
    CONSOLE: {
        "clients": "accepted browsers",
        "clients_refused": "browsers refused because all places were taken",
        "turned_away": "WebSockets of a foreign page, or with a wrong token",
        "messages": "messages of browsers, valid or not",
        "malformed": "messages of browsers that are not valid commands",
        "malformed_heard": "messages of the HLI that could not be understood",
        "internal_errors": "messages and ticks that failed with an unexpected error",
        "too_many": "commands beyond the number that a browser may send in a second",
        "expired": "commands that came too late to be carried out",
        "refused": "commands refused for another reason",
        "refused_by_driver": "requests that a robot's driver did not carry out",
        "stops": "stops that were pressed",
        "tokens_wrong": "wrong tokens that were shown; the log has each with its address",
        "tokens_not_compared": (
            "tokens refused without a comparison because wrong ones came from the same address"
        ),
    },
}

COUNTERS: tuple[Counted, ...] = tuple(
    Counted(service, name, meaning) for service, rows in _MEANINGS.items() for name, meaning in rows.items()
)
"""The table."""
