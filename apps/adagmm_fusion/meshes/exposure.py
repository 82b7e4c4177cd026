"""Exposure and white balance of photographs of one surface made alike, before they are blended."""

from dataclasses import replace

import numpy as np

from adagmm_fusion.meshes.texture_views import TextureView

# Darker and brighter values are noise and clipping: they do not tell a gain.
DARKEST, BRIGHTEST = 12.0, 243.0
# Two photographs share at least so many places, else nothing is known between them.
MIN_SHARED = 200
# How strongly a photograph is held to be right as it is, against one shared pair of photographs.
TRUST_AS_IT_IS = 0.05
MOST_GAIN = 4.0
GAMMA = 2.2


def matched_exposures(views: list[TextureView], points: np.ndarray, normals: np.ndarray) -> list[TextureView]:
    """The views with their colours as one camera with one exposure and white balance would have them.

    Gains of each channel of light (not of sRGB values) make photographs that show the same of the points (n, 3), with
    normals (n, 3), agree; their mean over the photographs is none.
    """
    gains = exposure_gains(views, points, normals)
    return [
        replace(view, color=_brightened(view.color, gain)) if np.any(np.abs(gain - 1.0) > 1e-3) else view
        for view, gain in zip(views, gains, strict=True)
    ]


def exposure_gains(views: list[TextureView], points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(k, 3) gains of light for k views, by least squares over the pairs of views that share enough places."""
    k = len(views)
    quality = [view.quality(points, normals) for view in views]
    light = [np.where(_well_exposed(c), np.log(np.maximum(c, 1.0)) * GAMMA, np.nan) for c in _colors(views, points)]
    system, sides = np.zeros((k, k)), np.zeros((k, 3))
    for i in range(k):
        for j in range(i):
            both = (quality[i] > 0) & (quality[j] > 0) & np.isfinite(light[i] + light[j]).all(axis=1)
            if np.count_nonzero(both) < MIN_SHARED:
                continue
            ratio = np.median(light[j][both] - light[i][both], axis=0)  # what i lacks to look like j
            system[[i, j], [i, j]] += 1.0
            system[[i, j], [j, i]] -= 1.0
            sides[i] += ratio
            sides[j] -= ratio
    gains = np.linalg.solve(system + TRUST_AS_IT_IS * np.eye(k), sides)
    return np.clip(np.exp(gains), 1.0 / MOST_GAIN, MOST_GAIN)


def _colors(views: list[TextureView], points: np.ndarray) -> list[np.ndarray]:
    return [view.colors_at(points) for view in views]


def _well_exposed(colors: np.ndarray) -> np.ndarray:
    return (colors >= DARKEST) & (colors <= BRIGHTEST)


def _brightened(color: np.ndarray, gain: np.ndarray) -> np.ndarray:
    values = np.arange(256.0)[:, None] * gain ** (1.0 / GAMMA)
    table = np.floor(np.clip(values, 0.0, 255.0) + 0.5).astype(np.uint8)
    return np.stack([table[color[..., c], c] for c in range(3)], axis=-1)
