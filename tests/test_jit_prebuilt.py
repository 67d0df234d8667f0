"""Which prebuilt kernels are used: those of these sources, this Python, this Numba, and a processor like this one."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from rootmatch.jit import cache, prebuilt, sources
from rootmatch.jit.locks import FileLock


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    prebuilt.write_manifest(tmp_path)
    return tmp_path


def change(folder: Path, **entries: object) -> None:
    path = folder / prebuilt.MANIFEST
    path.write_text(json.dumps({**json.loads(path.read_text()), **entries}))


@pytest.fixture
def able(monkeypatch: pytest.MonkeyPatch) -> dict[str, bool]:
    """A processor with everything that is asked for."""
    _, needed = prebuilt.GENERIC[prebuilt.architecture()]
    features = dict.fromkeys(needed, True)
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", lambda: features)
    monkeypatch.setattr(numba.config, "ENABLE_AVX", 1)
    return features


def test_kernels_of_these_versions_are_used(folder: Path, able: dict[str, bool]) -> None:
    assert prebuilt.reason_for_misfit(folder) is None


def test_a_folder_without_kernels_is_told(tmp_path: Path) -> None:
    assert prebuilt.reason_for_misfit(tmp_path) == "none come with this installation"


@pytest.mark.parametrize(
    ("entries", "told"),
    [
        ({"interpreter": "cpython-30 numba 0.1"}, "for cpython-30 numba 0.1, and this is"),
        ({"sources": "0" * 16}, "of other sources"),
        ({"files": ["gone.py"]}, "cannot be read"),
        ({"files": 3}, "cannot be read"),
        ({"cpu": "another"}, "lacks another"),
    ],
)
def test_others_are_left_alone(folder: Path, able: dict[str, bool], entries: dict[str, object], told: str) -> None:
    change(folder, **entries)
    assert told in str(prebuilt.reason_for_misfit(folder))


def test_a_processor_without_what_they_need_is_told(
    folder: Path, able: dict[str, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    for feature in list(able)[:1]:
        able[feature] = False
        assert prebuilt.reason_for_misfit(folder) == f"this processor lacks {feature}"
        able[feature] = True
    monkeypatch.setattr(numba.config, "CPU_NAME", "generic")
    assert "asks for a processor" in str(prebuilt.reason_for_misfit(folder))


def test_the_stamp_is_that_of_the_sources() -> None:
    assert prebuilt.stamp() == sources.stamp() == sources.digest(sources.compiled_sources())


class Terminal(io.StringIO):
    """Standard error on a screen."""

    def isatty(self) -> bool:
        return True


def test_a_first_compilation_is_told_once_and_in_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    for screen, lines in ((Terminal(), 1), (io.StringIO(), 0)):
        monkeypatch.setattr(cache, "_announce_once", [])
        monkeypatch.setattr(sys, "stderr", screen)
        cache._announce("one")
        cache._announce("another")
        assert screen.getvalue().count("\n") == lines
        assert ("`rootmatch warmup` does it in advance" in screen.getvalue()) == bool(lines)


WAIT = """
import sys, time
from pathlib import Path
from rootmatch.jit.locks import FileLock
lock = FileLock.taken(Path(sys.argv[1]))
print("taken", flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(os.name == "nt", reason="no such locks on Windows")
def test_a_lock_is_for_one_process_and_dies_with_it(tmp_path: Path) -> None:
    file = tmp_path / "one.kernel"
    command = [sys.executable, "-c", WAIT, str(file)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=environment, **pipes) as first:  # type: ignore[call-overload]
        assert first.stdout.readline() == "taken\n"
        with subprocess.Popen(command, env=environment, **pipes) as second:  # type: ignore[call-overload]
            with pytest.raises(subprocess.TimeoutExpired):
                second.wait(0.5)
            first.kill()
            assert second.stdout.readline() == "taken\n"
            second.stdin.close()
    lock = FileLock.taken(file)
    assert lock is not None
    lock.release()
    assert list(tmp_path.iterdir()) == []
