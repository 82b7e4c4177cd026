"""Clouds that lie on the device, in the simulator: the same mixtures, errors, tiles and scores as from the host."""

import numpy as np
import pytest
from mixtures import random_colours, random_points_and_covariances, random_pose

from adagmm_o3d import estimate_surface_covariances, mark_outliers
from adagmm_o3d.errors import AdaGMMError
from adagmm_o3d.kernels.cuda.front_end import TILE, cuda
from adagmm_o3d.kernels.limits import KNN
from adagmm_o3d.mixtures.device_mixture import DeviceMixture, device_mixture
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.pairs import cuda_pairs
from adagmm_o3d.pairs.cpu_pairs import PairLoop
from adagmm_o3d.pairs.cuda_sides import make_side
from adagmm_o3d.trust.pose_covariance import Fit, score_moments
from adagmm_o3d.uncertainty.surface import stand_in_covariances

# More tiles than a block looks at at a time.
SIZES = (TILE * TILE + 3, 50)


@pytest.fixture(autouse=True)
def few_blocks(monkeypatch):
    monkeypatch.setattr(cuda_pairs, "WANTED_BLOCKS", 1)


def clouds(seed, isotropic=False, dtype=np.float64):
    rng = np.random.default_rng(seed)
    pairs = [random_points_and_covariances(rng, n, 3, isotropic=isotropic) for n in SIZES]
    return [(points.astype(dtype), covariances.astype(dtype)) for points, covariances in pairs]


def full(seed):
    return clouds(seed)


def narrow(seed):
    return clouds(seed, dtype=np.float32)


def round_ones(seed):
    return clouds(seed, isotropic=True)


def thin(seed):
    """Some covariances thinner than float32 can tell, and one that is not quite symmetric."""
    both = clouds(seed)
    for _, covariances in both:
        axes = np.linalg.qr(covariances[0])[0]
        covariances[:10] = (axes * (1e-9, 0.5, 1.0)) @ axes.T
        covariances[20, 0, 1] *= 1.0 + 1e-7
    return both


def singular(seed):
    """Some covariances flat, some needles, some below zero by rounding, and some zero."""
    both = clouds(seed)
    for _, covariances in both:
        axes = np.linalg.qr(covariances[0])[0]
        for k, variances in enumerate([(0.0, 0.5, 1.0), (0.0, 0.0, 1.0), (-1e-6, 1e-7, 1.0), (0.0, 0.0, 0.0)]):
            covariances[7 * k : 7 * k + 7] = (axes * variances) @ axes.T
    return both


def zero_beside_round_ones(seed):
    both = round_ones(seed)
    for _, covariances in both:
        covariances[::5] = 0.0
    return both


def flagged(seed):
    return [(p, mark_outliers(c, np.arange(len(p)) % 9 == 0)) for p, c in clouds(seed)]


def far_away(seed):
    return [(points + np.array([1e5, -3e5, 10.0]), covariances) for points, covariances in clouds(seed)]


def on_both(pairs):
    """The mixtures of the host and those of the device."""
    names = ("source", "target")
    host = [make_mixture(name, *pair) for name, pair in zip(names, pairs, strict=True)]
    device = [device_mixture(name, *map(cuda.to_device, pair)) for name, pair in zip(names, pairs, strict=True)]
    return host, device


@pytest.fixture
def no_points_on_the_host(monkeypatch):
    """Whoever asks for all the points of a cloud on the device fails."""

    def refuse(self):
        raise AssertionError("all points were copied to the host")

    monkeypatch.setattr(DeviceMixture, "_everything", property(refuse))


@pytest.mark.parametrize("make", [full, narrow, round_ones, thin, singular, zero_beside_round_ones, flagged, far_away])
def test_mixtures_and_normalisation_are_those_of_the_host(make):
    host, device = on_both(make(1))
    for a, b in zip(host, device, strict=True):
        same_mixture(b, a)
    *host, expected = normalise(*host)
    *device, normalisation = normalise(*device)
    np.testing.assert_allclose(normalisation.source_centre, expected.source_centre, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(normalisation.target_centre, expected.target_centre, rtol=1e-12, atol=1e-12)
    sizes = [normalisation.scale, normalisation.variance]
    np.testing.assert_allclose(sizes, [expected.scale, expected.variance], rtol=1e-10, atol=0)
    for a, b in zip(host, device, strict=True):
        same_mixture(b, a)


def same_mixture(mixture, expected):
    assert len(mixture) == len(expected) and mixture.isotropic == expected.isotropic
    np.testing.assert_array_equal(mixture.kept, expected.kept)
    assert mixture.regularised == expected.regularised
    np.testing.assert_allclose(mixture.points, expected.points, rtol=1e-9, atol=1e-9)
    largest = np.abs(expected.covariances).max()
    np.testing.assert_allclose(mixture.covariances, expected.covariances, rtol=1e-9, atol=1e-13 * largest)
    # a thin covariance keeps nine digits of its least variance, and the mean is a third power
    np.testing.assert_allclose(mixture.variances, expected.variances, rtol=1e-8, atol=0)


@pytest.mark.parametrize("make", [full, narrow, round_ones, flagged])
def test_tiles_are_those_of_the_host(make):
    host, device = on_both(make(2))
    host, device = normalise(*host)[:2], normalise(*device)[:2]
    for a, b in zip(host, device, strict=True):
        expected, side = make_side(a, a.isotropic), make_side(b, a.isotropic)
        np.testing.assert_array_equal(side.order, expected.order)
        np.testing.assert_array_equal(side.restore(np.arange(len(b))), expected.restore(np.arange(len(b))))
        for what in ("precision_tiles", "covariance_tiles", "amplitude_tiles", "weight_tiles"):
            got, wanted = (getattr(s, what)().copy_to_host() for s in (side, expected))
            np.testing.assert_allclose(got, wanted, rtol=1e-6, atol=1e-6 * np.abs(wanted).max())
        got, wanted = side.boxes.copy_to_host(), expected.boxes.copy_to_host()
        np.testing.assert_allclose(got, wanted, rtol=1e-6, atol=1e-6)


def test_isotropic_covariances_beside_others_are_matrices_too():
    (points, covariances), other = round_ones(3)[0], full(3)[1]
    host, device = on_both([(points, covariances), other])
    expected, side = (make_side(normalise(*pair)[0], False) for pair in (host, device))
    got, wanted = side.precision_tiles().copy_to_host(), expected.precision_tiles().copy_to_host()
    np.testing.assert_allclose(got, wanted, rtol=1e-6, atol=1e-6)


def test_points_that_or_whose_covariances_are_not_finite_are_left_out():
    rng = np.random.default_rng(4)
    points, covariances = random_points_and_covariances(rng, 120, 3, isotropic=False)
    points[[3, 90], [0, 2]], covariances[17, 1, 2] = (np.nan, np.inf), np.nan
    same_mixture(
        device_mixture("source", cuda.to_device(points), cuda.to_device(covariances)),
        make_mixture("source", points, covariances),
    )


def spoil(n=60, **changes):
    rng = np.random.default_rng(5)
    points, covariances = random_points_and_covariances(rng, n, 3, isotropic=False)
    for what, (index, value) in changes.items():
        (points if what == "points" else covariances)[index] = value
    return points, covariances


SPOILED = {
    "no point that is finite": spoil(points=((slice(None), 1), np.inf)),
    "two points that are finite": spoil(points=((slice(58), 0), np.nan)),
    "too many covariances that are not finite": spoil(covariances=(([2, 5], 0, 0), np.nan)),
    "a crooked covariance": spoil(covariances=((8, 0, 1), 9.0)),
    "an indefinite covariance": spoil(covariances=((9, 0, 0), -1.0)),
    "a covariance with a slightly negative eigenvalue": spoil(covariances=(9, np.diag([1.0, 1.0, -1e-4]))),
    "no covariance": spoil(covariances=(slice(None), 0.0)),
    "two points": spoil(2),
    "many points on a line": spoil(points=((slice(None), slice(1, None)), 2.0)),
    "few points on a line": spoil(9, points=((slice(None), slice(1, None)), 2.0)),
    "many points in one place": spoil(points=(slice(None), 1e3)),
    "a coordinate too large": spoil(points=((4, 2), 1e150)),
    "an extent too small": tuple(a * f for a, f in zip(spoil(), (1e-150, 1.0), strict=True)),
}


@pytest.mark.parametrize("what", SPOILED)
def test_what_is_refused_is_refused_with_the_same_words(what):
    points, covariances = SPOILED[what]
    with pytest.raises(AdaGMMError) as expected:
        make_mixture("target", points, covariances)
    with pytest.raises(type(expected.value)) as caught:
        device_mixture("target", cuda.to_device(points), cuda.to_device(covariances))
    assert str(caught.value) == str(expected.value)


@pytest.mark.parametrize(
    ("points", "covariances", "message"),
    [
        ((9, 2), None, r"target.points: expected shape \(9, 3\), got \(9, 2\)"),
        ((9,), None, r"target.points: expected shape \(9, 3\), got \(9,\)"),
        ((0, 3), None, "target.points: the cloud is empty"),
        ((9, 3), (9, 9), r"target.covariances: expected shape \(9, 3, 3\), got \(9, 9\)"),
        ((9, 3), (8, 3, 3), r"target.covariances: expected shape \(9, 3, 3\), got \(8, 3, 3\)"),
    ],
)
def test_arrays_of_the_wrong_shape_are_refused(points, covariances, message):
    given = None if covariances is None else cuda.to_device(np.ones(covariances))
    with pytest.raises(AdaGMMError, match=message):
        device_mixture("target", cuda.to_device(np.ones(points)), given)


def surface_points(n):
    rng = np.random.default_rng(n)
    points = rng.normal(size=(n, 3))
    points[:, 2] = 0.3 * np.sin(2.0 * points[:, 0]) + 0.01 * rng.normal(size=n)
    return points


def two_lines():
    points = np.zeros((2 * KNN + 4, 3))
    points[:, 0] = np.arange(len(points)) % (KNN + 2)
    points[KNN + 2 :, 1:] = 1e3
    return points


@pytest.mark.parametrize("points", [surface_points(2 * TILE * TILE + 5), surface_points(KNN - 3), two_lines()])
def test_covariances_of_the_surface_are_those_of_the_host(points):
    expected = make_mixture("source", points, estimate_surface_covariances(points))
    mixture = device_mixture("source", cuda.to_device(points), None)
    np.testing.assert_allclose(mixture.covariances, expected.covariances, rtol=0, atol=1e-8)
    np.testing.assert_allclose(mixture.variances, expected.variances, rtol=1e-9, atol=0)


def test_a_surface_needs_four_points():
    points = surface_points(3)
    with pytest.raises(AdaGMMError) as expected:
        stand_in_covariances(points, name="source.points")
    with pytest.raises(type(expected.value)) as caught:
        device_mixture("source", cuda.to_device(points), None)
    assert str(caught.value) == str(expected.value)


@pytest.mark.parametrize("coloured", [False, True])
@pytest.mark.parametrize(("make", "mutuality"), [(full, 0.0), (full, 0.5), (round_ones, 0.3), (flagged, 0.5)])
def test_scores_are_those_of_the_host(make, mutuality, coloured, no_points_on_the_host):
    host, device = on_both(make(6))
    model = None
    if coloured:
        colours, model = random_colours(*SIZES)
        host, device = ([m.coloured(c) for m, c in zip(pair, colours, strict=True)] for pair in (host, device))
    host, device = normalise(*host)[:2], normalise(*device)[:2]
    pose = random_pose(np.random.default_rng(6), 3, angle=0.2, distance=0.1)
    # so small a σ that most tiles are out of each other's reach
    fit = Fit(pose, 2e-3, 0.2, mutuality, model)
    expected = score_moments(PairLoop(*host), *host, fit)
    scores = score_moments(cuda_pairs.CudaPairLoop(*device), *device, fit)
    for what in ("curvature", "by_points", "by_blocks", "matched"):
        wanted = getattr(expected, what)
        np.testing.assert_allclose(getattr(scores, what), wanted, rtol=1e-4, atol=1e-5 * np.abs(wanted).max())
