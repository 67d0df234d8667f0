"""Kernels of a wheel serve what README and pages show, without compiling; one that `rootmatch.warmup` misses is found.

They run where the package is installed with kernels (`make smoke-wheel`, which `.ci/run` calls): each call in a process
of its own whose cache is empty, by the compiler's own counters.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rootmatch.jit import prebuilt
from rootmatch.precompile.scenes import OWN
from rootmatch.problems import PROBLEMS
from rootmatch.solvers import SOLVERS

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")

COUNTED = """
import sys
from numba.core import event
from numba.core.dispatcher import Dispatcher
compiled, loaded = event.RecordingListener(), []
event.register("numba:compile", compiled)
before = Dispatcher.add_overload
Dispatcher.add_overload = lambda self, result: (loaded.append(self), before(self, result))
exec(sys.argv[1])
names = sorted({str(one.data["dispatcher"].py_func) for _, one in compiled.buffer})
assert not names, names
assert loaded, "what is counted is not there"
assert not any(one.stats.cache_misses for one in loaded)
"""
"""A program whose argument has to run without compiling: by Numba's events, and by its count of misses."""

MATCH = """
import rootmatch as rm
from rootmatch.simulation import p3p_scene, three_plus_one_scene, up2p_scene
scene = {make}
rm.match(scene.source, scene.target, scene.problem, noise=0.5{options})
"""

needs_kernels = pytest.mark.skipif(
    prebuilt.reason_for_misfit() is not None, reason=f"make smoke-wheel runs it; here {prebuilt.reason_for_misfit()}"
)


def matching(make: str, options: str = "") -> str:
    """A program that matches a simulated scene."""
    return MATCH.format(make=make, options=options)


def programs() -> Iterator[tuple[str, str]]:
    """What must not compile, by name."""
    for name, make in {"p3p": "p3p_scene", "up2p": "up2p_scene", "3p1": "three_plus_one_scene"}.items():
        yield f"match {name}", matching(f"{make}(9, 3, 0.5, 7)")
        yield f"paper's preset, {name}", matching(f"{make}(9, 0, 0.5, 7)", ', preset="paper", samples=3000')
    for name in ("p3p", "up2p"):
        make = f"{name}_scene"
        yield f"guided {name}", matching(f"{make}(14, 10, 0.5, 7)", ', sampler="guided"')
        yield f"guided by itself, {name}", matching(f"{make}(30, 25, 0.5, 7)")
        yield f"motions of {name}", matching(f"{make}(12, 3, 0.5, 7, motions=2)", ", motions=2")
        yield f"normals of {name}", matching(f"{make}(9, 3, 0.5, 7)", ", normals=scene.source")
    yield "motions counted", matching("up2p_scene(12, 3, 0.5, 7, motions=2)", ', motions="auto"')
    yield "noise estimated", matching("p3p_scene(9, 1, 0.5, 7)").replace("noise=0.5", 'noise="auto"')
    for name in PROBLEMS:
        if name in OWN:
            scene = f"from rootmatch.precompile.scenes import sample; scene = sample({name!r})"
            yield (
                f"match {name}",
                f"{scene}\n"
                + MATCH.partition("scene = {make}")[2]
                .format(options="")
                .replace("rm.match", "import rootmatch as rm; rm.match"),
            )
    for name in SOLVERS:
        yield f"solver {name}", matching("up2p_scene(9, 3, 0.5, 7)", f", solver={name!r}")
        yield f"solver {name}, p3p", matching("p3p_scene(8, 2, 0.5, 7)", f", solver={name!r}")
    yield "README", "\n".join(re.findall(r"^```python\n(.*?)^```", README, re.DOTALL | re.MULTILINE))
    yield (
        "README's frames",
        (
            matching("p3p_scene(10, 5, 0.5, 1)") + "matcher = rm.Matcher(scene.source, scene.problem, noise=0.5)\n"
            "for _ in range(3):\n    matcher.match(scene.target)\n"
        ),
    )
    yield (
        "residuals",
        (
            matching("p3p_scene(9, 0, 0.5, 7)")
            + "first = [[0, 1, 2, 3]]\nrm.residuals(scene.source, scene.target, scene.problem, first, first)\n"
        ),
    )


PROGRAMS = dict(programs())


def commands() -> list[str]:
    """The arguments of the first two commands that the page on the command line runs."""
    text = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8").replace("\\\n", " ")
    found = re.findall(r"^ +\$ rootmatch ((?:simulate|match) [^\n]*)", text, re.MULTILINE)
    assert [words.split()[0] for words in found[:2]] == ["simulate", "match"]
    return found[:2]


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """A program in a process of its own, whose cache is empty."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": ""}
    command = [sys.executable, "-c", COUNTED, code]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@needs_kernels
@pytest.mark.parametrize("name", PROGRAMS)
def test_nothing_is_compiled(name: str, tmp_path: Path) -> None:
    done = run(PROGRAMS[name], tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]


@needs_kernels
def test_the_first_commands_compile_nothing(tmp_path: Path) -> None:
    simulate, match = commands()
    call = "from rootmatch.cli import main\nsys.argv[1:] = {words!r}.split()\ntry:\n    main()\n"
    call += "except SystemExit as end:\n    assert not end.code, end.code\n"
    done = subprocess.run(
        [sys.executable, "-m", "rootmatch", *simulate.split()], cwd=tmp_path, capture_output=True, check=False
    )
    assert done.returncode == 0
    done = run(call.format(words=match), tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]


@needs_kernels
def test_where_it_must_compile_the_counters_tell(tmp_path: Path) -> None:
    done = run("from numba import njit\nnjit(lambda x: x + 1)(1)", tmp_path)
    assert done.returncode == 1
    assert "lambda" in done.stderr
