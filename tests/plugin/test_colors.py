"""Colours as further coordinates: they hold what the shape leaves free, and what is learnt of them is what was done."""

import re

import numpy as np
import open3d as o3d
import pytest

from adagmm_o3d import InputError, TransformationEstimationForAdaptiveGMM, register_points, registration_adaptive_gmm
from adagmm_o3d.errors import InputTypeError
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp
from adagmm_o3d.mixtures.colours import ColourModel, checked_colors, lab_of
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.trust.held_by_colour import free_of_colours

reg, treg = o3d.pipelines.registration, o3d.t.pipelines.registration
COLOURED = TransformationEstimationForAdaptiveGMM(color=True)


def painted(points):
    """(n, 3) colours of places on a wall, from 0.1 to 0.9."""
    u, v = points[:, 0], points[:, 1]
    waves = [np.sin(6.0 * u + 2.0 * v), np.sin(5.0 * v - 3.0 * u), np.sin(4.0 * (u + v))]
    return 0.5 + 0.4 * np.stack(waves, axis=1)


class Wall:
    """Two looks at a painted wall, which can slide and turn in its plane: only the paint holds it."""

    def __init__(self, n=900, seed=0):
        rng = np.random.default_rng(seed)
        wall = np.concatenate([rng.uniform(-1.0, 1.0, (2 * n, 2)), 0.002 * rng.normal(size=(2 * n, 1))], axis=1)
        self.T = se_exp(np.array([0.01, -0.02, 0.08, 0.1, -0.06, 0.02]))
        colors = painted(wall)
        self.target, self.target_colors = wall[:n], colors[:n]
        self.source, self.source_colors = (wall[n:] - self.T[:3, 3]) @ self.T[:3, :3], colors[n:]
        thin = np.tile(np.diag([1.0, 1.0, 1e-3]), (n, 1, 1))
        self.target_covariances, self.source_covariances = thin, self.T[:3, :3].T @ thin @ self.T[:3, :3]

    def arrays(self):
        return self.source, self.target, self.source_covariances, self.target_covariances

    def clouds(self):
        clouds = []
        for points, colors, covariances in (
            (self.source, self.source_colors, self.source_covariances),
            (self.target, self.target_colors, self.target_covariances),
        ):
            cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
            cloud.colors = o3d.utility.Vector3dVector(colors)
            cloud.covariances = o3d.utility.Matrix3dVector(covariances)
            clouds.append(cloud)
        return clouds


@pytest.fixture(scope="module")
def wall():
    return Wall()


def found(wall, transformation):
    errors = pose_errors(wall.T, np.asarray(transformation))
    return errors.rotation_deg < 0.5 and errors.translation < 0.01


def test_paint_holds_a_wall_that_the_shape_lets_slide(wall):
    plain = register_points(*wall.arrays())
    coloured = register_points(*wall.arrays(), source_colors=wall.source_colors, target_colors=wall.target_colors)
    assert not found(wall, plain.transformation)
    assert found(wall, coloured.transformation)
    assert plain.color is None and plain.color_support is None
    # nor is a wall, on which every scale fits, said to be of another size
    assert coloured.warnings == ()
    assert coloured.color.lying < 0.1
    np.testing.assert_allclose(coloured.color.gain, 1.0, rtol=0, atol=0.05)
    np.testing.assert_allclose(coloured.color.offset, 0.0, rtol=0, atol=2.0)
    assert np.nanmedian(coloured.color_support) > 0.5


def stripes(points):
    """(n, 3) grey that changes across the wall only."""
    return np.repeat(0.5 + 0.4 * np.sin(9.0 * points[:, :1]), 3, axis=1)


def grey(points):
    return np.full((len(points), 3), 0.5)


@pytest.mark.parametrize(("paint", "free"), [(painted, 0), (stripes, 1), (grey, 3)])
def test_what_colours_hold_is_not_said_to_be_free(wall, paint, free):
    """A wall can slide two ways and turn; stripes hold all but the way along them, one colour holds nothing."""
    rng = np.random.default_rng(1)
    places = wall.source @ wall.T[:3, :3].T + wall.T[:3, 3], wall.target
    seen = [np.clip(paint(points) + 0.03 * rng.normal(size=(len(points), 3)), 0.0, 1.0) for points in places]
    method = TransformationEstimationForAdaptiveGMM(color=True, start="init", search=False)
    result = register_points(
        *wall.arrays(), init=wall.T, estimation_method=method, source_colors=seen[0], target_colors=seen[1]
    )
    assert len(result.unobservable) == free
    assert any("free" in text for text in result.warnings) == bool(free)
    if free == 1:
        assert abs(result.unobservable[0][4]) > 0.98  # a shift along the stripes
        assert np.sqrt(result.pose_covariance[4, 4]) > 0.5 > 10.0 * np.sqrt(result.pose_covariance[3, 3])


@pytest.mark.parametrize(("slid", "left"), [(0.0, 0), (0.5, 3)])
def test_colours_hold_nothing_where_the_pose_is_wrong(wall, slid, left):
    """However rich they are: on the way from a wrong place they get no worse."""
    mixtures = [
        make_mixture("cloud", points, covariances).coloured(lab_of(colors))
        for points, covariances, colors in (
            (wall.source, wall.source_covariances, wall.source_colors),
            (wall.target, wall.target_covariances, wall.target_colors),
        )
    ]
    T = se_exp(np.array([0.0, 0.0, 0.3 * slid, slid, -slid, 0.0])) @ wall.T
    colour = ColourModel(np.full(3, 10.0), np.ones(3), np.zeros(3), 0.1, 2.0, 0.2)
    in_plane = np.eye(6)[2:5]
    assert len(free_of_colours(*mixtures, T, colour, in_plane, np.ones(len(wall.source)))) == left


@pytest.mark.parametrize("kind", ["legacy", "tensor float32", "tensor uint8", "tensor intensity"])
def test_open3ds_method_for_coloured_icp_is_taken_for_color(wall, kind):
    clouds, method = wall.clouds(), reg.TransformationEstimationForColoredICP()
    if kind == "legacy":
        expected = registration_adaptive_gmm(*clouds, 0.1, np.eye(4), COLOURED).transformation
    else:
        method = treg.TransformationEstimationForColoredICP()
        clouds = [o3d.t.geometry.PointCloud.from_legacy(cloud) for cloud in clouds]
        for cloud in clouds:
            if kind == "tensor uint8":
                cloud.point.colors = (cloud.point.colors * 255.0).round().to(o3d.core.uint8)
            elif kind == "tensor intensity":
                # one channel with all the paint in it, as a reflectance from 0 to 65535
                cloud.point.intensity = cloud.point.colors.mean(dim=[1], keepdim=True) * 65535.0
                del cloud.point.colors
        expected = None
    # Open3D's registration_colored_icp with the name changed
    result = registration_adaptive_gmm(*clouds, 0.1, np.eye(4), method, reg.ICPConvergenceCriteria(max_iteration=60))
    pose = result.transformation if kind == "legacy" else result.transformation.numpy()
    assert found(wall, pose)
    if expected is not None:
        np.testing.assert_allclose(result.transformation, expected, rtol=0, atol=5e-3)


def test_colours_that_nobody_asked_for_change_no_bit(wall):
    clouds = wall.clouds()
    bare = wall.clouds()
    for cloud in bare:
        cloud.colors = o3d.utility.Vector3dVector()
    results = [registration_adaptive_gmm(*pair, 0.1).transformation for pair in (clouds, bare)]
    np.testing.assert_array_equal(*results)


def test_what_one_sensor_makes_of_the_others_colours_is_learnt(wall):
    darker = (0.6 * wall.source_colors) ** 1.1
    result = register_points(*wall.arrays(), source_colors=darker, target_colors=wall.target_colors)
    assert found(wall, result.transformation)
    seen, wanted = lab_of(darker), lab_of(painted(wall.source @ wall.T[:3, :3].T + wall.T[:3, 3]))
    corrected = result.color.gain * seen + result.color.offset
    assert np.abs(corrected - wanted).mean() < 0.5 * np.abs(seen - wanted).mean()


@pytest.mark.parametrize(("gain", "offset"), [(0.6, 0.1), (1.0 / 0.6, -0.1 / 0.6)])
def test_other_exposures_are_learnt(wall, gain, offset):
    colors = np.clip(gain * wall.source_colors + offset, 0.0, 1.0)
    result = register_points(*wall.arrays(), source_colors=colors, target_colors=wall.target_colors)
    assert found(wall, result.transformation)
    assert (result.color.gain > 1.2).all() if gain < 1.0 else (result.color.gain < 1.0).all()


@pytest.mark.parametrize("unit", [(1.0, 1.0), (0.01, 60.0), (65535.0, 0.6)])
def test_intensities_may_be_in_different_units(wall, unit):
    brightness = [colors.mean(axis=1) for colors in (wall.source_colors, wall.target_colors)]
    result = register_points(
        *wall.arrays(), source_colors=unit[0] * brightness[0], target_colors=unit[1] * brightness[1]
    )
    assert found(wall, result.transformation)


def looks(n=1000):
    """Two looks at the corner of a room of three sizes, and which pose brings the first to the second."""
    rng = np.random.default_rng(4)
    points = rng.uniform(-1.0, 1.0, (2 * n, 3))
    points[np.arange(2 * n), rng.integers(0, 3, 2 * n)] = -1.0
    points = points * (1.3, 1.0, 0.7) + 0.003 * rng.normal(size=points.shape)
    T = se_exp(np.array([0.01, -0.02, 0.08, 0.1, -0.06, 0.02]))
    return points[:n], points[n:], T


@pytest.mark.parametrize("kind", ["grey", "black", "white beside grey", "no intensity", "nearly grey", "inverted"])
def test_colours_that_tell_nothing_cost_nothing(kind):
    """Where the shape holds the pose, no worse than without them by half a standard deviation."""
    source, target, T = looks()
    rng = np.random.default_rng(5)
    grey, some = np.full(source.shape, 0.5), [0.5 + 0.02 * rng.normal(size=source.shape) for _ in range(2)]
    colors = {
        "grey": (grey, grey),
        "black": (0.0 * grey, 0.0 * grey),
        "white beside grey": (2.0 * grey, grey),
        "no intensity": (np.zeros(len(source)), np.zeros(len(target))),
        "nearly grey": tuple(some),
        "inverted": (1.0 - painted(source), painted(target)),
    }[kind]
    source = (source - T[:3, 3]) @ T[:3, :3]
    plain = register_points(source, target)
    result = register_points(source, target, source_colors=colors[0], target_colors=colors[1])
    assert result.warnings == ()
    errors, before = pose_errors(T, result.transformation), pose_errors(T, plain.transformation)
    deviations = np.sqrt(np.diag(plain.pose_covariance))
    assert errors.rotation_deg < before.rotation_deg + 0.5 * np.degrees(np.linalg.norm(deviations[:3]))
    assert errors.translation < before.translation + 0.5 * np.linalg.norm(deviations[3:])


def test_the_share_of_colours_that_lie_is_learnt(wall):
    rng = np.random.default_rng(5)
    colors = wall.source_colors.copy()
    lying = rng.random(len(colors)) < 0.25
    colors[lying] = rng.random((lying.sum(), 3))
    result = register_points(*wall.arrays(), source_colors=colors, target_colors=wall.target_colors)
    assert found(wall, result.transformation)
    assert 0.1 < result.color.lying < 0.35
    support = result.color_support
    assert np.nanmedian(support[lying]) < 0.0 < np.nanmedian(support[~lying])


def test_colours_help_in_the_plane_too():
    rng = np.random.default_rng(3)
    angle, points = 0.1, rng.uniform(-1.0, 1.0, (600, 2))
    colors = painted(np.column_stack([points, np.zeros(len(points))]))
    R, t = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]), np.array([0.05, -0.1])
    source, target = (points[:300] - t) @ R, points[300:]
    result = register_points(source, target, source_colors=colors[:300], target_colors=colors[300:])
    np.testing.assert_allclose(result.transformation[:2, :2], R, rtol=0, atol=0.01)
    np.testing.assert_allclose(result.transformation[:2, 2], t, rtol=0, atol=0.02)


def test_colours_that_overshoot_are_cut_off(wall):
    lowest, highest = wall.source_colors.min(), wall.source_colors.max()
    seen = 1.08 * (wall.source_colors - lowest) / (highest - lowest) - 0.04
    kept = np.full(len(seen), True), np.full(len(wall.target_colors), True)
    for given in (seen, np.clip(seen, 0.0, 2.0)):
        cut, _ = checked_colors(given, wall.target_colors, kept)
        expected, _ = checked_colors(np.clip(seen, 0.0, 1.0), wall.target_colors, kept)
        np.testing.assert_array_equal(cut, expected)
    for wrong, words in ((1.06, r"0 to 1, got 1\.06; divide by 255"), (-0.06, r"at least 0, got -0\.06")):
        with pytest.raises(InputError, match=rf"^source\.colors: expected .*{words}"):
            checked_colors(np.full((5, 3), wrong), np.ones((5, 3)), (kept[0][:5], kept[1][:5]))
    with pytest.raises(InputError, match=r"at least 0, got -0\.01"):
        checked_colors(np.full(5, -0.01), np.ones(5), (kept[0][:5], kept[1][:5]))


@pytest.mark.parametrize(
    ("source", "target", "error", "words"),
    [
        (None, "same", InputError, "source.colors: expected one for each of the points as the other cloud has them"),
        ("same", None, InputError, "target.colors: expected one for each of the points as the other cloud has them"),
        (255.0, "same", InputError, "source.colors: expected 0 to 1, got 2"),
        (-1.0, "same", InputError, "source.colors: expected numbers of at least 0, got -0.9"),
        ("short", "same", InputError, "source.colors: expected shape (900, 3 or 1), got (899, 3)"),
        ("two", "same", InputError, "source.colors: expected shape (900, 3 or 1), got (900, 2)"),
        ("nan", "same", InputError, "source.colors: expected finite numbers, got nan at index (7, 1)"),
        ("words", "same", InputTypeError, "source.colors: expected an array of real numbers, got"),
        ("same", "grey", InputError, "target.colors: expected colours as the source has, got intensities"),
    ],
)
def test_what_is_wrong_with_colours_is_said(wall, source, target, error, words):
    def made(what, colors):
        if isinstance(what, float):
            return what * colors
        bad = colors.copy()
        bad[7, 1] = np.nan
        return {
            None: None,
            "same": colors,
            "short": colors[1:],
            "two": colors[:, :2],
            "nan": bad,
            "words": np.full(colors.shape, "red"),
            "grey": colors[:, 0],
        }[what]

    with pytest.raises(error, match=re.escape(words)):
        register_points(
            *wall.arrays(),
            source_colors=made(source, wall.source_colors),
            target_colors=made(target, wall.target_colors),
        )


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_a_cloud_without_the_colours_that_are_asked_for_is_refused(wall, kind):
    clouds = wall.clouds()
    clouds[1].colors = o3d.utility.Vector3dVector()
    if kind == "tensor":
        clouds = [o3d.t.geometry.PointCloud.from_legacy(cloud) for cloud in clouds]
    with pytest.raises(InputError, match=r"target\.colors: expected one for each of the points"):
        registration_adaptive_gmm(*clouds, 0.1, np.eye(4), COLOURED)
    with pytest.raises(InputError, match=r"source\.colors: expected one for each of the points as color is on"):
        register_points(wall.source, wall.target, estimation_method=COLOURED)


def test_lab_is_that_of_the_standard():
    # Reference values of sRGB's corners (D65, two degrees), to the digits they are published with.
    rgb = np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    lab = [[100, 0, 0], [0, 0, 0], [53.24, 80.09, 67.20], [87.73, -86.18, 83.18], [32.30, 79.19, -107.86]]
    np.testing.assert_allclose(lab_of(rgb), lab, rtol=0, atol=0.05)
