"""Which numbers the data can tell: singular values of the weighted derivatives, and what is in the way, in words."""

from __future__ import annotations

import numpy as np

from kr270_milling.identification.problem import Problem
from kr270_milling.robot.kinematics import forward, jacobian_at

__all__ = ["held_numbers", "hidden", "singular_values", "why_held"]

#: a column whose length is a smaller share of the longest, or a direction with a smaller share of the largest singular
#: value of the columns of length 1, is rounding of the model (1e-13 rad of 1e-4 rad) and no information
NOTHING = 1e-6
#: a torque below this share of the largest, or a lever [m] of the reflector below it, is said to be none
UNSEEN = 1e-3


def singular_values(derivatives: np.ndarray) -> np.ndarray:
    """Of the columns, each scaled to length 1, (p,), the largest first; 1 each where nothing is mixed up."""
    lengths = np.linalg.norm(derivatives, axis=0)
    unit = derivatives / np.where(lengths > 0.0, lengths, 1.0)
    return np.linalg.svd(unit, compute_uv=False)


def held_numbers(derivatives: np.ndarray) -> dict[int, int | None]:
    """Columns to be held so that the others can be told: number -> the one that it is mixed up with, None: no effect.

    derivatives: of the residuals by the factors, (m, p).
    """
    lengths = np.linalg.norm(derivatives, axis=0)
    held: dict[int, int | None] = {int(k): None for k in np.flatnonzero(~(lengths > NOTHING * lengths.max()))}
    while True:
        free = np.array([k for k in range(derivatives.shape[1]) if k not in held])
        if not free.size:
            return held
        _, values, directions = np.linalg.svd(derivatives[:, free] / lengths[free], full_matrices=False)
        if len(values) == free.size and values[-1] > NOTHING * values[0]:
            return held
        share = np.abs(np.linalg.svd(derivatives[:, free] / lengths[free])[2][-1])
        worst, partner = np.argsort(-share)[:2] if free.size > 1 else (0, 0)
        held[int(free[worst])] = int(free[partner])


def why_held(problem: Problem, number: int, partner: int | None) -> str:
    """The reason in words; partner: the number that it is mixed up with."""
    name = problem.names[number]
    if partner is not None:
        return (
            f"{name}: in every test it moved the reflector as {problem.names[partner]} does, they cannot be told apart"
        )
    if number >= 6:
        return f"{name}: nothing that was measured depends on it"
    return hidden(problem, number) or f"{name}: nothing that was measured depends on it"


def hidden(problem: Problem, number: int) -> str | None:
    """Why a joint, 0 to 5, cannot show what it does, if that is so for a reason of geometry."""
    name = problem.names[number]
    torques = np.abs(problem.torques())
    if torques[:, number].max() <= UNSEEN * torques.max():
        return f"{name}: no load turned it"
    frames = forward(problem.arm, problem.mount, problem.measured.q)
    place = frames.flange.apply(problem.measured.reflector)
    lever = np.linalg.norm(jacobian_at(frames, place)[:, :3, number], axis=-1)
    if lever.max() <= UNSEEN and not problem.finite[:, 3:].any():
        return f"{name}: the reflector lay on its axis, so its turning was not seen"
    return None
