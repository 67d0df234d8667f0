"""Planar motion: two images from a camera that moves in a plane and rotates about its normal, as on a ground robot."""

from rootmatch.problems.planar_motion.problem import PlanarMotion as PlanarMotion
