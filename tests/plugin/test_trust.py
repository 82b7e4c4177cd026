"""Whether a result knows if it is right: outcomes of kinds that mislead, with how many may be misjudged of each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from outcomes import misjudged, noisy, outcome, twist
from shapes import body_with_head, bumpy, move, rectangle

from adagmm_o3d import estimate_surface_covariances, register_points
from adagmm_o3d.lie import se_exp
from adagmm_o3d.mixtures.merging import sample
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.result import Verdict
from adagmm_o3d.trust.agreement import HELD, VAGUEST, Surface, agreement, surfaces_of
from adagmm_o3d.trust.copies import are_copies
from adagmm_o3d.trust.partners import partners_at
from adagmm_o3d.trust.scale import estimate_scale
from adagmm_o3d.trust.verdict import BETTER_IMAGE, NEAREST, TURNED, believe, signs


def box_with_knob(rng, n=800):
    """A box that only a knob near one end tells from itself half a turn on."""
    extent = np.array([2.0, 1.0, 0.4])
    areas = extent.prod() / extent
    axis = rng.choice(3, n, p=areas / areas.sum())
    points = rng.uniform(-0.5, 0.5, (n, 3)) * extent
    points[np.arange(n), axis] = rng.choice([-0.5, 0.5], n) * extent[axis]
    knob = rng.normal(size=(60, 3))
    knob *= 0.3 / np.linalg.norm(knob, axis=1, keepdims=True)
    knob[:, 2] = np.abs(knob[:, 2])
    return np.concatenate([points, knob + np.array([0.6, 0.2, 0.2])])


def part(rng, points, share):
    """The lower and the upper piece along a direction, of which this share of either lies in both."""
    kept = 1.0 / (2.0 - share)
    along = points @ rng.normal(size=3)
    upper, lower = np.quantile(along, (kept, 1.0 - kept))
    return points[along <= upper], points[along >= lower]


def seen_twice(rng, trial):
    dimension = 2 + trial % 2
    n = (120, 900)[trial % 2]
    T = twist(rng, dimension, rng.uniform(0.0, 0.3))
    return noisy(rng, body_with_head(rng, n, dimension)), move(noisy(rng, body_with_head(rng, n, dimension)), T), T


def shared_parts(rng, trial):
    low, high = part(rng, body_with_head(rng, 1800, 3), 0.6)
    T = twist(rng, 3, rng.uniform(0.0, 0.3))
    return noisy(rng, low[::2]), move(noisy(rng, high[1::2]), T), T


def biased(rng, trial):
    """Two sensors, of which each bends what it sees by a hundredth of the radius."""
    clouds = []
    for _ in range(2):
        points, waves = body_with_head(rng, 900, 3), rng.normal(size=(3, 3))
        clouds.append(noisy(rng, points + 0.01 * np.sin(points @ waves + rng.uniform(0.0, 6.0, 3))))
    T = twist(rng, 3, rng.uniform(0.0, 0.3))
    return clouds[0], move(clouds[1], T), T


def copies_of_few(rng, trial):
    points = rng.uniform(-1.0, 1.0, (4 + trial, 3))
    T = twist(rng, 3, rng.uniform(0.0, 0.2))
    return points, move(points, T), T


def halves(rng, trial):
    return *part(rng, noisy(rng, body_with_head(rng, 1200, 3)), 0.0), None


def half_a_turn_off(rng, trial):
    T = twist(rng, 3, 0.0, 0.02)
    T[:3, :3] = np.diag(-np.ones(3)) + 2.0 * np.outer(*[np.eye(3)[trial % 3]] * 2)
    return noisy(rng, box_with_knob(rng)), move(noisy(rng, box_with_knob(rng)), T), T


def outline_half_a_turn_off(rng, trial):
    T = twist(rng, 2, np.pi + rng.uniform(-0.2, 0.2))
    return noisy(rng, bumpy(rng, 120, 2)), move(noisy(rng, bumpy(rng, 120, 2)), T), T


def mirror(dimension):
    return np.diag([-1.0, 1.0, 1.0][:dimension])


def mirrored(rng, trial):
    dimension = 2 + trial % 2
    n = (120, 900)[trial % 2]
    source, target = (noisy(rng, body_with_head(rng, n, dimension)) for _ in range(2))
    T = twist(rng, dimension, rng.uniform(0.0, 0.3)) if trial >= 6 else np.eye(dimension + 1)
    return source, move(target @ mirror(dimension), T), None


def mirrored_but_for_a_tenth(rng, trial):
    """A body that is its own mirror image, but for a tenth of its points."""
    source, target = (
        np.concatenate([bumpy(rng, 900, 3), 0.3 * bumpy(rng, 90, 3) + np.array([1.0, 0.5, 0.3])]) for _ in range(2)
    )
    return noisy(rng, source), move(noisy(rng, target) @ mirror(3), twist(rng, 3, rng.uniform(0.0, 0.3))), None


def mirrored_and_more(rng, trial):
    """Of another size as well, or sheared."""
    more = (1.05 * np.eye(3), np.eye(3) + 0.05 * np.eye(3)[[1, 0, 2]] * [[1.0], [0.0], [0.0]])[trial % 2]
    source, target = (noisy(rng, body_with_head(rng, 900, 3)) for _ in range(2))
    return source, move(target @ mirror(3) @ more, twist(rng, 3, rng.uniform(0.0, 0.3))), None


def own_mirror_image(rng, trial):
    """Bodies of which the mirror image fits as well as they do, or better by chance."""
    dimension = 2 + trial % 2
    n = (60, 450)[trial % 2]
    clouds = []
    for _ in range(2):
        half = bumpy(rng, 2 * n, dimension)[:, ::-1]
        clouds.append(noisy(rng, np.concatenate([half[:n], half[n:] @ mirror(dimension)])))
    T = twist(rng, dimension, rng.uniform(0.0, 0.3))
    return clouds[0], move(clouds[1], T), T


def parts_of_own_mirror_image(rng, trial):
    """Parts of a body that is its own mirror image, of which the image shares more than they do."""
    direction = np.array([0.0, rng.normal(scale=0.3), 1.0])  # mostly across the plane of symmetry
    clouds = []
    for side in (1.0, -1.0):
        points = bumpy(rng, 1400, 3)
        clouds.append(noisy(rng, points[side * points @ direction > -0.25]))
    T = twist(rng, 3, rng.uniform(0.0, 0.2))
    return clouds[0], move(clouds[1], T), T


def another_size(rng, trial):
    T = twist(rng, 3, rng.uniform(0.0, 0.3))
    return noisy(rng, body_with_head(rng, 900, 3)), 1.05 * move(noisy(rng, body_with_head(rng, 900, 3)), T), None


def outline_of_another_size(rng, trial):
    """Of few points and of many: on a curve they are closer than what another size puts between the clouds."""
    n = (120, 400)[trial % 2]
    shape = (bumpy, body_with_head)[trial // 2 % 2]
    T = twist(rng, 2, rng.uniform(0.0, 0.3))
    return noisy(rng, shape(rng, n, 2)), 1.05 * move(noisy(rng, shape(rng, n, 2)), T), None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "trials", "silent", "alarms"),
    [
        (seen_twice, 8, 0, 0),
        (shared_parts, 4, 0, 0),
        (biased, 4, 0, 0),
        (copies_of_few, 8, 0, 0),
        (halves, 4, 0, 0),
        (half_a_turn_off, 6, 0, 1),
        (outline_half_a_turn_off, 6, 0, 0),
        (mirrored, 10, 0, 0),
        (mirrored_but_for_a_tenth, 4, 0, 0),
        (mirrored_and_more, 4, 0, 0),
        (own_mirror_image, 6, 0, 0),
        (parts_of_own_mirror_image, 4, 0, 0),
        (another_size, 4, 0, 0),
        (outline_of_another_size, 8, 0, 0),
    ],
    ids=lambda value: getattr(value, "__name__", str(value)),
)
def test_how_often_a_result_is_misjudged(kind, trials, silent, alarms):
    """At most so many wrong without a warning, and so many right with one."""
    wrong_and_silent, right_and_warned = misjudged(kind, trials)
    assert len(wrong_and_silent) <= silent, wrong_and_silent
    assert len(right_and_warned) <= alarms, right_and_warned


def test_another_size_is_said_with_its_factor():
    source, target, _ = another_size(np.random.default_rng([0, 16]), 0)
    result = outcome(source, target, None)[2]
    assert result.scale == pytest.approx(1.05, abs=0.005)
    assert any("1.05" in warning and "different sizes" in warning for warning in result.warnings)
    # whichever comes first
    assert outcome(target, source, None)[2].scale == pytest.approx(1.0 / 1.05, abs=0.005)


def shelf(rng):
    """Thin boards with things on them: near their many edges normals face any way."""
    boards = [((0, 0, 0.4 * k), (2.0, 0, 0), (0, 0.3, 0)) for k in range(4)]
    boards += [((x, 0, 0), (0, 0.3, 0), (0, 0, 1.2)) for x in (0.0, 0.7, 2.0)]
    for x, z, height in ((0.2, 0.0, 0.3), (1.0, 0.0, 0.2), (1.5, 0.4, 0.25), (0.3, 0.8, 0.3), (1.7, 0.8, 0.15)):
        sides = ((0.15, 0, 0), (0, 0.15, 0), (0, 0, height))
        for low in range(3):
            edges = [sides[i] for i in range(3) if i != low]
            corner = np.array([x, 0.05, z])
            boards += [(corner, *edges), (corner + sides[low], *edges)]
    return noisy(rng, np.concatenate([rectangle(rng, *board, density=250.0) for board in boards]))


@pytest.mark.parametrize("factor", [1.05, 1.1, 1.3, 0.8])
def test_sizes_that_differ_much_are_said_too(factor):
    """They went unsaid where few points faced as those next to them did, or points lay beyond each other's reach."""
    for seed in range(2):
        rng = np.random.default_rng([seed, 21])
        source, target = shelf(rng), factor * shelf(rng)
        pose = np.eye(4)
        pose[:3, 3] = target.mean(axis=0) - source.mean(axis=0) + 0.03
        scale = estimate_scale(Surface(source, 3), Surface(target, 3), pose, 3)
        assert scale.differs and scale.factor == pytest.approx(factor, rel=0.02)
        assert outcome(source, target, None)[2].warnings


@pytest.mark.parametrize("reach", [2.0, 1.5, 1.2])
def test_parts_of_one_size_are_not_said_to_differ(reach):
    for seed in range(3):
        rng = np.random.default_rng([seed, 22])
        source, target = shelf(rng), shelf(rng)
        result = outcome(source[source[:, 0] < reach], target[target[:, 0] > 2.0 - reach], None)[2]
        assert result.scale is None


def test_a_mirror_image_is_said_to_be_one():
    source, target, _ = mirrored_but_for_a_tenth(np.random.default_rng([0, 16]), 0)
    for result in (outcome(source, target, None)[2], outcome(target, source, None)[2]):
        assert any("mirror image" in warning for warning in result.warnings), result.warnings
        assert result.belief < 0.5


def test_one_size_is_not_said_to_differ():
    rng = np.random.default_rng(3)
    surfaces = [Surface(noisy(rng, bumpy(rng, 900, 3)), 3) for _ in range(2)]
    scale = estimate_scale(*surfaces, np.eye(4), 3)
    assert not scale.differs and scale.factor == pytest.approx(1.0, abs=0.01)
    # a third is too little to tell
    some = Surface(surfaces[0].points[surfaces[0].points[:, 0] > 0.3], 3)
    assert estimate_scale(surfaces[1], some, np.eye(4), 3) is None


def wall_with_boxes(rng, count, noise):
    points = np.column_stack([rng.uniform(-1.5, 1.5, count), rng.uniform(-1.0, 1.0, count), np.zeros(count)])
    boxes = np.random.default_rng(5)
    for _ in range(10):
        middle, half = boxes.uniform(-1.0, 1.0, 2) * (1.4, 0.9), boxes.uniform(0.1, 0.3, 2)
        points[(np.abs(points[:, :2] - middle) < half).all(axis=1), 2] = boxes.uniform(-0.08, 0.16)
    return points + rng.normal(0.0, noise, points.shape)


@pytest.mark.parametrize("noise", [0.012, 0.03])
def test_noise_does_not_pass_for_another_size(noise):
    """It took 1 to 4 % off where most surfaces face one way."""
    factors = []
    for seed in range(6):
        rng = np.random.default_rng([seed, 23])
        scale = estimate_scale(*(Surface(wall_with_boxes(rng, 1000, noise), 3) for _ in range(2)), np.eye(4), 3)
        assert not scale.differs
        factors.append(scale.factor)
    assert np.mean(factors) == pytest.approx(1.0, abs=0.008)


def test_surfaces_agree_where_they_meet():
    rng = np.random.default_rng(4)
    one, other = (Surface(noisy(rng, body_with_head(rng, 900, 3)), 3) for _ in range(2))
    right = agreement(one, other, np.eye(4))
    assert right.held > 0.9 and right.share > 0.9
    askew = agreement(one, other, se_exp(np.array([0.4, -0.3, 0.5, 0.05, 0.0, 0.0])))
    assert askew.held < 0.6 and askew.share < right.share
    # swapped it is the same
    swapped = agreement(other, one, np.eye(4))
    assert swapped == right


def test_what_lies_beyond_an_end_is_told_from_what_differs():
    rng = np.random.default_rng(8)
    whole = [bumpy(rng, 1400, 3) for _ in range(2)]
    parts = [
        Surface(noisy(rng, points[sign * points[:, 2] > -0.1]), 3) for points, sign in zip(whole, (1, -1), strict=True)
    ]
    shared = agreement(*parts, np.eye(4))
    # most of either is not shared, and takes nothing from what holds
    assert shared.beyond > 0.9 and shared.share < 0.5 and shared.held > 0.85
    bodies = [Surface(noisy(rng, body_with_head(rng, 900, 3)) @ flip, 3) for flip in (np.eye(3), np.diag([1, 1, -1]))]
    differing = agreement(*bodies, np.eye(4))
    assert differing.beyond < 0.4 and differing.held < 0.8
    # whichever comes first
    assert agreement(*bodies[::-1], np.eye(4)) == differing
    # clouds that are one have nothing beyond
    assert agreement(bodies[0], bodies[0], np.eye(4)).beyond == 0.0


def test_a_reflected_surface_is_that_of_the_reflected_points():
    rng = np.random.default_rng(10)
    points, flip = noisy(rng, body_with_head(rng, 600, 3)), np.diag([-1.0, 1.0, 1.0])
    target, image, made = Surface(points, 3), Surface(points, 3).reflected(flip), Surface(points @ flip, 3)
    assert agreement(image, target, np.eye(4)) == agreement(made, target, np.eye(4))
    np.testing.assert_array_equal(image.ends, made.ends)


def test_belief_grows_with_each_sign():
    least = np.array([np.log(0.5), TURNED[0], BETTER_IMAGE[0], NEAREST[0]])
    most = np.array([np.log(HELD[1]), TURNED[1], BETTER_IMAGE[1], NEAREST[1]])
    assert believe(least) < 0.05 and believe(most) > 0.95
    for sign in range(4):
        more = least.copy()
        more[sign] = most[sign]
        assert believe(more) > believe(least)


def test_rivals_count_by_the_nearest_and_an_image_that_does_better_against_the_pose():
    verdict = Verdict(1.0, share=0.9, held=0.95, margin=0.8)
    belief = believe(signs(verdict))
    # the mirror image is no rival where it is further off than what is turned
    assert believe(signs(replace(verdict, over_image=0.9))) == belief
    assert believe(signs(replace(verdict, over_image=0.2))) < belief
    assert believe(signs(replace(verdict, over_image=-0.3))) < believe(signs(replace(verdict, over_image=0.0)))
    assert believe(signs(replace(verdict, margin=-0.2, over_image=0.9))) < 0.5 < belief


def test_of_points_that_are_said_to_be_noisy_less_is_expected():
    rng = np.random.default_rng(9)
    covariances = np.where(rng.random(900) < 0.4, 9.0, 1.0)[:, None, None] * np.eye(3)
    noise = 0.03 * np.sqrt(covariances[:, :1, 0]) * rng.normal(size=(900, 3))
    clouds = [body_with_head(rng, 900, 3), body_with_head(rng, 900, 3) + noise]
    said = [None, covariances]
    mixtures = [make_mixture(name, *given) for name, *given in zip(("source", "target"), clouds, said, strict=True)]
    judged = surfaces_of(*(sample(mixture, 1000) for mixture in normalise(*mixtures)[:2]))
    plain = [Surface(surface.points, 3) for surface in judged]
    assert judged[0].vague.max() == 1.0 and judged[1].vague.max() == VAGUEST
    share, plain_share = (agreement(*pair, np.eye(4)).share for pair in (judged, plain))
    assert share > plain_share + 0.03


def mixtures_of(source, target):
    return normalise(*(make_mixture(name, points, None) for name, points in (("source", source), ("target", target))))


def test_copies_are_known_from_another_sample_and_a_lattice():
    rng = np.random.default_rng(5)
    points = rng.uniform(-1.0, 1.0, (60, 3)) * (1.0, 1.0, 0.0)
    source, target, _ = mixtures_of(points, points)
    assert are_copies(source, target, np.eye(4))
    assert not are_copies(source, target, se_exp(np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0])))
    source, target, _ = mixtures_of(points, rng.uniform(-1.0, 1.0, (60, 3)) * (1.0, 1.0, 0.0))
    assert not are_copies(source, target, np.eye(4))
    lattice = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0), [0.0]), axis=-1).reshape(-1, 3)
    source, target, _ = mixtures_of(lattice, lattice)
    assert not are_copies(source, target, np.eye(4))


@pytest.mark.parametrize("share", [1.0, 0.5, 0.2])
def test_overlap_is_what_is_shared(share):
    rng = np.random.default_rng(6)
    low, high = part(rng, bumpy(rng, 4000, 3), share)
    source, target, normalisation = mixtures_of(low[::2], high[1::2])
    partners = partners_at(source, target, normalisation.pose_in(np.eye(4)))
    # partners are found a little beyond the edge of what is shared
    assert share - 0.03 < partners.overlap < share + 0.08
    assert partners.overlap == pytest.approx(partners.row_weights.mean(), abs=1e-12)


def test_overlap_does_not_depend_on_the_start():
    source, target, T = shared_parts(np.random.default_rng(7), 0)
    covariances = [estimate_surface_covariances(cloud) for cloud in (source, target)]
    overlaps = [register_points(source, target, *covariances, init=init).overlap for init in (None, T, "global")]
    assert np.ptp(overlaps) < 0.01
