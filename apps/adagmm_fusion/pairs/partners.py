"""How near two points must be to count as partners: one answer for settings, judgement and what the viewer shows."""

import numpy as np
import open3d as o3d

from adagmm_fusion.pairs.settings import Settings

# Partners are nearer than this many mean distances of neighbouring target points.
PARTNER_SPACINGS = 2.0
# The same for clouds known by their voxel size alone.
PARTNER_VOXELS = 1.5


def partner_distance(target: o3d.geometry.PointCloud, chosen: float | None = None) -> float:
    """How near a target point counts as a partner [m]: as chosen, else by the target's spacing."""
    return chosen or PARTNER_SPACINGS * float(np.mean(target.compute_nearest_neighbor_distance()))


def common_partner_distance(settings: Settings) -> float:
    """How near points count as partners [m] in all clouds made with these settings, whose voxel size is fixed."""
    return settings.partner_distance_m or PARTNER_VOXELS * settings.voxel_size_m
