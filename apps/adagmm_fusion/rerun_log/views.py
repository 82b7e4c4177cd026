"""The kinds of view that the dashboard is made of."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.colors import BACKGROUND
from adagmm_fusion.rerun_log.eyes import eye_pose


@dataclass(frozen=True)
class Eye:
    """Where the 3D views look from and to, in the target sensor's frame [m]."""

    position: tuple[float, float, float] = (0.6, -0.9, -1.2)
    look_target: tuple[float, float, float] = (0.0, 0.0, 2.0)

    @classmethod
    def seeing(cls, clouds: list[np.ndarray]) -> "Eye":
        """An eye before which clouds (n, 3) fill the picture; see `eye_pose`."""
        T = eye_pose(clouds)
        ahead = float(np.median((np.concatenate(clouds) - T[:3, 3]) @ T[:3, 2]))
        return cls(_three(T[:3, 3]), _three(T[:3, 3] + max(ahead, 0.1) * T[:3, 2]))

    @classmethod
    def around(cls, points: np.ndarray) -> "Eye":
        """An eye that sees all of a cloud, points (N, 3), wherever its sensor was."""
        center = points.mean(axis=0)
        radius = float(np.linalg.norm(points - center, axis=1).max())
        position = center + radius * np.array((0.7, -0.8, -1.6))
        return cls(_three(position), _three(center))

    def controls(self, *, tracking: str | None = None) -> rrb.EyeControls3D:
        return rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=self.position,
            look_target=self.look_target,
            eye_up=(0.0, -1.0, 0.0),
            tracking_entity=None if tracking is None else f"/{tracking}",
        )


def scene(name: str, contents: Mapping[str, str | None], eye: Eye | str) -> rrb.Spatial3DView:
    """A 3D view of entities, each with the layer that colours its points, or None for what it is logged with.

    eye : where it looks from, or the entity of the eye that it tracks.
    """
    tracked = [eye] if isinstance(eye, str) else []
    controls = Eye().controls(tracking=eye) if isinstance(eye, str) else eye.controls()
    return rrb.Spatial3DView(
        name=name,
        origin=entities.WORLD,
        contents=[f"/{entity}" for entity in (*contents, *tracked)],
        overrides={entity: _colored_by(layer) for entity, layer in contents.items() if layer is not None},
        background=BACKGROUND,
        line_grid=False,
        eye_controls=controls,
    )


def _colored_by(layer: str) -> rrb.Visualizer:
    colors = VisualizerComponentMapping(
        target="Points3D:colors",
        source_kind=ComponentSourceKind.SourceComponent,
        source_component=f"{layer}:colors",
    )
    return rr.Points3D.from_fields().visualizer(mappings=[colors])


def image(name: str, origin: str, contents: list[str]) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(name=name, origin=origin, contents=[f"/{entity}" for entity in contents])


def curve(name: str, *contents: str) -> rrb.TimeSeriesView:
    """Series over time, with a cursor; all such views share one time axis. No legend hides any of them."""
    return rrb.TimeSeriesView(
        name=name,
        contents=[f"/{entity}" for entity in contents],
        axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def legend(entity: str, size: tuple[int, int]) -> rrb.Spatial2DView:
    """An image of (height, width) as it is, without a title."""
    bounds = rrb.VisualBounds2D(x_range=(0, size[1]), y_range=(0, size[0]))
    return rrb.Spatial2DView(name="Legend", origin=entity, titlebar=False, visual_bounds=bounds, background=BACKGROUND)


def bars(name: str, entity: str) -> rrb.BarChartView:
    return rrb.BarChartView(name=name, origin=entity, plot_legend=rrb.PlotLegend(visible=False))


def _three(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = map(float, vector)
    return x, y, z
