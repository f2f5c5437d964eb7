"""A certificate for encrypted lines."""

import subprocess
from pathlib import Path


def certificate(folder: Path) -> dict[str, str]:
    """One made as docs/how-to/talk-over-a-socket.md tells; returns the environment that names it."""
    names = "subjectAltName=IP:127.0.0.1"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
         "-subj", "/CN=deltaq", "-addext", names, "-keyout", folder / "lines.key", "-out", folder / "lines.pem"],
        check=True, capture_output=True,
    )  # fmt: skip
    return {
        "DELTAQ_LINES_CERTIFICATE_FILE": str(folder / "lines.pem"),
        "DELTAQ_LINES_KEY_FILE": str(folder / "lines.key"),
    }
