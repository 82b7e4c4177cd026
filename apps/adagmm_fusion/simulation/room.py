"""The simulated living room: fixed furniture, and what moves between the pairs of a recording.

World frame: z up, metres, floor at z = 0; the sensors stand near y = 0 and look along +y.
"""

import numpy as np

from adagmm_fusion.simulation.parts import Box, Ellipsoid, Lathe, Part, Shape, at, cylinder
from adagmm_fusion.simulation.textures import (
    Texture,
    abstract_painting,
    beach_ball,
    book,
    bricks,
    carton,
    clock_face,
    fabric,
    foliage,
    globe,
    landscape,
    plain,
    planks,
    plaster,
    rug,
    stripes,
    wallpaper,
    wood,
)

WIDTH, DEPTH, HEIGHT = 4.6, 4.2, 2.6
LIGHT_CENTER = np.array([0.1, 1.9, HEIGHT - 0.08])
LIGHT_SIZE = (1.1, 0.5)

OAK = ([0.36, 0.21, 0.10], [0.62, 0.42, 0.24])
WALNUT = ([0.17, 0.09, 0.05], [0.36, 0.21, 0.12])
PINE = ([0.66, 0.47, 0.27], [0.86, 0.70, 0.46])


def furnish(seed: int, pair_index: int) -> list[Part]:
    """The room while one pair is taken: what stands fixed depends on the seed, what moves on the pair as well."""
    fixed, moving = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1, pair_index])
    return [
        *_shell(),
        *_window(1.05, 1.62),
        *_bookshelf(-1.72, DEPTH - 0.17, fixed),
        *_sofa(0.55, DEPTH - 0.52),
        *_wall_pictures(),
        *_coffee_table(0.28, 2.35, turn_deg=-8.0),
        *_floor_lamp(1.92, DEPTH - 0.42),
        *_plant(-0.78, DEPTH - 0.38, fixed),
        *_sideboard(WIDTH / 2 - 0.24, 2.35),
        *_chair(-1.25 + moving.uniform(-0.15, 0.2), 2.45 + moving.uniform(-0.25, 0.25), moving.uniform(-150.0, -60.0)),
        *_ball(moving.uniform(-0.75, -0.35), moving.uniform(1.7, 2.6), moving),
        *_carton(moving.uniform(-0.7, -0.45), moving.uniform(3.0, 3.2), moving.uniform(-40.0, 40.0)),
    ]


def _shell() -> list[Part]:
    wall = 0.1
    floor = Part(Box((WIDTH, DEPTH + 1.0, wall)), planks(*OAK, seed=2), at(0, DEPTH / 2 - 0.5, -wall / 2))
    ceiling = Part(
        Box((WIDTH, DEPTH + 1.0, wall)), plaster([0.93, 0.92, 0.89]), at(0, DEPTH / 2 - 0.5, HEIGHT + wall / 2)
    )
    back = Part(
        Box((WIDTH, wall, HEIGHT)),
        wallpaper([0.80, 0.82, 0.70], [0.70, 0.76, 0.64], [0.42, 0.55, 0.46], seed=4),
        at(0, DEPTH + wall / 2, HEIGHT / 2),
    )
    brick_tones = [[0.55, 0.25, 0.18], [0.62, 0.31, 0.21], [0.48, 0.20, 0.15], [0.66, 0.38, 0.27], [0.56, 0.30, 0.24]]
    left = Part(
        Box((wall, DEPTH + 1.0, HEIGHT)),
        bricks(brick_tones, [0.72, 0.69, 0.64], seed=5),
        at(-WIDTH / 2 - wall / 2, DEPTH / 2 - 0.5, HEIGHT / 2),
    )
    right = Part(
        Box((wall, DEPTH + 1.0, HEIGHT)),
        plaster([0.80, 0.68, 0.48], seed=6),
        at(WIDTH / 2 + wall / 2, DEPTH / 2 - 0.5, HEIGHT / 2),
    )
    front = Part(Box((WIDTH, wall, HEIGHT)), plaster([0.75, 0.75, 0.73], seed=7), at(0, -1.05, HEIGHT / 2))
    skirting = Part(Box((WIDTH, 0.02, 0.11)), plain([0.92, 0.91, 0.88]), at(0, DEPTH - 0.01, 0.055))
    carpet_size = (2.3, 1.5, 0.012)
    carpet = Part(
        Box(carpet_size),
        rug(carpet_size, [0.60, 0.10, 0.12], [0.10, 0.14, 0.34], [0.86, 0.72, 0.42], seed=8),
        at(0.15, 2.35, 0.006, 4.0),
    )
    lamp = Part(
        Box((*LIGHT_SIZE, 0.04)),
        plain([1.0, 0.98, 0.92]),
        at(LIGHT_CENTER[0], LIGHT_CENTER[1], HEIGHT - 0.02),
        glow=1.5,
    )
    return [floor, ceiling, back, left, right, front, skirting, carpet, lamp]


def _window(x: float, z: float) -> list[Part]:
    size, bar, white = (1.15, 0.02, 0.95), 0.07, plain([0.95, 0.95, 0.93])
    y = DEPTH - 0.02
    frame = [
        Part(Box((size[0] + 2 * bar, 0.06, bar)), white, at(x, y, z + side * 0.5 * (size[2] + bar))) for side in (-1, 1)
    ]
    frame += [Part(Box((bar, 0.06, size[2])), white, at(x + side * 0.5 * (size[0] + bar), y, z)) for side in (-1, 1)]
    frame += [
        Part(Box((0.035, 0.05, size[2])), white, at(x, y, z)),
        Part(Box((size[0], 0.05, 0.035)), white, at(x, y, z + 0.12)),
    ]
    sill = Part(Box((size[0] + 0.3, 0.16, 0.035)), white, at(x, y - 0.05, z - 0.5 * size[2] - bar))
    pane = Part(Box(size), landscape(size, seed=12), at(x, y + 0.005, z), glow=0.75, returns_infrared=False)
    curtain = fabric([0.62, 0.20, 0.22], seed=14)
    folds = [
        Part(cylinder(0.035, 1.6), curtain, at(x + side * (0.70 + 0.055 * k), y - 0.07 - 0.02 * (k % 2), z - 0.12))
        for side in (-1, 1)
        for k in range(4)
    ]
    return [*frame, sill, pane, *folds]


def _bookshelf(x: float, y: float, rng: np.random.Generator) -> list[Part]:
    width, depth, height, board, levels = 0.96, 0.3, 1.95, 0.028, 5
    timber = wood(*WALNUT, axis=2, seed=20)
    shelf_timber = wood(*WALNUT, axis=0, seed=21)
    parts = [
        Part(Box((board, depth, height)), timber, at(x + side * 0.5 * (width - board), y, height / 2))
        for side in (-1, 1)
    ]
    parts.append(Part(Box((width, 0.015, height)), shelf_timber, at(x, y + depth / 2 - 0.008, height / 2)))
    spacing = (height - board) / levels
    for level in range(levels + 1):
        parts.append(Part(Box((width, depth, board)), shelf_timber, at(x, y, 0.5 * board + level * spacing)))
    covers = [[0.62, 0.12, 0.12], [0.12, 0.25, 0.52], [0.15, 0.42, 0.24], [0.82, 0.64, 0.18], [0.40, 0.20, 0.45]]
    covers += [[0.88, 0.85, 0.78], [0.10, 0.45, 0.50], [0.80, 0.38, 0.14], [0.22, 0.22, 0.26]]
    for level in range(levels):
        edge = x - width / 2 + board + 0.01
        end = x + width / 2 - board - 0.02 - rng.uniform(0.0, 0.28)
        while True:
            thickness, tall, deep = rng.uniform(0.022, 0.06), rng.uniform(0.19, 0.31), rng.uniform(0.14, 0.22)
            if edge + thickness > end:
                break
            size = (thickness, deep, tall)
            texture = book(covers[rng.integers(len(covers))], size, seed=int(rng.integers(1000)))
            place = at(edge + thickness / 2, y - depth / 2 + 0.02 + deep / 2, level * spacing + board + tall / 2)
            parts.append(Part(Box(size), texture, place))
            edge += thickness + 0.003
    vase = ((0.0, 0.0), (0.05, 0.0), (0.085, 0.08), (0.06, 0.19), (0.035, 0.23), (0.05, 0.27))
    parts.append(Part(Lathe(vase), stripes([[0.16, 0.34, 0.56], [0.92, 0.90, 0.82]], 0.035), at(x - 0.2, y, height)))
    return parts


def _sofa(x: float, y: float) -> list[Part]:
    cloth, width, depth = fabric([0.20, 0.33, 0.42], seed=30), 1.75, 0.82
    parts = [
        Part(Box((width, depth, 0.22)), cloth, at(x, y, 0.21)),
        Part(Box((width, 0.22, 0.52)), cloth, at(x, y + depth / 2 - 0.11, 0.55)),
    ]
    parts += [Part(Box((0.2, depth, 0.5)), cloth, at(x + side * (width / 2 - 0.1), y, 0.37)) for side in (-1, 1)]
    parts += [Part(cylinder(0.1, depth), cloth, _lying(x + side * (width / 2 - 0.1), y, 0.62)) for side in (-1, 1)]
    seat = fabric([0.24, 0.39, 0.49], seed=31)
    parts += [Part(Ellipsoid((0.36, 0.36, 0.13)), seat, at(x + side * 0.34, y - 0.09, 0.34)) for side in (-1, 1)]
    cushions = [
        ((0.78, 0.52, 0.10), (0.95, 0.86, 0.62), -0.50, 15.0),
        ((0.70, 0.18, 0.16), (0.94, 0.90, 0.84), 0.02, -5.0),
        ((0.32, 0.46, 0.22), (0.90, 0.88, 0.70), 0.50, -20.0),
    ]
    for color, check, offset, turn in cushions:
        shape, texture = Ellipsoid((0.21, 0.085, 0.20)), fabric(color, check, period=0.075, seed=32)
        parts.append(Part(shape, texture, at(x + offset, y + 0.12, 0.58, turn)))
    legs = wood(*WALNUT, axis=2, seed=33)
    for dx in (-0.78, 0.78):
        parts.append(Part(cylinder(0.025, 0.1), legs, at(x + dx, y - 0.33, 0.05)))
    return parts


def _lying(x: float, y: float, z: float) -> np.ndarray:
    """A pose whose part's z axis lies along the world's y."""
    pose = at(x, y, z)
    pose[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    return pose


def _wall_pictures() -> list[Part]:
    frame = wood(*WALNUT, axis=0, seed=40)
    palette = [[0.95, 0.94, 0.90], [0.78, 0.10, 0.10], [0.95, 0.80, 0.15], [0.12, 0.25, 0.60], [0.95, 0.94, 0.90]]
    canvas = (0.62, 0.02, 0.72)
    parts = [
        Part(Box((0.70, 0.03, 0.80)), frame, at(-0.32, DEPTH - 0.015, 1.62)),
        Part(Box(canvas), abstract_painting(canvas, palette, seed=41), at(-0.32, DEPTH - 0.025, 1.62)),
    ]
    clock_pose = at(WIDTH / 2 - 0.02, 3.15, 1.72)
    clock_pose[:3, :3] = [[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    parts.append(Part(cylinder(0.19, 0.04), clock_face(0.19), clock_pose))
    poster = (0.9, 0.012, 0.64)
    turned = at(-WIDTH / 2 + 0.012, 2.45, 1.6, 90.0)
    parts.append(Part(Box(poster), landscape(poster, seed=46), turned))
    return parts


def _coffee_table(x: float, y: float, turn_deg: float) -> list[Part]:
    base = at(x, y, 0.0, turn_deg)
    parts: list[tuple[Shape, Texture, np.ndarray]] = [
        (Box((0.98, 0.56, 0.035)), wood(*PINE, axis=0, seed=50), at(0, 0, 0.42))
    ]
    leg = wood(*PINE, axis=2, seed=51)
    parts += [(Box((0.05, 0.05, 0.41)), leg, at(dx, dy, 0.205)) for dx in (-0.44, 0.44) for dy in (-0.23, 0.23)]
    parts.append((Box((0.86, 0.46, 0.02)), wood(*PINE, axis=0, seed=52), at(0, 0, 0.16)))
    parts.append((Ellipsoid((0.125, 0.125, 0.125)), globe(), at(-0.28, 0.06, 0.61)))
    parts.append(
        (Lathe(((0.0, 0.0), (0.09, 0.0), (0.03, 0.03), (0.03, 0.06))), plain([0.35, 0.24, 0.1]), at(-0.28, 0.06, 0.437))
    )
    mug = ((0.0, 0.0), (0.042, 0.0), (0.042, 0.10), (0.037, 0.10), (0.037, 0.012), (0.0, 0.012))
    parts.append((Lathe(mug), stripes([[0.92, 0.92, 0.9], [0.8, 0.25, 0.2]], 0.025), at(0.12, -0.14, 0.437)))
    for k, (color, turn) in enumerate((([0.14, 0.3, 0.5], 12.0), ([0.75, 0.55, 0.15], -9.0), ([0.5, 0.12, 0.2], 25.0))):
        size = (0.27, 0.2, 0.03)
        parts.append((Box(size), book(color, size, seed=53 + k), at(0.3, 0.08, 0.453 + 0.03 * k, turn)))
    bowl = ((0.0, 0.0), (0.06, 0.0), (0.13, 0.06), (0.12, 0.06), (0.055, 0.015), (0.0, 0.015))
    parts.append((Lathe(bowl), plain([0.85, 0.83, 0.78]), at(0.3, 0.08, 0.53)))
    for k, color in enumerate(([0.8, 0.2, 0.1], [0.9, 0.6, 0.1], [0.55, 0.7, 0.15])):
        angle = 2.1 * k
        parts.append(
            (
                Ellipsoid((0.04, 0.04, 0.038)),
                plain(color),
                at(0.3 + 0.045 * np.cos(angle), 0.08 + 0.045 * np.sin(angle), 0.585),
            )
        )
    return [Part(shape, texture, base @ pose) for shape, texture, pose in parts]


def _floor_lamp(x: float, y: float) -> list[Part]:
    metal = plain([0.28, 0.26, 0.24])
    shade = Lathe(((0.24, 1.42), (0.15, 1.75), (0.145, 1.75), (0.235, 1.42)))
    return [
        Part(cylinder(0.15, 0.03), metal, at(x, y, 0.015)),
        Part(cylinder(0.016, 1.6), metal, at(x, y, 0.8)),
        Part(shade, stripes([[0.93, 0.80, 0.55], [0.88, 0.72, 0.46]], 0.055), at(x, y, 0.0), glow=0.55),
    ]


def _plant(x: float, y: float, rng: np.random.Generator) -> list[Part]:
    pot = Lathe(((0.0, 0.0), (0.13, 0.0), (0.18, 0.30), (0.165, 0.30), (0.16, 0.26), (0.0, 0.26)))
    parts = [Part(pot, stripes([[0.72, 0.36, 0.22], [0.80, 0.46, 0.30]], 0.06), at(x, y, 0.0))]
    parts.append(Part(cylinder(0.02, 0.5), wood(*WALNUT, axis=2, seed=60), at(x, y, 0.5)))
    for k in range(26):
        azimuth, rise = rng.uniform(0, 360), rng.uniform(0.45, 1.08)
        reach = 0.26 * np.sin(np.pi * (rise - 0.35) / 0.85)
        pose = at(x + reach * np.cos(np.deg2rad(azimuth)), y + reach * np.sin(np.deg2rad(azimuth)), rise, azimuth)
        tilt = np.deg2rad(rng.uniform(-55.0, 25.0))
        pose[:3, :3] = pose[:3, :3] @ np.array(
            [[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]]
        )
        parts.append(Part(Ellipsoid((0.14, 0.06, 0.012)), foliage(seed=61 + k), pose))
    return parts


def _sideboard(x: float, y: float) -> list[Part]:
    doors = [
        Part(Box((0.02, 0.42, 0.56)), wood(*OAK, axis=2, seed=71 + k), at(x - 0.23, y - 0.46 + 0.46 * k, 0.42))
        for k in range(3)
    ]
    knobs = [
        Part(Ellipsoid((0.018, 0.018, 0.018)), plain([0.8, 0.7, 0.35]), at(x - 0.25, y - 0.3 + 0.46 * k, 0.45))
        for k in range(3)
    ]
    radio = Part(
        Box((0.2, 0.36, 0.22)), fabric([0.75, 0.22, 0.15], [0.2, 0.1, 0.1], period=0.03, seed=75), at(x, y + 0.2, 0.86)
    )
    return [Part(Box((0.44, 1.45, 0.72)), wood(*WALNUT, axis=1, seed=70), at(x, y, 0.39)), *doors, *knobs, radio]


def _chair(x: float, y: float, turn_deg: float) -> list[Part]:
    base, timber = at(x, y, 0.0, turn_deg), wood(*PINE, axis=2, seed=80)
    parts = [
        (Box((0.44, 0.44, 0.05)), fabric([0.80, 0.42, 0.12], [0.95, 0.85, 0.6], period=0.12, seed=81), at(0, 0, 0.46))
    ]
    parts += [(Box((0.04, 0.04, 0.44)), timber, at(dx, -0.19, 0.22)) for dx in (-0.19, 0.19)]
    parts += [(Box((0.04, 0.04, 0.96)), timber, at(dx, 0.19, 0.48)) for dx in (-0.19, 0.19)]
    parts += [
        (Box((0.36, 0.025, 0.07)), wood(*PINE, axis=0, seed=82), at(0, 0.19, height)) for height in (0.62, 0.76, 0.90)
    ]
    return [Part(shape, texture, base @ pose) for shape, texture, pose in parts]


def _ball(x: float, y: float, rng: np.random.Generator) -> list[Part]:
    palette = [
        [0.86, 0.12, 0.12],
        [0.95, 0.95, 0.9],
        [0.98, 0.78, 0.1],
        [0.1, 0.35, 0.75],
        [0.95, 0.95, 0.9],
        [0.1, 0.6, 0.3],
    ]
    pose = at(x, y, 0.17 + 0.012)
    pose[:3, :3] = _random_rotation(rng)
    return [Part(Ellipsoid((0.17, 0.17, 0.17)), beach_ball(palette), pose)]


def _random_rotation(rng: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def _carton(x: float, y: float, turn_deg: float) -> list[Part]:
    low, high = (0.42, 0.32, 0.30), (0.26, 0.22, 0.20)
    return [
        Part(Box(low), carton(low, seed=90), at(x, y, 0.15, turn_deg)),
        Part(Box(high), carton(high, seed=91), at(x + 0.03, y - 0.02, 0.40, turn_deg + 27.0)),
    ]
