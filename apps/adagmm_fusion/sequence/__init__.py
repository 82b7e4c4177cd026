"""Whole recordings: frames registered with each other, poses made consistent, and all of them fused into one mesh."""
