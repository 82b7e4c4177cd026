"""A whole recording, fused: its mesh, every frame's camera and image, the loops, and the way beside the true one."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import open3d as o3d
import rerun as rr
import rerun.blueprint as rrb

from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.meshes.textured_mesh import TexturedMesh
from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.cameras import FRUSTUM_DEPTH, log_frustum, log_pose
from adagmm_fusion.rerun_log.colors import BAD_COLOR, GOOD_COLOR, SOURCE_COLOR, TOGETHER_COLOR, TRUTH_COLOR
from adagmm_fusion.rerun_log.entities import FUSED_CAMERA
from adagmm_fusion.rerun_log.guide import log_guide
from adagmm_fusion.rerun_log.iterations import LEAST_SHOWN
from adagmm_fusion.rerun_log.legends import ramp_colors
from adagmm_fusion.rerun_log.meshes import TWO_SIDED, log_textured_mesh
from adagmm_fusion.rerun_log.views import Eye, curve, image, scene
from adagmm_fusion.rerun_log.when import When
from adagmm_fusion.rerun_log.words import entity_part, markdown
from adagmm_fusion.sequence.edges import Edge
from adagmm_fusion.sequence.pose_graph import LOOP_TOLERANCE_M
from adagmm_fusion.sequence.trajectory_errors import align_rigid
from adagmm_o3d.lie import se_inverse

# What is drawn of a camera lies within these corners about its place.
CAMERA_CORNERS = FRUSTUM_DEPTH * np.array(((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)))
# In the viewer's points, however near the eye is.
LINE_RADIUS, PLACE_RADIUS, EDGE_RADIUS = (rr.Radius.ui_points(points) for points in (1.5, 4.0, 1.0))
# Of kept registrations: those that agree with the poses, up to those that are as far off as the pose graph bears.
KEPT_RAMP = np.array(((105, 110, 125), (250, 220, 80)))
WORST_SHOWN = 20
FRAME_JPEG_QUALITY = 60  # there may be a thousand
MILLIMETRES_PER_METRE = 1000.0


@dataclass(frozen=True, eq=False)
class FusedRecording:
    """What became of a recording's frames.

    poses : T_world_camera (4, 4) of the frames that are placed, by their number.    sensors : of all frames.
    truth : true T_world_camera of those that have one, in a world of its own.
    edges : the registrations between places: a moving sensor's frames, or the frame that stands for a fixed sensor.
    dropped : those of them that the pose graph dropped as wrong.
    ends : T_world_camera (4, 4) of the places.
    left_out : numbers of the frames without a pose.
    """

    poses: Mapping[int, np.ndarray]
    sensors: Mapping[int, str]
    truth: Mapping[int, np.ndarray]
    edges: Sequence[Edge] = ()
    dropped: Sequence[Edge] = ()
    ends: Mapping[int, np.ndarray] = field(default_factory=dict)
    left_out: Sequence[int] = ()


@dataclass(frozen=True, eq=False)
class EdgeResidual:
    """A usable edge between placed frames: how far the poses are from it, and whether the pose graph kept it."""

    edge: Edge
    off_mm: float
    kept: bool

    @property
    def name(self) -> str:
        """What it is logged as."""
        if not self.kept:
            return "dropped"
        return "together" if self.edge.only_together else "kept"

    @property
    def remark(self) -> str:
        """What the report says of it."""
        return {"dropped": "× dropped", "together": "only together"}.get(self.name, "")


def fused_blueprint(vertices: np.ndarray, poses: Mapping[int, np.ndarray]) -> rrb.Blueprint:
    """The mesh with vertices (N, 3), the ways and the loops; beside it the frames' images, errors and the report.

    poses : T_world_camera (4, 4) of the frames; the views are fitted to them and to the mesh.
    """
    points, places = np.asarray(vertices), np.array([pose[:3, 3] for pose in poses.values()])
    whole, way = Eye.seeing([points, places + CAMERA_CORNERS[0], places + CAMERA_CORNERS[1]]), Eye.seeing([places])
    ways = dict.fromkeys((entities.FUSED, f"{entities.WAYS}/**", f"{entities.TRUE_WAYS}/**", FUSED_CAMERA.image))
    loops = dict.fromkeys((f"{entities.LOOPS}/**", f"{entities.WAYS}/**", f"{entities.TRUE_WAYS}/**"))
    ate = entities.log10_of(entities.TRANSLATION_ERROR_MM)
    page = rrb.Horizontal(
        rrb.Vertical(
            scene("Fused: estimate orange, truth green", ways, whole),
            rrb.Horizontal(
                scene("Registrations: off yellow, together blue, dropped red", loops, way),
                curve("Off along the way mm, log₁₀", ate),
            ),
            row_shares=[3, 2],
        ),
        rrb.Vertical(
            image("Frame", FUSED_CAMERA.image, [FUSED_CAMERA.rgb]),
            rrb.TextDocumentView(name="Report", origin=entities.REPORT),
        ),
        column_shares=[3, 1],
        name="Fused",
    )
    guide = rrb.Horizontal(rrb.TextDocumentView(name="How to read this", origin=entities.GUIDE), name="Guide")
    return rrb.Blueprint(
        rrb.Tabs(page, guide),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=entities.FRAME, play_state="following"),
        auto_layout=False,
        auto_views=False,
    )


def log_fused_recording(
    rec: rr.RecordingStream,
    mesh: TexturedMesh | o3d.geometry.TriangleMesh,
    fused: FusedRecording,
    load: Callable[[int], RGBDFrame],
) -> None:
    """Log the mesh, textured or coloured, and what became of the frames; `load` gives one by its number."""
    rec.log(entities.WORLD, rr.ViewCoordinates.RDF, static=True)
    log_guide(rec)
    _log_mesh(rec, mesh)
    aligned = aligned_truth(fused)
    _log_ways(rec, fused, aligned)
    residuals = edge_residuals(fused)
    _log_edges(rec, fused, residuals)
    errors_mm = {
        frame: MILLIMETRES_PER_METRE * float(np.linalg.norm(fused.poses[frame][:3, 3] - place))
        for frame, place in aligned.items()
    }
    _log_frames(rec, fused, errors_mm, load)
    text = fused_report(fused, residuals, errors_mm)
    rec.log(entities.REPORT, markdown(text), static=True)


def aligned_truth(fused: FusedRecording) -> dict[int, np.ndarray]:
    """True places (3,) of the placed frames, moved to the estimate's world by least squares; none of fewer than 3."""
    both = [frame for frame in sorted(fused.poses) if frame in fused.truth]
    if len(both) < 3:
        return {}
    true, estimated = (np.array([poses[frame][:3, 3] for frame in both]) for poses in (fused.truth, fused.poses))
    T = align_rigid(true, estimated)
    return dict(zip(both, true @ T[:3, :3].T + T[:3, 3], strict=True))


def edge_residuals(fused: FusedRecording) -> list[EdgeResidual]:
    """How far the poses are from each usable edge between placed frames; those dropped are the pose graph's word."""
    found, dropped = [], set(fused.dropped)
    for edge in fused.edges:
        if edge.usable and edge.source in fused.ends and edge.target in fused.ends:
            T = se_inverse(fused.ends[edge.target]) @ fused.ends[edge.source]
            off = float(np.linalg.norm(T[:3, 3] - edge.transformation[:3, 3]))
            found.append(EdgeResidual(edge, MILLIMETRES_PER_METRE * off, edge not in dropped))
    return found


def fused_report(fused: FusedRecording, residuals: Sequence[EdgeResidual], errors_mm: Mapping[int, float]) -> str:
    """Markdown: how many frames are placed, what holds them together, how far they are off, the worst first."""
    frames = len(fused.poses) + len(fused.left_out)
    refused = sum(not edge.usable for edge in fused.edges)
    dropped = sum(not residual.kept for residual in residuals)
    lines = [f"### {len(fused.poses)} of {frames} frames fused", ""]
    if errors_mm:
        ate = np.sqrt(np.mean(np.square(list(errors_mm.values()))))
        worst = max(errors_mm, key=lambda frame: errors_mm[frame])
        lines += [f"**ATE {ate:.1f} mm**, root mean square; worst: frame {worst}, {errors_mm[worst]:.0f} mm.", ""]
    if fused.left_out:
        lines += [f"Left out, their pose is not known: {', '.join(map(str, fused.left_out))}.", ""]
    together = sum(residual.name == "together" for residual in residuals)
    lines += [f"{len(residuals) - dropped} registrations used, {dropped} dropped, {refused} refused.", ""]
    if together:
        lines += [f"Of those used {together} are believed only because several say the same; they join parts.", ""]
    if residuals:
        remarks = bool(dropped or together)
        lines += ["| source | target | off mm |" + " |" * remarks, "|--:|--:|--:|" + ":--|" * remarks]
        worst_first = sorted(residuals, key=lambda residual: (residual.kept, -residual.off_mm))
        for residual in worst_first[:WORST_SHOWN]:
            row = f"| {residual.edge.source} | {residual.edge.target} | {residual.off_mm:.0f} |"
            lines.append(f"{row} {residual.remark} |" if remarks else row)
    return "\n".join(lines)


def _log_mesh(rec: rr.RecordingStream, mesh: TexturedMesh | o3d.geometry.TriangleMesh) -> None:
    if isinstance(mesh, TexturedMesh):
        log_textured_mesh(rec, entities.FUSED, mesh, When())
        return
    colors = np.floor(255.0 * np.asarray(mesh.vertex_colors) + 0.5).astype(np.uint8)
    archetype = rr.Mesh3D(
        vertex_positions=np.asarray(mesh.vertices, np.float32),
        triangle_indices=np.asarray(mesh.triangles, np.uint32),
        vertex_colors=colors,
        face_rendering=TWO_SIDED,
    )
    rec.log(entities.FUSED, archetype, static=True)


def _log_ways(rec: rr.RecordingStream, fused: FusedRecording, aligned: Mapping[int, np.ndarray]) -> None:
    for sensor in dict.fromkeys(fused.sensors.values()):
        frames = [frame for frame in sorted(fused.poses) if fused.sensors[frame] == sensor]
        ways = {
            entities.WAYS: (np.array([fused.poses[frame][:3, 3] for frame in frames]), SOURCE_COLOR),
            entities.TRUE_WAYS: (np.array([aligned[frame] for frame in frames if frame in aligned]), TRUTH_COLOR),
        }
        for root, (places, color) in ways.items():
            if len(places):
                line = rr.LineStrips3D([places], colors=color, radii=LINE_RADIUS)
                points = rr.Points3D(places, colors=color, radii=PLACE_RADIUS)
                rec.log(f"{root}/{entity_part(sensor)}", line, points, static=True)


def _log_edges(rec: rr.RecordingStream, fused: FusedRecording, residuals: Sequence[EdgeResidual]) -> None:
    for name, color in (("kept", None), ("together", TOGETHER_COLOR), ("dropped", BAD_COLOR)):
        chosen = [residual for residual in residuals if residual.name == name]
        if not chosen:
            continue
        ends = np.array([(residual.edge.source, residual.edge.target) for residual in chosen])
        strips = [[fused.ends[frame][:3, 3] for frame in pair] for pair in ends]
        residual_mm = np.array([residual.off_mm for residual in chosen])
        colors = ramp_colors(residual_mm, MILLIMETRES_PER_METRE * LOOP_TOLERANCE_M, KEPT_RAMP)
        lines = rr.LineStrips3D(strips, colors=color or colors, radii=EDGE_RADIUS)
        numbers = rr.AnyValues(source_frame=ends[:, 0], target_frame=ends[:, 1], residual_mm=residual_mm)
        rec.log(f"{entities.LOOPS}/{name}", lines, numbers, static=True)


def _log_frames(
    rec: rr.RecordingStream,
    fused: FusedRecording,
    errors_mm: Mapping[int, float],
    load: Callable[[int], RGBDFrame],
) -> None:
    metric = entities.TRANSLATION_ERROR_MM
    style = rr.SeriesLines(names="off, log₁₀ mm", colors=GOOD_COLOR, widths=2.0)
    rec.log(entities.log10_of(metric), style, static=True)
    for frame in sorted(fused.poses):
        shown = load(frame)
        when = When(frame, frame, shown.timestamp)
        log_pose(rec, FUSED_CAMERA, fused.poses[frame], when)
        log_frustum(rec, FUSED_CAMERA, shown.intrinsics, SOURCE_COLOR, when)
        when.log(rec, FUSED_CAMERA.rgb, rr.Image(shown.color).compress(jpeg_quality=FRAME_JPEG_QUALITY))
        if frame in errors_mm:
            when.log(rec, metric, rr.Scalars(errors_mm[frame]))
            when.log(rec, entities.log10_of(metric), rr.Scalars(np.log10(max(errors_mm[frame], LEAST_SHOWN))))
