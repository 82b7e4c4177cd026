"""Where numbers cease to mean something, and what covariances of a surface are made of; for the CPU and CUDA alike."""

# What float32 can tell apart: the least variance of a point to its largest.
THINNEST = 1e-6
# Entries may differ from their mirror images by this share of the largest; a variance below that one is none.
SKEW, LEAST_POSITIVE = 1e-5, 1e-12
# Surface covariances, as Open3D has them: neighbours of each point, and the variance across the surface.
KNN, EPSILON = 20, 1e-3
# A neighbourhood whose second smallest variance is below this share of the whole has no normal.
LINE_RATIO = 1e-10
