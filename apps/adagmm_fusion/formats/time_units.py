"""Times of recordings are in seconds, but also in milli-, micro- or nanoseconds, which their numbers betray."""

from collections.abc import Iterable

import numpy as np

# Since 1970 about 1.7e9 seconds have passed, so a time from here on counts so many units a second.
SINCE_1970 = ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3))
# Images follow each other within seconds: whole numbers that are as far apart as this count other units.
DISTANCES = ((1e6, 1e9), (1e4, 1e6), (10.0, 1e3))


def units_per_second(stamps: Iterable[float]) -> float:
    """1, 1e3, 1e6 or 1e9, by the size of the times, or, of whole numbers, by the median distance of neighbours."""
    times = np.sort(np.fromiter(stamps, float))
    if not times.size:
        return 1.0
    for least, units in SINCE_1970:
        if abs(times[-1]) >= least:
            return units
    steps = np.diff(np.unique(times))
    if steps.size and np.array_equal(times, np.floor(times)):
        for least, units in DISTANCES:
            if np.median(steps) >= least:
                return units
    return 1.0
