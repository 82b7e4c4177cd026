"""What the viewer opens with, as one value: before and after, the result, the curves, the images, the report."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.clouds import DIMMED, OVERLAP, RESIDUAL_MM, SHAPE, WEIGHT_SHARE
from adagmm_fusion.rerun_log.entities import INITIAL_SOURCE, SOURCE, TARGET, TRUE_SOURCE
from adagmm_fusion.rerun_log.legends import STRIP

BACKGROUND = (24, 26, 32)
LEGEND_BOUNDS = rrb.VisualBounds2D(x_range=(-40, STRIP[1] + 40), y_range=(-4, STRIP[0] + 24))
SENSORS = (TARGET, SOURCE, INITIAL_SOURCE, TRUE_SOURCE)
COVARIANCES = {TARGET.points: DIMMED, TARGET.covariances: None, SOURCE.covariances: None}
MARKS = (entities.DIFFERENCE, entities.UNOBSERVABLE)
RESULT = dict.fromkeys((TARGET.mesh, SOURCE.mesh, *(sensor.image for sensor in SENSORS), *MARKS))


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
        position = center + reach * np.array((0.4, -0.6, -1.0))
        return cls(tuple(map(float, position)), tuple(map(float, center)))

    def stepped_back(self, factor: float) -> "Eye":
        """The same view from farther away."""
        position, target = np.array(self.position), np.array(self.look_target)
        return Eye(tuple(map(float, target + factor * (position - target))), self.look_target)

    def controls(self) -> rrb.EyeControls3D:
        return rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=self.position, look_target=self.look_target, eye_up=(0.0, -1.0, 0.0)
        )


def dashboard(*, many_pairs: bool = False, eye: Eye = Eye(), page: str | None = None) -> rrb.Blueprint:
    """The blueprint of a recording of one pair, or of many, which opens on the summary page.

    page : "Summary", "Pair" or "Why", to open on another page than the first.
    """
    pages = [_overview(eye), _why_page(eye)]
    if many_pairs:
        pages.insert(0, _summary_page())
    timeline = entities.FRAME if many_pairs else entities.ITERATION
    return rrb.Blueprint(
        rrb.Tabs(*pages, active_tab=0 if page is None else [p.name for p in pages].index(page)),
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
    scenes = rrb.Vertical(
        rrb.Horizontal(
            _scene("Before: target blue, source orange", {TARGET.points: SHAPE, INITIAL_SOURCE.points: SHAPE}, eye),
            _scene("After", {TARGET.points: SHAPE, SOURCE.points: SHAPE}, eye),
        ),
        rrb.Horizontal(
            _scene("Result: cameras truth green, estimate orange, start blue", RESULT, eye.stepped_back(1.6)),
            _scene("Covariances σ·Σ", COVARIANCES, eye),
        ),
        rrb.Horizontal(
            _curve("Energy", entities.ENERGY),
            _curve("σ [m²]", entities.SIGMA),
            _curve("Rotation error [°]", entities.ROTATION_ERROR_DEG),
            _curve("Translation error [mm]", entities.TRANSLATION_ERROR_MM),
        ),
        row_shares=[5, 5, 3],
    )
    return rrb.Horizontal(scenes, _side(), column_shares=[3, 1], name="Pair")


def _why_page(eye: Eye) -> rrb.Vertical:
    layers = (
        ("Who pulls: share of the pair weights", WEIGHT_SHARE, entities.WEIGHT_LEGEND),
        ("How far off: residual", RESIDUAL_MM, entities.RESIDUAL_LEGEND),
        ("Who has a partner", OVERLAP, entities.OVERLAP_LEGEND),
    )
    columns = [
        rrb.Vertical(
            _scene(name, {TARGET.points: DIMMED, SOURCE.points: layer, entities.UNOBSERVABLE: None}, eye),
            rrb.Spatial2DView(name="Legend", origin=legend, titlebar=False, visual_bounds=LEGEND_BOUNDS),
            row_shares=[7, 1],
        )
        for name, layer, legend in layers
    ]
    below = rrb.Horizontal(
        _bars("Residuals [mm]", entities.RESIDUAL_HISTOGRAM),
        _image("Source over dimmed target", TARGET.image, [TARGET.overlay]),
        _image("Checkerboard: edges meet if it worked", TARGET.image, [TARGET.checkerboard]),
    )
    return rrb.Vertical(rrb.Horizontal(*columns), below, row_shares=[3, 2], name="Why")


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
        _bars("Residuals [mm]", entities.RESIDUAL_HISTOGRAM),
    )
    return rrb.Vertical(images, texts)


def _summary_page() -> rrb.Horizontal:
    bars = rrb.Vertical(
        _bars("Rotation error [°] by frame", entities.SUMMARY_ROTATION_ERROR_DEG),
        _bars("Translation error [mm] by frame", entities.SUMMARY_TRANSLATION_ERROR_MM),
    )
    table = rrb.TextDocumentView(name="All pairs", origin=entities.SUMMARY_TABLE)
    return rrb.Horizontal(table, bars, column_shares=[3, 2], name="Summary")


def _scene(name: str, contents: Mapping[str, str | None], eye: Eye) -> rrb.Spatial3DView:
    """A 3D view of entities, each with the layer that colours its points, or None for what it is logged with."""
    return rrb.Spatial3DView(
        name=name,
        origin=entities.WORLD,
        contents=[f"/{entity}" for entity in contents],
        overrides={entity: _colored_by(layer) for entity, layer in contents.items() if layer is not None},
        background=BACKGROUND,
        line_grid=False,
        eye_controls=eye.controls(),
    )


def _colored_by(layer: str) -> rrb.Visualizer:
    colors = VisualizerComponentMapping(
        target="Points3D:colors",
        source_kind=ComponentSourceKind.SourceComponent,
        source_component=f"{layer}:colors",
    )
    return rr.Points3D.from_fields().visualizer(mappings=[colors])


def _image(name: str, origin: str, contents: list[str]) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(name=name, origin=origin, contents=[f"/{entity}" for entity in contents])


def _curve(name: str, entity: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name=name, origin=entity, plot_legend=rrb.PlotLegend(visible=False))


def _bars(name: str, entity: str) -> rrb.BarChartView:
    return rrb.BarChartView(name=name, origin=entity, plot_legend=rrb.PlotLegend(visible=False))
