"""`adagmm-fusion fuse`: a whole recording as one coloured or textured mesh."""

import argparse
import contextlib
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from adagmm_fusion.commands.recording_arguments import add_recording_arguments, print_notes, recording_of
from adagmm_fusion.processes.terminal import printable
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_fusion.rerun_arguments import logs_to_file

MESHES = ("ply", "glb", "obj")
# What another run may have left under the name of the mesh.
OTHER_MESHES = ("mesh.ply", "mesh.glb", "mesh.obj", "mesh.mtl")
# The image of an .obj file, ours where its .mtl file is.
TEXTURE, OF_TEXTURE = "mesh_0.png", "mesh.mtl"
# The code and the libraries that a registration between two frames comes from.
REGISTERED_BY = (
    "adagmm_o3d",
    *(f"adagmm_fusion.{name}" for name in ("clouds", "frames", "measurements", "pairs", "sequence")),
)
REGISTERED_WITH = ("numba", "numpy", "open3d", "opencv-python-headless", "scipy")


def add(commands: argparse._SubParsersAction) -> None:
    from adagmm_fusion.rerun_arguments import add_rerun_arguments

    text = (
        "Register the frames of a recording with each other, make their poses consistent with loop closures and a pose "
        "graph, and fuse them into one mesh. What moves, a sensor or a rig of several, is fused as a whole; of sensors "
        "that stand still, what they see at one moment, or at all of them. Started again, an interrupted run goes on "
        "where it was."
    )
    command = commands.add_parser("fuse", help="fuse a whole recording into one mesh", description=text)
    add_recording_arguments(command)
    command.add_argument(
        "--moment",
        metavar="FRAME",
        help="of sensors that stand still, which moment is fused, or all, if nothing else moved (default: the first)",
    )
    command.add_argument("--output", metavar="DIR", help="where results go (default: output/<recording>_fused)")
    command.add_argument(
        "--poses",
        choices=("estimated", "truth"),
        default="estimated",
        help="where the frames are: registered, or as the recording says (default: %(default)s)",
    )
    command.add_argument(
        "--voxel-size", type=float, default=0.01, metavar="METRES", help="of the mesh (default: %(default)g)"
    )
    command.add_argument(
        "--max-depth", type=float, default=5.0, metavar="METRES", help="farther is ignored (default: %(default)g)"
    )
    command.add_argument(
        "--target-points", type=int, default=3500, metavar="N", help="points a cloud to register (default: %(default)s)"
    )
    command.add_argument(
        "--max-memory", type=float, default=2000.0, metavar="MB", help="for the voxels (default: %(default)g)"
    )
    command.add_argument(
        "--mesh",
        choices=MESHES,
        default="glb",
        help="ply: a colour at each vertex; glb, obj: the colour images as texture (default: %(default)s)",
    )
    command.add_argument(
        "--device", choices=("auto", "cpu", "cuda"), default="auto", help="where the kernels run (default: %(default)s)"
    )
    text = "Without one of these, the mesh, the ways and the registrations are saved with the other results."
    viewer = command.add_argument_group("Rerun", text)
    viewer.add_argument("--no-rerun", action="store_true", help="make no Rerun recording")
    add_rerun_arguments(viewer)
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Fuse args.recording; returns the exit code.

    Raises
    ------
    AdaGMMError  if the recording cannot be used, the poses are not known, or a result cannot be written.
    """
    from adagmm_fusion.files.atomic_file import check_output_file
    from adagmm_fusion.files.output_folder import check_apart, exclusive
    from adagmm_fusion.files.stale_results import check_not_foreign, is_marked, remove_untouched, states_of
    from adagmm_fusion.rerun_log import check_destination

    if not args.no_rerun:
        check_destination(args)
    recording = recording_of(args)
    folder = Path(args.output) if args.output else Path("output") / f"{recording.path.resolve().name}_fused"
    own_names = [f"mesh.{args.mesh}"]
    if logs_to_file(args) and args.save is None:
        args.save = str(folder / f"{recording.path.resolve().name}.rrd")
        own_names.append(Path(args.save).name)
        check_destination(args)
    check_apart(recording.path, folder, args.save)
    # With --stdout the Rerun recording goes there, and what is said to stderr.
    with contextlib.redirect_stdout(sys.stderr) if args.stdout else contextlib.nullcontext(), exclusive(folder):
        for path in (folder / f"mesh.{args.mesh}", *(path for _, path in _trajectory_files(recording, folder))):
            check_output_file(path)
        trajectories = [path.name for _, path in _trajectory_files(recording, folder)]
        others = [name for name in OTHER_MESHES if is_marked(folder / name)]
        if OF_TEXTURE in others:
            others.append(TEXTURE)
        if args.mesh == "obj":
            own_names += [OF_TEXTURE, TEXTURE]
        check_not_foreign(folder, [*own_names, *trajectories], others)
        earlier = states_of(folder, [*others, *trajectories])
        _fuse(args, recording, folder)
        remove_untouched(folder, earlier)
    return 0


def _fuse(args: argparse.Namespace, recording: Recording, folder: Path) -> None:
    from adagmm_fusion.commands.progress import staged_progress_bar
    from adagmm_fusion.meshes.tsdf import check_voxels
    from adagmm_fusion.pairs.settings import Settings
    from adagmm_fusion.sequence.fused_mesh import fuse_frames, save_fused_mesh
    from adagmm_fusion.sequence.scene import scene_of

    check_voxels(args.voxel_size, args.max_memory)
    scene = scene_of(recording, args.moment)
    settings = Settings(max_depth_m=args.max_depth, target_points=args.target_points, device=args.device)
    edges: Sequence[Any] = ()
    dropped: Sequence[Any] = ()
    if args.poses == "truth":
        poses = {index: recording.entries[index].T_world_camera for index in scene.places}
        poses = {index: pose for index, pose in poses.items() if pose is not None}
    else:
        poses, edges, dropped = _estimated(recording, scene, settings, folder)
    placed = {index: poses[scene.place_of[index]] for index in scene.frames if scene.place_of[index] in poses}
    left_out = [recording.entries[index].name for index in scene.frames if index not in placed]
    with staged_progress_bar() as report:
        mesh, note = fuse_frames(
            recording,
            placed,
            textured=args.mesh != "ply",
            voxel_size_m=args.voxel_size,
            max_depth_m=args.max_depth,
            max_memory_mb=args.max_memory,
            progress=report,
        )
    paths = save_fused_mesh(folder / f"mesh.{args.mesh}", mesh)
    if left_out:
        print(printable(f"left out, their pose is not known: {len(left_out)} frames ({', '.join(left_out[:5])})"))
    shown = f"{', '.join(map(str, paths))}, {len(placed)} frames, {len(mesh.triangles)} triangles, {note}"
    print(printable(f"mesh: {shown}"))
    print_notes(recording)
    if not args.no_rerun:
        from adagmm_fusion.rerun_log import FusedRecording

        truth = {index: recording.entries[index].T_world_camera for index in placed}
        fused = FusedRecording(
            poses=placed,
            sensors={index: recording.entries[index].sensor for index in scene.frames},
            truth={index: pose for index, pose in truth.items() if pose is not None},
            edges=edges,
            dropped=dropped,
            ends={index: poses[index] for index in scene.places if index in poses},
            left_out=[index for index in scene.frames if index not in placed],
        )
        _show(args, recording, mesh, fused)
        if args.save:
            print(printable(f"Rerun recording: {args.save}"))


def _show(args: argparse.Namespace, recording: Recording, mesh: Any, fused: Any) -> None:
    """Log the mesh, the frames and the registrations between them to Rerun, as the arguments say."""
    from adagmm_fusion.rerun_log import fused_blueprint, log_fused_recording, open_stream

    with open_stream(args, recording.name, fused_blueprint(mesh.vertices, fused.poses), kind="fuse") as stream:
        log_fused_recording(stream, mesh, fused, lambda index: recording.entries[index].load())


def _estimated(recording: Recording, scene: Any, settings: Any, folder: Path) -> tuple[dict, list, list]:
    """T_world_camera of the places that hold together, the first one's camera frame being the world; the edges, and
    those of them that the pose graph dropped.

    What was found out about them is printed and written.
    """
    from dataclasses import asdict

    from adagmm_fusion.commands.progress import progress_bar, staged_progress_bar
    from adagmm_fusion.rigs.checking import rig_notes
    from adagmm_fusion.sequence.edge_file import EdgeFile
    from adagmm_fusion.sequence.joining import joined
    from adagmm_fusion.sequence.pose_graph import connected_sets, optimized_poses
    from adagmm_fusion.sequence.registration import register_scene
    from adagmm_fusion.sequence.scene import fixed_voxel_size, placed_edges
    from adagmm_fusion.source_digest import source_digest

    entries = recording.entries
    settings = fixed_voxel_size(entries[scene.frames[0]].load(), settings)
    with staged_progress_bar() as report:
        of = {
            "recording": str(recording.path.resolve()),
            "format": recording.format,
            "settings": asdict(settings),
            "program": source_digest(*REGISTERED_BY, distributions=REGISTERED_WITH),
            "content of the images or calibration": _digests(recording, scene, report),
        }
        file = EdgeFile(folder / "registrations.jsonl", of, len(entries))
        if file.edges:
            print(f"resumed: {len(file.edges)} registrations are there")
        try:
            register_scene(recording, scene, settings, file, report)
        except KeyboardInterrupt:
            with contextlib.suppress(OSError):  # whoever has hung up reads no more of it
                print(printable(f"kept: {len(file.edges)} registrations in {file.path}; the same command goes on"))
            raise
    placed = placed_edges(scene, file.edges)
    edges = joined(placed, scene.places) if scene.paths else placed
    sets = connected_sets(edges, scene.places)
    poses, dropped = optimized_poses(edges, first=sets[0][0])
    used = [edge for edge in edges[len(scene.rig) :] if edge.usable]
    loops = sum(edge.loop_closure for edge in used)
    registered = f"registered: {len(used)} of {len(file.edges)}"
    print(f"{registered}; loop closures: {loops}, of which dropped as wrong: {len(dropped)}")
    if together := sum(edge.only_together for edge in used):
        print(
            f"believed only because several say the same: {together} registrations, which join parts of the recording"
        )
    if len(sets) > 1:
        print(f"frames that hang together: sets of {', '.join(str(len(s)) for s in sets)}; the first is fused")
    if scene.rig:
        print(f"known from the rig: {len(scene.rig)} poses between its sensors")
        with progress_bar("looking at the rig") as on_frame:
            notes = list(rig_notes(recording, settings, on_frame))
        for note in notes:
            print(printable(f"note: {note}"))
    for sensor, path in _trajectory_files(recording, folder):
        of_sensor = {index: pose for index, pose in poses.items() if entries[index].sensor == sensor}
        if scene.paths and of_sensor:
            _conclude_path(recording, of_sensor, path)
    return poses, edges, dropped


def _digests(recording: Recording, scene: Any, report: Callable[[str, int, int], None]) -> list[list[str]]:
    """What each frame of the scene is: its sensor, its name, and a digest of its images and calibration."""
    from adagmm_fusion.recordings.digests import entry_digest

    found = []
    for done, index in enumerate(scene.place_of):
        report("reading frames", done, len(scene.place_of))
        entry = recording.entries[index]
        found.append([entry.sensor, entry.name, entry_digest(entry)])
    return found


def _trajectory_files(recording: Recording, folder: Path) -> list[tuple[str, Path]]:
    """Each sensor and the file of its trajectory."""
    if len(recording.sensors) == 1:
        return [(recording.sensors[0], folder / "trajectory.txt")]
    return [(sensor, folder / f"trajectory_{sensor}.txt") for sensor in recording.sensors]


def _conclude_path(recording: Recording, poses: dict, path: Path) -> None:
    """Write one sensor's trajectory, and print how far it is from the true one, where that is known."""
    from adagmm_fusion.sequence.trajectory import save_trajectory, true_and_estimated
    from adagmm_fusion.sequence.trajectory_errors import trajectory_errors

    save_trajectory(path, recording, poses)
    print(printable(f"trajectory: {path}"))
    true, estimated = true_and_estimated(recording, poses)
    if len(true) >= 3:
        e = trajectory_errors(true, estimated)
        print(
            f"against the ground truth: ATE {1000 * e.ate_m:.1f} mm, RPE {1000 * e.rpe_m:.1f} mm and "
            f"{e.rpe_deg:.2f}° a frame (root mean square, {e.poses} poses)"
        )
