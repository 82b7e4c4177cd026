"""Pairs that a careful user might try: what repeats itself, what has no hold, what is alike and not the same."""

import numpy as np
import pytest
from outcomes import misjudged, noisy, twist
from shapes import body_with_head, bumpy, move

from adagmm_o3d.lie import se_exp


def box(rng, n, extent, centre=(0.0, 0.0, 0.0)):
    """(n, 3) on the faces of a box by their areas; a plate where an extent is 0."""
    extent = np.array(extent, dtype=float)
    areas = np.array([np.delete(extent, axis).prod() for axis in range(3)])
    axis = rng.choice(3, n, p=areas / areas.sum())
    points = rng.uniform(-0.5, 0.5, (n, 3))
    points[np.arange(n), axis] = rng.choice([-0.5, 0.5], n)
    return points * extent + np.array(centre)


def cylinder(rng, n, radius, height):
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-0.5, 0.5, n) * height])


def upright(angle, shift=(0.0, 0.0, 0.0)):
    return se_exp(np.array([0.0, 0.0, angle, 0.0, 0.0, 0.0])) + np.pad(np.array([shift]).T, ((0, 1), (3, 0)))


def seen_twice(rng, make, T):
    return noisy(rng, make()), move(noisy(rng, make()), T), T


def room(rng, things):
    """A floor of two by two, four walls, and boxes on it."""
    walls = [box(rng, 500, (2, 0, 1.2), (0, y, 0.6)) for y in (-1, 1)]
    walls += [box(rng, 500, (0, 2, 1.2), (x, 0, 0.6)) for x in (-1, 1)]
    return np.concatenate([box(rng, 700, (2, 2, 0)), *walls, *(box(rng, 60, *thing) for thing in things)])


def square_room(rng, trial):
    """Furnished, started quarter turns off."""
    things = [(rng.uniform(0.1, 0.4, 3), (*rng.uniform(-0.8, 0.8, 2), 0.2)) for _ in range(4)]
    return seen_twice(rng, lambda: room(rng, things), upright(0.5 * np.pi * trial) @ twist(rng, 3, 0.08))


def empty_square_room(rng, trial):
    """Which of four turns is right nobody can know."""
    return *seen_twice(rng, lambda: room(rng, []), upright(0.5 * np.pi) @ twist(rng, 3, 0.08))[:2], None


def corridor(rng, trial):
    """That slides along itself."""

    def make():
        walls = [box(rng, 800, (6, 0, 2), (0, y, 1)) for y in (-0.75, 0.75)]
        return np.concatenate([box(rng, 700, (6, 1.5, 0)), *walls])

    return *seen_twice(rng, make, twist(rng, 3, 0.05, 0.02) @ upright(0.0, (0.8, 0.0, 0.0)))[:2], None


def stairs(rng, trial):
    """A step or two off, of which each sees a part."""

    def make(keep):
        steps = [box(rng, 160, (0.3, 1.2, 0), (0.3 * i, 0, 0.2 * i)) for i in range(8)]
        steps += [box(rng, 110, (0, 1.2, 0.2), (0.3 * i + 0.15, 0, 0.2 * i + 0.1)) for i in range(8)]
        points = np.concatenate(steps)
        return noisy(rng, points[keep(points[:, 0])])

    T = twist(rng, 3, 0.05, 0.01) @ upright(0.0, (0.3 * (1 + trial % 2), 0.0, 0.2 * (1 + trial % 2)))
    return make(lambda x: x < 1.8), move(make(lambda x: x > 0.2), T), T


def shelf_with_books(rng, trial):
    """A board off, or none."""
    books = [(rng.uniform(0.05, 0.2), rng.uniform(0.15, 0.28), x, z) for z in range(4) for x in (-0.8, -0.4, 0.0, 0.4)]

    def make():
        boards = [box(rng, 300, (2, 0.4, 0), (0, 0, 0.35 * z)) for z in range(5)]
        backs = [box(rng, 40, (w, 0.2, h), (x, 0, 0.35 * z + h / 2)) for w, h, x, z in books]
        return np.concatenate([*boards, box(rng, 700, (2, 0, 1.4), (0, 0.2, 0.7)), *backs])

    return seen_twice(rng, make, twist(rng, 3, 0.05, 0.01) @ upright(0.0, (0.0, 0.0, 0.35 * (trial - 1))))


def mugs(rng, trial):
    """That a handle alone tells apart, half a turn or less off."""

    def make():
        handle = cylinder(rng, 140, 0.2, 0.1)[:, [2, 0, 1]] + (0.65, 0.0, 0.0)
        return np.concatenate([cylinder(rng, 900, 0.5, 1.2), box(rng, 200, (0.7, 0.7, 0), (0, 0, -0.6)), handle])

    return seen_twice(rng, make, upright(rng.uniform(1.0, np.pi)) @ twist(rng, 3, 0.05))


def three_arms(rng, trial):
    """That are the same a third of a turn on."""

    def make():
        arms = box(rng, 900, (1.6, 0.3, 0.2), (0.6, 0.0, 0.0))
        return np.concatenate([move(arms[i::3], upright(2.0 * np.pi / 3.0 * i)) for i in range(3)])

    return *seen_twice(rng, make, upright(2.0 * np.pi / 3.0) @ twist(rng, 3, 0.08))[:2], None


def boxes_of_other_sides(rng, trial):
    extent = rng.uniform(0.5, 2.0, 3)
    other = extent * np.array([1.25, 0.9, 0.8])[rng.permutation(3)]
    return noisy(rng, box(rng, 1000, extent)), move(noisy(rng, box(rng, 1000, other)), twist(rng, 3, 0.2)), None


def cylinder_and_box(rng, trial):
    return (
        noisy(rng, cylinder(rng, 1000, 0.5, 2.0)),
        move(noisy(rng, box(rng, 1000, (0.9, 0.9, 2))), twist(rng, 3, 0.2)),
        None,
    )


def round_shapes(rng, trial):
    """Spheres, cylinders, plates: what they leave free nobody can know."""

    def sphere():
        directions = rng.normal(size=(800, 3))
        return directions / np.linalg.norm(directions, axis=1, keepdims=True)

    make = (sphere, lambda: cylinder(rng, 800, 0.4, 2.0), lambda: box(rng, 800, (2, 1.5, 0)))[trial % 3]
    return *seen_twice(rng, make, twist(rng, 3, 0.2))[:2], None


def few_strangers(rng, trial):
    return bumpy(rng, 40, 3), box(rng, 40, (1.5, 1.0, 0.6)), None


def points_given_several_times(rng, trial):
    source, target, T = seen_twice(rng, lambda: body_with_head(rng, 700, 3), twist(rng, 3, 0.2))
    return source[rng.integers(0, 700, 2500)], target[rng.integers(0, 700, 1500)], T


@pytest.mark.parametrize(
    ("kind", "trials", "alarms"),
    [
        (square_room, 4, 1),
        (empty_square_room, 2, 0),
        (corridor, 2, 0),
        (stairs, 2, 0),
        (shelf_with_books, 3, 0),
        (mugs, 3, 0),
        (three_arms, 2, 0),
        (boxes_of_other_sides, 3, 0),
        (cylinder_and_box, 2, 0),
        (round_shapes, 3, 0),
        (few_strangers, 3, 0),
        (points_given_several_times, 2, 0),
    ],
    ids=lambda value: getattr(value, "__name__", str(value)),
)
def test_nothing_wrong_is_silent(kind, trials, alarms):
    """And at most so many right ones have a warning."""
    silent, right_and_warned = misjudged(kind, trials)
    assert silent == []
    assert len(right_and_warned) <= alarms, right_and_warned
