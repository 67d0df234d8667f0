"""Tries many calls, files and command lines: ``python tests/fuzz/run_cases.py --calls 10000`` (`make fuzz`).

Cases are numbered, and each is made from its number, so a run goes on where an earlier one stopped. They run in a child
process under bounds of time and memory; one that hangs, or takes the process down, is a failure too. Every failure is
made as simple as it stays one and kept in tests/fuzz/kept, where the test suite finds it.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import random
import resource
import signal
import subprocess
import sys
import time
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
KEPT = HERE / "kept"
SECONDS, GIBIBYTES = 60, 8
"""Bounds of one case; compilation, which comes once, is in them. Seconds of the processor: other work is no fault."""
IDLE = 600
"""Seconds by the clock after which a case counts as hanging though it computes nothing."""


def case(what: str, number: int) -> dict[str, Any]:
    """The recipe of that number."""
    recipe: dict[str, Any] = import_module(f"{what}_cases").recipe(random.Random(f"{what} {number}"))
    return recipe


def fault(what: str, recipe: dict[str, Any]) -> str:
    """What is wrong with a case, in a few words without its figures; nothing if it holds."""
    try:
        import_module(f"{what}_cases").attempt(recipe)
    except Exception as error:
        while (cause := error.__traceback__.tb_next if error.__traceback__ else None) is not None:
            error = error.with_traceback(cause)
        frame = error.__traceback__.tb_frame.f_code if error.__traceback__ else None
        return f"{type(error).__name__} in {frame.co_name if frame else '?'}: {str(error)[:80]}"
    return ""


def sort_of(text: str) -> str:
    """What two faults have in common that are the same mistake."""
    return text.partition(":")[0]


def simplest(what: str, recipe: dict[str, Any], text: str) -> dict[str, Any]:
    """The recipe with everything left out that the fault does without."""
    shorter = True
    while shorter:
        shorter = False
        for other in import_module(f"{what}_cases").simpler(recipe):
            if sort_of(fault(what, other)) == sort_of(text):
                recipe, shorter = other, True
                break
    return recipe


def keep(what: str, recipe: dict[str, Any], text: str) -> Path:
    """Keep a failure as a test."""
    content = json.dumps({"what": what, "fault": text, "recipe": recipe}, indent=1) + "\n"
    name = f"{what}-{hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()[:8]}.json"
    KEPT.mkdir(exist_ok=True)
    (KEPT / name).write_text(content, encoding="utf-8")
    return KEPT / name


def work(what: str, first: int, last: int, seconds: float) -> None:
    """Try cases one after the other; a line on standard output for each, before and after it."""
    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_AS, (GIBIBYTES << 30, GIBIBYTES << 30))
    ends = time.monotonic() + seconds
    known: set[str] = set()
    for number in range(first, last):
        if time.monotonic() > ends:
            break
        print(number, flush=True)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)  # its signal ends the process, also within compiled code
        recipe = case(what, number)
        text = fault(what, recipe)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        if text and sort_of(text) not in known:
            known.add(sort_of(text))
            path = keep(what, simplest(what, recipe, text), text)
            print(f"{number} {text} ({path.name})", flush=True)
        elif text:
            print(f"{number} {text}", flush=True)
        else:
            print(f"{number} holds", flush=True)


def supervised(what: str, first: int, last: int, seconds: float) -> tuple[int, list[str]]:
    """Try cases in a child process; the number of the next one, and the faults that were found."""
    command = [sys.executable, str(Path(__file__).resolve()), "--work", what, str(first), str(last), str(seconds)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    number, done, faults = first - 1, first, []
    watch = _Watch(child)
    for line in child.stdout:
        watch.alive()
        number, _, text = int(line.split()[0]), *line.rstrip("\n").partition(" ")[1:]
        if text:
            done = number + 1
            if text != "holds":
                faults.append(f"{what} {number}: {text}")
                print(faults[-1], file=sys.stderr, flush=True)
    code = child.wait()
    watch.end()
    if number >= done:  # begun and not ended
        hangs = watch.fired or code == -signal.SIGPROF
        text = f"hangs for {SECONDS} s" if hangs else f"ends the process with code {code}"
        keep(what, case(what, number), text)
        faults.append(f"{what} {number}: {text}")
        print(faults[-1], file=sys.stderr, flush=True)
        done = number + 1
    return done, faults


class _Watch:
    """Kills a child process from which nothing has been heard for too long."""

    def __init__(self, child: subprocess.Popen[str]) -> None:
        import threading

        self.child, self.fired, self.heard = child, False, time.monotonic()
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def alive(self) -> None:
        self.heard = time.monotonic()

    def end(self) -> None:
        self.stop.set()
        self.thread.join()

    def _run(self) -> None:
        while not self.stop.wait(1.0):
            if time.monotonic() - self.heard > IDLE:
                self.fired = True
                self.child.kill()
                return


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calls", type=int, default=10_000)
    parser.add_argument("--files", type=int, default=100_000)
    parser.add_argument("--commands", type=int, default=20_000)
    parser.add_argument("--state", type=Path, default=HERE.parents[1] / ".fuzz.json", help="how far earlier runs came")
    parser.add_argument("--seconds", type=float, default=math.inf, help="stop after so long; the next run goes on")
    parser.add_argument("--work", nargs=4, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work:
        work(given.work[0], int(given.work[1]), int(given.work[2]), float(given.work[3]))
        return 0
    sizes = {"call": given.calls, "file": given.files, "command": given.commands}
    state = {what: {"done": 0, "seconds": 0.0, "faults": []} for what in sizes}
    if given.state.exists():
        state |= json.loads(given.state.read_text(encoding="utf-8"))
    ends = time.monotonic() + given.seconds
    for what, size in sizes.items():
        part = state[what]
        while part["done"] < size and time.monotonic() < ends:
            start = time.monotonic()
            left = min(ends - start, 300.0)
            part["done"], faults = supervised(what, part["done"], min(size, part["done"] + 20_000), left)
            part["faults"] += faults
            part["seconds"] += time.monotonic() - start
            given.state.write_text(json.dumps(state, indent=1), encoding="utf-8")
        print(f"{what}s: {part['done']} of {size} in {part['seconds']:.0f} s, {len(part['faults'])} faults")
    return 1 if any(part["faults"] for part in state.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
