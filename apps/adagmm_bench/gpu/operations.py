"""Floating-point operations of one pair of points in each kernel, what a share of a card's peak is counted from.

An addition and a multiplication are one each, a fused multiplication and addition two, an inverse square root and a
power of two one. Nothing else counts: no index, no load, no test of a tile, no sum of sums. In three dimensions; a test
in the CUDA simulator counts them anew.
"""

PAIR_OPERATIONS = {
    "adaptive": 87,
    "adaptive isotropic": 27,
    "convolved": 82,
    "convolved isotropic": 29,
    "columns": 59,
    "columns isotropic": 17,
}
