"""A controller in front of three headset cameras, over a socket: how many frames are right, and how long each takes.

``python round_trip.py [--frames 300] [--no-imu] [--rate 60]`` simulates the flight, starts the server of serve.py and
asks it.
"""

import argparse
import json
import socket
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from serve import server

import rootmatch as rm

K, D, SIZE = [[275.0, 0, 320], [0, 275.0, 240], [0, 0, 1]], [0.05, -0.01, 0.002, -0.0004], (640, 480)
NOISE = 0.3


def controller(rng):
    """LEDs (16, 3) in metres on a tilted ring and a handle, and their normals."""
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False) + rng.uniform(-0.1, 0.1, 12)
    ring = np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(-0.5, 0.5, 12)])
    normals = np.vstack([ring, rng.normal(size=(4, 3)) + np.array([0, -1, 0])])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    leds = np.vstack([0.052 * normals[:12], [0, -0.08, -0.03] + 0.02 * normals[12:]]) + rng.normal(0, 0.003, (16, 3))
    return leds, normals


def rig():
    """Three splayed cameras, with x_camera = R x_rig + t."""
    for yaw, pitch, place in ((-35, 15, (-0.07, 0, 0.03)), (35, 15, (0.07, 0, 0.03)), (0, 40, (0, 0.03, 0.03))):
        R = Rotation.from_euler("yx", [yaw, -pitch], degrees=True).as_matrix().T
        yield {"K": K, "D": D, "R": R.tolist(), "t": (-R @ place).tolist(), "size": SIZE}


def flight(frames, rate, rng, leds, normals, views):
    """Frames as the server takes them, each with the true pose."""
    first, spin = Rotation.random(random_state=rng.integers(1 << 30)), rng.normal(0, 1.0, 3)
    lights = np.column_stack([rng.uniform(-2, 2, 4), rng.uniform(-1.5, 0, 4), rng.uniform(1.5, 3, 4)])
    cameras = [rm.Camera.from_opencv_fisheye(view["K"], view["D"]) for view in views]
    for k in range(frames):
        now = k / rate
        turn = Rotation.from_rotvec(spin * now) * first
        place = np.array([0.15 * np.sin(2.0 * now), 0.2 + 0.05 * np.cos(3.0 * now), 0.5])
        pixels, index = [], []
        for c, (camera, view) in enumerate(zip(cameras, views, strict=True)):
            X = turn.apply(leds) + place
            own, towards = X @ np.transpose(view["R"]) + view["t"], turn.apply(normals) @ np.transpose(view["R"])
            seen = -(own * towards).sum(1) > 0.35 * np.linalg.norm(own, axis=1)
            other = lights @ np.transpose(view["R"]) + view["t"]
            dots = camera.project(np.vstack([own[seen], other[other[:, 2] > 0.1]]))
            dots = dots[((dots > 0) & (dots < SIZE)).all(axis=1)]
            pixels.append(dots + rng.normal(0, NOISE, dots.shape))
            index += [c] * len(dots)
        imu = Rotation.from_rotvec(rng.normal(0, np.radians(2.0) / np.sqrt(3), 3)) * turn
        frame = {"time": now, "pixels": np.vstack(pixels).tolist(), "camera": index, "imu": imu.as_quat().tolist()}
        yield frame, rm.Pose(turn.as_matrix(), place)


def main():
    """Print the count of frames that are right, and the round trip."""
    ask = argparse.ArgumentParser()
    ask.add_argument("--frames", type=int, default=300)
    ask.add_argument("--rate", type=float, default=60.0)
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--no-imu", action="store_true")
    asked = ask.parse_args()
    rng = np.random.default_rng(asked.seed)
    (leds, normals), views = controller(rng), list(rig())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "controller.json"
        known = {"leds": leds.tolist(), "normals": normals.tolist(), "noise": NOISE, "rig": views}
        path.write_text(json.dumps(known))
        serving = server(path)
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        with socket.create_connection(serving.server_address) as connection, connection.makefile("rwb") as stream:
            took, busy, right, wrong = [], [], 0, 0
            for frame, truth in flight(asked.frames, asked.rate, rng, leds, normals, views):
                line = json.dumps(frame | ({"imu": None} if asked.no_imu else {})).encode() + b"\n"
                started, worked = time.perf_counter(), time.process_time()
                stream.write(line)
                stream.flush()
                answer = json.loads(stream.readline())
                took.append(1e3 * (time.perf_counter() - started))
                busy.append(time.process_time() - worked)
                if answer["t"] is not None:
                    found = rm.Pose.from_quaternion(answer["quaternion"], answer["t"], order="xyzw")
                    off = found @ truth.inverse()
                    good = np.linalg.norm(found.t - truth.t) < 0.01 and np.linalg.norm(off.rvec) < np.radians(5.0)
                    right, wrong = right + good, wrong + (not good)
        serving.shutdown()
        serving.server_close()
    later = np.array(took[1:])
    print(f"{right} of {asked.frames} frames right, {wrong} wrong")
    print(
        f"round trip: first {took[0]:.0f} ms, then median {np.median(later):.1f}, 99 % {np.quantile(later, 0.99):.1f}"
    )
    print(f"processor time of both ends after the first: {1e3 * np.mean(busy[1:]):.1f} ms a frame")


if __name__ == "__main__":
    main()
