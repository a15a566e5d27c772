"""The `linkrover` command: one verb, one file; a verb's module is imported only when it is used."""

from __future__ import annotations

import os
import sys

from cyclopts import App

from linkrover import __version__
from linkrover.cli._help import HelpFormatter
from linkrover.errors import ConfigError, LinkRoverError, missing_extra

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_INTERRUPTED = 130

app = App(
    name="linkrover",
    version=__version__,
    help="Measures a mobile robot's Wi-Fi link at both ends while it drives, records it, and says what happened.",
    help_epilogue="Start with: linkrover demo (no radio, no ROS needed). Exit status: 0 done, 1 failed or a stated "
    "limit broken, 2 wrong usage, 130 interrupted.",
    help_formatter=HelpFormatter(),
    help_format="plaintext",  # the default reads help as Markdown, whose parser costs a third of the start-up time
)

VERBS: tuple[tuple[str, str, str], ...] = (
    ("demo", "demo:demo", "A real two-ended measurement over an emulated link, with a report."),
    ("agent", "agent:agent", "Measure at this end: link, traffic, errors, delay to the peer; record it."),
    ("reflect", "reflect:reflect", "Answer probes (STAMP reflector): the ping-only station."),
    ("probe", "probe:probe", "Probe a reflector: round trip, one-way loss, jitter, delay variation."),
    ("info", "info:info", "What is in a recording."),
    ("report", "report:report", "Tables, figures and a report of one or several runs."),
    ("compare", "compare:compare", "Is a new run worse than a base run, beyond noise?"),
    ("import", "import_:import_", "Turn the published 2021 CSV files into recordings."),
    ("convert", "convert:convert", "Recordings to a partitioned Parquet dataset."),
    ("doctor", "doctor:doctor", "Check this machine, its radio and the path to the peer; say what to mend."),
    ("stress", "stress:stress", "Round trip and loss while the link is loaded, through the peer's agent."),
    ("model", "model:app", "Fit radio models to recordings, and predict from them."),
    ("emulate", "emulate:emulate", "Run any program behind an emulated Wi-Fi link."),
    ("experiment", "experiment:app", "Cases x trials: emulate or run a whole campaign."),
    ("ros1", "ros1:app", "ROS 1 nodes: client, server, ping-server, traffic."),
    ("ros2", "ros2:app", "ROS 2 nodes, without a ROS 2 installation: client, server, ping-server."),
)

_wanted = sys.argv[1] if len(sys.argv) > 1 else ""
for _name, _target, _help in VERBS:
    # the one verb that is called is loaded anyway: its own docstring says more than the line here
    app.command(f"linkrover.cli.{_target}", name=_name, help=None if _name == _wanted else _help)


def main() -> None:
    """Entry point: runs the verb, turns what a user can mend into one line and exit status 1 (2: wrong usage)."""
    try:
        app()
    except ConfigError as error:
        print(f"linkrover: {error}", file=sys.stderr)
        sys.exit(EXIT_USAGE)
    except LinkRoverError as error:
        print(f"linkrover: {error}", file=sys.stderr)
        sys.exit(EXIT_FAILED)
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    except BrokenPipeError:
        # the reader of our output went away (head, less); nothing is left to say
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except ModuleNotFoundError as error:
        extra = missing_extra(error)
        if extra is None:
            raise
        print(f"linkrover: {extra}", file=sys.stderr)
        sys.exit(EXIT_FAILED)
    except OSError as error:
        if error.filename is None:
            raise
        # a file or folder the user named: not there, not his, or the disk is full
        print(f"linkrover: {error.filename}: {error.strerror}", file=sys.stderr)
        sys.exit(EXIT_FAILED)
