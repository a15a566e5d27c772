from __future__ import annotations

import subprocess
import sys

import pytest

from linkrover.cli.main import VERBS

LINKROVER = [sys.executable, "-m", "linkrover"]
HEAVY = ("numpy", "polars", "scipy", "matplotlib", "plotly", "rosbags", "sklearn", "arch", "asyncio", "rospy")
WITHOUT = """
import sys
sys.modules[{module!r}] = None
sys.argv = ["linkrover", *{arguments!r}]
from linkrover.cli.main import main
main()
"""
HELP = """
import sys
sys.argv = ["linkrover", *{arguments!r}]
from linkrover.cli.main import main
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
print("imported:", [name for name in {heavy!r} if name in sys.modules])
"""


def run(*arguments, **more):
    return subprocess.run([*LINKROVER, *arguments], capture_output=True, text=True, **more)


def test_the_version_is_printed():
    done = run("--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout[0].isdigit()


@pytest.mark.parametrize("verb", ["", *(name for name, _, _ in VERBS)])
def test_help_teaches_and_imports_nothing_heavy(verb):
    arguments = [verb, "--help"] if verb else ["--help"]
    done = subprocess.run(
        [sys.executable, "-c", HELP.format(arguments=arguments, heavy=HEAVY)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("imported: []\n"), done.stdout[-300:]
    assert f"Usage: linkrover {verb}".rstrip() in done.stdout


def test_an_unknown_verb_is_wrong_usage():
    assert run("reprot").returncode == 2


@pytest.mark.parametrize(
    ("module", "extra", "arguments"),
    [
        ("numpy", "report", ["report", "RUN"]),
        ("numpy", "report", ["compare", "RUN", "RUN"]),
        ("numpy", "report", ["model", "fit", "RUN"]),
        ("polars", "report", ["convert", "RUN", "--to", "parquet", "SET"]),
    ],
)
def test_without_an_extra_a_verb_says_how_to_install_it(module, extra, arguments, tmp_path):
    recording = tmp_path / "RUN" / "robot"
    recording.mkdir(parents=True)
    (recording / "robot.mcap").write_bytes(b"")
    code = WITHOUT.format(module=module, arguments=arguments)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 1
    assert f"pip install 'linkrover[{extra}]'" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "give at least one RUN"),
        (["RUN", "--outage-threshold", "-1"], "must be more than 0 s"),
        (["RUN", "--outage-threshold", "nan"], "must be more than 0 s"),
        (["RUN", "--out", "report.doc"], "say --format"),
    ],
)
def test_a_report_that_cannot_be_made_is_refused_by_name(arguments, words):
    done = run("report", *arguments)
    assert done.returncode == 2
    assert words in done.stderr


def test_a_file_that_cannot_be_made_is_one_line():
    done = run("demo", "--duration", "3", "--out", "/proc/here")
    assert done.returncode == 1
    assert done.stderr == "linkrover: /proc/here: No such file or directory\n"


def test_a_reader_that_goes_away_is_no_complaint():
    help_text = subprocess.Popen([*LINKROVER, "agent", "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    help_text.stdout.close()
    assert help_text.stderr.read() == b""
    help_text.stderr.close()
    help_text.wait(30)
