"""Many frames on the command line: each for itself, or in order, and what a run that stopped left behind."""

from __future__ import annotations

import csv
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import rootmatch as rm
from commands import descendants
from rootmatch.cli import app
from rootmatch.errors import InputError
from rootmatch.io.frame_files import Frame, read_frames
from test_tracker import BODY, frame
from test_worker_lifetime import running

OPTIONS = ("--problem", "p3p", "--camera", "800,780,320,240", "--noise", "0.2")
FRAMES, HIDDEN = 8, (5,)


def run(*arguments: object, text: str | None = None) -> Any:
    return CliRunner().invoke(app, [str(one) for one in arguments], input=text, catch_exceptions=False)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def write(path: Path, header: str, rows: list[list[Any]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header.split(","))
        writer.writerows(rows)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("frames")
    write(made / "model.csv", "x,y,z", BODY.tolist())
    detections = [[k, *point] for k in range(FRAMES) for point in frame(k, k in HIDDEN)[0].tolist()]
    write(made / "frames.csv", "frame,x,y", detections)
    write(made / "image.csv", "x,y", frame(0)[0].tolist())
    return made


def test_every_frame_is_matched_for_itself_and_a_run_is_continued(folder: Path, tmp_path: Path) -> None:
    output, poses = tmp_path / "matches.csv", tmp_path / "poses.csv"
    files = folder / "model.csv", folder / "frames.csv"
    result = run("match", *files, *OPTIONS, "--output", output, "--poses", poses, "--json")
    assert result.exit_code == 1  # a frame shows nothing
    assert "8 frames: 7 matched, 0 ambiguous, 1 untrusted" in result.stderr
    assert [json.loads(line)["frame"] for line in result.stdout.splitlines()] == list(range(FRAMES))
    whole = output.read_text()
    found = rows_of(output)
    for k in range(FRAMES):
        mine = {row["source"]: row["target"] for row in found if row["frame"] == str(k)}
        truth = frame(k, k in HIDDEN)[1]
        expected = {str(i): str(j) for i, j in enumerate(truth.tolist()) if j >= 0}
        assert mine == (expected or {"": ""})
    assert [row["status"] for row in rows_of(poses)] == ["matched"] * 5 + ["untrusted"] + ["matched"] * 2
    assert float(rows_of(poses)[0]["cov_rx_rx"]) > 0.0
    refused = run("match", *files, *OPTIONS, "--output", output)
    assert refused.exit_code == 2
    assert "add --resume" in refused.stderr
    lines = whole.splitlines(keepends=True)
    output.write_text("".join(lines[:20]) + "2,5")  # cut short within frame 2
    again = run("match", *files, *OPTIONS, "--output", output, "--resume")
    assert "2 done before" in again.stdout
    assert output.read_text() == whole


def test_a_last_frame_that_ends_at_a_line_is_not_taken_for_whole(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "matches.csv"
    command = "match", folder / "model.csv", folder / "frames.csv", *OPTIONS, "--output", output
    run(*command)
    whole = output.read_text()
    output.write_text("".join(whole.splitlines(keepends=True)[:20]))
    again = run(*command, "--resume")
    assert "2 done before" in again.stdout
    assert output.read_text() == whole
    refused = run(*command, "--resume", "--noise", "0.3")
    assert refused.exit_code == 2
    assert "--noise: '0.3' given, and it was begun with '0.2'" in refused.stderr
    assert output.read_text() == whole


def test_a_run_that_is_refused_leaves_nothing(folder: Path, tmp_path: Path) -> None:
    bad = write(tmp_path / "bad.csv", "frame,x,y", [[0, 1, "a"]])
    for command in ("match", "track"):
        files = "--output", tmp_path / "matches.csv", "--poses", tmp_path / "poses.csv"
        assert run(command, folder / "model.csv", bad, *OPTIONS, *files).exit_code == 2
        assert list(tmp_path.iterdir()) == [bad]


@pytest.mark.parametrize("jobs", [0, -2000, 2000])
def test_numbers_of_processes_that_mean_nothing(folder: Path, jobs: int) -> None:
    result = run("match", folder / "model.csv", folder / "frames.csv", *OPTIONS, "--jobs", jobs)
    assert result.exit_code == 2
    assert f"jobs: {jobs} given" in result.stderr


def test_loading_does_not_count_against_the_first_frame(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first match of the process is made one that was cut off while it loaded."""
    from rootmatch.cli import frames
    from rootmatch.io import read_points

    loaded: list[int] = []
    true = rm.Matcher.match

    def slow(self: rm.Matcher, *args: Any, **options: Any) -> Any:
        found = true(self, *args, **options)
        if loaded:
            return found
        loaded.append(1)
        return replace(found, stopped_early=True)

    monkeypatch.setattr(rm.Matcher, "match", slow)
    source = read_points(folder / "model.csv", 3)
    problem = rm.P3P(rm.Camera(800.0, 780.0, 320.0, 240.0))
    job = frames.Job(source, problem, {"noise": 0.2, "max_seconds": 2.0})
    (result,) = frames._matched(pickle.dumps(job), (Frame(0, frame(0)[0], np.arange(9)),))
    assert loaded
    assert result[1] == "matched"
    assert not result[3]["stopped_early"]


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
@pytest.mark.parametrize("victim", ["worker", "parent"])
def test_no_process_outlives_a_kill(folder: Path, tmp_path: Path, victim: str) -> None:
    many = tmp_path / "many.csv"
    body = (folder / "frames.csv").read_text().splitlines()[1:9]
    rows = [line.split(",", 1)[1] for line in body]
    many.write_text("frame,x,y\n" + "".join(f"{k},{row}\n" for k in range(20_000) for row in rows))
    output = tmp_path / "m.csv"
    command = [sys.executable, "-m", "rootmatch", "match", str(folder / "model.csv"), str(many), *OPTIONS]
    command += ["--jobs", "2", "--output", str(output)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    deadline = time.monotonic() + 120
    while not output.exists() or not output.stat().st_size:
        assert process.poll() is None, process.stderr.read() if process.stderr else ""
        assert time.monotonic() < deadline, "no frame is matched"
        time.sleep(0.1)
    children = descendants(process.pid)
    assert len(children) >= 2
    workers = [pid for pid in children if b"LokyProcess" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(workers[0] if victim == "worker" else process.pid, signal.SIGKILL)
    stderr = process.communicate(timeout=60)[1]
    if victim == "worker":
        assert process.returncode == 2
        assert stderr.startswith("rootmatch: a worker process died")
        assert len(stderr.splitlines()) == 1
    deadline = time.monotonic() + 30
    while any(map(running, children)):
        assert time.monotonic() < deadline, "a process is left"
        time.sleep(0.1)
    assert {path.name for path in tmp_path.iterdir()} == {"many.csv", "m.csv", "m.csv.settings.json"}


def test_standard_input_closed_or_with_a_byte_order_mark(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (folder / "frames.csv").read_text()
    plain = run("track", folder / "model.csv", "-", *OPTIONS, text=text)
    marked = run("track", folder / "model.csv", "-", *OPTIONS, text="\ufeff" + text)
    assert marked.exit_code == 0
    assert marked.stdout == plain.stdout
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InputError, match="standard input: it is closed"):
        next(read_frames(Path("-")))


@pytest.mark.skipif(os.name == "nt", reason="no pipes by name there")
@pytest.mark.parametrize("image", ["image.csv", "frames.csv"])
def test_an_image_that_is_a_pipe(folder: Path, tmp_path: Path, image: str) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=lambda: pipe.write_bytes((folder / image).read_bytes()))
    writer.start()
    piped = run("match", folder / "model.csv", pipe, *OPTIONS, "--json")
    writer.join(10)
    plain = run("match", folder / "model.csv", folder / image, *OPTIONS, "--json")
    assert piped.exit_code == plain.exit_code
    assert [json.loads(line)["assignment"] for line in piped.stdout.splitlines()] == [
        json.loads(line)["assignment"] for line in plain.stdout.splitlines()
    ]


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no /dev/zero")
@pytest.mark.parametrize("command", ["match", "track"])
def test_a_device_without_end_is_refused(folder: Path, command: str) -> None:
    for files in ((folder / "model.csv", "/dev/zero"), ("/dev/zero", folder / "frames.csv")):
        result = run(command, *files, *OPTIONS)
        assert result.exit_code == 2
        assert "/dev/zero: " in result.stderr
    result = run(command, folder / "model.csv", folder / "frames.csv", "--problem", "p3p", "--camera", "/dev/zero")
    assert result.exit_code == 2
    assert "/dev/zero: more than" in result.stderr


def test_frames_in_order_from_a_pipe(folder: Path, tmp_path: Path) -> None:
    poses = tmp_path / "poses.csv"
    result = run("track", folder / "model.csv", folder / "frames.csv", *OPTIONS, "--poses", poses)
    assert result.exit_code == 0, result.output
    rows = rows_of(poses)
    assert [row["frame"] for row in rows] == [str(k) for k in range(FRAMES)]
    assert [row["status"] for row in rows] == ["matched"] * 5 + ["untrusted"] + ["matched"] * 2
    assert rows[5]["tx"] == ""
    piped = run("track", folder / "model.csv", "-", *OPTIONS, text=(folder / "frames.csv").read_text())
    assert piped.exit_code == 0
    assert piped.stdout == poses.read_text()
    assert "warning" not in result.stderr
    slow = run(
        "track", folder / "model.csv", folder / "frames.csv", *OPTIONS, "--rate", 0.5, "--poses", tmp_path / "b.csv"
    )
    assert "warning: the frames are 2 s apart at --rate 0.5; where frame is a time in milliseconds" in slow.stderr


def test_bodies_of_a_model(folder: Path, tmp_path: Path) -> None:
    other = np.random.default_rng(8).uniform(-0.3, 0.3, (6, 3))
    rows = [["hmd", *point] for point in BODY.tolist()] + [["left", *point] for point in other.tolist()]
    model, poses = write(tmp_path / "model.csv", "body,x,y,z", rows), tmp_path / "poses.csv"
    result = run("track", model, folder / "frames.csv", *OPTIONS, "--poses", poses)
    assert result.exit_code == 0, result.output
    assert [(row["body"], row["status"] == "matched") for row in rows_of(poses)[:2]] == [("hmd", True), ("left", False)]
    few = write(tmp_path / "few.csv", "body,x,y,z", rows[:10])
    result = run("match", few, folder / "image.csv", *OPTIONS)
    assert result.exit_code == 2
    assert "body 'left' has too few points, 3; give it at least 4" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_a_predicted_pose(folder: Path, tmp_path: Path) -> None:
    poses, prior = tmp_path / "poses.json", tmp_path / "prior.json"
    run("match", folder / "model.csv", folder / "image.csv", *OPTIONS, "--poses", poses)
    (record,) = json.loads(poses.read_text())
    record["covariance"] = (1e-4 * np.eye(6)).tolist()
    prior.write_text(json.dumps(record))
    result = run("match", folder / "model.csv", folder / "image.csv", *OPTIONS, "--prior", prior, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["evaluated"] == 0
    record["covariance"][0][0] = -1.0
    prior.write_text(json.dumps(record))
    result = run("match", folder / "model.csv", folder / "image.csv", *OPTIONS, "--prior", prior)
    assert result.exit_code == 2
    assert "the covariance is not positive" in result.stderr


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([[3, 1, 2], [2, 1, 2]], "row 3: frame 2 after frame 3; frames are out of order"),
        ([[-1, 1, 2]], "row 2: frame is '-1'"),
        ([[0, 1, "a"]], "row 2: y is 'a'"),
    ],
)
def test_frames_that_cannot_be_read(folder: Path, tmp_path: Path, rows: list[list[Any]], text: str) -> None:
    bad = write(tmp_path / "bad.csv", "frame,x,y", rows)
    for command in ("match", "track"):
        result = run(command, folder / "model.csv", bad, *OPTIONS)
        assert result.exit_code == 2
        assert text in result.stderr
        assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("options", "image", "text"),
    [
        (("--plot", "x.svg"), "frames.csv", "--plot: it is of one image"),
        (("--jobs", "2"), "image.csv", "--jobs: "),
        (("--resume",), "frames.csv", "--resume: nothing is written"),
        (("--output", "x.txt"), "frames.csv", "--output x.txt: many frames are written as CSV"),
    ],
)
def test_options_of_one_image_or_of_many(folder: Path, options: tuple[str, ...], image: str, text: str) -> None:
    result = run("match", folder / "model.csv", folder / image, *OPTIONS, *options)
    assert result.exit_code == 2
    assert text in result.stderr
