"""A rig's sensors where its file says they are, and where the clouds of its frames say they are."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.cameras import FRUSTUM_DEPTH, log_frustum, log_pose
from adagmm_fusion.rerun_log.colors import BAD_COLOR, LABEL_COLOR, SOURCE_COLOR, TARGET_CAMERA_COLOR, TRUTH_COLOR
from adagmm_fusion.rerun_log.entities import Sensor
from adagmm_fusion.rerun_log.views import Eye, scene
from adagmm_fusion.rerun_log.when import When
from adagmm_fusion.rerun_log.words import entity_part, markdown
from adagmm_fusion.rigs.checking import MOVED, SensorCheck
from adagmm_fusion.rigs.rig import Rig

RIG = f"{entities.WORLD}/rig"
POINT_RADIUS = 0.004
FOUND_COLORS = {False: SOURCE_COLOR, True: BAD_COLOR}  # by whether it moved
WIDEST = np.array(((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))) * FRUSTUM_DEPTH


def verified_rig_blueprint(checks: Sequence[SensorCheck], rig: Rig) -> rrb.Blueprint:
    """The sensors, and beside them what was found."""
    places = [np.zeros(3)]
    for check in checks:
        places.append(rig.T_target_source(check.target, check.source)[:3, 3])
        if check.T_target_source is not None:
            places.append(check.T_target_source[:3, 3])
    eye = Eye.seeing([np.concatenate([place + WIDEST for place in places])])
    view = scene("Sensors: by the rig file green, found orange or red where it moved", {f"{RIG}/**": None}, eye)
    report = rrb.TextDocumentView(name="Report", origin=entities.REPORT)
    return rrb.Blueprint(
        rrb.Horizontal(view, report, column_shares=[2, 1]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="hidden"),  # nothing changes with time
        auto_layout=False,
        auto_views=False,
    )


def log_verified_rig(rec: rr.RecordingStream, checks: Sequence[SensorCheck], rig: Rig) -> None:
    """Log each pair of sensors in the target's frame: the source by the rig file, by every frame, and by their mean."""
    rec.log(entities.WORLD, rr.ViewCoordinates.RDF, static=True)
    lines = []
    for check in checks:
        lines += ["", *_log_check(rec, check, rig)]
    rec.log(entities.REPORT, markdown("\n".join(lines[1:])), static=True)


def _log_check(rec: rr.RecordingStream, check: SensorCheck, rig: Rig) -> list[str]:
    root = f"{RIG}/{entity_part(check.target)}/{entity_part(check.source)}"
    T_rig = rig.T_target_source(check.target, check.source)
    color = FOUND_COLORS[check.verdict == MOVED]
    placed = {"target": (np.eye(4), check.target, TARGET_CAMERA_COLOR), "rig": (T_rig, check.source, TRUTH_COLOR)}
    if check.T_target_source is not None:
        placed["found"] = (check.T_target_source, check.source, color)
    for name, (T, sensor, camera_color) in placed.items():
        log_pose(rec, Sensor(f"{root}/{name}"), T, When())
        log_frustum(rec, Sensor(f"{root}/{name}"), rig.sensors[sensor].intrinsics, camera_color, When())
    used = [frame for frame in check.frames if frame.T_target_source is not None]
    if used:
        numbers = rr.AnyValues(
            frame=[frame.frame for frame in used],
            rotation_deg=np.array([frame.rotation_deg for frame in used]),
            translation_mm=np.array([frame.translation_mm for frame in used]),
        )
        places = np.array([frame.T_target_source[:3, 3] for frame in used])
        rec.log(f"{root}/frames", rr.Points3D(places, colors=color, radii=POINT_RADIUS), numbers, static=True)
    title = f"### {check.source} against {check.target}: {check.verdict}"
    if check.T_target_source is None:
        return [title, "", f"{len(used)} of {len(check.frames)} frames registered."]
    off = f"{check.rotation_deg:.2f}° and {check.translation_mm:.0f} mm"
    start, end = T_rig[:3, 3], check.T_target_source[:3, 3]
    arrow = rr.Arrows3D(origins=start, vectors=end - start, radii=POINT_RADIUS, colors=color)
    rec.log(f"{root}/moved", arrow, static=True)
    label = rr.Points3D([0.5 * (start + end)], colors=LABEL_COLOR, radii=0.0, labels=off, show_labels=True)
    rec.log(f"{root}/moved/label", label, static=True)
    rows = [f"| {frame.frame} | {frame.rotation_deg:.2f} | {frame.translation_mm:.0f} |" for frame in used]
    return [title, "", f"{off} from the rig file.", "", "| frame | ° | mm |", "|:--|--:|--:|", *rows]
