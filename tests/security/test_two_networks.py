"""The guarded realm across two networks: who has no identity of the cell stays outside, whatever it tries."""

import json
import os
import subprocess
import sys

import pytest
from identities import make
from networks import why_none
from ran import ran

from deltaq_protocol.certified.names import IDENTITY
from studies.two_sites.sites import sites, within, write_cell

pytestmark = [
    pytest.mark.long,
    pytest.mark.service,
    pytest.mark.skipif(bool(why_none()), reason=why_none()),
]

GATE = """
import sys
from deltaq_cell.load import load_cell
from deltaq_protocol.sayings import SIM
from deltaq_protocol.topic import Party
from deltaq_services.guarded_realm import open_guarded_session
session = open_guarded_session(load_cell(sys.argv[1]), Party.SIM, SIM, listen=[SIM])
heard = session.declare_subscriber("**", lambda sample: print(sample.key_expr, flush=True))
print("listens", flush=True)
sys.stdin.read()
session.close()
"""

STRANGER = """
import sys, time
from pathlib import Path
from deltaq_cell.load import load_cell
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.session import open_session
from deltaq_services.service_identity import tls_settings
file, folder, how = sys.argv[1:]
cell = load_cell(file)
link = cell.sim.replace("tls/", "tcp/") if how == "plain" else cell.sim
tls = tls_settings(cell, Path(folder), "hli") if folder else None
try:
    session = open_session(connect=[link], must_connect=True, tls=tls)
except ServiceUnreachableError:
    print("outside")
    sys.exit()
print("inside", flush=True)
for _ in range(50):
    for key in ("fr/admission", "fr/supervision", "fr/state", "health/sim", "fr/request"):
        session.put(f"deltaq-guarded/lab/{key}", b"said")
    time.sleep(0.02)
session.close()
"""


def run_in(namespace, program, *arguments):
    done = ran(within(namespace, [sys.executable, "-c", program, *map(str, arguments)]))
    return done.stdout.strip()


def test_foreign_identities_are_refused_and_the_hli_can_send_as_itself_only(tmp_path):
    own, others = (make(tmp_path / name, cell="lab") for name in ("identities", "others"))
    with sites() as made:
        cell = write_cell(tmp_path)
        command = within(made.robots, [sys.executable, "-c", GATE, str(cell)])
        with subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {IDENTITY: str(own)},
        ) as gate:
            assert gate.stdout.readline() == "listens\n"
            for folder, how in (("", "plain"), ("", "tls"), (others, "tls")):
                assert run_in(made.office, STRANGER, cell, folder, how) == "outside", json.dumps(
                    [str(folder), how]
                )
            assert run_in(made.office, STRANGER, cell, own, "tls") == "inside"
            gate.stdin.close()
            heard = set(gate.stdout.read().split())
    assert heard == {"deltaq-guarded/lab/fr/request"}
