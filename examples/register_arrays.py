"""Register NumPy arrays, in the plane: no Open3D needed."""

import numpy as np

from adagmm_o3d import mark_outliers, register_points

rng = np.random.default_rng(1)
angle = np.linspace(0.0, 2.0 * np.pi, 150, endpoint=False)
outline = np.column_stack(
    [(1.0 + 0.3 * np.cos(3.0 * angle)) * np.cos(angle), 0.7 * np.sin(angle) + 0.1 * np.cos(angle) ** 2]
)
turn = np.radians(40.0)
R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

# Half of it, noisy, elsewhere; twenty points are known to be wrong.
source = (outline[:110] + rng.normal(scale=0.01, size=(110, 2))) @ R + (0.5, -0.2)
source[:20] = rng.uniform(-2.0, 2.0, size=(20, 2))
wrong = np.arange(len(source)) < 20
covariances = mark_outliers(np.tile(np.eye(2), (len(source), 1, 1)), wrong)

result = register_points(source, outline, covariances, np.tile(np.eye(2), (len(outline), 1, 1)))
found = np.degrees(np.arctan2(result.transformation[1, 0], result.transformation[0, 0]))
print(f"turned by {found:.1f} degrees (true: {np.degrees(turn):.1f})")
print(f"{result.iterations} iterations, overlap {result.overlap:.2f}, warnings {result.warnings}")
print(f"standard deviation {np.degrees(np.sqrt(result.pose_covariance[0, 0])):.2f} degrees")
