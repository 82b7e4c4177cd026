"""Surfaces: one depth image's grid, the fused surface of many frames, its texture, and the files they are saved as."""
