"""What the real viewer shows, without a display: poses as it resolved them, no complaints, pictures that differ."""

import argparse

import cv2
import numpy as np
import psutil
import pytest
from registered_scene import ITERATIONS, known_estimate, room_clouds, room_mesh, room_pair
from viewer import complaints, eventually, needs_viewer, screenshot

from adagmm_fusion.pairs.record import PairRecord
from adagmm_fusion.rerun_log import (
    add_rerun_arguments,
    dashboard,
    log_pair,
    log_recording_summary,
    log_refused_pair,
    open_stream,
)
from adagmm_fusion.rerun_log.headless_viewer import headless_viewer
from adagmm_fusion.rerun_log.picture import TOP_BAR_PX, main, show_page
from adagmm_fusion.rerun_log.picture import screenshot as picture_of
from adagmm_o3d.errors import InputError

pytestmark = [needs_viewer, pytest.mark.slow]
RESULT = "Result: cameras truth green, estimate orange, start blue"
IDENTITY, BEFORE, AFTER = "Identity: target blue", "Start", "End"


def save(path, log, **blueprint):
    parser = argparse.ArgumentParser()
    add_rerun_arguments(parser)
    with open_stream(parser.parse_args(["--save", str(path)]), "room", dashboard(**blueprint)) as rec:
        log(rec)
    return path


def assert_pose(viewer, entity: str, expected: np.ndarray, *, rtol: float = 1e-5, atol: float = 1e-6) -> None:
    """The viewer comes to place the entity there."""

    def look() -> None:
        edges = viewer.get_transform_graph(include_transforms=True)["edges"]
        placed = [e["source"]["parent_from_child"] for e in edges if e["child"] == f"tf#/{entity}"]
        assert len(placed) == 1, f"{entity}: {len(placed)} transforms"
        np.testing.assert_allclose(np.array(placed[0]), expected, rtol=rtol, atol=atol)

    eventually(look)


def assert_time(viewer, timeline: str, time: int | None = None) -> None:
    """The viewer comes to show one recording, on that timeline and at that time."""

    def look() -> None:
        (shown,) = [(r.current_timeline, r.current_time) for r in viewer.get_state().recordings]
        assert shown == (timeline, shown[1] if time is None else time)

    eventually(look)


def go_to(viewer, timeline: str, time: int, source_pose: np.ndarray | None = None) -> None:
    """Move the viewer to a time and wait until it is there, with the source where it is then."""
    viewer.set_time(timeline, sequence=time, play_state="paused")
    assert_time(viewer, timeline, time)
    if source_pose is not None:
        assert_pose(viewer, "world/source", source_pose)


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Share of pixels that are not nearly the same; views side by side may differ in size by a pixel."""
    height, width = (min(x, y) for x, y in zip(a.shape[:2], b.shape[:2], strict=True))
    a, b = a[:height, :width], b[:height, :width]
    return float(np.mean(np.abs(a.astype(int) - b.astype(int)).max(axis=2) > 30))


def colorfulness(picture: np.ndarray) -> int:
    """How many clearly different saturated colours cover more than a few pixels."""
    saturated = picture[np.ptp(picture, axis=2) > 60] // 64
    _, counts = np.unique(saturated, axis=0, return_counts=True)
    return int(np.sum(counts > 20))


@pytest.fixture(scope="module")
def pair_viewer(tmp_path_factory):
    path = tmp_path_factory.mktemp("viewer") / "pair.rrd"
    free = (np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0]), np.array([0.8, 0.0, 0.0, 0.0, 0.6, 0.0]))
    save(
        path,
        lambda rec: log_pair(rec, room_pair(), *room_clouds(), known_estimate(unobservable=free), fused=room_mesh()),
    )
    with headless_viewer(path) as viewer:
        yield viewer


def test_opens_on_the_last_iteration_without_a_complaint(pair_viewer):
    screenshot(pair_viewer)
    assert_time(pair_viewer, "iteration", ITERATIONS)
    assert complaints(pair_viewer) == []


@pytest.mark.parametrize("iteration", [0, ITERATIONS // 2, ITERATIONS])
def test_poses_are_the_estimates(pair_viewer, iteration):
    pair_viewer.set_time("iteration", sequence=iteration, play_state="paused")
    expected = known_estimate().transformations[iteration]
    assert_pose(pair_viewer, "world/source", expected)
    assert_pose(pair_viewer, "world/target", np.eye(4), rtol=0, atol=1e-9)
    assert_pose(pair_viewer, "world/truth/source", room_pair().T_target_source)


def test_scrubbing_moves_the_source_and_before_stays(pair_viewer):
    def look() -> None:
        go_to(pair_viewer, "iteration", 0, known_estimate().transformations[0])
        before, after_0 = screenshot(pair_viewer, BEFORE), screenshot(pair_viewer, AFTER)
        go_to(pair_viewer, "iteration", ITERATIONS, known_estimate().transformations[ITERATIONS])
        after = screenshot(pair_viewer, AFTER)
        moved = difference(after_0, after)
        assert moved > 0.1 and difference(before, after) > 0.1
        assert difference(before, screenshot(pair_viewer, BEFORE)) < 0.005
        assert difference(before, after_0) < 0.5 * moved  # the same scene, but the edges of its points fall elsewhere

    eventually(look)
    assert complaints(pair_viewer) == []


def test_texture_is_visible_and_the_clouds_have_their_two_colors(pair_viewer):
    go_to(pair_viewer, "iteration", ITERATIONS, known_estimate().transformations[ITERATIONS])

    def look() -> None:
        assert colorfulness(screenshot(pair_viewer, RESULT)) >= 30
        after = screenshot(pair_viewer, AFTER).astype(int)
        red, green, blue = np.moveaxis(after, 2, 0)
        assert np.mean((red > blue + 60) & (red > green + 20)) > 0.02  # orange
        assert np.mean((blue > red + 60) & (blue > green + 20)) > 0.02  # blue

    eventually(look)


def test_why_page(tmp_path):
    path = tmp_path / "why.rrd"
    estimate = known_estimate(off=(0.3, 0.0, 0.0))
    save(path, lambda rec: log_pair(rec, room_pair(), *room_clouds(), estimate))
    with headless_viewer(path) as viewer:
        show_page(viewer, "Why")
        screenshot(viewer)

        def look() -> None:
            weights = screenshot(viewer, "Who pulls: share of weight")
            residuals = screenshot(viewer, "How far off: residual")
            overlap = screenshot(viewer, "Who has a partner")
            for a, b in ((weights, residuals), (residuals, overlap), (weights, overlap)):
                assert difference(a, b) > 0.02

        eventually(look)
        assert complaints(viewer) == []


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_both_themes_can_be_read_in_a_small_window(tmp_path, theme):
    """Legends have bright labels on a dark ground in either theme, and the report has all its columns."""
    path = tmp_path / "pair.rrd"
    save(path, lambda rec: log_pair(rec, room_pair(), *room_clouds(), known_estimate()))
    with headless_viewer(path, size=(1280, 720), theme=theme) as viewer:
        report = screenshot(viewer, "Report").astype(int).mean(axis=2)
        ground = np.median(report)
        assert (ground > 200) == (theme == "light") and (ground < 60) == (theme == "dark")
        written = np.abs(report - ground) > 60
        columns = np.flatnonzero(written.any(axis=0))
        assert columns[-1] < report.shape[1] - 8, "something is cut off on the right"
        show_page(viewer, "Why")

        def look() -> None:
            ids = [view.view_id for view in viewer.get_state().views if view.name == "Legend" and view.visible]
            assert len(ids) == 4
            for view_id in ids:
                legend = picture_of(viewer, view_id).astype(int)
                labels = legend[int(0.55 * len(legend)) :].mean(axis=2)
                assert np.median(labels) < 60 and np.mean(labels > 180) > 0.01

        eventually(look)
        assert complaints(viewer) == []


def test_many_pairs(tmp_path):
    def log(rec):
        em_step = 0
        for frame in (0, 1):
            estimate = known_estimate(frame, off=(0.5 * frame, 0.0, 0.0))
            em_step = log_pair(rec, room_pair(frame), *room_clouds(frame), estimate, frame_index=frame, em_step=em_step)
        log_refused_pair(rec, "pair_2", "no depth", before=room_pair(1), frame_index=2, em_step=em_step)
        log_recording_summary(
            rec, [PairRecord("pair_0", 0, "ok", "estimate", ""), PairRecord("pair_1", 1, "failed", "estimate", "")]
        )

    path = save(tmp_path / "many.rrd", log, many_pairs=True)
    with headless_viewer(path) as viewer:
        screenshot(viewer)
        assert_time(viewer, "frame")
        assert complaints(viewer) == []
        show_page(viewer, "Pair")
        screenshot(viewer)

        def look() -> None:
            pictures, images = [], []
            for frame in (0, 1, 2):
                expected = known_estimate(frame, off=(0.5 * frame, 0.0, 0.0)).transformation if frame < 2 else None
                go_to(viewer, "frame", frame, expected)
                pictures.append(screenshot(viewer, AFTER))
                images.append(screenshot(viewer, "Target colour"))
            assert difference(pictures[0], pictures[1]) > 0.05
            for shown in (pictures, images):
                assert np.mean(np.ptp(shown[1], axis=2) > 60) > 0.05
                assert np.mean(np.ptp(shown[2], axis=2) > 60) < 0.002  # nothing of the pair before is left

        eventually(look)
        viewer.set_time("em_step", sequence=ITERATIONS + 1 + 3, play_state="paused")
        screenshot(viewer, AFTER)  # only a painted frame knows the transforms of a timeline that is new to the viewer
        assert_pose(viewer, "world/source", known_estimate(1, off=(0.5, 0.0, 0.0)).transformations[3])
        assert complaints(viewer) == []


def test_a_view_behind_tabs_and_a_point_can_be_shown(tmp_path):
    path = save(tmp_path / "pair.rrd", lambda rec: log_pair(rec, room_pair(), *room_clouds(), known_estimate()))
    pictures = []
    for more in ([], ["--page", "Target depth"], ["--page", "Target depth", "--select", "world/source/points[#7]"]):
        out = tmp_path / f"{len(pictures)}.png"
        assert main([str(path), str(out), *more]) == 0
        pictures.append(cv2.imread(str(out)))
    images, panel = (slice(60, 240), slice(920, 1270)), (slice(0, 680), slice(985, 1280))
    assert difference(pictures[0][images], pictures[1][images]) > 0.2
    assert difference(pictures[1][panel], pictures[2][panel]) > 0.2
    with headless_viewer(path) as viewer, pytest.raises(InputError, match=r"page: expected one of .*, got 'Nowhere'"):
        show_page(viewer, "Nowhere")


def test_names_in_any_script_can_be_shown(tmp_path):
    """Without an escape, the viewer ends at the first character that its font lacks."""
    name = "漢字 مرحبا 😀 हिन्दी \u2028 \ue000 \x07 \U0010ffff"
    parser = argparse.ArgumentParser()
    add_rerun_arguments(parser)
    path = tmp_path / "names.rrd"
    with open_stream(parser.parse_args(["--save", str(path)]), name, dashboard()) as rec:
        log_refused_pair(rec, name, f"no depth in {name}")
    with headless_viewer(path) as viewer:
        viewer.run_command("ui.toggle_blueprint_panel")  # where the recording's name is
        show_page(viewer, "Pair")
        screenshot(viewer)
        assert complaints(viewer) == []
        (report,) = [view for view in viewer.get_state().views if view.name == "Report"]
        assert report.visible


def test_the_viewer_for_pictures_listens_on_loopback_only(pair_viewer):
    family = psutil.Process().children(recursive=True)
    listening = [c.laddr for p in family for c in p.net_connections() if c.status == psutil.CONN_LISTEN]
    assert listening and {place.ip for place in listening} == {"127.0.0.1"}


def test_picture_command(tmp_path, capfd):
    path = save(tmp_path / "pair.rrd", lambda rec: log_pair(rec, room_pair(), *room_clouds(), known_estimate()))
    out = tmp_path / "pair.jpg"
    assert main([str(path), str(out), "--time", "iteration=0", "--size", "800x600"]) == 0
    assert cv2.imread(str(out)).shape == (600 - TOP_BAR_PX, 800, 3)
    capfd.readouterr()
    for arguments, message in (
        ([str(tmp_path / "none.rrd"), str(out)], "none.rrd: no such Rerun recording"),
        (
            [str(path), str(out), "--time", "iteration"],
            "--time: expected TIMELINE=N as in iteration=0, got 'iteration'",
        ),
        (
            [str(path), str(out), "--size", "1280"],
            "--size: expected WIDTHxHEIGHT up to 8192x8192 as in 1280x720, got '1280'",
        ),
        ([str(path), str(tmp_path / "pair.txt")], "pair.txt: expected a name ending in .jpg or .png"),
    ):
        assert main(arguments) == 1
        assert capfd.readouterr().err.splitlines()[-1].endswith(message)
    assert {p.name for p in tmp_path.iterdir()} == {"pair.rrd", "pair.jpg"}
