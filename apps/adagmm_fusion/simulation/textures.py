"""Procedural textures: the albedo of a surface as a function of the position on it.

A texture is `texture(points, normals) -> colors`: points (N, 3) in the part's own frame [m], its outward unit normals
(N, 3), and colours (N, 3) in 0..1, sRGB-like. Nothing is stored in vertices or images, so a texture is as sharp as the
ray that asks for it. All randomness is a hash of integer lattice positions: the same on every platform.
"""

from collections.abc import Callable, Sequence

import numpy as np

Texture = Callable[[np.ndarray, np.ndarray], np.ndarray]
Color = Sequence[float]


def lattice_hash(cells: np.ndarray, seed: int = 0) -> np.ndarray:
    """A number in 0..1 for each row of integer lattice coordinates (N, K)."""
    mixed = np.full(len(cells), (seed * 0x9E3779B1 + 0x7F4A7C15) & 0xFFFFFFFF, dtype=np.uint64)
    for column in np.asarray(cells, dtype=np.int64).T:
        mixed ^= (column & 0xFFFFFFFF).astype(np.uint64)
        mixed = (mixed * np.uint64(0x85EBCA6B)) & np.uint64(0xFFFFFFFF)
        mixed ^= mixed >> np.uint64(15)
    mixed = (mixed * np.uint64(0xC2B2AE35)) & np.uint64(0xFFFFFFFF)
    mixed ^= mixed >> np.uint64(16)
    return mixed.astype(np.float64) / 2**32


def value_noise(positions: np.ndarray, seed: int = 0) -> np.ndarray:
    """Smooth noise in 0..1 with one feature per unit length; positions (N, K)."""
    floor = np.floor(positions)
    weight = positions - floor
    weight = weight * weight * (3.0 - 2.0 * weight)
    cells, dimensions = floor.astype(np.int64), positions.shape[1]
    total = np.zeros(len(positions))
    for corner in np.ndindex(*(2,) * dimensions):
        share = np.prod(np.where(np.array(corner), weight, 1.0 - weight), axis=1)
        total += share * lattice_hash(cells + np.array(corner), seed)
    return total


def fractal_noise(positions: np.ndarray, octaves: int = 4, seed: int = 0) -> np.ndarray:
    """Value noise of halving size and strength, summed; about 0..1 with mean 0.5."""
    weights = 0.5 ** np.arange(octaves)
    layers = [w * value_noise(positions * 2.0**k, seed + k) for k, w in enumerate(weights)]
    return np.sum(layers, axis=0) / weights.sum()


def face_coordinates(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(N, 2) coordinates [m] on the face of an axis-aligned box that each point lies on; z, where it varies, second."""
    axis = np.abs(normals).argmax(axis=1)
    first = np.where(axis == 0, points[:, 1], points[:, 0])
    second = np.where(axis == 2, points[:, 1], points[:, 2])
    return np.stack([first, second], axis=1)


def _blend(share: np.ndarray, low: Color, high: Color) -> np.ndarray:
    share = np.clip(share, 0.0, 1.0)[:, None]
    return (1.0 - share) * np.asarray(low) + share * np.asarray(high)


def _choose(index: np.ndarray, palette: Sequence[Color]) -> np.ndarray:
    return np.asarray(palette, dtype=np.float64)[index.astype(np.int64) % len(palette)]


def plain(color: Color) -> Texture:
    """One colour."""
    return lambda points, normals: np.tile(np.asarray(color, dtype=np.float64), (len(points), 1))


def plaster(color: Color, seed: int = 0) -> Texture:
    """One colour with the faint unevenness of a painted wall."""

    def texture(points, normals):
        return np.asarray(color) * (0.88 + 0.24 * fractal_noise(points * 5.0, 4, seed))[:, None]

    return texture


def wood(dark: Color, light: Color, axis: int = 0, seed: int = 0) -> Texture:
    """Grain that runs along an axis of the part."""

    def texture(points, normals):
        stretched = points * np.where(np.arange(3) == axis, 3.0, 45.0)
        rings = np.sin(9.0 * fractal_noise(stretched * 0.35, 3, seed) + 4.0 * fractal_noise(stretched, 2, seed + 9))
        return _blend(0.5 + 0.5 * rings, dark, light)

    return texture


def planks(dark: Color, light: Color, width: float = 0.14, length: float = 1.1, seed: int = 0) -> Texture:
    """A plank floor: boards along y with gaps, staggered ends, each with its own tone and grain."""

    def texture(points, normals):
        row = np.floor(points[:, 0] / width)
        shifted = points[:, 1] / length + lattice_hash(row[:, None], seed)
        board = np.stack([row, np.floor(shifted)], axis=1)
        tone = lattice_hash(board, seed + 1)
        grain = fractal_noise(np.stack([points[:, 0] * 60.0, points[:, 1] * 4.0, tone * 50.0], axis=1), 3, seed + 2)
        color = _blend(0.65 * tone + 0.7 * (grain - 0.35), dark, light)
        across = np.abs(points[:, 0] / width - row - 0.5)
        along = np.abs(shifted - np.floor(shifted) - 0.5)
        gap = (across > 0.5 - 0.004 / width) | (along > 0.5 - 0.003 / length)
        return np.where(gap[:, None], color * 0.35, color)

    return texture


def bricks(
    tones: Sequence[Color], mortar: Color, size: Sequence[float] = (0.21, 0.075), joint: float = 0.012, seed: int = 0
) -> Texture:
    """Brickwork in running bond on any vertical face."""

    def texture(points, normals):
        uv = face_coordinates(points, normals)
        row = np.floor(uv[:, 1] / size[1])
        column = uv[:, 0] / size[0] + 0.5 * (row % 2)
        cell = np.stack([np.floor(column), row], axis=1)
        color = _choose(np.floor(lattice_hash(cell, seed) * len(tones)), tones)
        color = color * (0.7 + 0.6 * fractal_noise(uv * 40.0, 3, seed + 1))[:, None]
        inside_u = np.abs(column - np.floor(column) - 0.5) < 0.5 - 0.5 * joint / size[0]
        inside_v = np.abs(uv[:, 1] / size[1] - row - 0.5) < 0.5 - 0.5 * joint / size[1]
        return np.where((inside_u & inside_v)[:, None], color, mortar)

    return texture


def wallpaper(base: Color, stripe: Color, motif: Color, period: float = 0.24, seed: int = 0) -> Texture:
    """Vertical stripes with a row of rosettes on every second one."""

    def texture(points, normals):
        uv = face_coordinates(points, normals)
        phase = uv[:, 0] / period
        color = np.where((np.floor(2.0 * phase) % 2 == 0)[:, None], base, stripe)
        du = (phase - np.floor(phase) - 0.25) * period
        row = np.floor(uv[:, 1] / period)
        dv = (uv[:, 1] / period - row - 0.5) * period
        radius, angle = np.hypot(du, dv), np.arctan2(dv, du)
        rosette = radius < 0.034 * (1.0 + 0.45 * np.cos(6.0 * angle))
        color = np.where((rosette & (radius > 0.009))[:, None], motif, color)
        return color * (0.93 + 0.14 * fractal_noise(points * 6.0, 3, seed))[:, None]

    return texture


def rug(size: Sequence[float], field: Color, border: Color, accent: Color, seed: int = 0) -> Texture:
    """An oriental rug: fringe, bordered frame with diamonds, and a medallion on a patterned field."""
    half = 0.5 * np.asarray(size[:2])

    def texture(points, normals):
        inset = np.minimum(half[0] - np.abs(points[:, 0]), half[1] - np.abs(points[:, 1]))
        lattice = points[:, :2] / 0.11
        cell = np.abs(lattice - np.floor(lattice) - 0.5)
        diamond = cell.sum(axis=1)
        color = np.where((diamond < 0.22)[:, None], accent, field)
        ring = np.hypot(points[:, 0] / half[0], points[:, 1] / half[1])
        petals = ring * (1.0 + 0.12 * np.cos(12.0 * np.arctan2(points[:, 1] / half[1], points[:, 0] / half[0])))
        color = np.where((petals < 0.52)[:, None], border, color)
        color = np.where((petals < 0.42)[:, None], accent, color)
        color = np.where((petals < 0.30)[:, None], field, color)
        color = np.where((petals < 0.14)[:, None], border, color)
        framed = np.where((diamond < 0.30)[:, None], accent, border)
        color = np.where((inset < 0.17)[:, None], framed, color)
        color = np.where(((inset < 0.185) & (inset > 0.165))[:, None], accent, color)
        color = np.where((inset < 0.035)[:, None], [0.88, 0.84, 0.74], color)
        return color * (0.75 + 0.5 * value_noise(points[:, :2] * 160.0, seed))[:, None]

    return texture


def fabric(color: Color, check: Color | None = None, period: float = 0.1, seed: int = 0) -> Texture:
    """Woven cloth, with a tartan of a second colour when one is given."""

    def texture(points, normals):
        uv = face_coordinates(points, normals)
        shade = (0.82 + 0.36 * fractal_noise(uv * 90.0, 2, seed))[:, None]
        if check is None:
            return np.asarray(color) * shade
        bands = np.mod(uv / period, 1.0)
        return (
            _blend(0.5 * (bands < 0.3).sum(axis=1) + 0.35 * (np.abs(bands - 0.6) < 0.04).any(axis=1), color, check)
            * shade
        )

    return texture


def book(cover: Color, size: Sequence[float], seed: int = 0) -> Texture:
    """A book: its cover, two bands around it, and a line of words along the middle of each side."""
    contrast = [0.93, 0.87, 0.66] if sum(cover) < 1.6 else [0.2, 0.16, 0.14]
    long_axis = int(np.argmax(size))

    def texture(points, normals):
        relative = 2.0 * points / np.asarray(size)
        along = relative[:, long_axis]
        axes = np.arange(3)
        across_axis = (axes != long_axis) & (axes != np.abs(normals).argmax(axis=1)[:, None])
        across = np.where(across_axis, np.abs(relative), 0.0).max(axis=1)
        letters = lattice_hash(np.floor(points[:, [long_axis]] / 0.016).astype(np.int64), seed) > 0.3
        title = (np.abs(along) < 0.5) & (across < 0.3) & letters
        band = np.abs(np.abs(along) - 0.78) < 0.06
        return np.where((band | title)[:, None], contrast, np.asarray(cover))

    return texture


def beach_ball(palette: Sequence[Color]) -> Texture:
    """Coloured segments between two white caps."""

    def texture(points, normals):
        sector = np.floor((np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5) * 6)
        cap = np.abs(points[:, 2]) > 0.93 * np.linalg.norm(points, axis=1)
        return np.where(cap[:, None], [0.95, 0.95, 0.92], _choose(sector, palette))

    return texture


def globe(seed: int = 3) -> Texture:
    """Continents in a blue sea, with a graticule and white poles."""

    def texture(points, normals):
        direction = points / np.linalg.norm(points, axis=1, keepdims=True)
        land = fractal_noise(direction * 1.9 + 7.0, 4, seed)
        color = _blend((land - 0.5) * 6.0, [0.35, 0.55, 0.22], [0.72, 0.60, 0.34])
        color = np.where((land < 0.5)[:, None], [0.16, 0.42, 0.66], color)
        latitude = np.arcsin(np.clip(direction[:, 2], -1.0, 1.0)) / np.pi
        longitude = np.arctan2(direction[:, 1], direction[:, 0]) / np.pi
        line = (np.abs(np.mod(latitude * 6, 1.0) - 0.5) > 0.48) | (np.abs(np.mod(longitude * 6, 1.0) - 0.5) > 0.48)
        color = np.where(line[:, None], color * 0.7, color)
        return np.where((np.abs(direction[:, 2]) > 0.93)[:, None], [0.94, 0.95, 0.96], color)

    return texture


def carton(size: Sequence[float], seed: int = 0) -> Texture:
    """A cardboard box: tape along the top, a printed label and arrows on the sides."""

    def texture(points, normals):
        uv = face_coordinates(points, normals)
        color = np.array([0.70, 0.53, 0.34]) * (0.85 + 0.3 * fractal_noise(points * 30.0, 3, seed))[:, None]
        side = np.abs(normals[:, 2]) < 0.5
        label = side & (np.abs(uv[:, 0]) < 0.26 * size[0]) & (np.abs(uv[:, 1] - 0.12 * size[2]) < 0.2 * size[2])
        print_rows = (np.mod(uv[:, 1] / 0.022, 1.0) < 0.5) & (value_noise(uv * [70.0, 12.0], seed + 4) > 0.35)
        color = np.where(label[:, None], np.where(print_rows[:, None], [0.13, 0.2, 0.45], [0.95, 0.94, 0.9]), color)
        tape = (~side & (np.abs(points[:, 1]) < 0.03)) | (
            side & (np.abs(uv[:, 0]) < 0.03) & (uv[:, 1] > 0.42 * size[2])
        )
        color = np.where(tape[:, None], [0.84, 0.74, 0.52], color)
        stripe = side & (np.abs(uv[:, 1] + 0.36 * size[2]) < 0.05 * size[2])
        return np.where(stripe[:, None], [0.75, 0.16, 0.12], color)

    return texture


def foliage(seed: int = 0) -> Texture:
    """Mottled green leaves with pale veins."""

    def texture(points, normals):
        tone = fractal_noise(points * 22.0, 3, seed)
        return _blend(1.8 * (tone - 0.25), [0.06, 0.22, 0.07], [0.38, 0.60, 0.20])

    return texture


def stripes(palette: Sequence[Color], period: float, axis: int = 2) -> Texture:
    """Bands of equal width across one axis."""
    return lambda points, normals: _choose(np.floor(points[:, axis] / period), palette)


def landscape(size: Sequence[float], seed: int = 0) -> Texture:
    """A view of hills under a cloudy sky, for windows and pictures; lies in x and z."""

    def texture(points, normals):
        u, v = points[:, 0] / size[0], points[:, 2] / size[2]
        cloud = fractal_noise(np.stack([u * 3.0, v * 8.0], axis=1) + seed, 4, seed)
        color = _blend(2.6 * (cloud - 0.42), [0.42, 0.66, 0.93], [0.97, 0.97, 0.98])
        for layer, tone in enumerate(([0.36, 0.50, 0.58], [0.28, 0.48, 0.30], [0.45, 0.58, 0.22])):
            ridge = (
                0.12 - 0.19 * layer + 0.34 * (value_noise(np.stack([u * (2 + layer) + 5 * layer], axis=1), seed) - 0.5)
            )
            color = np.where((v < ridge)[:, None], tone, color)
        return color

    return texture


def abstract_painting(size: Sequence[float], palette: Sequence[Color], seed: int = 0) -> Texture:
    """Rectangles divided by black lines; lies in x and z."""

    def texture(points, normals):
        u, v = points[:, 0] / size[0] + 0.5, points[:, 2] / size[2] + 0.5
        cuts_u, cuts_v = np.array([0.22, 0.60, 0.84]), np.array([0.18, 0.52, 0.80])
        cell = np.stack([np.searchsorted(cuts_u, u), np.searchsorted(cuts_v, v)], axis=1)
        color = _choose(np.floor(lattice_hash(cell, seed) * len(palette)), palette)
        line = (np.abs(u[:, None] - cuts_u) < 0.014).any(axis=1) | (np.abs(v[:, None] - cuts_v) < 0.014).any(axis=1)
        return np.where(line[:, None], [0.06, 0.06, 0.06], color)

    return texture


def clock_face(radius: float) -> Texture:
    """Twelve ticks, two hands, a dark rim; lies in x and y, facing z."""

    def texture(points, normals):
        distance = np.hypot(points[:, 0], points[:, 1]) / radius
        angle = np.arctan2(points[:, 1], points[:, 0])
        tick = (np.abs(np.mod(angle / (np.pi / 6) + 0.5, 1.0) - 0.5) < 0.09) & (distance > 0.68) & (distance < 0.85)
        hands = np.zeros(len(points), dtype=bool)
        for direction, length, width in ((0.9, 0.5, 0.05), (2.4, 0.75, 0.035)):
            along = (points[:, 0] * np.cos(direction) + points[:, 1] * np.sin(direction)) / radius
            across = (points[:, 1] * np.cos(direction) - points[:, 0] * np.sin(direction)) / radius
            hands |= (along > -0.08) & (along < length) & (np.abs(across) < width)
        dark = tick | hands | (distance > 0.92)
        return np.where(dark[:, None], [0.10, 0.09, 0.10], [0.96, 0.95, 0.90])

    return texture
