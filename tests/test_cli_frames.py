"""Many frames on the command line: each for itself, or in order, and what a run that stopped left behind."""

from __future__ import annotations

import csv
import json
import os
import pickle
import re
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

import rootmatch as rm
from commands import Command, descendants, rows_of, run, started
from rootmatch.errors import InputError
from rootmatch.io.frame_files import Frame, has_frames, read_frames
from rootmatch.io.known_files import read_known
from rootmatch.io.point_files import read_points
from test_tracker import BODY, frame
from test_worker_lifetime import running

OPTIONS = ("--problem", "p3p", "--camera", "800,780,320,240", "--noise", "0.2")
FRAMES, HIDDEN = 8, (5,)


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
    assert "--noise: '0.3' given, but the file was begun with '0.2'" in refused.stderr
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
    (result,) = frames._match_chunk(pickle.dumps(job), (Frame(0, frame(0)[0]),))
    assert loaded
    assert result[1] == "matched"
    assert not result[3]["stopped_early"]


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
@pytest.mark.parametrize("victim", ["worker", "parent"])
def test_no_process_outlives_a_kill(folder: Path, tmp_path: Path, victim: str) -> None:
    # compiled here, loaded by the workers
    assert run("match", folder / "model.csv", folder / "frames.csv", *OPTIONS).exit_code in (0, 1)
    many = tmp_path / "many.csv"
    body = (folder / "frames.csv").read_text().splitlines()[1:9]
    rows = [line.split(",", 1)[1] for line in body]
    many.write_text("frame,x,y\n" + "".join(f"{k},{row}\n" for k in range(4_000) for row in rows))
    output = tmp_path / "m.csv"
    command = [sys.executable, "-m", "rootmatch", "match", str(folder / "model.csv"), str(many), *OPTIONS]
    command += ["--jobs", "2", "--output", str(output)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    work, deadline = Command(process.pid, tmp_path), time.monotonic() + 600
    while not output.exists() or not output.stat().st_size:
        assert process.poll() is None, process.stderr.read() if process.stderr else ""
        # seconds of the processor: on a busy machine the clock says nothing
        assert work.worked() < 120, "no frame is matched"
        assert time.monotonic() < deadline, "nothing is computed"
        time.sleep(0.1)
    children = descendants(process.pid)
    assert len(children) >= 2
    workers = [pid for pid in children if b"LokyProcess" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(workers[0] if victim == "worker" else process.pid, signal.SIGKILL)
    stderr = process.communicate(timeout=300)[1]
    if victim == "worker":
        assert process.returncode == 2
        assert stderr.startswith("rootmatch: a worker process died")
        assert len(stderr.splitlines()) == 1
    deadline = time.monotonic() + 120
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
    assert "warning: the frames are 2 s apart at --rate 0.5; if frame is a time in milliseconds" in slow.stderr
    assert slow.stderr.count("apart") == 1  # not by the tracker too


def test_a_warning_of_every_frame_is_printed_once(folder: Path) -> None:
    files = folder / "model.csv", folder / "frames.csv"
    result = run("match", *files, *OPTIONS, "--solver", "rrwhm", "--jobs", 1)
    assert "8 frames" in result.output
    assert result.stderr.count("this solver only adds proposals") == 1


def test_bodies_of_a_model(folder: Path, tmp_path: Path) -> None:
    other = np.random.default_rng(8).uniform(-0.3, 0.3, (6, 3))
    rows = [["hmd", *point] for point in BODY.tolist()] + [["left", *point] for point in other.tolist()]
    model, poses = write(tmp_path / "model.csv", "body,x,y,z", rows), tmp_path / "poses.csv"
    result = run("track", model, folder / "frames.csv", *OPTIONS, "--poses", poses)
    assert result.exit_code == 0, result.output
    assert [(row["body"], row["status"] == "matched") for row in rows_of(poses)[:2]] == [("hmd", True), ("left", False)]
    record = json.loads(run("match", model, folder / "image.csv", *OPTIONS, "--json").stdout)
    assert list(record["bodies"]) == ["hmd", "left"]
    hmd, left = record["bodies"].values()
    assert (hmd["status"], left["status"], left["pose"]) == ("matched", "untrusted", None)
    assert hmd["pose"]["t"] == pytest.approx(record["poses"][0]["t"])
    assert [record["assignment"][i] for i, _ in hmd["pairs"]] == [j for _, j in hmd["pairs"]]
    assert hmd["probability"] > 0.99 > left["probability"]
    assert len(left["advice"]) > 20
    few = write(tmp_path / "few.csv", "body,x,y,z", rows[:10])
    result = run("match", few, folder / "image.csv", *OPTIONS)
    assert result.exit_code == 2
    assert "body 'left' has 3 points; give it at least 4" in result.stderr
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
    assert "the covariance has a negative eigenvalue" in result.stderr
    for text in ('{"R": [[1, 0, 0]]}', json.dumps(record)):  # the second is too long for the name of a file
        result = run("match", folder / "model.csv", folder / "image.csv", *OPTIONS, "--prior", text)
        assert result.exit_code == 2
        assert "no file has this name; write the JSON to a file, and give its name" in result.stderr


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([[3, 1, 2], [2, 1, 2]], "row 3: frame 2 after frame 3; frames are out of order"),
        ([[-1, 1, 2]], "row 2: frame is '-1'"),
        ([[0.5, 1, 2]], "row 2: frame is '0.5'"),
        ([["1e17", 1, 2]], "row 2: frame is '1e17'"),
        ([["nan", 1, 2]], "row 2: frame is 'nan'"),
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
        (("--plot", "x.svg"), "frames.csv", "--plot: it applies to one image"),
        (("--jobs", "2"), "image.csv", "--jobs: "),
        (("--resume",), "frames.csv", "--resume: there is no file"),
        (("--output", "x.txt"), "frames.csv", "--output x.txt: many frames are written as CSV"),
    ],
)
def test_options_of_one_image_or_of_many(folder: Path, options: tuple[str, ...], image: str, text: str) -> None:
    result = run("match", folder / "model.csv", folder / image, *OPTIONS, *options)
    assert result.exit_code == 2
    assert text in result.stderr


def rows_at(times: list[float], noise: str = "") -> list[list[Any]]:
    """Detections with a time, frame after frame."""
    more = [noise] if noise else []
    return [[time, *point, *more] for k, time in enumerate(times) for point in frame(k)[0].tolist()]


def test_times_may_be_irregular(folder: Path, tmp_path: Path) -> None:
    times = [0.1, 0.1163, 0.1337, 0.15, 0.21]
    timed = write(tmp_path / "timed.csv", "time,x,y", rows_at(times))
    poses = tmp_path / "poses.csv"
    result = run("track", folder / "model.csv", timed, *OPTIONS, "--poses", poses)
    assert result.exit_code == 0, result.output
    assert [(row["frame"], float(row["time"])) for row in rows_of(poses)] == [(str(k), t) for k, t in enumerate(times)]
    assert all(row["status"] == "matched" for row in rows_of(poses))
    both = write(tmp_path / "both.csv", "frame,time,x,y", [[7, *row] for row in rows_at([0.5])])
    row = json.loads(run("track", folder / "model.csv", both, *OPTIONS, "--json").stdout)
    assert (row["frame"], row["time"]) == (7, 0.5)
    result = run("track", folder / "model.csv", timed, *OPTIONS, "--rate", 30)
    assert result.exit_code == 2
    assert "has a column time; leave one of them out" in result.stderr
    slow = write(tmp_path / "slow.csv", "time,x,y", rows_at([0.0, 17.0, 33.0]))
    result = run("track", folder / "model.csv", slow, *OPTIONS, "--poses", tmp_path / "slow-poses.csv")
    assert "16.5 s apart; time is in seconds" in result.stderr
    several = run("match", folder / "model.csv", timed, *OPTIONS, "--json")
    assert [json.loads(line)["frame"] for line in several.stdout.splitlines()] == [0, 1, 2, 3, 4]


def test_lines_of_json(folder: Path, tmp_path: Path) -> None:
    poses = tmp_path / "poses.csv"
    result = run("track", folder / "model.csv", folder / "frames.csv", *OPTIONS, "--json", "--poses", poses)
    assert result.exit_code == 0, result.output
    records = [json.loads(line) for line in result.stdout.splitlines()]
    assert [record["status"] for record in records] == ["matched"] * 5 + ["untrusted"] + ["matched"] * 2
    assert [record["state"] for record in records[4:6]] == ["tracking", "coasting"]
    assert records[5]["pose"] is None
    for record, row in zip(records, rows_of(poses), strict=True):
        assert len(record["pairs"]) == int(row["matched"])
        if record["pose"] is not None:
            assert record["pose"]["t"] == [float(row[axis]) for axis in ("tx", "ty", "tz")]
    bodies = [["hmd", *point] for point in BODY.tolist()]
    model = write(tmp_path / "model.csv", "body,x,y,z", bodies)
    first = json.loads(run("track", model, folder / "frames.csv", *OPTIONS, "--json").stdout.splitlines()[0])
    assert first["bodies"]["hmd"]["status"] == "matched"


@pytest.mark.skipif(os.name == "nt", reason="no pipes by name there")
def test_a_frame_is_answered_when_it_ends(folder: Path, tmp_path: Path) -> None:
    """At an empty line, and not when the next frame begins: the answer comes while the pipe is still open."""
    os.mkfifo(tmp_path / "frames")
    read, write = os.pipe()
    words = ["track", str(folder / "model.csv"), "-", *OPTIONS, "--json"]
    command = started(words, tmp_path, tmp_path / "logs", stdin=tmp_path / "frames", stdout=write)
    os.close(write)
    with open(read, encoding="utf-8") as answers:
        with (tmp_path / "frames").open("w", encoding="utf-8") as frames:
            frames.write("time,x,y\n")
            for k in range(3):
                frames.writelines(f"{k / 60},{x},{y}\n" for x, y in frame(k)[0].tolist())
                frames.write("\n")
                frames.flush()
                assert json.loads(answers.readline())["frame"] == k
        assert answers.read() == ""
    assert command.ended(60.0)
    assert command.code == 0, command.stderr


@pytest.mark.parametrize(("spelled", "comments"), [("%.18e", ""), ("%.18e", "# "), ("%.1f", "# ")])
def test_frames_of_numpy(tmp_path: Path, spelled: str, comments: str) -> None:
    path, rows = tmp_path / "frames.csv", np.array([[0, 1, 2], [0, 3, 4], [12, 5, 6]])
    np.savetxt(path, rows, delimiter=",", header="frame,x,y", comments=comments, fmt=spelled)
    assert has_frames(path)
    assert [(one.number, one.points.tolist()) for one in read_frames(path)] == [(0, [[1, 2], [3, 4]]), (12, [[5, 6]])]


def test_frames_without_detections_and_where_frames_end(tmp_path: Path) -> None:
    path = tmp_path / "frames.csv"
    path.write_text("frame,x,y,sigma\n3,1,2,.5\n\n\n4,,,\n5,3,4,1\n5,5,6,2\n\n")
    frames = list(read_frames(path))
    assert [one.number for one in frames] == [3, 4, 5]
    assert [one.points.tolist() for one in frames] == [[[1, 2]], [], [[3, 4], [5, 6]]]
    assert frames[1].points.shape == (0, 2)
    assert frames[2].sigma is not None
    assert frames[2].sigma.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("header", "rows", "text"),
    [
        ("time,x,y", [[0.5, 1, 2], [0.2, 1, 2]], "row 3: time 0.2 after time 0.5; frames are out of order"),
        ("frame,time,x,y", [[1, 0.5, 1, 2], [2, 0.5, 1, 2]], "row 3: time 0.5 after time 0.5; frames are out of order"),
        ("frame,time,x,y", [[1, 0.5, 1, 2], [1, 0.6, 1, 2]], "row 3: frame 1 has two times, 0.5 and 0.6"),
        ("time,x,y", [["soon", 1, 2]], "row 2: time is 'soon'"),
        ("frame,x,y", [[1, 1, 2], [], [1, 3, 4]], "row 4: frame 1 continues after an empty line"),
        ("frame,x,y,sigma", [[1, 1, 2, -1]], "row 2: sigma is '-1'; give a number of 0 or more"),
        ("frame,x,y", [[1, 1, 2], ["", "", ""], [1, 3, 4]], "row 3: a row of commas without values"),
        ("timestamp,x,y", [[1, 2, 3]], "rename 'timestamp' to time, in seconds?"),
        ("x,y", [[1, 2]], "the column 'frame' is missing"),
    ],
)
def test_times_and_ends_that_cannot_be_read(tmp_path: Path, header: str, rows: list[list[Any]], text: str) -> None:
    with pytest.raises(InputError, match=re.escape(text)):
        list(read_frames(write(tmp_path / "bad.csv", header, rows)))


def test_nothing_is_printed_of_a_file_without_frames(folder: Path, tmp_path: Path) -> None:
    for header, rows, words in [
        ("x,y", [[1, 2]], "must name frame,x,y, or time (in seconds) in the place of frame"),
        ("frame,x,y", [], "no row follows the header"),
        ("frame,x,y", [[0, 1, "a"]], "y is 'a'"),
    ]:
        result = run("track", folder / "model.csv", write(tmp_path / "bad.csv", header, rows), *OPTIONS)
        assert result.exit_code == 2
        assert words in result.stderr
        assert result.stdout == ""


@pytest.mark.parametrize("command", ["match", "track"])
def test_an_error_about_noise_in_columns_names_these(folder: Path, tmp_path: Path, command: str) -> None:
    rows = [[0, x, y, 1, 2, 1] for x, y in frame(0)[0].tolist()]
    bad = write(tmp_path / "bad.csv", "frame,x,y,sxx,sxy,syy", rows)
    result = run(command, folder / "model.csv", bad, *OPTIONS[:-2])
    assert result.exit_code == 2
    assert f"{bad}: columns sxx,sxy,syy: a covariance has a negative eigenvalue" in result.stderr
    assert "--noise" not in result.stderr


def test_a_column_sigma_says_how_noisy_each_detection_is(folder: Path, tmp_path: Path) -> None:
    camera = ("--problem", "p3p", "--camera", "800,780,320,240")
    image, files = frame(0)[0].tolist(), {}
    for name, header, more in (("plain", "x,y", []), ("sigma", "x,y,sigma", [0.2])):
        files[name] = write(tmp_path / f"{name}.csv", header, [[*point, *more] for point in image])
    files["frames"] = write(tmp_path / "frames.csv", "frame,x,y,sigma", [[0, *point, 0.2] for point in image])
    records = []
    for name, options in (("plain", ("--noise", "0.2")), ("sigma", ()), ("frames", ())):
        result = run("match", folder / "model.csv", files[name], *camera, *options, "--json")
        assert result.exit_code == 0, result.output
        records.append(json.loads(result.stdout))
    for record in records[1:]:
        assert record["assignment"] == records[0]["assignment"]
        assert record["noise"] is None
        np.testing.assert_allclose(record["poses"][0]["covariance"], records[0]["poses"][0]["covariance"], rtol=1e-6)
    tracked = run("track", folder / "model.csv", files["frames"], *camera, "--json")
    np.testing.assert_allclose(
        json.loads(tracked.stdout)["pose"]["covariance"], records[0]["poses"][0]["covariance"], rtol=1e-6
    )
    for command, name in (("match", "sigma"), ("match", "frames"), ("track", "frames")):
        result = run(command, folder / "model.csv", files[name], *camera, "--noise", "0.2")
        assert result.exit_code == 2
        assert "has a column that states the noise; leave one of them out" in result.stderr


def test_columns_sigma_of_two_noisy_sets(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    plan = rng.uniform(-80, 80, (7, 3))
    seen = plan @ np.diag([-1.0, -1.0, 1.0]) + 100.0 + rng.normal(0, 0.3, (7, 3))
    files = {
        "plan": write(tmp_path / "plan.csv", "x,y,z", plan.tolist()),
        "plan-sigma": write(tmp_path / "plan-sigma.csv", "x,y,z,sigma", [[*x, 0.2] for x in plan.tolist()]),
        "seen": write(tmp_path / "seen.csv", "x,y,z", seen.tolist()),
        "seen-sigma": write(tmp_path / "seen-sigma.csv", "x,y,z,sigma", [[*x, 0.3] for x in seen.tolist()]),
    }

    def covariance(model: str, image: str, *options: object) -> list[list[float]]:
        result = run("match", files[model], files[image], "--problem", "rigid", *options, "--json")
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)["poses"][0]["covariance"]

    expected = covariance("plan", "seen", "--noise", "0.2,0.3")
    for case in (
        covariance("plan-sigma", "seen-sigma"),
        covariance("plan-sigma", "seen", "--noise", "0.3"),
        covariance("plan", "seen-sigma", "--noise", "0.2"),
    ):
        np.testing.assert_allclose(case, expected, rtol=1e-9)
    both = run("match", files["plan-sigma"], files["seen-sigma"], "--problem", "rigid", "--noise", "0.3")
    assert "leave one of them out" in both.stderr
    points = write(tmp_path / "image.csv", "x,y", seen[:, :2].tolist())
    down = ["--vertical-camera", "0,1,0", "--vertical-world", "0,1,0"]
    refused = run("match", files["plan-sigma"], points, "--problem", "up2pf", "--centre", "320,240", *down)
    assert refused.exit_code == 2
    assert (
        "plan-sigma.csv: it has a column sigma, but up2pf takes its points as exact; leave the column out"
        in refused.stderr
    )


def test_noise_of_the_model_as_an_option_or_as_columns(folder: Path, tmp_path: Path) -> None:
    image = write(tmp_path / "image.csv", "x,y", frame(0)[0].tolist())
    plain = folder / "model.csv"
    named = {
        "sigma": write(tmp_path / "sigma.csv", "x,y,z,sigma", [[*point, 0.002] for point in BODY.tolist()]),
        "axes": write(tmp_path / "axes.csv", "x,y,z,sx,sy,sz", [[*point, *[0.002] * 3] for point in BODY.tolist()]),
    }

    def covariance(model: Path, *options: object) -> list[list[float]]:
        result = run("match", model, image, *OPTIONS, *options, "--json")
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)["poses"][0]["covariance"]

    expected = covariance(plain, "--source-noise", "0.002")
    assert np.trace(expected) > 1.5 * np.trace(covariance(plain))
    for model in named.values():
        np.testing.assert_allclose(covariance(model), expected, rtol=1e-9)
        tracked = run("track", model, folder / "frames.csv", *OPTIONS, "--json")
        assert tracked.exit_code == 0, tracked.output
        both = run("match", model, image, *OPTIONS, "--source-noise", "0.002")
        assert both.exit_code == 2
        assert "which states it; leave one of them out" in both.stderr
    many = run("match", named["axes"], folder / "frames.csv", *OPTIONS, "--json")
    assert "7 matched" in many.output
    wrong = run("match", plain, image, *OPTIONS, "--source-noise", "-1")
    assert wrong.exit_code == 2
    assert "--source-noise: -1 given; a standard deviation is not negative" in wrong.stderr


def test_a_trajectory_of_the_frames_is_written(folder: Path, tmp_path: Path) -> None:
    """TUM's: times, and the camera in the frame of the points; only of frames that are matched."""
    both, place = (folder / "model.csv", folder / "frames.csv"), tmp_path / "camera.tum"
    records = [
        json.loads(line) for line in run("track", *both, *OPTIONS, "--json", "--poses", place).stdout.splitlines()
    ]
    matched = [record for record in records if record["status"] == "matched"]
    assert 0 < len(matched) < len(records)
    table = np.loadtxt(place)
    np.testing.assert_allclose(table[:, 0], [record["time"] for record in matched])
    for row, record in zip(table, matched, strict=True):
        back = rm.Pose(record["pose"]["R"], record["pose"]["t"]).inverse()
        np.testing.assert_allclose(row[1:], [*back.t, *back.quaternion], atol=1e-12)
    printed = run("track", *both, *OPTIONS, "--pose-format", "tum").stdout
    assert printed == place.read_text()
    again = run("track", *both, *OPTIONS, "--poses", place)
    assert "it already exists, with rows of an earlier run; remove it, or give another name" in again.stderr
    bodies = write(tmp_path / "bodies.csv", "body,x,y,z", [["hmd", *point] for point in BODY.tolist()])
    refused = run("track", bodies, both[1], *OPTIONS, "--pose-format", "tum")
    assert "tum is a trajectory of one body" in refused.stderr


def test_a_tracker_names_the_problems_that_it_takes(folder: Path) -> None:
    both, options = (folder / "model.csv", folder / "frames.csv"), OPTIONS[2:]
    assert "'p3p', 'up2p', 'rigid', 'similarity'" in run("track", *both, "--problem", "3p1", *options).stderr
    shown = run("track", "--help").stdout
    assert not any(name in shown for name in ("3p1", "planar", "up2pf"))
    assert f"({rm.TrackingOptions().search_budget})" in shown
    assert "--noise: auto given" in run("track", *both, *OPTIONS, "--noise", "auto").stderr


def test_what_is_known_is_read_from_a_file(folder: Path, tmp_path: Path) -> None:
    """A rotation of each frame: for one image, for many, and for a tracker; of a body by its label."""
    both = folder / "model.csv", folder / "frames.csv"
    records = [json.loads(line) for line in run("track", *both, *OPTIONS, "--json").stdout.splitlines()]
    poses = {record["frame"]: record["pose"] for record in records if record["pose"] is not None}
    rows = [[number, *pose["quaternion"], 2.0, *[""] * 4] for number, pose in poses.items()]
    header = "qx,qy,qz,qw,q_sigma,tx,ty,tz,t_sigma"
    known = write(tmp_path / "known.csv", f"frame,{header}", rows)
    for command in ("match", "track"):
        result = run(command, *both, *OPTIONS, "--known", known, "--json")
        told = [json.loads(line) for line in result.stdout.splitlines() if line.startswith("{")]
        assert [one["status"] for one in told].count("matched") >= len(poses) - 1
    image = write(tmp_path / "image.csv", "x,y", frame(0)[0].tolist())
    one = write(tmp_path / "one.csv", header, [rows[0][1:]])
    assert run("match", folder / "model.csv", image, *OPTIONS, "--known", one).exit_code == 0
    refused = run("match", folder / "model.csv", image, *OPTIONS, "--known", one, "--prior", one)
    assert "--known: --prior already gives the whole pose" in refused.stderr
    bodies = write(tmp_path / "model.csv", "body,x,y,z", [["hmd", *point] for point in BODY.tolist()])
    labelled = write(tmp_path / "labelled.csv", f"frame,body,{header}", [[row[0], "hmd", *row[1:]] for row in rows])
    assert "hmd" in run("track", bodies, folder / "frames.csv", *OPTIONS, "--known", labelled, "--json").stdout


@pytest.fixture(scope="module")
def turns(folder: Path) -> list[list[float]]:
    """The quaternion of the body in each of the first frames, as it was found, and its σ in degrees."""
    lines = run("track", folder / "model.csv", folder / "frames.csv", *OPTIONS, "--json").stdout.splitlines()
    return [[*json.loads(line)["pose"]["quaternion"], 2.0] for line in lines[:4]]


TURN = "qx,qy,qz,qw,q_sigma"


@pytest.mark.parametrize("command", ["match", "track"])
def test_rows_of_known_poses_that_match_no_frame_are_named(
    folder: Path, tmp_path: Path, turns: list[list[float]], command: str
) -> None:
    """A time that is rounded, or read a moment later, is that of its frame; one of another clock is said so."""
    with (folder / "frames.csv").open(encoding="utf-8", newline="") as stream:
        seen = [[f"{int(row['frame']) / 60.0:.6f}", row["x"], row["y"]] for row in csv.DictReader(stream)]
    model, timed = folder / "model.csv", write(tmp_path / "timed.csv", "time,x,y", seen)
    near = [[f"{k / 60.0 + 1e-4:.4f}", *turn] for k, turn in enumerate(turns)]
    late = [[10.0 + k / 60.0, *turn] for k, turn in enumerate(turns)]
    numbers = [[k + 6, *turn] for k, turn in enumerate(turns)]
    for image, column, rows, text in (
        (timed, "time", [*near, late[0]], f"{FRAMES - 4} of {FRAMES} frames have no row within 1 ms"),
        (timed, "time", late, "no row matches a frame: its time runs from 10 to 10.05, that of the frames from 0 to"),
        (folder / "frames.csv", "frame", numbers, None),  # it is merely longer
        (folder / "frames.csv", "frame", [[1, *turns[1]], [3, *turns[3]]], None),
    ):
        known = write(tmp_path / "known.csv", f"{column},{TURN}", rows)
        result = run(command, model, image, *OPTIONS, "--known", known, "--json")
        assert result.stdout.count('"matched"') >= 6
        assert "warning" not in result.stderr if text is None else f"warning: {known}: {text}" in result.stderr


def test_a_clock_that_is_off_by_milliseconds_is_interpolated(
    folder: Path, tmp_path: Path, turns: list[list[float]]
) -> None:
    """An IMU is never within a millisecond of a camera."""
    rows = [[f"{k / 60.0:.6f}", x, y] for k in range(4) for x, y in frame(k)[0].tolist()]
    timed = write(tmp_path / "timed.csv", "time,x,y", rows)
    known = write(tmp_path / "known.csv", f"time,{TURN}", [[k / 60.0 + 5e-3, *turn] for k, turn in enumerate(turns)])
    result = run("track", folder / "model.csv", timed, *OPTIONS, "--known", known, "--json")
    assert "warning" not in result.stderr
    assert f"rootmatch: {known}: interpolated at the times of 4 of 4 frames" in result.stderr
    assert all(json.loads(line)["prior_holds"] for line in result.stdout.splitlines())


def test_what_is_known_is_interpolated_between_rows(tmp_path: Path) -> None:
    rows: list[list[Any]] = []
    for k in range(2):
        rows.append([0.02 * k, 0, 0, np.sin(0.1 * k), np.cos(0.1 * k), 2, k, 0, 0, 1 + k, 0, 1, 0.1 * k, 0, 0, 1, 1])
    rows.append([1.0, *rows[1][1:]])
    path = write(tmp_path / "known.csv", f"time,{TURN},tx,ty,tz,t_sigma,vx,vy,vz,wx,wy,wz,v_sigma", rows)
    known = read_known(path)
    for when, share in ((0.01, 0.5), (0.005, 0.25), (0.0295, 1.475)):
        found = known.of(time=when)
        turn, _ = found.rotation
        np.testing.assert_allclose(turn[:2, 0], [np.cos(0.2 * share), np.sin(0.2 * share)], atol=1e-9)
        np.testing.assert_allclose(found.position[0], [share, 0.0, 0.0], atol=1e-9)
        assert found.position[1][0, 0] == (1.0 if share <= 0.5 else 4.0)
        assert found.vertical[1][2] > 0.0
    assert known.of(time=0.04) is None
    assert known.of(time=0.5) is None
    assert known.mismatch_note is not None
    assert "2 of 5 frames have no row within 1 ms" in known.mismatch_note


def test_a_time_is_that_of_the_nearest_row(tmp_path: Path, turns: list[list[float]]) -> None:
    """Rows of a sensor that is faster than the camera, of two bodies."""
    rows = [[k / 2000.0, body, k, 0, 0, 1] for k in range(12) for body in "LR"]
    known = read_known(write(tmp_path / "known.csv", "time,body,tx,ty,tz,t_sigma", rows), ["L", "R"])
    for when, row in ((0.0, 0), (0.00274, 5), (0.00276, 6), (0.0064, 11)):
        found = known.of(time=when)
        assert [found[body].position[0][0] for body in "LR"] == [row, row]
    assert known.of(time=0.0066) is None


def test_known_poses_of_no_frame_or_body_are_refused(folder: Path, tmp_path: Path, turns: list[list[float]]) -> None:
    bodies = write(tmp_path / "model.csv", "body,x,y,z", [["hmd", *point] for point in BODY.tolist()])
    plain, frames, image = folder / "model.csv", folder / "frames.csv", folder / "image.csv"
    named = [["pen", *turns[0]]]
    for model, seen, header, rows, text in (
        (plain, frames, TURN, turns, "row 3: the same body as in row 2; add a column frame or time"),
        (plain, image, f"frame,{TURN}", [[0, *turns[0]]], "it has a column frame, but the image file has none"),
        (bodies, frames, f"body,{TURN}", named, "row 2: body is 'pen'; the bodies of the model are hmd"),
        (plain, frames, f"body,{TURN}", named, "row 2: body is 'pen', but the model has no column body"),
    ):
        known = write(tmp_path / "known.csv", header, rows)
        refused = run("match", model, seen, *OPTIONS, "--known", known)
        assert refused.exit_code == 2
        assert f"rootmatch: {known}" in refused.stderr
        assert text in refused.stderr
    known = write(tmp_path / "known.csv", f"time,{TURN}", [[0.0, *turns[0]]])
    assert (
        "it has a column time, but the image file has none"
        in run("match", plain, frames, *OPTIONS, "--known", known).stderr
    )


def test_what_is_known_is_read_from_the_image_file(folder: Path, tmp_path: Path) -> None:
    """In one row of each frame or in all, for one image, for many, and for a tracker: as from a file of its own."""
    both = folder / "model.csv", folder / "frames.csv"
    records = [json.loads(line) for line in run("track", *both, *OPTIONS, "--json").stdout.splitlines()]
    poses = {record["frame"]: record["pose"]["quaternion"] for record in records if record["pose"] is not None}
    header = "qx,qy,qz,qw,q_sigma"
    apart = write(tmp_path / "known.csv", f"frame,{header}", [[k, *q, 2.0] for k, q in poses.items()])
    with both[1].open(encoding="utf-8", newline="") as stream:
        names, *rows = csv.reader(stream)
    told, seen = [], set()
    for row in rows:
        number = int(row[names.index("frame")])
        whole = number in poses and (number % 2 == 0 or number not in seen)
        seen.add(number)
        told.append([*row, *(map(repr, [*poses[number], 2.0]) if whole else [""] * 5)])
    inside = write(tmp_path / "frames.csv", ",".join(names) + f",{header}", told)
    for command in ("match", "track"):
        one = run(command, both[0], inside, *OPTIONS, "--json")
        other = run(command, *both, *OPTIONS, "--known", apart, "--json")
        results = [[json.loads(line) for line in text.stdout.splitlines()] for text in (one, other)]
        assert [record["status"] for record in results[0]].count("matched") >= len(poses) - 1
        assert _without_times(results[0]) == _without_times(results[1])
        twice = run(command, both[0], inside, *OPTIONS, "--known", apart)
        assert "--known: the image file has columns of what is known as well" in twice.stderr
        assert twice.exit_code == 2
    pixels = frame(0)[0].tolist()
    first = [[*pixels[0], *poses[0], 2.0], *([*row, *[""] * 5] for row in pixels[1:])]
    image = write(tmp_path / "image.csv", f"x,y,{header}", first)
    assert run("match", both[0], image, *OPTIONS).exit_code == 0
    refused = run("match", both[0], image, *OPTIONS, "--prior", apart)
    assert "--prior" in refused.stderr
    assert "has columns of what is known of the pose" in refused.stderr


def _without_times(value: Any) -> Any:
    """A record without what a clock tells."""
    if isinstance(value, dict):
        return {name: _without_times(one) for name, one in value.items() if "second" not in name}
    return [_without_times(one) for one in value] if isinstance(value, list) else value


@pytest.mark.parametrize(
    ("header", "rows", "text"),
    [
        ("frame,x,y,tx,ty,tz,t_sigma", [[0, 1, 2, 0, 0, 1, 1], [0, 3, 4, 0, 0, 2, 1]],
         "row 3: tz is '2', but '1' in an earlier row of the same image"),
        ("frame,x,y,tx,ty,tz", [[0, 1, 2, 0, 0, 1]], "the column t_sigma is missing; give tx,ty,tz,t_sigma or none"),
        ("frame,x,y,tx,ty,tz,t_sigma", [[0, 1, 2, 0, "", 1, 1]], "row 2: ty is empty"),
        ("frame,x,y,qx,qy,qz,qw,q_sigma", [[0, 1, 2, 0, 0, 0, 2, 1]], "row 2: pose: a quaternion of length 2 given"),
    ],
)  # fmt: skip
def test_columns_of_what_is_known_that_cannot_be_read(
    tmp_path: Path, header: str, rows: list[list[Any]], text: str
) -> None:
    with pytest.raises(InputError, match=re.escape(text)):
        list(read_frames(write(tmp_path / "bad.csv", header, rows)))
    alone = header.removeprefix("frame,")
    with pytest.raises(InputError, match=re.escape(text)):
        read_points(write(tmp_path / "one.csv", alone, [row[1:] for row in rows]), 2, of_image=True)


def test_knowledge_of_one_frame_is_not_that_of_the_next(tmp_path: Path) -> None:
    rows = [[0, 1, 2, 0, 0, 1, 1], [0, 3, 4, *[""] * 4], [1, 5, 6, *[""] * 4], [2, "", "", 0, 0, 3, 1]]
    first, second, third = read_frames(write(tmp_path / "frames.csv", "frame,x,y,tx,ty,tz,t_sigma", rows))
    assert first.known is not None
    assert first.known.position is not None
    assert second.known is None
    assert third.known is not None, "of a frame without detections"
    assert len(third.points) == 0


@pytest.mark.parametrize(
    ("header", "row", "text"),
    [
        ("qx,qy,qz,qw", [0, 0, 0, 1], "the column q_sigma is missing; give qx,qy,qz,qw,q_sigma or none of them"),
        ("tx,ty,tz,t_sigma", [0, 0, "", 1], "row 2: tz is empty"),
        ("tx,ty,tz,t_sigma", [0, 0, 1, -1], "row 2: t_sigma is '-1'; give a number of 0 or more"),
        ("qx,qy,qz,qw,q_sigma", [0, 0, 0, 2, 1], "row 2: pose: a quaternion of length 2 given"),
        ("qx,qy,qz,qw,q_sigma", [0, 0, 0, 1, 60], "row 2: q_sigma is 60; give degrees up to 57"),
        ("frame,time,tx,ty,tz,t_sigma", [0, 0, 0, 0, 1, 1], "columns frame and time; give one of them"),
        ("vx,vy,vz,wx,wy,wz,v_sigma", [0, 0, 0, 0, 1, 0, 1], "row 2: prior: vertical: its length is 0"),
        ("frame,x,y", [0, 1, 2], "wz, v_sigma; is it a file of points or detections?"),
    ],
)
def test_knowledge_that_cannot_be_read(tmp_path: Path, header: str, row: list[Any], text: str) -> None:
    with pytest.raises(InputError, match=re.escape(text)):
        read_known(write(tmp_path / "bad.csv", header, [row]))
