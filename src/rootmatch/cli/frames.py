"""Many images at once: ``rootmatch match`` where the image file has a column ``frame``, each matched for itself."""

from __future__ import annotations

import hashlib
import json
import pickle
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, closing, nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rootmatch.cli.error_messages import rephrase_advice
from rootmatch.cli.noise import Noise
from rootmatch.cli.problem_options import flag
from rootmatch.cli.surroundings import note_remainder
from rootmatch.errors import InputError, RootmatchError

if TYPE_CHECKING:
    from rootmatch.io import PointSet
    from rootmatch.io.frame_files import Frame
    from rootmatch.io.known_files import KnownPoses
    from rootmatch.matcher import Matcher

CHUNK = 4
"""Frames that go to a worker together; what a kill loses is a few of these."""
AHEAD = 4
"""Chunks sent ahead for each process, or thread of a cluster."""
LOADING = 10.0
"""Seconds that a process may search while it loads kernels for its first frame; a round value."""
PASSES = 3
"""Times that it does so, where kernels are compiled in between."""


@dataclass(frozen=True)
class FrameOutputs:
    """Outputs for the results of many frames."""

    output: Path | None
    poses: Path | None
    as_json: bool
    resume: bool
    trajectory: bool = False
    """Whether the poses are a trajectory of TUM, whose file may have any name."""

    @property
    def paths(self) -> dict[str, Path]:
        """The files to write, by option."""
        return {flag: path for flag, path in (("--output", self.output), ("--poses", self.poses)) if path is not None}

    def check(self, inputs: list[Path]) -> None:
        """Refuse before any work what could not be written."""
        from rootmatch.io import check_output, is_standard_output
        from rootmatch.io.appended_table import SETTINGS_SUFFIX
        from rootmatch.io.outputs import is_written_through

        taken = list(inputs)
        for option, path in self.paths.items():
            check_output(path, option, taken)
            of_any_name = is_written_through(path) or (self.trajectory and path == self.poses)
            if path.suffix.lower() != ".csv" and not of_any_name:
                raise InputError(
                    f"{option} {path}: many frames are written as CSV; give a name that ends in .csv "
                    "(`rootmatch track` also writes trajectories, .tum)"
                )
            if self.as_json and is_standard_output(path):
                raise InputError(f"--json: {option} goes to standard output too; give it a file")
            taken.append(path)
            if not is_written_through(path):
                check_output(path.with_name(path.name + SETTINGS_SUFFIX), option, taken)
        if self.resume and not self.paths:
            raise InputError("--resume: there is no file to continue; give --output or --poses")


@dataclass(frozen=True)
class Job:
    """Input of a worker that matches frames: the arguments of `rootmatch.Matcher`, and names for the rows."""

    source: PointSet
    problem: Any
    options: dict[str, Any]
    noise: Noise | None = None
    known: KnownPoses | None = None

    def noise_of(self, frame: Frame) -> Any:
        """σ of a frame whose detections have each their own; None if that of the options holds."""
        return None if self.noise is None or frame.sigma is None else self.noise.of(frame.sigma)


def match_frames(job: Job, image: Path, outputs: FrameOutputs, jobs: int, scheduler: str | None) -> int | None:
    """Match every frame of a file and write what is found; the first that is not matched, None if all are.

    Frames that an earlier run has written are left out where ``outputs`` resumes.
    """
    from rootmatch.cli.frame_outputs import MATCH_COLUMNS, count_statuses, pose_columns
    from rootmatch.io import is_standard_output
    from rootmatch.io.appended_table import AppendedTable
    from rootmatch.research.sweep import check_jobs

    check_jobs(jobs)
    if outputs.paths:
        note_remainder("what was written is kept, and --resume continues")

    headers = {"--output": MATCH_COLUMNS, "--poses": pose_columns(job.problem)}
    count: Counter[str] = Counter()
    unmatched: int | None = None
    with ExitStack() as files:
        open_files = {
            flag: files.enter_context(closing(AppendedTable(path, headers[flag], _settings(job), outputs.resume)))
            for flag, path in outputs.paths.items()
        }
        done = set.intersection(*(file.done for file in open_files.values())) if open_files else set[int]()
        frames = (frame for frame in _read_frames(job, image) if frame.number not in done)
        for number, status, rows, record in _match_chunks(job, frames, jobs, scheduler):
            for flag, file in open_files.items():
                if number not in file.done:
                    file.write(rows[flag])
            count[status] += 1
            if unmatched is None and status != "matched":
                unmatched = number
            if outputs.as_json:
                print(json.dumps(record, allow_nan=False), flush=True)
    warn_of_unused(job.known)
    before = f", {len(done)} done before" if done else ""
    rows_printed = any(map(is_standard_output, outputs.paths.values()))
    summary = f"{count.total()} frames: {count_statuses(count)}{before}"
    print(summary, file=sys.stderr if outputs.as_json or rows_printed else sys.stdout)
    return unmatched


def diagnose_frame(job: Job, image: Path, number: int) -> str:
    """What would explain the points of a frame that is not matched, see `rootmatch.Match.diagnose`."""
    frame = next(frame for frame in _read_frames(job, image) if frame.number == number)
    found = _matcher(job).match(frame.points, noise=job.noise_of(frame), prior=frame.known)
    return f"frame {number}, the first that is not matched:\n{rephrase_advice(str(found.diagnose()))}"


def _read_frames(job: Job, image: Path) -> Iterator[Frame]:
    """The frames of a file, each with what is known of it."""
    from rootmatch.io.frame_files import read_frames
    from rootmatch.io.known_files import prior_of_frame

    dimension = job.problem.target_dimension or job.source.points.shape[1]
    for frame in read_frames(image, dimension, of_rig=job.problem.rig is not None):
        yield replace(frame, known=prior_of_frame(job.known, frame.number, frame.time, frame.known))


def warn_of_unused(known: KnownPoses | None) -> None:
    """Name what a file of known poses told of no frame that there was, and how it told the others."""
    if known is not None and known.mismatch_note is not None:
        print(f"rootmatch: warning: {known.mismatch_note}", file=sys.stderr)
    if known is not None and known.interpolation_note is not None:
        print(f"rootmatch: {known.interpolation_note}", file=sys.stderr)


Result = tuple[int, str, dict[str, list[list[Any]]], dict[str, Any]]


def _match_chunks(job: Job, frames: Iterator[Frame], jobs: int, scheduler: str | None) -> Iterator[Result]:
    packed = pickle.dumps(job)
    chunks = iter(lambda: tuple(islice(frames, CHUNK)), ())
    if scheduler is not None:
        from rootmatch.backends.dask import connect_client, results_in_order

        with connect_client(scheduler) as client:
            ahead = AHEAD * sum(client.nthreads().values())
            sent = results_in_order(lambda chunk: client.submit(_match_chunk, packed, chunk, pure=False), chunks, ahead)
            yield from (result for _, results in sent for result in results)
    elif jobs == 1:
        for frame in frames:
            yield from _match_chunk(packed, (frame,))
    else:
        import joblib

        from rootmatch.backends.dask import results_in_order
        from rootmatch.backends.worker_lifetime import pool

        processes = joblib.effective_n_jobs(jobs)
        try:
            with pool(processes) as workers:
                sent = results_in_order(partial(workers.submit, _match_chunk, packed), chunks, AHEAD * processes)
                yield from (result for _, results in sent for result in results)
        except BrokenProcessPool:
            raise RootmatchError(
                "a worker process died, perhaps for lack of memory; what was written is kept: continue with --resume, "
                "with fewer --jobs if necessary"
            ) from None


def _settings(job: Job) -> dict[str, str]:
    """Settings that rows depend on, by option name, so that files are not continued with different ones."""
    from rootmatch._version import __version__

    source = job.source
    model = hashlib.sha256(repr((source.points.tolist(), source.names, source.bodies)).encode()).hexdigest()
    options = {flag(name): _setting_text(value) for name, value in sorted(job.options.items()) if name != "bodies"}
    if job.known is not None:
        rows = sorted(repr(item) for item in job.known.rows.items())
        options["--known"] = hashlib.sha256(repr(rows).encode()).hexdigest()
    return {"rootmatch": __version__, "model": model, "--problem": _setting_text(job.problem), **options}


def _setting_text(value: Any) -> str:
    """A setting as text, arrays and long ones as a digest."""
    import numpy as np

    text = repr(value.tolist() if isinstance(value, np.ndarray) else value)
    return text if len(text) <= 300 else f"sha256 {hashlib.sha256(text.encode()).hexdigest()[:16]}"


def _match_chunk(packed: bytes, frames: tuple[Frame, ...]) -> list[Result]:
    """Results of some frames, in a process of its own or in this one."""
    from rootmatch.cli.frame_outputs import match_rows, pose_rows
    from rootmatch.cli.match_outputs import rephrase_record
    from rootmatch.jit.threads import use_one_thread
    from rootmatch.report.json_record import match_record

    worker = _worker(packed)
    job, matcher = worker.job, worker.matcher
    results = []
    with use_one_thread():
        if not worker.loaded and job.options.get("max_seconds") is not None:
            _load(job, frames[0])
            worker.loaded = True
        for frame in frames:
            with nullcontext() if job.noise is None else job.noise.naming(frame.sigma):
                found = matcher.match(frame.points, noise=job.noise_of(frame), prior=frame.known)
            rows = {"--output": match_rows(frame.number, found, job.source), "--poses": pose_rows(frame.number, found)}
            record = {"frame": frame.number, **rephrase_record(match_record(found))}
            results.append((frame.number, found.status.name.lower(), rows, record))
    return results


@dataclass
class Worker:
    """State that a process keeps from frame to frame."""

    job: Job
    matcher: Any
    loaded: bool = False


@lru_cache(maxsize=1)
def _worker(packed: bytes) -> Worker:
    """The matcher of a job, made once in each process."""
    job: Job = pickle.loads(packed)
    return Worker(job, _matcher(job))


def _matcher(job: Job, **changed: Any) -> Matcher:
    from rootmatch.matcher import Matcher

    return Matcher(job.source.points, job.problem, **job.options | changed)


def _load(job: Job, frame: Frame) -> None:
    """Load, or compile, the kernels that a first match needs: ``max_seconds`` is for the match alone."""
    budget = max(job.options["max_seconds"], LOADING)
    patient = _matcher(job, max_seconds=budget)
    for _ in range(PASSES):
        started = time.monotonic()
        found = patient.match(frame.points, noise=job.noise_of(frame), prior=frame.known)
        if not found.stopped_early or time.monotonic() - started < 1.2 * budget:
            return
