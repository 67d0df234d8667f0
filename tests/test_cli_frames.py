"""Many frames on the command line: each for itself, or in order, and what a run that stopped left behind."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from rootmatch.cli import app
from test_tracker import BODY, frame

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
