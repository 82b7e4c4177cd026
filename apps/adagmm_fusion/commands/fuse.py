"""`adagmm-fusion fuse`: a whole recording as one coloured mesh."""

import argparse
from pathlib import Path

from adagmm_fusion.commands.recording_arguments import add_recording_arguments, recording_of


def add(commands) -> None:
    text = (
        "Register the frames of a recording with each other, make their poses consistent with loop closures and a pose "
        "graph, and fuse them into one coloured mesh. One sensor's path is fused as a whole; of several sensors, what "
        "they see at one moment. Started again, an interrupted run goes on where it was."
    )
    command = commands.add_parser("fuse", help="fuse a whole recording into one mesh", description=text)
    add_recording_arguments(command)
    command.add_argument("--moment", metavar="FRAME", help="of several sensors, which moment (default: the first)")
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
        "--max-memory", type=float, default=2000.0, metavar="MB", help="for the voxels (default: %(default)g)"
    )
    command.add_argument(
        "--mesh", choices=("ply", "glb"), default="ply", help="format of the mesh (default: %(default)s)"
    )
    command.add_argument(
        "--device", choices=("auto", "cpu", "cuda"), default="auto", help="where the kernels run (default: %(default)s)"
    )
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Fuse args.recording; returns the exit code.

    Raises
    ------
    AdaGMMError  if the recording cannot be used, the poses are not known, or a result cannot be written.
    """
    from adagmm_fusion.output_folder import exclusive

    recording = recording_of(args)
    folder = Path(args.output) if args.output else Path("output") / f"{recording.path.resolve().name}_fused"
    with exclusive(folder):
        return _fuse(args, recording, folder)


def _fuse(args: argparse.Namespace, recording, folder: Path) -> int:
    from adagmm_fusion.commands.progress import progress_bar
    from adagmm_fusion.sequence.registration import scene_of
    from adagmm_fusion.sequence.tsdf import TSDFVolume, save_mesh
    from adagmm_fusion.settings import Settings

    scene = scene_of(recording, args.moment)
    volume = TSDFVolume(args.voxel_size, max_depth_m=args.max_depth, max_memory_mb=args.max_memory)
    settings = Settings(max_depth_m=args.max_depth, device=args.device)
    if args.poses == "truth":
        poses = {index: recording.entries[index].T_world_camera for index in scene.frames}
        poses = {index: pose for index, pose in poses.items() if pose is not None}
    else:
        poses = _estimated(recording, scene, settings, folder)
    left_out = [recording.entries[index].name for index in scene.frames if index not in poses]
    with progress_bar("fusing") as report:
        for done, index in enumerate(sorted(poses)):
            report(done, len(poses))
            volume.integrate(recording.entries[index].load(), poses[index])
    path = folder / f"mesh.{args.mesh}"
    mesh = volume.mesh()
    save_mesh(path, mesh)
    if left_out:
        print(f"left out, their pose is not known: {len(left_out)} frames ({', '.join(left_out[:5])})")
    print(f"mesh: {path}, {volume.frames} frames, {len(mesh.triangles)} triangles, {volume.memory_mb:.0f} MB of voxels")
    return 0


def _estimated(recording, scene, settings, folder: Path) -> dict:
    """T_world_camera of the frames that hold together, the first one's camera frame being the world.

    What was found out about them is printed and written.
    """
    from dataclasses import asdict

    from adagmm_fusion.commands.progress import progress_bar
    from adagmm_fusion.sequence.edge_file import EdgeFile
    from adagmm_fusion.sequence.pose_graph import best_connected, optimized_poses
    from adagmm_fusion.sequence.registration import fixed_voxel_size, register_scene
    from adagmm_fusion.sequence.trajectory import save_trajectory, true_and_estimated
    from adagmm_fusion.sequence.trajectory_errors import trajectory_errors

    entries = recording.entries
    settings = fixed_voxel_size(entries[scene.frames[0]].load(), settings)
    of = {"recording": str(recording.path.resolve()), "format": recording.format, "settings": asdict(settings)}
    file = EdgeFile(folder / "registrations.jsonl", of | {"frames": [entries[i].name for i in scene.frames]})
    if file.edges:
        print(f"resumed: {len(file.edges)} registrations are there")
    with progress_bar("registering") as report:
        register_scene(recording, scene, settings, file, report)
    first = best_connected(file.edges, scene.frames)
    poses, dropped = optimized_poses(file.edges, first=first)
    used = [edge for edge in file.edges if edge.usable]
    loops = sum(edge.loop_closure for edge in used)
    print(f"registered: {len(used)} of {len(file.edges)}; loop closures: {loops}, of which dropped as wrong: {dropped}")
    save_trajectory(folder / "trajectory.txt", recording, poses)
    print(f"trajectory: {folder / 'trajectory.txt'}")
    true, estimated = true_and_estimated(recording, poses)
    if len(true) >= 3 and scene.is_path:
        e = trajectory_errors(true, estimated)
        print(
            f"against the ground truth: ATE {1000 * e.ate_m:.1f} mm, RPE {1000 * e.rpe_m:.1f} mm and "
            f"{e.rpe_deg:.2f}° a frame (root mean square, {e.poses} poses)"
        )
    return poses
