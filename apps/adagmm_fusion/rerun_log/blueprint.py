"""What the viewer opens with, as one value: before and after, the result, the curves, the images, the report."""

from collections.abc import Mapping

import rerun.blueprint as rrb

from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.clouds import COLOR_SUPPORT, DIMMED, OVERLAP, RESIDUAL_MM, SHAPE, WEIGHT_SHARE
from adagmm_fusion.rerun_log.entities import INITIAL_SOURCE, RECORDED_SOURCE, SOURCE, TARGET, TRUE_SOURCE
from adagmm_fusion.rerun_log.legends import LEGEND_SIZE
from adagmm_fusion.rerun_log.views import Eye, bars, curve, image, legend, scene

SENSORS = (TARGET, SOURCE, INITIAL_SOURCE, TRUE_SOURCE)
STAGES = {
    "Identity: target blue": RECORDED_SOURCE,
    "Start": INITIAL_SOURCE,
    "End": SOURCE,
}
COVARIANCES = {TARGET.points: DIMMED, TARGET.covariances: None, SOURCE.covariances: None}
UNOBSERVABLE = (entities.UNOBSERVABLE, f"{entities.UNOBSERVABLE}/label")
MARKS = (entities.DIFFERENCE, f"{entities.DIFFERENCE}/label", *UNOBSERVABLE)
RESULT = dict.fromkeys((entities.FUSED, *(sensor.image for sensor in SENSORS), *MARKS))


def dashboard(*, many_pairs: bool = False, page: str | None = None) -> rrb.Blueprint:
    """The blueprint of a recording of one pair, or of many, which opens on the summary page.

    page : "Summary", "Pair", "Why" or "Guide", to open on another page than the first.
    """
    pages = [_overview(), _why_page(), _guide_page()]
    if many_pairs:
        pages.insert(0, _summary_page())
    tabs = rrb.Tabs(*pages, active_tab=0 if page is None else [p.name for p in pages].index(page))
    return _blueprint(tabs, entities.FRAME if many_pairs else entities.ITERATION)


def script_dashboard(*, eye: Eye, with_truth: bool = False) -> rrb.Blueprint:
    """The blueprint for two clouds from a script, without cameras: before, after and the curves."""
    curves = [curve("Energy", entities.ENERGY), curve("σ", entities.SIGMA)]
    if with_truth:
        curves.append(curve("Rotation error [°]", entities.ROTATION_ERROR_DEG))
        curves.append(curve("Translation error [mm]", entities.TRANSLATION_ERROR_MM))
    else:
        curves.append(curve("Fitness", entities.FITNESS))
        curves.append(curve("Inlier RMSE", entities.INLIER_RMSE))
    before = {TARGET.points: SHAPE, INITIAL_SOURCE.points: SHAPE}
    after = {TARGET.points: SHAPE, SOURCE.points: SHAPE}
    body = rrb.Vertical(_before_and_after(before, after, eye), rrb.Horizontal(*curves), row_shares=[2, 1])
    return _blueprint(body, entities.ITERATION)


def _blueprint(body: rrb.Container, timeline: str) -> rrb.Blueprint:
    return rrb.Blueprint(
        body,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following"),
        auto_layout=False,
        auto_views=False,
    )


def _scenes_of_stages() -> rrb.Horizontal:
    return rrb.Horizontal(
        *(scene(name, dict.fromkeys((TARGET.shape, sensor.shape)), entities.EYE) for name, sensor in STAGES.items())
    )


def _before_and_after(before: Mapping[str, str | None], after: Mapping[str, str | None], eye: Eye) -> rrb.Horizontal:
    return rrb.Horizontal(scene("Before: target blue, source orange", before, eye), scene("After", after, eye))


def _overview() -> rrb.Horizontal:
    curves = [curve("Energy", entities.ENERGY), curve("Spread mm, log₁₀", entities.log10_of(entities.SPREAD_MM))]
    curves += [error_curve("° off, log₁₀", entities.ROTATION_ERROR_DEG)]
    curves += [error_curve("mm off, log₁₀", entities.TRANSLATION_ERROR_MM)]
    scenes = rrb.Vertical(
        _scenes_of_stages(),
        rrb.Horizontal(
            scene("Result: cameras truth green, estimate orange, start blue", RESULT, entities.EYE_WITH_SENSORS),
            scene("Covariances σ·Σ, three standard deviations", COVARIANCES, entities.EYE_AT_END),
        ),
        rrb.Horizontal(*curves),
        row_shares=[5, 5, 3],
    )
    return rrb.Horizontal(scenes, _side(), column_shares=[5, 2], name="Pair")


def error_curve(name: str, metric: str, *, with_iterations: bool = True) -> rrb.TimeSeriesView:
    """The errors of the stages on a logarithmic axis, and those of the EM iterations between."""
    contents = [f"{entities.stages_of(metric)}/**"]
    if with_iterations:
        contents.append(entities.log10_of(metric))
    return curve(name, *contents)


def _why_page() -> rrb.Vertical:
    layers = (
        ("Who pulls: share of weight", WEIGHT_SHARE, entities.WEIGHT_LEGEND),
        ("How far off: residual", RESIDUAL_MM, entities.RESIDUAL_LEGEND),
        ("Who has a partner", OVERLAP, entities.OVERLAP_LEGEND),
        ("What colour says", COLOR_SUPPORT, entities.COLOR_LEGEND),
    )
    columns = [
        rrb.Vertical(
            scene(
                name, {TARGET.points: DIMMED, SOURCE.points: layer} | dict.fromkeys(UNOBSERVABLE), entities.EYE_AT_END
            ),
            legend(legend_entity, LEGEND_SIZE),
            row_shares=[7, 1],
        )
        for name, layer, legend_entity in layers
    ]
    below = rrb.Horizontal(
        bars("Residuals [mm]", entities.RESIDUAL_HISTOGRAM),
        image("Source over dimmed target", TARGET.image, [TARGET.overlay]),
        image("Checkerboard: edges meet if it worked", TARGET.image, [TARGET.checkerboard]),
    )
    return rrb.Vertical(rrb.Horizontal(*columns), below, row_shares=[3, 2], name="Why")


def _side() -> rrb.Vertical:
    images = rrb.Tabs(
        image("Target colour", TARGET.image, [TARGET.rgb, TARGET.features]),
        image("Source colour", SOURCE.image, [SOURCE.rgb, SOURCE.features]),
        image("Matches: source, target", entities.MATCHES, [f"{entities.MATCHES}/**"]),
        image("Target depth", TARGET.image, [TARGET.depth]),
        image("Source depth", SOURCE.image, [SOURCE.depth]),
    )
    reports = rrb.Tabs(
        rrb.TextDocumentView(name="Report", origin=entities.REPORT),
        rrb.TextLogView(name="Log", origin=entities.LOG),
        bars("Residuals [mm]", entities.RESIDUAL_HISTOGRAM),
    )
    return rrb.Vertical(images, reports, row_shares=[2, 3])


def _summary_page() -> rrb.Horizontal:
    charts = rrb.Vertical(
        error_curve("Rotation error °, log₁₀", entities.ROTATION_ERROR_DEG, with_iterations=False),
        error_curve("Translation error mm, log₁₀", entities.TRANSLATION_ERROR_MM, with_iterations=False),
    )
    table = rrb.TextDocumentView(name="All pairs", origin=entities.SUMMARY_TABLE)
    return rrb.Horizontal(table, charts, column_shares=[2, 1], name="Summary")


def _guide_page() -> rrb.Horizontal:
    return rrb.Horizontal(rrb.TextDocumentView(name="How to read this", origin=entities.GUIDE), name="Guide")
