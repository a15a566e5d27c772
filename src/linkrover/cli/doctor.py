"""`linkrover doctor`: what is wrong with this machine, its radio and the path to the peer."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from linkrover.doctor.examine import Examination
from linkrover.doctor.finding import Finding, Status, run_checks
from linkrover.doctor.render import as_json, as_lines, closing
from linkrover.probe.address import load_key
from linkrover.stress.protocol import DEFAULT_PORT as STRESS_PORT
from linkrover.stress.protocol import check_token, load_token

TOKEN_VARIABLE = "LINKROVER_STRESS_TOKEN"  # noqa: S105  # the name of a variable, not a secret


def doctor(
    *,
    interface: str | None = None,
    peer: str | None = None,
    key_file: Path | None = None,
    stress_token_file: Path | None = None,
    stress_port: int = STRESS_PORT,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Check this machine, its radio and the path to the peer; say what to mend, with the exact command.

    Each line is OK, WARN, FAIL or UNKNOWN, with the value found; where
    something is to be done also why it matters for a robot and what mends it.
    Nothing is changed. Reading needs no root. Exit status 1 if anything FAILs.

    With --peer the other end must run `linkrover reflect` or an agent with
    --reflect. The bufferbloat test loads the link and needs the peer's consent
    token (`linkrover reflect --allow-stress` prints it) in
    LINKROVER_STRESS_TOKEN or --stress-token-file.

    Args:
        interface: The one to check; by default every wireless one, else the one towards the peer or the default route.
        peer: HOST or HOST:PORT of the other end's reflector.
        key_file: Key of authenticated probes, where the peer's reflector has one.
        stress_token_file: File with the peer's consent token.
        stress_port: TCP port of the peer's consent server.
        json: Print one JSON object instead of the page.
    """
    token = load_token(stress_token_file) if stress_token_file is not None else None
    given = os.environ.get(TOKEN_VARIABLE)
    if token is None and given:
        token = check_token(given.strip().encode(), f"in {TOKEN_VARIABLE}")
    examination = Examination(
        interface=interface,
        peer=peer,
        key=load_key(key_file) if key_file is not None else None,
        stress_token=token,
        stress_port=stress_port,
    )
    width = shutil.get_terminal_size((100, 24)).columns
    colour = sys.stdout.isatty() and "NO_COLOR" not in os.environ
    findings: list[Finding] = []
    for finding in run_checks(examination.checks()):
        findings.append(finding)
        if not json:
            print("\n".join(as_lines(finding, width=width, colour=colour)), flush=True)
    print(as_json(findings) if json else f"\n{closing(findings)}")
    return 1 if any(f.status is Status.FAIL for f in findings) else 0
