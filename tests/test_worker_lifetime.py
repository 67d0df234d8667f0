"""Workers of a sweep end with their parent, however that one ends."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

SCRIPT = """
import os, signal, sys, time
from pathlib import Path
from rootmatch.backends.worker_lifetime import pool

signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background

def work(folder):
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(120)

with pool(2) as workers:
    for one in [workers.submit(work, sys.argv[1]) for _ in range(2)]:
        one.result()
"""


def running(pid: int) -> bool:
    """Whether a process is there and not merely unburied."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_no_worker_is_left_running(tmp_path: Path, how: signal.Signals) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    folder = tmp_path / "workers"
    folder.mkdir()
    parent = subprocess.Popen([sys.executable, str(script), str(folder)], stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while len(list(folder.iterdir())) < 2:
        assert parent.poll() is None, "the workers' parent ended by itself"
        assert time.monotonic() < deadline, "the workers do not start"
        time.sleep(0.05)
    workers = [int(path.name) for path in folder.iterdir()]
    assert all(map(running, workers))
    os.kill(parent.pid, how)
    parent.wait(timeout=60)
    deadline = time.monotonic() + 30
    while any(map(running, workers)):
        assert time.monotonic() < deadline, "a worker outlives its parent"
        time.sleep(0.1)
