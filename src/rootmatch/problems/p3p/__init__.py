"""The perspective three-point problem: points in space and their image in one calibrated camera."""

from rootmatch.problems.p3p.problem import P3P as P3P
