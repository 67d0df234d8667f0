"""`explain`: what a task's detections are, from the caller's points to a finding.

The road depends on what is known: a rig's cameras are searched one by one and verified together, several bodies are
explained in turn, a predicted pose narrows the candidates. Otherwise hyper-edges are sampled into a tensor, the tensor
is solved and the solution assessed.
"""

from __future__ import annotations

from dataclasses import replace

from rootmatch.errors import InputError
from rootmatch.explain.assessment import assess
from rootmatch.explain.bodies import match_bodies
from rootmatch.explain.finding import Finding
from rootmatch.explain.multi_motion import pack_motions
from rootmatch.explain.noise_estimation import solve_with_estimated_noise
from rootmatch.explain.pose_decision import decided_by_pose
from rootmatch.explain.predicted_pose import match_predicted
from rootmatch.explain.proposed_pairs import motions_of_pairs, pays
from rootmatch.explain.rig_copies import RigCopies, copies_task, is_rig
from rootmatch.explain.rig_search import match_copies
from rootmatch.explain.sampling import affordable, sample, swept
from rootmatch.explain.searched_solution import searched_solution
from rootmatch.explain.task import MatchingTask
from rootmatch.solvers.base import solved

SOLVED = 0.6
"""Share of the time left at a deadline, after sampling, that the solver may take; the rest is for the assessment."""


def explain(task: MatchingTask) -> Finding:
    """What was found of a task, its noise estimated first where that is asked for.

    The finding of a rig is that of the copies of its points, see `rootmatch.explain.rig_copies`.
    """
    if task.estimates_noise and is_rig(task):
        raise InputError("noise: a rig does not estimate it; give a number of pixels")
    return solve_with_estimated_noise(task, _explained) if task.estimates_noise else _explained(task)


def _explained(task: MatchingTask) -> Finding:
    """What was found of a task whose noise is known."""
    if is_rig(task):
        task = copies_task(task)
    if task.bodies is not None:
        return match_bodies(task, _explained)
    if task.prior_pose is not None:
        return match_predicted(task, _explained)
    if isinstance(task.problem, RigCopies):
        return match_copies(task)
    return _several_motions(task) if task.options.packs_motions else _one_motion(task)


def _several_motions(task: MatchingTask) -> Finding:
    """Groups of one motion each, packed."""
    solution, sampled = motions_of_pairs(task) if pays(task) else pack_motions(task, sample(task))
    return assess(task, solution, sampled)


def _one_motion(task: MatchingTask) -> Finding:
    """Sampled hyper-edges, solved and assessed; all of them where a quick search leaves no match to trust."""
    sampled = sample(task)
    if (decided := decided_by_pose(task, sampled)) is not None:
        return decided
    solution = searched_solution(task, sampled)
    if solution is None:
        deadline = task.deadline.part(SOLVED)
        tensor = affordable(sampled.tensor, deadline)
        solver = task.options.solver_after(sampled.assignments is not None)
        solution = solved(solver, tensor, task.options.seed, deadline)
    assessed = assess(task, solution, sampled)
    if not assessed.status and (every := swept(task, sampled)) is not None:
        found = _explained(every)
        return replace(found, task=task, evaluated=found.evaluated + sampled.evaluated)
    return assessed
