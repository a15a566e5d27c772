from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import msgspec
import pytest

from linkrover.emulator import leftovers
from linkrover.emulator.leftovers import OWNER_FILE, Owner, RunFolder, clean, find_leftovers, identify, is_alive
from linkrover.errors import LinkRoverError


@pytest.fixture(autouse=True)
def runtime(monkeypatch):
    """A folder for working folders of this test's own; short, for the sockets in it."""
    with tempfile.TemporaryDirectory(prefix="lr-", dir="/tmp") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield Path(folder)


def killed_run(tmp_path, child_code):
    """A run whose owner was killed while its child, started apart, lives on."""
    code = (
        "import subprocess, sys, time\nfrom pathlib import Path\n"
        "from linkrover.emulator.leftovers import RunFolder\n"
        f"folder = RunFolder(Path({str(tmp_path / 'out')!r}))\n"
        f"child = subprocess.Popen([sys.executable, '-c', {child_code!r}], start_new_session=True)\n"
        "folder.add(child.pid, 'agent')\nprint(child.pid, flush=True)\ntime.sleep(60)\n"
    )
    owner = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    child = int(owner.stdout.readline())
    return owner, child


def test_a_run_that_lives_is_no_leftover_and_its_folder_goes_at_the_end(tmp_path):
    folder = RunFolder(tmp_path / "out")
    folder.add(os.getpid(), "itself")
    assert find_leftovers() == []
    folder.remove()
    assert not folder.path.exists()


@pytest.mark.parametrize(
    "child_code",
    [
        "import time; time.sleep(60)",
        "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(); time.sleep(60)",
    ],
)
def test_what_a_killed_run_left_is_found_ended_and_removed(tmp_path, child_code):
    owner, child = killed_run(tmp_path, child_code)
    time.sleep(0.2)
    owner.kill()
    owner.wait()
    owner.stdout.close()
    (left,) = find_leftovers()
    assert left.owner.out == str(tmp_path / "out")
    assert [process.pid for process in left.alive] == [child]
    clean(left, patience_s=0.5)
    assert leftovers.start_ticks(child) is None
    assert find_leftovers() == []


def test_a_process_that_merely_has_the_same_id_is_left_alone(tmp_path):
    folder = RunFolder(tmp_path / "out")
    owner = msgspec.json.decode((folder.path / OWNER_FILE).read_bytes(), type=Owner)
    older = msgspec.structs.replace(identify(os.getpid(), "another"), start_ticks=1)
    gone = msgspec.structs.replace(owner, process=older, children=(older,))
    (folder.path / OWNER_FILE).write_bytes(msgspec.json.encode(gone))
    (left,) = find_leftovers()
    assert left.alive == ()
    clean(left)
    assert is_alive(identify(os.getpid(), "this test"))


def test_a_damaged_folder_is_a_leftover(tmp_path):
    folder = RunFolder(tmp_path / "out")
    (folder.path / OWNER_FILE).write_bytes(b"{")
    (left,) = find_leftovers()
    clean(left)
    assert not folder.path.exists()


def test_a_base_folder_that_others_can_write_to_is_refused(runtime):
    (runtime / "linkrover").mkdir(mode=0o700)
    (runtime / "linkrover").chmod(0o777)
    with pytest.raises(LinkRoverError, match="only you"):
        find_leftovers()
