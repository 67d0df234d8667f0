"""Many images at once: ``rootmatch match`` where the image file has a column ``frame``, each matched for itself."""

from __future__ import annotations

import json
import pickle
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rootmatch.errors import InputError

if TYPE_CHECKING:
    from rootmatch.io import PointSet
    from rootmatch.io.frame_files import Frame

CHUNK = 16
"""Frames that go to a worker together."""
AHEAD = 4
"""Chunks sent ahead for each thread of a cluster."""


@dataclass(frozen=True)
class FrameOutputs:
    """Where the results of many frames go."""

    output: Path | None
    poses: Path | None
    as_json: bool
    resume: bool

    @property
    def paths(self) -> dict[str, Path]:
        """The files to write, by option."""
        return {flag: path for flag, path in (("--output", self.output), ("--poses", self.poses)) if path is not None}

    def check(self, inputs: list[Path]) -> None:
        """Refuse before any work what could not be written."""
        from rootmatch.io import check_output

        taken = list(inputs)
        for flag, path in self.paths.items():
            check_output(path, flag, taken)
            if path.suffix.lower() != ".csv":
                raise InputError(f"{flag} {path}: many frames are written as CSV; give a name that ends in .csv")
            taken.append(path)
        if self.resume and not self.paths:
            raise InputError("--resume: nothing is written that could be continued; give --output or --poses")


@dataclass(frozen=True)
class Job:
    """What a worker needs to match frames: the arguments of `rootmatch.Matcher`, and names for the rows."""

    source: PointSet
    problem: Any
    options: dict[str, Any]


def match_frames(job: Job, image: Path, outputs: FrameOutputs, jobs: int, scheduler: str | None) -> bool:
    """Match every frame of a file and write what is found; whether all of them are matched.

    Frames that an earlier run has written are left out where ``outputs`` resumes.
    """
    from rootmatch.cameras.rig import rig_of
    from rootmatch.cli.frame_outputs import COVARIANCES, MATCH_COLUMNS, POSE_COLUMNS, Appended
    from rootmatch.io.frame_files import read_frames

    headers = {"--output": MATCH_COLUMNS, "--poses": (*POSE_COLUMNS, *COVARIANCES)}
    count: Counter[str] = Counter()
    with ExitStack() as files:
        open_files = {
            flag: files.enter_context(closing(Appended(path, headers[flag], outputs.resume)))
            for flag, path in outputs.paths.items()
        }
        done = set.intersection(*(file.done for file in open_files.values())) if open_files else set[int]()
        dimension = job.problem.target_dimension or job.source.points.shape[1]
        read = read_frames(image, dimension, of_rig=rig_of(job.problem) is not None)
        frames = (frame for frame in read if frame.number not in done)
        for number, status, rows, record in _results(job, frames, jobs, scheduler):
            for flag, file in open_files.items():
                if number not in file.done:
                    file.write(rows[flag])
            count[status] += 1
            if outputs.as_json:
                print(json.dumps(record, allow_nan=False), flush=True)
    text = ", ".join(f"{count[status]} {status}" for status in ("matched", "ambiguous", "untrusted"))
    before = f", {len(done)} done before" if done else ""
    print(f"{count.total()} frames: {text}{before}", file=sys.stderr if outputs.as_json else sys.stdout)
    return count.total() == count["matched"]


Result = tuple[int, str, dict[str, list[list[Any]]], dict[str, Any]]


def _results(job: Job, frames: Iterator[Frame], jobs: int, scheduler: str | None) -> Iterator[Result]:
    packed = pickle.dumps(job)
    chunks = iter(lambda: tuple(islice(frames, CHUNK)), ())
    if scheduler is not None:
        yield from _on_cluster(packed, chunks, scheduler)
    elif jobs == 1:
        for frame in frames:
            yield from _matched(packed, (frame,))
    else:
        import joblib

        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator", batch_size=1, pre_dispatch="2*n_jobs")
        for results in parallel(joblib.delayed(_matched)(packed, chunk) for chunk in chunks):
            yield from results


def _on_cluster(packed: bytes, chunks: Iterator[tuple[Frame, ...]], scheduler: str) -> Iterator[Result]:
    """In order, with a bounded number of chunks on their way."""
    from rootmatch.backends.dask import connected

    with connected(scheduler) as client:
        most = AHEAD * sum(client.nthreads().values())
        waiting = [client.submit(_matched, packed, chunk, pure=False) for chunk in islice(chunks, most)]
        while waiting:
            yield from waiting.pop(0).result()
            waiting += [client.submit(_matched, packed, chunk, pure=False) for chunk in islice(chunks, 1)]


def _matched(packed: bytes, frames: tuple[Frame, ...]) -> list[Result]:
    """Results of some frames, in a process of its own or in this one."""
    from rootmatch.cli.frame_outputs import match_rows, pose_rows
    from rootmatch.jit.threads import at_most
    from rootmatch.report.json_record import match_record

    job, matcher = _matcher(packed)
    results = []
    with at_most(1):
        for frame in frames:
            found = matcher.match(frame.points)
            rows = {
                "--output": match_rows(frame.number, found, job.source),
                "--poses": pose_rows(frame.number, found),
            }
            record = {"frame": frame.number, **match_record(found)}
            results.append((frame.number, found.status.name.lower(), rows, record))
    return results


@lru_cache(maxsize=1)
def _matcher(packed: bytes) -> tuple[Job, Any]:
    """The matcher of a job, made once in each process."""
    from rootmatch.matcher import Matcher

    job: Job = pickle.loads(packed)
    return job, Matcher(job.source.points, job.problem, **job.options)
