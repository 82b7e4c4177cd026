"""Where a turned cloud may lie on another: two points whose normals agree vote for the shift between them.

The sum of the votes is the correlation of the two surfaces, for as many shifts as there are cells, at the cost of one
look at each pair of points.
"""

import numpy as np
from numba import njit

from adagmm_o3d.kernels.cpu.compiling import EXACT_FLAGS, EXACT_KERNEL_FLAGS, source_stamp

HALF = np.float32(0.5)


@njit(**EXACT_FLAGS)
def _vote(moved, normals, target, facing, low, edge, cosine, votes):
    """Let every two points whose normals agree vote for the shift between them; `facing` (3, n) are the target's."""
    agree, voting = np.empty(len(target)), np.empty(len(target), np.int64)
    for i in range(len(moved)):
        a, b, c = normals[i, 0], normals[i, 1], normals[i, 2]
        for j in range(len(target)):
            agree[j] = abs(a * facing[0, j] + b * facing[1, j] + c * facing[2, j])
        count = 0
        for j in range(len(target)):
            voting[count] = j
            count += agree[j] >= cosine
        px, py, pz = moved[i, 0] + low[0], moved[i, 1] + low[1], moved[i, 2] + low[2]
        for j in voting[:count]:
            x = int((target[j, 0] - px) / edge)
            y = int((target[j, 1] - py) / edge)
            z = int((target[j, 2] - pz) / edge)
            votes[x, y, z] += moved[i, 3] * target[j, 3]


@njit(**EXACT_FLAGS)
def _soften(votes):
    """Add to each cell of (nx, ny, nz) votes half of what its neighbours along each axis have, one axis after another;
    those at the rim stay as they are."""
    nx, ny, nz = votes.shape
    before = np.empty(nz, np.float32)
    for x in range(nx):
        for y in range(ny):
            before[:] = votes[x, y]
            for z in range(1, nz - 1):
                votes[x, y, z] = before[z] + HALF * (before[z - 1] + before[z + 1])
    for x in range(nx):
        before[:] = votes[x, 0]
        for y in range(1, ny - 1):
            for z in range(nz):
                own = votes[x, y, z]
                votes[x, y, z] = own + HALF * (before[z] + votes[x, y + 1, z])
                before[z] = own
    for y in range(ny):
        before[:] = votes[0, y]
        for x in range(1, nx - 1):
            for z in range(nz):
                own = votes[x, y, z]
                votes[x, y, z] = own + HALF * (before[z] + votes[x + 1, y, z])
                before[z] = own


@njit(**EXACT_FLAGS)
def _is_peak(votes, x, y, z):
    """Whether no cell around this one, which is not at the rim, has more; of equal ones the first is the peak."""
    own = votes[x, y, z]
    for a in range(x - 1, x + 2):
        for b in range(y - 1, y + 2):
            for c in range(z - 1, z + 2):
                first = (a, b, c) < (x, y, z)
                if votes[a, b, c] > own or (first and votes[a, b, c] == own):
                    return False
    return True


@njit(**EXACT_FLAGS)
def _find_peaks(votes, low, edge, peaks):
    """`peaks` (k, 4) receives the shifts with most votes, the most first, and their votes."""
    peaks[:] = -1.0
    last = len(peaks) - 1
    least = np.float32(0.0)
    nx, ny, nz = votes.shape
    for x in range(1, nx - 1):
        for y in range(1, ny - 1):
            for z in range(1, nz - 1):
                count = votes[x, y, z]
                if count > least and _is_peak(votes, x, y, z):
                    place = last
                    while place > 0 and count > peaks[place - 1, 3]:
                        peaks[place] = peaks[place - 1]
                        place -= 1
                    peaks[place, 0] = low[0] + (x + 0.5) * edge
                    peaks[place, 1] = low[1] + (y + 0.5) * edge
                    peaks[place, 2] = low[2] + (z + 0.5) * edge
                    peaks[place, 3] = count
                    least = max(least, np.float32(peaks[last, 3]))


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**EXACT_KERNEL_FLAGS)
    def vote_for_shifts(source, source_normals, target, target_normals, rotations, edge, cosine, peaks):
        """`peaks` (r, k, 4) receives for each of (r, 3, 3) rotations the shifts with most votes, the most first, and
        how many votes each has; minus one where there are fewer than k.

        source, target : (m, 4) and (n, 4) points and their weights; a vote weighs as much as both points.
        source_normals, target_normals : (m, 3) and (n, 3), of either sign.   edge : of a cell of shifts.
        cosine : normals agree whose absolute cosine is at least this.
        """
        _ = stamp
        facing = np.ascontiguousarray(target_normals.T)
        for r in range(len(rotations)):
            moved, normals = np.empty((len(source), 4)), np.empty((len(source), 3))
            for i in range(len(source)):
                for a in range(3):
                    moved[i, a], normals[i, a] = 0.0, 0.0
                    for b in range(3):
                        moved[i, a] += rotations[r, a, b] * source[i, b]
                        normals[i, a] += rotations[r, a, b] * source_normals[i, b]
                moved[i, 3] = source[i, 3]
            low, cells = np.empty(3), np.empty(3, np.int64)
            for a in range(3):
                # an empty cell on every side
                low[a] = target[:, a].min() - moved[:, a].max() - edge
                cells[a] = int((target[:, a].max() - moved[:, a].min() - low[a]) / edge) + 2
            votes = np.zeros((cells[0], cells[1], cells[2]), np.float32)
            _vote(moved, normals, target, facing, low, edge, cosine, votes)
            _soften(votes)
            _find_peaks(votes, low, edge, peaks[r])

    return vote_for_shifts


vote_for_shifts = _build(source_stamp())
