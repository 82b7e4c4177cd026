"""Where numbers cease to mean something, and what covariances of a surface are made of; for the CPU and CUDA alike."""

# What float32 can tell apart: the least variance of a point to its largest. A thinner covariance is singular and is
# given the thickness of a surface, EPSILON.
THINNEST = 1e-6
# The least float64 that has all its digits; a variance below it counts as none.
SMALLEST = 2.2250738585072014e-308
# What float32 may make of a covariance, as a share of its largest number: entries may differ from their mirror images,
# and variances lie below zero, by this.
ROUNDING = 1e-5
# Surface covariances, as Open3D has them: neighbours of each point, and the variance across the surface.
KNN, EPSILON = 20, 1e-3
# A neighbourhood whose second smallest variance is below this share of the whole has no normal.
LINE_RATIO = 1e-10
