"""The order of the numbers that make a point, and that a source point and a pass over all pairs leave behind.

It is that of all devices. C is the weight of a pair, d = y - x, A and B the two precisions over sigma (the paper's
Eq. 5).
"""

# A point of a mixture, component by component.
X = 0  # 0..2: x, y, z
SHARE = 3  # what the weight of a pair is multiplied with
MATRIX = 4  # 4..9: its covariance at σ, or its precision, packed; of multiples of the identity one entry
# Behind the matrix, and so by its size, where they count:
FACTOR, ISOTROPIC_FACTOR = 10, 5  # what its posterior does to the weights of its pairs
HUE, ISOTROPIC_HUE = 11, 6  # three coordinates of its colour

# Sums over all target points for one source point. With convolved weights the precision P of the pair stands for
# A + B, and nothing turns.
WEIGHT = 0  # Σ C
ENERGY = 1  # Σ C dᵀ(A + B)d
PRECISION = 2  # 2..7: Σ C A (Σ C P), packed
PULL = 8  # 8..10: Σ C (A + B) d
TORQUE = 11  # 11..13: Σ C d x (B d), the part of the gradient that is there because B turns with R
DENSITY = 14  # the target mixture's density at the source point (convolved weights only)
ROW_SUMS = 15

# Sums over all pairs, for a left perturbation exp(δ)·T with δ = (ω, v): what the M-step needs.
HESSIAN = 0  # 0..20: the upper triangle of the 6x6 Gauss-Newton matrix, row by row
GRADIENT = 21  # 21..26
TOTAL_WEIGHT = 27
TOTAL_ENERGY = 28
TOTAL_MATCHED = 29  # Σ weight · the probability to have a partner (convolved weights only)
TOTAL_SUMS = 30

# What is summed over the pairs of a point, for a left perturbation δ = (ω, v) of the pose.
SCORE = 0  # 0..5: Σ w j, w the weight of a pair, j = Jᵀ S⁻¹ d the gradient of half its squared Mahalanobis distance
SENSITIVITY = 6  # 6..11: -Σ share ∂c/∂δ, the change of the density at the point
CURVATURE = 12  # 12..47: Σ w ∂j/∂δ + Σ j ∂c/∂δ w/c, row by row: the change of the score but for that of the densities
# ... and but for the Σ w e x v by which a shift along e moves the lever arms: at an optimum the pulls v sum to nothing.
POINT_SUMS = 48
