"""What not every problem can do: who declares it, and the one error where it is asked for in vain.

A problem declares what it can: by class attributes (`rootmatch.problems.base.Problem`) and by what its record of
kernels holds (`rootmatch.problems.kernels.ProblemKernels`).
"""

from __future__ import annotations

from enum import Enum

from rootmatch.errors import InputError


class Capability(Enum):
    """Capabilities: the argument that asks for one, what a problem without it lacks, and what to do instead."""

    NORMALS = "normals", "cannot use them, as its source is not seen by one calibrated camera", "leave them out"
    """Declared by `Problem.takes_normals`."""
    PRIOR = (
        "prior",
        "is not offered with one",
        "leave it out, or use what takes one: P3P or UP2P, with the focal length in its camera, Rigid or Similarity",
    )
    """Declared by `Problem.takes_prior` and `Problem.takes_motion_prior`."""
    RESOLUTION = "resolution", "has no camera in whose image points could fall together", "leave it out"
    """Declared by a camera with pixels whose pose the problem fits."""
    SOURCE_NOISE = (
        "noise",
        "has exact source points, but a pair (source, target) was given",
        "give one number, or one for each target point",
    )
    """Declared by `Problem.noisy_source`."""
    POSE = (
        "pose",
        "fits no poses, as its equations do not say what they are",
        "estimate one from `assignment` with a solver of your own",
    )
    """Declared by `Problem.min_for_pose`."""
    GUIDED = "sampler", "has no hypotheses to guide a search", 'use sampler="exhaustive" or "random"'
    """Declared by `ProblemKernels.hypotheses`, `Problem.point_clouds`, `Problem.two_views` and
    `Problem.at_focal_lengths`."""
    COMPLETION = ("sampler", "has no predictions to complete minimal sets", 'use sampler="exhaustive" or "random"')
    """Declared by `ProblemKernels.completion`."""
    RESIDUAL = "residual", "has no kernels of that kind", 'use another kind, such as residual="joint"'
    """Declared by `ProblemKernels.residuals`."""
    SINGLE_PRECISION = (
        "backend",
        "has no residual of this kind whose ranking of hyper-edges survives single precision",
        'use backend="cuda"; "joint" and "normalised" of p3p and up2p do survive it',
    )
    """Declared by `ResidualKernels.single`."""

    def require(self, declared: object, problem: str) -> None:
        """Raise the one error unless the capability is declared.

        ``declared``: what the problem declares; false where it lacks the capability. ``problem``: name of the problem.
        Raises `InputError`.
        """
        if not declared:
            argument, lacking, instead = self.value
            raise InputError(f"{argument}: {problem} {lacking}; {instead}")
