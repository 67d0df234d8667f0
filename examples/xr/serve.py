"""Track over a socket: one line of JSON in per frame, one line out. ``python serve.py controller.json [PORT]``

In:  {"time": s, "pixels": [[x, y], …], "camera": [index, …], "imu": [qx, qy, qz, qw] or null}
Out: {"time": s, "state": "tracking", "matched": n, "t": [x, y, z], "quaternion": [x, y, z, w]}, t null where unknown
"""

import gc
import json
import socketserver
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import rootmatch as rm

IMU_SIGMA = np.radians(2.0) / np.sqrt(3.0)
"""About each axis: 2° in all."""


def tracker_of(path: Path) -> rm.Tracker:
    """The tracker of a file with the controller's LEDs and the cameras of the rig."""
    known = json.loads(path.read_text())
    views = [
        (rm.Camera.from_opencv_fisheye(one["K"], one["D"]), np.array(one["R"]), np.array(one["t"]))
        for one in known["rig"]
    ]
    rig = rm.Rig(views, sizes=[one["size"] for one in known["rig"]])
    return rm.Tracker(known["leds"], rm.P3P(rig), noise=known["noise"], normals=known["normals"])


def answered(tracker: rm.Tracker, line: bytes) -> bytes:
    """The answer to a frame."""
    frame = json.loads(line)
    pixels, camera = np.reshape(frame["pixels"], (-1, 2)), np.array(frame["camera"], int)
    prior = None
    if frame.get("imu") is not None:  # also where the controller is lost: the rotation helps to find it again
        prior = rm.PosePrior(rotation=(Rotation.from_quat(frame["imu"]).as_matrix(), IMU_SIGMA))
    match = tracker.update((pixels, camera), time=frame["time"], prior=prior)
    answer = {"time": frame["time"], "state": tracker.state.name.lower(), "matched": 0, "t": None, "quaternion": None}
    if match:
        pose = match.fused_pose or match.pose
        seen = match.sightings.assignment >= 0  # a camera a row
        answer |= {"matched": int(seen.sum()), "t": pose.t.tolist(), "quaternion": pose.quaternion.tolist()}
    return json.dumps(answer).encode() + b"\n"


class Handler(socketserver.StreamRequestHandler):
    """A connection, with a tracker of its own."""

    disable_nagle_algorithm = True  # or an answer waits for more to send

    def handle(self) -> None:
        """Answer each line as it comes."""
        tracker = tracker_of(self.server.path)
        for line in self.rfile:
            self.wfile.write(answered(tracker, line))


def server(path: Path, port: int = 0) -> socketserver.TCPServer:
    """A server on this machine; port 0 for a free one."""
    made = socketserver.ThreadingTCPServer(("127.0.0.1", port), Handler)
    made.daemon_threads, made.path = True, path
    return made


if __name__ == "__main__":
    tracker = tracker_of(Path(sys.argv[1]))
    rm.warmup(
        tracker.matcher.problem, tracker.matcher.source, normals=tracker.matcher.normals
    )  # or a frame waits for it
    gc.freeze()  # a garbage collection of all that was imported would hold up a frame by 0.05 to 0.2 s
    serving = server(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 5005)
    print(f"listening on port {serving.server_address[1]}")
    serving.serve_forever()
