"""Simulated scenes of the paper's section "Experiments", seeded, with ground truth.

World frame: y points down, so that the vertical is (0, 1, 0) in the world and, for a levelled camera, in the camera
too.  Camera frame: x right, y down, z forward, ``x_cam = R X + t``.  Lengths are in the units of the cube (side 4),
image coordinates in pixels.

Each ingredient of a scene (points, camera, motions, outliers, noise, order) draws from a random stream of its own,
derived from the seed.  Scenes with the same seed therefore differ only where their parameters do: the noise at σ = 1 is
ten times the noise at σ = 0.1, and five outliers are the first five of ten.
"""

from rootmatch.simulation.ingredients import FOCAL, HEIGHT, WIDTH
from rootmatch.simulation.scenes import SCENES, Scene, p3p_scene, three_plus_one_scene, up2p_scene

__all__ = ["FOCAL", "HEIGHT", "SCENES", "WIDTH", "Scene", "p3p_scene", "three_plus_one_scene", "up2p_scene"]
