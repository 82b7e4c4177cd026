"""Whether to stay where the surfaces let a start be.

Where a camera was turned in place the walls of its two views slide along each other until more of them overlaps, and EM
goes there, as a point without a partner costs. But nothing that both views know asks for it. So the start is fitted by
its surfaces alone, along what these hold. If the clouds hold there, and nothing that is known at both poses fits worse
there than at the end of the search, that end was not worth leaving the start for.
"""

from __future__ import annotations

import math

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.runs import inverse_of, pose_distance
from adagmm_o3d.lie import se_exp
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.search.find import ESTABLISHED, ESTABLISHED_HELD, STAYED
from adagmm_o3d.trust.agreement import LEAST_POINTS, NEAR, SAME_WAY, Surface, typical_off
from adagmm_o3d.trust.fit_loss import SIGNIFICANT, FitLoss, some_surface
from adagmm_o3d.trust.judge import Judge, holds

# Steps of a fit, when one is short, and how much softer than the stiffest direction one may be that gets a step.
STEPS, SHORT, SOFT = 30, 1e-6, 1e-3
# So far from the start's fit the end of the search is another pose; see `runs.pose_distance`.
LEFT = 0.05
# What holds at a fit of few points, at least, for one of more to be tried.
ROUGHLY = 0.9


def fit_to_stay_at(
    judge: Judge, source: Mixture, target: Mixture, start: Array, end: Array, *, vouched: bool
) -> Array | None:
    """(4, 4) the fit of `start` that there is no reason to leave for `end`; None if there is, or they are the same.

    A start that nobody `vouched` for has to be near its fit, unless the end is not established.
    """
    farthest = math.inf
    if not vouched and judge.evidence([end])[0] >= ESTABLISHED and judge.held(end) >= ESTABLISHED_HELD:
        farthest = STAYED
    rough = surface_fit(*judge.surfaces, start, farthest)
    if rough is None or pose_distance(rough, end) <= LEFT or judge.held(rough) < ROUGHLY:
        return None
    own, other = some_surface(source), some_surface(target)
    if own is None or other is None:
        return None
    fit = surface_fit(own, other, rough, farthest)
    if fit is None or pose_distance(fit, end) <= LEFT or not holds(judge.held(fit)):
        return None
    back, forth = fit @ inverse_of(end), inverse_of(fit) @ end
    lost = FitLoss(own, other, end).of(back) + FitLoss(other, own, inverse_of(end)).of(forth)
    return fit if lost < SIGNIFICANT * math.sqrt(2.0) else None


def surface_fit(source: Surface, target: Surface, start: Array, farthest: float) -> Array | None:
    """(4, 4) where the points of two surfaces in space near `start` are nearest to each other's planes; None where
    hardly any meet, or it is farther from there than that.

    Both clouds' points count, those where the other surface goes on and faces alike, and less the farther off they are.
    Directions that no plane holds get no step.

    Source
    ------
    J. Zhang, M. Kaess, S. Singh: On Degeneracy of Optimization-based State Estimation Problems, ICRA 2016.
    """
    pose = start
    for _ in range(STEPS):
        there, back = _met(source, target, pose), _met(target, source, inverse_of(pose))
        # What the target's points meet is seen from the source: it is taken along.
        points, normals, offsets = back
        turned = normals @ pose[:3, :3].T
        back = points @ pose[:3, :3].T + pose[:3, 3], turned, -offsets
        points, normals, offsets = (np.concatenate(parts) for parts in zip(there, back, strict=True))
        if len(points) < LEAST_POINTS:
            return None
        typical = typical_off(offsets, max(source.spacing, target.spacing))
        rows = np.concatenate([np.cross(points, normals), normals], axis=1)
        weighted = rows / (1.0 + (0.5 * offsets / typical) ** 2)[:, None]
        stiffness, directions = np.linalg.eigh(np.einsum("nk,nl->kl", weighted, rows))
        held = stiffness > SOFT * stiffness[-1]
        pull = directions[:, held].T @ np.einsum("nk,n->k", weighted, offsets)
        step = -(directions[:, held] / stiffness[held]) @ pull
        pose = se_exp(step) @ pose
        if pose_distance(pose, start) > farthest:
            return None
        if np.linalg.norm(step) < SHORT:
            break
    return pose


def _met(own: Surface, other: Surface, pose: Array) -> tuple[Array, Array, Array]:
    """Of the points that a pose moves to the other surface: where it is met (k, 3), its normals there, and how far off
    along these the points are (k,)."""
    moved, turned = own.points @ pose[:3, :3].T + pose[:3, 3], own.normals @ pose[:3, :3].T
    nearest, squares, _ = other.beside(moved)
    normals = other.normals[nearest]
    met = (squares < (NEAR * max(own.spacing, other.spacing)) ** 2) & ~other.ends[nearest]
    met &= np.abs(np.einsum("ni,ni->n", turned, normals)) > SAME_WAY
    offsets = np.einsum("ni,ni->n", normals, moved - other.points[nearest])
    return moved[met], normals[met], offsets[met]
