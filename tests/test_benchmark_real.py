"""The benchmark on real targets: judged by hand-made replies, on made-up data of the same form."""

import json
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rootmatch.benchmark.real import leaderboard
from rootmatch.benchmark.real.judge import judged
from rootmatch.benchmark.real.run import run_real
from rootmatch.benchmark.real.scenes import all_scenes, protocols
from rootmatch.errors import InputError

AWAY = np.array([0.0, 0.0, 6.0])


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A film of two frames: eight points, seven visible in the second."""
    folder = tmp_path / "data"
    folder.mkdir()
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (8, 3))
    K = np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]])
    pixels = (points + AWAY) @ K.T
    image = pixels[:, :2] / pixels[:, 2:] + 0.3 * rng.normal(size=(2, 8, 2))
    image[1, 3] = np.nan
    np.savez(folder / "tears_of_steel_01.npz", points3d=points, points2d=image, K=np.array([K, K]), rms_px=[0.3, 0.3])
    return folder


def answering(tmp_path: Path, body: str) -> str:
    """Command of a method whose reply to ``request`` is made by ``body``."""
    script = tmp_path / "method.py"
    lines = ["import json, sys, time", "for line in sys.stdin:", "    request = json.loads(line)"]
    script.write_text("\n".join([*lines, *(f"    {line}" for line in body.splitlines())]) + "\n")
    return f"{sys.executable} {shlex.quote(str(script))}"


def test_shuffled_scenes_keep_the_truth(data: Path) -> None:
    scenes = list(all_scenes(data))
    assert len(scenes) == 16
    for scene in scenes:
        K = np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]])
        source, target = np.array(scene.request["source"]), np.array(scene.request["target"])
        pixels = (source + AWAY) @ K.T
        seen = scene.truth >= 0
        assert seen.sum() == len(target) == 8 - scene.number % 2
        distance = (pixels[:, :2] / pixels[:, 2:])[seen] - target[scene.truth[seen]]
        assert np.abs(distance).max() < 2.0


def test_replies_are_judged(data: Path) -> None:
    scene = next(iter(all_scenes(data)))
    truth = scene.truth
    swapped = truth.copy()
    swapped[:2] = truth[[1, 0]]
    cases: list[tuple[Any, dict[str, Any]]] = [
        (truth.tolist(), {"right": 8, "wrong": 0, "full": True, "claimed": True, "misled": False, "error": None}),
        (swapped.tolist(), {"right": 6, "wrong": 2, "full": False, "claimed": True, "misled": True}),
        ([-1] * 8, {"right": 0, "wrong": 0, "full": False, "claimed": False, "misled": False}),
        ([0] * 8, {"right": 0, "claimed": False}),
        ([99] * 8, {"right": 0, "claimed": False}),
        ("nonsense", {"right": 0, "claimed": False}),
    ]
    for assignment, expected in cases:
        found = judged(scene, {"assignment": assignment, "wall": 1.0})
        assert {key: found[key] for key in expected} == expected
    assert judged(scene, {"assignment": [99] * 8, "wall": 1.0})["error"]
    assert not judged(scene, {"assignment": truth.tolist(), "matched": False, "wall": 1.0})["claimed"]


def test_a_program_is_measured_and_a_run_resumes(data: Path, tmp_path: Path) -> None:
    method = answering(
        tmp_path, 'print(json.dumps({"assignment": [-1] * len(request["source"]), "seconds": 0.5}), flush=True)'
    )
    output = tmp_path / "out"
    (entry,) = run_real(data, output, [method])
    assert (entry["scenes"], entry["full"], entry["claimed"], entry["median_seconds"]) == (16, 0, 0, 0.5)
    rows = leaderboard.rows_file(output, method)
    lines = rows.read_bytes().splitlines(keepends=True)
    # cut off in the middle of the fourth row: the run goes on there
    rows.write_bytes(b"".join(lines[:3]) + lines[3][:20])
    calls = []
    (again,) = run_real(data, output, [method], progress=lambda done, total: calls.append((done, total)))
    assert again == entry
    assert calls[0] == (4, 16)
    assert len(calls) == 13
    assert json.loads((output / "leaderboard.json").read_text()) == [entry]
    assert "| film |" in (output / "leaderboard.md").read_text()


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("time.sleep(60)", "no reply within"),
        ("sys.exit(3)", "ended"),
        ('print("hello", flush=True)', "no reply in JSON"),
    ],
)
def test_a_program_that_fails_counts_as_failed(data: Path, tmp_path: Path, body: str, says: str) -> None:
    from rootmatch.benchmark.real.program import Program

    scene = next(iter(all_scenes(data)))
    with Program(answering(tmp_path, body), start_up=2.0) as program:
        found = judged(scene, program.ask(scene.request, 2.0))
    assert says in found["error"]
    assert (found["right"], found["claimed"]) == (0, False)


def test_bad_input_is_refused(data: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a folder"):
        run_real(tmp_path / "nowhere", tmp_path / "out", ["rootmatch"])
    with pytest.raises(InputError, match="protocol: 'x' given"):
        run_real(data, tmp_path / "out", ["rootmatch"], only=["x"])
    with pytest.raises(InputError, match="cannot be started"):
        run_real(data, tmp_path / "out", ["/no/such/program"])
    (data / "tears_of_steel_01.npz").write_bytes(b"no zip")
    with pytest.raises(InputError, match="cannot be read"):
        run_real(data, tmp_path / "out", ["rootmatch"])


def test_every_protocol_has_a_scene(load_shared: Any) -> None:
    for protocol in protocols():
        found = protocol.make(load_shared(protocol.file), 0)
        assert found.protocol == protocol.name
        json.dumps(found.request, allow_nan=False)


def test_this_library_replies() -> None:
    from rootmatch.benchmark.real.methods import reply
    from rootmatch.simulation import p3p_scene

    scene = p3p_scene(n=8, outliers=3, noise=0.5, seed=1)
    camera = {"fx": 1000.0, "fy": 1000.0, "cx": 320.0, "cy": 240.0}
    request = {
        "source": scene.source.tolist(),
        "target": scene.target.tolist(),
        "problem": "p3p",
        "camera": camera,
        "noise": 0.5,
    }
    found = reply(request, "rootmatch")
    assert scene.accuracy(np.array(found["assignment"])) == 1.0
    assert found["matched"]
    assert "error" in reply({**request, "noise": -1.0}, "rootmatch")
