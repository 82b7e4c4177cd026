"""What the viewer opens with, as one value: before and after, the result, the curves, the images, the report."""

from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.colors import SOURCE_COLOR, TARGET_COLOR
from adagmm_fusion.rerun_log.entities import INITIAL_SOURCE, SOURCE, TARGET, TRUE_SOURCE

BACKGROUND = (24, 26, 32)


@dataclass(frozen=True)
class Eye:
    """Where the 3D views look from and to, in the target sensor's frame [m]."""

    position: tuple[float, float, float] = (0.6, -0.9, -1.2)
    look_target: tuple[float, float, float] = (0.0, 0.0, 2.0)

    @classmethod
    def behind(cls, points: np.ndarray) -> "Eye":
        """An eye above and to the right of the target sensor, looking at the middle of what it saw, points (N, 3)."""
        center = np.median(np.asarray(points), axis=0)
        reach = float(np.linalg.norm(center))
        position = center + reach * np.array((0.45, -0.55, -1.0))
        return cls(tuple(map(float, position)), tuple(map(float, center)))

    def controls(self) -> rrb.EyeControls3D:
        return rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=self.position, look_target=self.look_target, eye_up=(0.0, -1.0, 0.0)
        )


def dashboard(*, many_pairs: bool = False, eye: Eye = Eye()) -> rrb.Blueprint:
    """The blueprint of a recording of one pair, or of many, which opens on the summary page."""
    pages = [_overview(eye)]
    if many_pairs:
        pages.insert(0, _summary_page())
    body = rrb.Tabs(*pages, active_tab=0) if len(pages) > 1 else pages[0]
    timeline = entities.FRAME if many_pairs else entities.ITERATION
    return rrb.Blueprint(
        body,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following"),
        auto_layout=False,
        auto_views=False,
    )


def send_blueprint(rec: rr.RecordingStream, *, many_pairs: bool = False, eye: Eye = Eye()) -> None:
    """Make the dashboard the recording's active blueprint; a saved file then opens with it."""
    rec.send_blueprint(dashboard(many_pairs=many_pairs, eye=eye))


def _overview(eye: Eye) -> rrb.Horizontal:
    target, source, initial = (_recolored(c) for c in (TARGET_COLOR, SOURCE_COLOR, SOURCE_COLOR))
    scenes = rrb.Vertical(
        rrb.Horizontal(
            _scene(
                "Before",
                [TARGET.points, INITIAL_SOURCE.points],
                eye,
                {TARGET.points: target, INITIAL_SOURCE.points: initial},
            ),
            _scene("After", [TARGET.points, SOURCE.points], eye, {TARGET.points: target, SOURCE.points: source}),
        ),
        rrb.Horizontal(
            _scene(
                "Textured: truth green, estimate orange, start blue",
                [s.mesh for s in (TARGET, SOURCE)] + [s.image for s in (TARGET, SOURCE, INITIAL_SOURCE, TRUE_SOURCE)],
                eye,
            ),
            _scene("Covariances", [TARGET.covariances, SOURCE.covariances], eye),
        ),
        rrb.Horizontal(
            _curve("Energy", entities.ENERGY),
            _curve("σ", entities.SIGMA),
            _curve("Rotation error [°]", entities.ROTATION_ERROR_DEG),
            _curve("Translation error [mm]", entities.TRANSLATION_ERROR_MM),
        ),
        row_shares=[5, 5, 3],
    )
    return rrb.Horizontal(scenes, _side(), column_shares=[3, 1], name="Pair")


def _side() -> rrb.Vertical:
    images = rrb.Tabs(
        _image("Target colour", TARGET.image, [TARGET.rgb]),
        _image("Source colour", SOURCE.image, [SOURCE.rgb]),
        _image("Target depth", TARGET.image, [TARGET.depth]),
        _image("Source depth", SOURCE.image, [SOURCE.depth]),
    )
    texts = rrb.Tabs(
        rrb.TextDocumentView(name="Report", origin=entities.REPORT),
        rrb.TextLogView(name="Log", origin=entities.LOG),
    )
    return rrb.Vertical(images, texts)


def _summary_page() -> rrb.Horizontal:
    bars = rrb.Vertical(
        rrb.BarChartView(name="Rotation error [°] by frame", origin=entities.SUMMARY_ROTATION_ERROR_DEG),
        rrb.BarChartView(name="Translation error [mm] by frame", origin=entities.SUMMARY_TRANSLATION_ERROR_MM),
    )
    table = rrb.TextDocumentView(name="All pairs", origin=entities.SUMMARY_TABLE)
    return rrb.Horizontal(table, bars, column_shares=[3, 2], name="Summary")


def _recolored(color) -> rr.Points3D:
    return rr.Points3D.from_fields(colors=[color])


def _scene(name: str, contents: list[str], eye: Eye, overrides=None) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        name=name,
        origin=entities.WORLD,
        contents=[f"/{entity}" for entity in contents],
        overrides=overrides,
        background=BACKGROUND,
        line_grid=False,
        eye_controls=eye.controls(),
    )


def _image(name: str, origin: str, contents: list[str]) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(name=name, origin=origin, contents=[f"/{entity}" for entity in contents])


def _curve(name: str, entity: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name=name, origin=entity, plot_legend=rrb.PlotLegend(visible=False))
