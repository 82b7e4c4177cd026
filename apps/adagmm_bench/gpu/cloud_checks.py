"""Clouds that lie on the card against the host's float64: mixtures, tiles, covariances of the surface, scores."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import open3d as o3d

from adagmm_o3d import estimate_surface_covariances
from adagmm_o3d.mixtures.colours import ColourModel
from adagmm_o3d.mixtures.mixture import Mixture, make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.pairs.cpu_pairs import PairLoop
from adagmm_o3d.trust.pose_covariance import SCORED, Fit, score_moments

# The mixtures are float64, but for the digits that thin covariances lose. Neighbours at nearly the same distance may
# change places. The scores are sums of float32.
EXACT, CLOSE, SUMMED = 1e-9, 1e-7, 1e-4
# How far colours differ from one another and between two looks at a place [L*a*b*].
COLOURS = 10.0
SIGMA, UNMATCHED, MUTUALITY = 0.02, 0.2, 0.5


def cloud_errors(source: Mixture, target: Mixture, pose: np.ndarray) -> Iterator[tuple[str, float, float]]:
    """What, its error relative to the largest entry, and the tolerance."""
    from adagmm_o3d.kernels.cuda.front_end import cuda
    from adagmm_o3d.mixtures.device_mixture import device_mixture

    on_card = [
        device_mixture("cloud", cuda.to_device(mixture.points), cuda.to_device(mixture.covariances))
        for mixture in (source, target)
    ]
    moving, fixed, expected = normalise(source, target)
    moving_there, fixed_there, normalisation = normalise(on_card[0], on_card[1])
    yield "scale", abs(normalisation.scale / expected.scale - 1.0), EXACT
    yield "unit of variance", abs(normalisation.variance / expected.variance - 1.0), EXACT
    for name, ours, theirs in zip(("source", "target"), (moving_there, fixed_there), (moving, fixed), strict=True):
        everything = ours.take(np.arange(len(ours)))
        yield f"{name} points", _relative(everything.points, theirs.points), EXACT
        yield f"{name} covariances", _relative(everything.covariances, theirs.covariances), EXACT
        yield f"{name} variances", _relative(ours.variances, theirs.variances), EXACT
    fit = Fit(pose, SIGMA, UNMATCHED, MUTUALITY)
    yield from _score_errors("", (moving_there, fixed_there), (moving, fixed), fit)
    rng = np.random.default_rng(0)
    first, second = (COLOURS * rng.normal(size=(len(mixture), 3)) for mixture in (moving, fixed))
    painted_there = moving_there.coloured(first), fixed_there.coloured(second)
    painted = moving.coloured(first), fixed.coloured(second)
    model = ColourModel(np.full(3, COLOURS), np.ones(3), np.zeros(3), lying=0.1, floor=1.5, expected=0.4)
    yield from _score_errors("coloured ", painted_there, painted, replace(fit, colour=model))
    if len(target) > 3:
        surface = device_mixture("cloud", cuda.to_device(target.points), None)
        surface_there = make_mixture("cloud", target.points, estimate_surface_covariances(target.points))
        yield "surface covariances", _relative(surface.covariances, surface_there.covariances), CLOSE


def _score_errors(
    kind: str, there: tuple[Mixture, Mixture], here: tuple[Mixture, Mixture], fit: Fit
) -> Iterator[tuple[str, float, float]]:
    """The same of the scores of mixtures on the card and on the host."""
    from adagmm_o3d.pairs.cuda_pairs import CudaPairLoop

    scores, expected = score_moments(CudaPairLoop(*there), *there, fit), score_moments(PairLoop(*here), *here, fit)
    if max(map(len, here)) <= SCORED:  # else the two look at different points
        for what in ("curvature", "by_points", "by_blocks"):
            yield f"{kind}scores, {what}", _relative(getattr(scores, what), getattr(expected, what)), SUMMED
    yield f"{kind}probabilities of a partner", _relative(scores.matched, expected.matched), SUMMED


def check_tensors(rng: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Whether Open3D's tensors are read where they lie; nothing where this Open3D knows no CUDA."""
    if not o3d.core.cuda.is_available():
        return
    from adagmm_o3d.kernels.cuda.clouds.tensors import on_the_device

    for dtype in (np.float32, np.float64):
        values = rng.normal(size=(1000, 3)).astype(dtype)
        tensor = o3d.core.Tensor(values, device=o3d.core.Device("CUDA:0"))
        yield f"{values.dtype}", _relative(on_the_device(tensor).copy_to_host(), values)
        yield f"{values.dtype} with gaps", _relative(on_the_device(tensor[::2, :2]).copy_to_host(), values[::2, :2])


def _relative(values: Any, expected: Any) -> float:
    return float(np.abs(values - expected).max() / np.abs(expected).max())
