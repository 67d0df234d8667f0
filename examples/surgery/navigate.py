"""Find the tip of a tool in the plan from unlabelled markers, with its expected error: ``python navigate.py [--seed
1]``

A plan (CT) lists fiducials. A tracker reports 3D points without labels, millimetres: the fiducials, the markers of two
tools, and strays. Not for clinical use.
"""

import argparse

import numpy as np
from scipy.spatial.transform import Rotation

import rootmatch as rm

CT, TRACKER = 0.2, 0.25  # σ of a coordinate: in the plan, and of the tracker
TIPS = {"pointer": np.array([0.0, 0.0, 160.0]), "drill": np.array([10.0, 0.0, 120.0])}


def shapes(rng):
    """Fiducials of the plan, and the markers of each tool in its own frame."""
    plan = rng.uniform(-80, 80, (8, 3)) * (1, 1, 0.6)
    pointer = np.array([[0, 0, 0], [50, 5, 0], [-8, 62, 0], [-45, -12, 9]], float)
    drill = np.array([[0, 0, 0], [38, 0, 6], [0, 75, 0], [-57, -20, 0], [12, 33, 25]], float)
    return plan, {"pointer": pointer, "drill": drill}


def moved(rng, points):
    """The points somewhere in the tracker's volume, and the true motion."""
    R = Rotation.random(random_state=rng.integers(1 << 30)).as_matrix()
    motion = rm.Pose(R, rng.uniform(-150.0, 150.0, 3) + np.array([0.0, 0.0, 1500.0]))
    return motion.transform(points), motion


def main():
    """Register the plan, find the tools, and print where their tips are."""
    ask = argparse.ArgumentParser()
    ask.add_argument("--seed", type=int, default=1)
    rng = np.random.default_rng(ask.parse_args().seed)
    plan, tools = shapes(rng)
    parts, truth = zip(*(moved(rng, points) for points in (plan, *tools.values())), strict=True)
    everything = np.vstack([*parts, rng.uniform((-200, -200, 1350), (200, 200, 1650), (4, 3))])  # and four strays
    measured = rng.permutation(everything + rng.normal(0, TRACKER, everything.shape))

    source = np.vstack([plan + rng.normal(0, CT, plan.shape), *tools.values()])
    bodies = np.repeat(["plan", *tools], [len(part) for part in parts])
    noise = np.where(bodies == "plan", CT, 0.02), TRACKER  # of each source point, and of the tracker
    match = rm.match(source, measured, rm.Rigid(), noise=noise, bodies=bodies)
    for name, body in match.bodies.items():
        if not body:
            raise SystemExit(f"{name}: {body.advice}")
    registration = match.bodies["plan"].pose  # from the plan to the tracker
    print(f"FRE {registration.fre:.2f} mm over {len(registration.points)} fiducials")
    for (name, tip), true in zip(TIPS.items(), truth[1:], strict=True):
        tool = registration.inverse() @ match.bodies[name].pose  # from the tool to the plan, with both errors
        expected = tool.tre(tip)
        off = np.linalg.norm(tool.transform(tip) - (truth[0].inverse() @ true).transform(tip))
        place = tool.transform(tip)
        print(f"{name}: tip at {place.round(1)} in the plan, expected error {expected.rms:.2f} mm, true {off:.2f} mm")


if __name__ == "__main__":
    main()
