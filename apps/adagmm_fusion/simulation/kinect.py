"""A Kinect v1 looking at a scene: its colour image, and its depth image with the defects of a real one."""

from dataclasses import dataclass

import numpy as np

from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.simulation.raycast import Hits, Scene
from adagmm_fusion.simulation.room import LIGHT_CENTER, LIGHT_SIZE

INTRINSICS = PinholeIntrinsics(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5)
_WARM, _COOL = np.array([1.0, 0.94, 0.84]), np.array([0.86, 0.93, 1.0])  # the lamp, and the light from all sides
_R2 = np.array([0.7548776662466927, 0.5698402909980532])  # steps of the R2 low-discrepancy sequence


@dataclass(frozen=True)
class KinectModel:
    """What the depth sensor does to the truth.

    baseline_m, disparity_step_px : depth = fx · baseline / disparity, disparity in multiples of the step.
    min_depth_m, max_depth_m : nothing is reported outside.
    max_incidence_deg : nor where the ray meets the surface more obliquely than this.
    edge_disparity_px : nor beside a depth edge, where the disparity's second difference exceeds this.
    Axial and lateral noise: Nguyen, Izadi and Lovell 2012, equations for σ_z and σ_L.
    """

    baseline_m: float = 0.075
    disparity_step_px: float = 0.125
    min_depth_m: float = 0.4
    max_depth_m: float = 5.0
    max_incidence_deg: float = 80.0
    edge_disparity_px: float = 0.5


def nguyen_axial_std_m(depth_m: np.ndarray, incidence: np.ndarray) -> np.ndarray:
    """Standard deviation along the optical axis [m]; incidence is the angle between normal and ray [rad], < π/2."""
    base = 0.0012 + 0.0019 * (depth_m - 0.4) ** 2
    grazing = 0.0001 / np.sqrt(depth_m) * incidence**2 / (np.pi / 2 - incidence) ** 2
    return base + np.where(incidence > np.deg2rad(60.0), grazing, 0.0)


def nguyen_lateral_std_px(incidence: np.ndarray) -> np.ndarray:
    """Standard deviation across the optical axis [px]."""
    return 0.8 + 0.035 * incidence / (np.pi / 2 - incidence)


def render_depth(
    scene: Scene,
    T_world_camera: np.ndarray,
    rng: np.random.Generator,
    model: KinectModel,
    intrinsics: PinholeIntrinsics = INTRINSICS,
) -> np.ndarray:
    """The sensor's depth image, (H, W) uint16 [mm], 0 where it reports none."""
    columns, rows = np.meshgrid(np.arange(intrinsics.width, dtype=float), np.arange(intrinsics.height, dtype=float))
    columns, rows = columns.ravel(), rows.ravel()
    shape = (intrinsics.height, intrinsics.width)
    exact = scene.cast(T_world_camera[:3, 3], _ray_directions(columns, rows, T_world_camera, intrinsics))
    edge = _depth_edges(
        exact.distance.reshape(shape), intrinsics.fx * model.baseline_m, model.edge_disparity_px
    ).ravel()

    max_incidence = np.deg2rad(model.max_incidence_deg)
    exact_incidence = _incidence(exact, T_world_camera)
    lateral = nguyen_lateral_std_px(np.minimum(exact_incidence, max_incidence))[:, None]
    lateral = lateral * rng.standard_normal((columns.size, 2))
    seen_directions = _ray_directions(columns + lateral[:, 0], rows + lateral[:, 1], T_world_camera, intrinsics)
    seen = scene.cast(T_world_camera[:3, 3], seen_directions)
    depth_m = seen.distance  # the directions have length one along the optical axis
    incidence = _incidence(seen, T_world_camera)
    with np.errstate(divide="ignore"):
        noisy = depth_m + nguyen_axial_std_m(np.maximum(depth_m, 1e-3), incidence) * rng.standard_normal(columns.size)
        steps = np.floor(intrinsics.fx * model.baseline_m / noisy / model.disparity_step_px + 0.5)
        measured = intrinsics.fx * model.baseline_m / (steps * model.disparity_step_px)

    # The projector stands to the right of the camera. Where it casts no light, there is no depth.
    projector = (T_world_camera @ [model.baseline_m, 0.0, 0.0, 1.0])[:3]
    reflecting = np.array([part.returns_infrared for part in scene.parts] + [False])[seen.part]
    missing = edge | ~reflecting | ~scene.visible(seen.points, seen.facet_normals, projector)
    missing |= (exact_incidence > max_incidence) | (incidence > max_incidence)
    missing |= ~((measured >= model.min_depth_m) & (measured <= model.max_depth_m))
    depth_mm = np.floor(np.where(missing, 0.0, measured) * 1000.0 + 0.5)
    return depth_mm.astype(np.uint16).reshape(shape)


def render_color(
    scene: Scene,
    T_world_camera: np.ndarray,
    rng: np.random.Generator,
    intrinsics: PinholeIntrinsics = INTRINSICS,
    light_samples: int = 4,
) -> np.ndarray:
    """The colour image, (H, W, 3) uint8 RGB: four rays a pixel, a ceiling lamp with soft shadows, ambient occlusion."""
    pixels = intrinsics.height * intrinsics.width
    columns, rows = np.meshgrid(np.arange(intrinsics.width, dtype=float), np.arange(intrinsics.height, dtype=float))
    shifts = rng.random((pixels, 2))  # a low-discrepancy sequence, shifted in each pixel: little noise from few samples
    total = np.zeros((pixels, 3))
    for k, (du, dv) in enumerate(((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))):
        directions = _ray_directions(columns.ravel() + du, rows.ravel() + dv, T_world_camera, intrinsics)
        hits = scene.cast(T_world_camera[:3, 3], directions)
        samples = [np.mod(shifts + (k * light_samples + i) * _R2, 1.0) for i in range(light_samples)]
        total += _radiance(scene, hits, samples)
    exposed = 1.0 - np.exp(-1.45 * total / 4.0)
    encoded = 255.0 * exposed ** (1.0 / 2.2) + rng.normal(0.0, 1.2, total.shape)
    return np.clip(np.floor(encoded + 0.5), 0, 255).astype(np.uint8).reshape(intrinsics.height, intrinsics.width, 3)


def _radiance(scene: Scene, hits: Hits, samples: list[np.ndarray]) -> np.ndarray:
    """(N, 3) linear light towards the camera; each sample (N, 2) in 0..1 picks a place on the lamp and in the sky."""
    albedo, normals, glow = scene.surface(hits)
    light, sky = np.zeros(len(albedo)), np.zeros(len(albedo))
    for sample in samples:
        place = LIGHT_CENTER + np.pad((sample - 0.5) * LIGHT_SIZE, ((0, 0), (0, 1)))
        to_light = place - hits.points
        distance = np.linalg.norm(to_light, axis=1)
        cosine = np.maximum((to_light * normals).sum(axis=1) / distance, 0.0)
        # The lamp is a panel that shines down: its own cosine, and the square law.
        emitted = np.maximum(to_light[:, 2] / distance, 0.05)
        light += (
            cosine * emitted / np.maximum(distance, 0.3) ** 2 * scene.visible(hits.points, hits.facet_normals, place)
        )
        # The normal plus a random unit vector is distributed as the cosine.
        height, azimuth = 2.0 * sample[:, 0] - 1.0, 2.0 * np.pi * sample[:, 1]
        ring = np.sqrt(1.0 - height**2)
        sphere = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), height], axis=1)
        sky += scene.openness(hits.points, _unit(normals + sphere), hits.facet_normals, reach=0.9)
    shade = (2.6 * light / len(samples))[:, None] * _WARM + (0.42 * sky / len(samples))[:, None] * _COOL
    return albedo**2.2 * (shade + 1.6 * glow[:, None])


def _ray_directions(
    columns: np.ndarray, rows: np.ndarray, T_world_camera: np.ndarray, intrinsics: PinholeIntrinsics
) -> np.ndarray:
    """(N, 3) directions in the world whose length along the optical axis is one."""
    x, y = (columns - intrinsics.cx) / intrinsics.fx, (rows - intrinsics.cy) / intrinsics.fy
    return np.stack([x, y, np.ones_like(x)], axis=1) @ T_world_camera[:3, :3].T


def _incidence(hits: Hits, T_world_camera: np.ndarray) -> np.ndarray:
    """Angle between surface normal and the ray to the camera [rad], kept below π/2."""
    to_camera = _unit(T_world_camera[:3, 3] - hits.points)
    return np.arccos(np.clip((to_camera * hits.facet_normals).sum(axis=1), 1e-3, 1.0))


def _depth_edges(depth_m: np.ndarray, focal_baseline: float, threshold_px: float) -> np.ndarray:
    """(H, W) bool; disparity is linear in the image on any plane, so its second difference shows the edges."""
    disparity = focal_baseline / np.maximum(depth_m, 0.1)
    edge = np.zeros(depth_m.shape, dtype=bool)
    edge[:, 1:-1] |= np.abs(disparity[:, 2:] - 2.0 * disparity[:, 1:-1] + disparity[:, :-2]) > threshold_px
    edge[1:-1, :] |= np.abs(disparity[2:, :] - 2.0 * disparity[1:-1, :] + disparity[:-2, :]) > threshold_px
    return edge


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
