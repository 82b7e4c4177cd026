"""What is logged, read back from the file: entities, counts, poses, images, blueprint, size."""

import argparse
import subprocess
from dataclasses import dataclass, replace

import numpy as np
import open3d as o3d
import pytest
import rerun as rr
from registered_scene import INTRINSICS, ITERATIONS, known_estimate, room_clouds, room_mesh, room_pair
from rerun.chunk import RrdReader

from adagmm_fusion.errors import OutputError
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame, RGBDPair
from adagmm_fusion.pairs.feature_start import FeatureStart
from adagmm_fusion.pairs.record import PairRecord
from adagmm_fusion.pairs.stages import END, IDENTITY, START, Stage, worse_than_start
from adagmm_fusion.rerun_log import (
    Eye,
    Limits,
    Progress,
    RegistrationLogger,
    add_rerun_arguments,
    dashboard,
    log_pair,
    log_recording_properties,
    log_recording_summary,
    log_refused_pair,
    log_result,
    open_stream,
)
from adagmm_fusion.rerun_log.blueprint import STAGES
from adagmm_fusion.rerun_log.ellipsoids import chosen_points
from adagmm_fusion.rerun_log.eyes import ASPECT, FIELD_OF_VIEW, NARROW, eye_pose
from adagmm_fusion.rerun_log.guide import GUIDE
from adagmm_fusion.rerun_log.headless_viewer import RERUN
from adagmm_fusion.rerun_log.iterations import CURVES
from adagmm_fusion.rerun_log.matches import projected
from adagmm_fusion.rerun_log.summary import HEADINGS, HINT, LEGEND, summary_markdown
from adagmm_fusion.rerun_log.words import entity_part, shown
from adagmm_o3d import registration_adaptive_gmm

MEGABYTE = 1e6


@pytest.fixture(autouse=True)
def strict():
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def arguments(*words) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_rerun_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def save(path, log, blueprint=None):
    with open_stream(arguments("--save", path), "test", blueprint) as rec:
        log(rec)
    return path


@dataclass
class Rows:
    """All rows of one entity's component, in the order of its timeline; None for static ones."""

    times: np.ndarray | None
    values: list


def rows(path, entity: str, component: str, timeline: str | None = None) -> Rows:
    times, values = [], []
    for chunk in RrdReader(path).stream().to_chunks():
        if chunk.entity_path != f"/{entity}" or chunk.is_static != (timeline is None):
            continue
        batch = chunk.to_record_batch()
        if component not in batch.schema.names or (timeline and timeline not in batch.schema.names):
            continue
        values += batch.column(component).to_pylist()
        if timeline:
            times += batch.column(timeline).to_pylist()
    if timeline is None:
        return Rows(None, values)
    order = np.argsort(times, kind="stable")
    return Rows(np.array(times)[order], [values[i] for i in order])


def poses(path, timeline: str) -> tuple[np.ndarray, np.ndarray]:
    translation = rows(path, "world/source", "Transform3D:translation", timeline)
    rotation = rows(path, "world/source", "Transform3D:mat3x3", timeline)
    np.testing.assert_array_equal(translation.times, rotation.times)
    T = np.tile(np.eye(4), (len(translation.values), 1, 1))
    T[:, :3, 3] = np.reshape(translation.values, (-1, 3))
    T[:, :3, :3] = np.reshape(rotation.values, (-1, 3, 3)).transpose(0, 2, 1)  # column-major on the wire
    return translation.times, T


def verify(path):
    done = subprocess.run([RERUN, "rrd", "verify", path], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def summary_record(name: str, status: str, rotation_deg: float, translation_mm: float, **more) -> PairRecord:
    """A pair that started 0.1° and 20 mm off."""
    errors = {IDENTITY: (15.0, 200.0), START: (0.1, 20.0), END: (rotation_deg, translation_mm)}
    stages = tuple(Stage(name, "", np.eye(4).tolist(), *error) for name, error in errors.items())
    worse = worse_than_start(*stages[1:])
    errors = {"rotation_error_deg": rotation_deg, "translation_error_mm": translation_mm}
    return PairRecord(name, 0, status, "ground truth", "", stages=stages, worse_than_start=worse, **errors, **more)


@pytest.fixture(scope="module")
def one_pair(tmp_path_factory):
    path = tmp_path_factory.mktemp("one") / "pair.rrd"
    free = (np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0]),)
    estimate = known_estimate(unobservable=free)
    return save(path, lambda rec: log_pair(rec, room_pair(), *room_clouds(), estimate, fused=room_mesh()), dashboard())


@pytest.fixture(scope="module")
def three_pairs(tmp_path_factory):
    path = tmp_path_factory.mktemp("many") / "pairs.rrd"

    def log(rec):
        em_step = 0
        for frame in (0, 1):
            em_step = log_pair(
                rec,
                room_pair(frame),
                *room_clouds(frame),
                known_estimate(frame, off=(0.5 * frame, 0.0, 0.0)),
                frame_index=frame,
                em_step=em_step,
                fused=room_mesh(frame, (0.5 * frame, 0.0, 0.0)),
            )
        assert (
            log_refused_pair(rec, "pair_2", "no depth", before=room_pair(1), frame_index=2, em_step=em_step)
            == em_step + 1
        )
        log_recording_summary(
            rec,
            [
                summary_record("pair_0", "ok", 0.0, 0.0),
                summary_record("pair_1", "failed", 0.0, 500.0, diagnosis="slid along the wall"),
                PairRecord("pair_2", 2, "failed", "error", "no depth"),
            ],
        )

    return save(path, log, dashboard(many_pairs=True))


def test_files_verify_and_leave_nothing_beside_them(one_pair, three_pairs):
    for path in (one_pair, three_pairs):
        verify(path)
        assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_entities_of_a_pair(one_pair):
    below_sensor = ("points", "covariances", "shape", "image", "image/rgb", "image/depth")
    expected = {f"/world/{sensor}/{entity}" for sensor in ("target", "source") for entity in below_sensor}
    expected |= {f"/metrics/{m}" for m in ("energy", "spread_mm", "rotation_error_deg", "translation_error_mm")}
    expected |= {f"/world/{w}" for w in ("target", "source", "initial/source", "initial/source/shape")}
    expected |= {f"/world/{w}" for w in ("truth/source", "truth/source/image", "initial/source/image", "difference")}
    expected |= {
        "/world",
        "/world/fused",
        "/world/unobservable",
        "/world/target/image/overlay",
        "/world/target/image/checkerboard",
    }
    expected |= {"/report", "/log", "/guide", "/matches/images", "/diagnostics/residual_histogram"}
    expected |= {"/world/recorded/source/shape", "/log10/spread_mm", "/log10/stages/rotation_error_deg/start"}
    assert expected <= set(RrdReader(one_pair).store().schema().entity_paths())


def test_one_transform_for_each_iteration_and_the_start(one_pair):
    times, T = poses(one_pair, "iteration")
    np.testing.assert_array_equal(times, np.arange(ITERATIONS + 1))
    np.testing.assert_allclose(T, known_estimate().transformations, rtol=1e-6, atol=1e-6)
    chunks = [c for c in RrdReader(one_pair).stream().to_chunks() if c.entity_path == "/world/source"]
    assert [chunk.num_rows for chunk in chunks] == [ITERATIONS + 1]


def test_clouds_are_logged_once_in_their_own_frame(one_pair):
    for entity, cloud in zip(("source", "target"), room_clouds(), strict=True):
        positions = rows(one_pair, f"world/{entity}/points", "Points3D:positions")
        assert len(positions.values) == 1
        np.testing.assert_allclose(positions.values[0], np.asarray(cloud.points), rtol=1e-6, atol=1e-6)
        colors = rows(one_pair, f"world/{entity}/points", "Points3D:colors").values[0]
        assert len(colors) == len(cloud.points)
        expected = np.floor(255.0 * np.asarray(cloud.colors) + 0.5).astype(np.uint32)
        np.testing.assert_array_equal(np.array(colors, np.uint32) >> 24, expected[:, 0])
        assert rows(one_pair, f"world/{entity}/points", "Points3D:positions", "iteration").values == []


def test_every_layer_has_a_color_for_every_point(one_pair):
    source, target = room_clouds()
    for entity, cloud, layers in (
        ("source", source, ("WeightShare", "ResidualMm", "Overlap", "ColorSupport")),
        ("target", target, ("Dimmed",)),
    ):
        for layer in layers:
            (colors,) = rows(one_pair, f"world/{entity}/points", f"{layer}:colors").values
            assert len(colors) == len(cloud.points), (entity, layer)


def test_curves(one_pair):
    estimate = known_estimate()
    variance = np.median(np.trace(np.asarray(room_clouds()[0].covariances), axis1=1, axis2=2) / 3.0)
    spreads = 1000.0 * np.sqrt(variance * estimate.sigmas)
    for entity, expected in (("energy", estimate.energies), ("spread_mm", spreads)):
        curve = rows(one_pair, f"metrics/{entity}", "Scalars:scalars", "iteration")
        np.testing.assert_array_equal(curve.times, np.arange(1, ITERATIONS + 1))
        np.testing.assert_allclose(np.ravel(curve.values), expected, rtol=1e-12, atol=0.0)
    degrees = rows(one_pair, "metrics/rotation_error_deg", "Scalars:scalars", "iteration")
    np.testing.assert_array_equal(degrees.times, np.arange(ITERATIONS + 1))
    np.testing.assert_allclose(np.ravel(degrees.values), np.linspace(15.0, 0.0, ITERATIONS + 1), rtol=1e-6, atol=1e-5)
    millimetres = np.ravel(rows(one_pair, "metrics/translation_error_mm", "Scalars:scalars", "iteration").values)
    exponents = rows(one_pair, "log10/spread_mm", "Scalars:scalars", "iteration")
    np.testing.assert_allclose(np.ravel(exponents.values), np.log10(spreads), rtol=1e-12, atol=0.0)
    start = 1000.0 * np.linalg.norm(room_pair().T_target_source[:3, 3])
    np.testing.assert_allclose(millimetres, np.linspace(start, 0.0, ITERATIONS + 1), rtol=1e-6, atol=1e-6)


def test_images_are_compressed_and_depth_keeps_its_unit(one_pair):
    for sensor in ("target", "source"):
        (kind,) = rows(one_pair, f"world/{sensor}/image/rgb", "EncodedImage:media_type").values
        assert kind == ["image/jpeg"]
        (meter,) = rows(one_pair, f"world/{sensor}/image/depth", "EncodedDepthImage:meter").values
        assert meter == [1000.0]
        (resolution,) = rows(one_pair, f"world/{sensor}/image", "Pinhole:resolution").values
        assert resolution == [[INTRINSICS.width, INTRINSICS.height]]
        assert rows(one_pair, f"world/{sensor}", "Pinhole:resolution").values == []


def test_ellipsoids_shrink_with_sigma(one_pair):
    sizes = rows(one_pair, "world/source/covariances", "Ellipsoids3D:half_sizes", "iteration")
    assert len(sizes.values) == ITERATIONS
    first, last = (np.array(sizes.values[i]) for i in (0, -1))
    sigmas = known_estimate().sigmas
    np.testing.assert_allclose(first / last, np.sqrt(sigmas[0] / sigmas[-1]), rtol=1e-5, atol=0.0)
    source, _ = room_clouds()
    variances = np.linalg.eigvalsh(np.asarray(source.covariances)[chosen_points(source)])
    np.testing.assert_allclose(first, 3.0 * np.sqrt(sigmas[0] * variances), rtol=1e-4, atol=1e-9)


def test_the_fused_mesh_carries_its_texture(one_pair):
    (buffer,) = rows(one_pair, "world/fused", "Mesh3D:albedo_texture_buffer").values
    assert bytes(buffer[0]) == room_mesh().texture.tobytes()
    (uvs,) = rows(one_pair, "world/fused", "Mesh3D:vertex_texcoords").values
    np.testing.assert_array_equal(np.float32(uvs), room_mesh().uvs)


def test_shapes_before_and_after_are_the_same_in_one_color_each(one_pair):
    positions = [
        rows(one_pair, f"world/{entity}/shape", "Mesh3D:vertex_positions").values[0]
        for entity in ("source", "initial/source", "target")
    ]
    assert positions[0] == positions[1] != positions[2]
    (colors,) = rows(one_pair, "world/source/shape", "Mesh3D:vertex_colors").values
    red, green, blue = (np.array(colors, np.uint32) >> shift & 255 for shift in (24, 16, 8))
    assert len(colors) == len(positions[0]) and (red > green).all() and (green > blue).all()


def test_blueprint_travels_with_the_file(one_pair, three_pairs):
    for path, page in ((one_pair, "Pair"), (three_pairs, "Summary")):
        (blueprint,) = RrdReader(path).blueprints()
        names = set()
        for chunk in RrdReader(path).stream(store=blueprint).to_chunks():
            batch = chunk.to_record_batch()
            for column in ("ViewBlueprint:display_name", "ContainerBlueprint:display_name"):
                if column in batch.schema.names:
                    names |= {name for row in batch.column(column).to_pylist() for name in row or ()}
        assert {"Identity: target blue", "Start", "End", "Energy", "Report", "Why", "Guide", page} <= names


def test_report_says_how_it_went(one_pair, three_pairs):
    (text,) = rows(one_pair, "report", "TextDocument:text").values
    before_mm = 1000.0 * np.linalg.norm(room_pair().T_target_source[:3, 3])
    assert text[0].startswith("### ✔ Registered: 0.00° and 0 mm off")
    for row in (f"| identity | 15.00 | {before_mm:.0f} |", f"| start (geometry) | 15.00 | {before_mm:.0f} |"):
        assert row in text[0].splitlines()
    assert {"| **end** | **0.00** | **0** |", "| limit | 5 | 100 |"} <= set(text[0].splitlines())
    reports = rows(three_pairs, "report", "TextDocument:text", "frame")
    assert [report[0].splitlines()[0] for report in reports.values] == [
        "### ✔ Registered: 0.00° and 0 mm off",
        "### × Failed: 0.00° and 500 mm off",
        "### × Failed: no depth",
    ]


def test_frames_show_results_and_em_steps_run_through_all_pairs(three_pairs):
    frames, T = poses(three_pairs, "frame")
    np.testing.assert_array_equal(frames, [0, 1])
    ends = [known_estimate(0).transformation, known_estimate(1, off=(0.5, 0.0, 0.0)).transformation]
    np.testing.assert_allclose(T, ends, rtol=1e-6, atol=1e-6)
    steps, T = poses(three_pairs, "em_step")
    np.testing.assert_array_equal(steps, np.arange(2 * (ITERATIONS + 1)))
    np.testing.assert_allclose(
        T[ITERATIONS + 1 :], known_estimate(1, off=(0.5, 0, 0)).transformations, rtol=1e-6, atol=1e-6
    )
    points = rows(three_pairs, "world/source/points", "Points3D:positions", "frame")
    assert [len(p) for p in points.values] == [len(room_clouds(frame)[0].points) for frame in (0, 1)]


def test_errors_of_the_stages_stand_at_their_pair_and_at_their_iteration(three_pairs):
    degrees = "log10/stages/rotation_error_deg"
    start = rows(three_pairs, f"{degrees}/start", "Scalars:scalars", "frame")
    assert start.times.tolist() == [0, 1]
    np.testing.assert_allclose(np.ravel(start.values), np.log10([15.0, 20.0]), rtol=1e-6, atol=0.0)
    right = rows(three_pairs, "log10/stages/translation_error_mm/end", "Scalars:scalars", "em_step")
    assert right.times.tolist() == [ITERATIONS] and right.values[0][0] <= 0.0  # a millimetre
    wrong = rows(three_pairs, "log10/stages/translation_error_mm/end_wrong", "Scalars:scalars", "em_step")
    assert wrong.times.tolist() == [2 * ITERATIONS + 1]
    np.testing.assert_allclose(np.ravel(wrong.values), np.log10([500.0]), rtol=1e-6, atol=0.0)
    limit = rows(three_pairs, "log10/stages/translation_error_mm/limit", "Scalars:scalars", "em_step")
    assert limit.times.tolist() == [0, ITERATIONS, ITERATIONS + 1, 2 * ITERATIONS + 1]


def test_a_refused_pair_hides_the_one_before(three_pairs):
    cleared = rows(three_pairs, "world", "Clear:is_recursive", "frame")
    assert (cleared.times.tolist(), cleared.values) == ([2], [[True]])


def test_summary_is_sorted_with_the_worst_first(three_pairs):
    (text,) = rows(three_pairs, "summary/table", "TextDocument:text").values
    assert "1 of 3 pairs registered" in text[0]
    lines = [line for line in text[0].splitlines() if line.startswith("| ")]
    assert lines[2] == "| 1 | ×▲ | 0.00 | 500 | 0.10 | 20 | 15.00 | 200 | – | – | – | – | – | – |"
    reasons = [line for line in text[0].splitlines() if line.startswith("- **")]
    assert reasons == ["- **2** pair_2: no depth.", "- **1** pair_1: slid along the wall.", "- **0** pair_0: ok."]
    assert "▲ 1 ended worse than it started." in text[0].splitlines()


def test_the_summary_of_a_run_that_goes_on_says_how_long(tmp_path):
    records = [summary_record("pair_0", "ok", 0.0, 0.0)]

    def log(rec):
        log_recording_summary(rec, records, progress=Progress(10, 125.0))

    (text,) = rows(save(tmp_path / "on.rrd", log), "summary/table", "TextDocument:text").values
    assert "**1 of 10 done, about 2 min 05 s left.**" in text[0].splitlines()
    assert summary_markdown([], "Summary", Progress(10, 0.0)).startswith("### Summary: 10 pairs to register\n")


def test_points_tell_their_numbers(one_pair):
    source, target = room_clouds()
    names = ("weight_share", "residual_mm", "partner_in_target", "variance_mm2")
    values = {name: np.array(rows(one_pair, "world/source/points", name).values[0]) for name in names}
    assert {len(numbers) for numbers in values.values()} == {len(source.points)}
    partner = values["partner_in_target"]
    assert np.isnan(values["residual_mm"]).tolist() == (partner < 0).tolist()
    T = known_estimate().transformation
    moved = np.asarray(source.points)[partner >= 0] @ T[:3, :3].T + T[:3, 3]
    gaps = np.linalg.norm(moved - np.asarray(target.points)[partner[partner >= 0]], axis=1)
    assert (1000.0 * gaps + 1e-6 >= values["residual_mm"][partner >= 0]).all()  # along the normal it is less
    layers = ("WeightShare", "ResidualMm", "Overlap", "ColorSupport")
    types = {
        str(field.name): field.metadata[b"rerun:component_type"]
        for chunk in RrdReader(one_pair).stream().to_chunks()
        if chunk.entity_path == "/world/source/points"
        for field in chunk.to_record_batch().schema
        if str(field.name).endswith(":colors")
    }
    assert {types[f"{layer}:colors"] for layer in layers} == {
        b"rerun.components.Color"
    }  # else they are told as numbers
    expected = 1e6 * known_estimate().sigma * np.trace(np.asarray(source.covariances), axis1=1, axis2=2) / 3.0
    np.testing.assert_allclose(values["variance_mm2"], expected, rtol=1e-9, atol=0.0)


def test_features_and_their_matches_are_in_the_images(tmp_path):
    pair = room_pair()
    points = np.array([[0.1, -0.1, 1.5], [-0.3, 0.2, 2.0], [0.2, 0.3, 1.8]])
    pixels = projected(points, pair.T_target_source, INTRINSICS)
    pixels[2] += (30.0, 0.0)
    features = FeatureStart(pair.T_target_source, 3, 9, points, pixels)
    path = tmp_path / "matches.rrd"
    save(path, lambda rec: log_pair(rec, pair, *room_clouds(), known_estimate(), features=features))
    (off_px,) = rows(path, "world/target/image/features", "end_is_off_px").values
    np.testing.assert_allclose(off_px, [0.0, 0.0, 30.0], rtol=1e-6, atol=1e-6)
    (lines,) = rows(path, "matches/lines", "LineStrips2D:strips").values
    np.testing.assert_allclose(np.array(lines)[:, 1], pixels + np.array((INTRINSICS.width, 0.0)), rtol=1e-6, atol=1e-4)
    (text,) = rows(path, "report", "TextDocument:text").values
    assert "| start (features) | 0.00 | 0 |" in text[0].splitlines()


@pytest.mark.parametrize(("timestamp", "timeline"), [(1305031233.25, "recorded at"), (12.5, "recorded after")])
def test_time_stamps_are_a_timeline(tmp_path, timestamp, timeline):
    pair = replace(room_pair(), source=replace(room_pair().source, timestamp=timestamp))
    path = tmp_path / "stamped.rrd"
    save(path, lambda rec: log_pair(rec, pair, *room_clouds(), known_estimate(), frame_index=0))
    assert len(rows(path, "world/source/points", "Points3D:positions", timeline).values) == 1
    assert len(rows(path, "world/source", "Transform3D:translation", timeline).values) == 1


def test_properties(tmp_path):
    def log(rec):
        log_recording_properties(rec, recording="room", sensors=["left", "right"], parameters={"voxel_size_m": 0.03})

    path = save(tmp_path / "properties.rrd", log)
    assert rows(path, "__properties/input", "sensors").values == [["left", "right"]]
    assert rows(path, "__properties/parameters", "voxel_size_m").values == [["0.03"]]


def test_the_result_is_a_property(tmp_path):
    records = [summary_record("a", "ok", 0.2, 10.0), summary_record("b", "failed", 9.0, 300.0)]
    records.append(PairRecord("c", 2, "failed", "error", "no depth"))
    path = save(tmp_path / "result.rrd", lambda rec: log_result(rec, records))
    for name, expected in (("failed_pairs", 2), ("pairs", 3), ("median_deg", 4.6), ("median_mm", 155.0)):
        np.testing.assert_allclose(rows(path, "__properties/found", name).values, [[expected]], rtol=1e-12, atol=0.0)


def test_words_that_the_viewer_has_no_glyphs_for_are_escaped():
    assert shown("a_b 0.5° → σ ✔ ▲ äéß Σ Жук log₁₀\n") == "a_b 0.5° → σ ✔ ▲ äéß Σ Жук log₁₀\n"
    assert shown("漢\u202e😀\x1b\ud800") == "\\u6f22\\u202e\\U0001f600\\x1b\\ud800"
    assert shown(shown("漢")) == shown("漢")
    assert entity_part("left/漢") == "left\\/\\\\u6f22"


def test_what_we_write_ourselves_is_not_escaped():
    texts = [GUIDE, *(text for text, _ in CURVES.values()), *(name for name in STAGES), *HEADINGS, LEGEND, HINT]
    assert [text for text in texts if shown(text) != text] == []


def test_a_vga_pair_of_50_iterations_stays_within_its_budget(tmp_path):
    pair, intrinsics = room_pair(), PinholeIntrinsics(640, 480, 560.0, 560.0, 319.5, 239.5)
    rng = np.random.default_rng(5)

    def enlarged(frame):
        color = np.kron(frame.color, np.ones((4, 4, 1), np.uint8)) ^ rng.integers(0, 16, (480, 640, 3), dtype=np.uint8)
        depth = np.kron(frame.depth, np.ones((4, 4), np.uint16)) + rng.integers(0, 9, (480, 640), dtype=np.uint16)
        return RGBDFrame(frame.name, color, depth, intrinsics, 1000.0, frame.sensor)

    vga = RGBDPair("vga", enlarged(pair.source), enlarged(pair.target), pair.T_target_source, 0)
    path = tmp_path / "vga.rrd"
    save(path, lambda rec: log_pair(rec, vga, *room_clouds(), known_estimate(iterations=50)), dashboard())
    assert path.stat().st_size <= 15.0 * MEGABYTE


def test_callback_of_a_script(tmp_path):
    source, target = room_clouds()
    estimate, T_truth = known_estimate(), room_pair().T_target_source

    def log(rec):
        logger = RegistrationLogger(rec, source, target, T_truth=T_truth)
        for i, T in enumerate(estimate.transformations[1:]):
            values = {"transformation": T, "sigma": estimate.sigmas[i], "energy": estimate.energies[i], "fitness": 0.5}
            logger({"iteration_index": i, "inlier_rmse": 0.01, **values})

    path = save(tmp_path / "script.rrd", log)
    verify(path)
    times, T = poses(path, "iteration")
    np.testing.assert_array_equal(times, np.arange(ITERATIONS + 1))
    np.testing.assert_allclose(T, estimate.transformations, rtol=1e-6, atol=1e-6)
    sigmas = rows(path, "metrics/sigma", "Scalars:scalars", "iteration")
    np.testing.assert_allclose(np.ravel(sigmas.values), estimate.sigmas, rtol=1e-12, atol=0.0)
    for entity, n in (
        ("source", len(source.points)),
        ("initial/source", len(source.points)),
        ("target", len(target.points)),
    ):
        assert [len(p) for p in rows(path, f"world/{entity}/points", "Points3D:positions").values] == [n]
        assert [len(c) for c in rows(path, f"world/{entity}/points", "Shape:colors").values] == [n]
    assert len(RrdReader(path).blueprints()) == 1


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_callback_of_a_real_registration(tmp_path, kind):
    source, target = room_clouds()
    if kind == "tensor":
        source, target = (o3d.t.geometry.PointCloud.from_legacy(cloud) for cloud in (source, target))
    results = []

    def log(rec):
        logger = RegistrationLogger(rec, source, target, T_truth=room_pair().T_target_source)
        results.append(registration_adaptive_gmm(source, target, 0.1, callback_after_iteration=logger))

    path = save(tmp_path / "real.rrd", log)
    details = results[0].details
    times, T = poses(path, "iteration")
    assert times[0] == 0 and times[-1] == details.iterations
    np.testing.assert_allclose(T[-1], details.transformation, rtol=1e-5, atol=1e-5)
    sigmas = rows(path, "metrics/sigma", "Scalars:scalars", "iteration")
    np.testing.assert_allclose(sigmas.values[-1], details.sigma, rtol=1e-9, atol=0.0)
    degrees = rows(path, "metrics/rotation_error_deg", "Scalars:scalars", "iteration").values
    assert degrees[0][0] == pytest.approx(15.0, rel=1e-6, abs=0.0) and degrees[-1][0] < 1.0


def test_report_counts_partners_and_contradictions(tmp_path):
    estimate = known_estimate(off=(0.0, 0.2, -0.2))
    path = save(tmp_path / "off.rrd", lambda rec: log_pair(rec, room_pair(), *room_clouds(), estimate))
    (text,) = rows(path, "report", "TextDocument:text").values
    cells = [[cell.strip() for cell in line.split("|")] for line in text[0].splitlines() if "%" in line]
    shares = {cell[1]: int(cell[2].removesuffix("%")) for cell in cells}
    assert shares.pop("partners it believes in") == 70
    within, contradicted, hidden = shares.values()
    assert within < 50 and contradicted > 10 and within + contradicted + hidden == pytest.approx(100, rel=0, abs=1)


def test_verdict_follows_the_limits(tmp_path):
    estimate = known_estimate(off=(0.05, 0.0, 0.0))
    for millimetres, verdict in ((60.0, "✔ Registered"), (40.0, "× Failed")):
        path = save(
            tmp_path / f"{millimetres}.rrd",
            lambda rec, mm=millimetres: log_pair(
                rec, room_pair(), *room_clouds(), estimate, limits=Limits(translation_mm=mm)
            ),
        )
        (text,) = rows(path, "report", "TextDocument:text").values
        assert text[0].startswith(f"### {verdict}: 0.00° and 50 mm off")


def test_a_pair_that_was_not_registered_shows_its_start(tmp_path):
    def log(rec):
        assert log_pair(rec, room_pair(), *room_clouds(), None, status="failed", reason="no overlap") == 1

    path = save(tmp_path / "none.rrd", log)
    verify(path)
    (text,) = rows(path, "report", "TextDocument:text").values
    assert text[0].startswith("### × Failed: no overlap")
    (translation,) = rows(path, "world/source", "Transform3D:translation").values
    assert translation == [[0.0, 0.0, 0.0]]


def test_an_interrupted_run_leaves_no_half_written_file(tmp_path):
    with pytest.raises(RuntimeError, match="stop"), open_stream(arguments("--save", tmp_path / "x.rrd"), "x") as rec:
        log_pair(rec, room_pair(), *room_clouds(), known_estimate())
        raise RuntimeError("stop")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    path = tmp_path / "file" / "x.rrd"
    with pytest.raises(OutputError, match=f"^{path}: cannot be written"), open_stream(arguments("--save", path), "x"):
        pass


def test_eye_looks_at_what_there_is():
    target = np.asarray(room_clouds()[1].points)
    eye = Eye.around(target)
    towards = np.array(eye.look_target) - np.array(eye.position)
    directions = target - np.array(eye.position)
    cosines = directions @ towards / np.linalg.norm(directions, axis=1) / np.linalg.norm(towards)
    assert np.mean(cosines > np.cos(np.radians(35.0))) > 0.95


@pytest.mark.parametrize("aspect", [ASPECT, NARROW])
@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (6.0, -3.0, 2.0), (0.0, 0.0, -9.0)])
def test_the_eye_of_a_pair_sees_a_source_that_flew_off(off, aspect):
    source, target = (np.asarray(cloud.points) for cloud in room_clouds())
    clouds = [target, source + off]
    T = eye_pose(clouds, aspect)
    for cloud in clouds:
        x, y, z = ((cloud - T[:3, 3]) @ T[:3, :3]).T
        inside = (z > 0) & (np.abs(y) < np.tan(0.5 * FIELD_OF_VIEW) * z)
        assert np.mean(inside & (np.abs(x) < aspect * np.tan(0.5 * FIELD_OF_VIEW) * z)) > 0.85
