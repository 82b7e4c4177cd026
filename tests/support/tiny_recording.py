"""A simulated recording of a quarter of the resolution, for tests that need a recording of their own."""

from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.simulation import recording

SMALL = PinholeIntrinsics(160, 120, 131.25, 131.25, 79.5, 59.5)


def small_sensor(monkeypatch) -> None:
    """Make `simulate_recording` render small images."""
    render_depth, render_color = recording.render_depth, recording.render_color
    monkeypatch.setattr(recording, "INTRINSICS", SMALL)
    monkeypatch.setattr(recording, "render_depth", lambda *args: render_depth(*args, SMALL))
    monkeypatch.setattr(recording, "render_color", lambda *args: render_color(*args, SMALL, light_samples=1))
