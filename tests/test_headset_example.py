"""examples/headset, shortened: from OpenCV's pixels to poses, by the command line and in Python."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from commands import rows_of
from rootmatch.cli.app import app

pytest.importorskip("cv2")
EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "headset"
FRAMES = 8


def run(monkeypatch: pytest.MonkeyPatch, script: str, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", [script, *arguments])
    runpy.run_path(str(EXAMPLE / script), run_name="__main__")


@pytest.mark.parametrize("lens", [(), ("--fisheye",)], ids=["distorted", "fisheye"])
def test_a_recording_is_tracked(
    lens: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, poses = tmp_path / "recording", tmp_path / "poses.csv"
    run(monkeypatch, "make_recording.py", str(folder), "--frames", str(FRAMES), *lens)
    if lens:
        command = ["track", str(folder / "model.csv"), str(folder / "frames.csv"), "--problem", "p3p"]
        command += ["--camera", str(folder / "camera.json"), "--noise", "0.4", "--view-angle", "65"]
        assert CliRunner().invoke(app, [*command, "--poses", str(poses)], catch_exceptions=False).exit_code == 0
    else:
        picture = tmp_path / "flight.gif"
        run(monkeypatch, "track.py", str(folder), str(poses), str(picture))
        assert picture.stat().st_size > 1000
    truth = {(row["frame"], row["body"]): row for row in rows_of(folder / "truth.csv")}
    found = [row for row in rows_of(poses) if row["status"] == "matched"]
    assert len(found) >= 2 * FRAMES - 2
    for row in found:
        off = [float(row[name]) - float(truth[row["frame"], row["body"]][name]) for name in ("tx", "ty", "tz")]
        assert np.linalg.norm(off) < 0.02
    capsys.readouterr()
    run(monkeypatch, "compare.py", str(folder / "truth.csv"), str(poses))
    assert f"of {FRAMES} frames matched" in capsys.readouterr().out


def test_the_program_is_short() -> None:
    assert len((EXAMPLE / "track.py").read_text().splitlines()) < 40
