"""How many units of a depth image a metre has, as calibration files say it."""

from collections.abc import Mapping
from typing import Any

from adagmm_o3d.errors import InputError

# Names of fields, small and without underscores: units a metre, or, below 1, metres a unit.
SCALES = ("depthscale", "depthfactor", "depthmapfactor", "pngdepthscale", "integerdepthscale")
# Metres a unit (RealSense's name), or the unit's own name.
UNITS = ("depthunits", "depthunit", "depthunitscalefactor")
NAMED = {"m": 1.0, "meter": 1.0, "metre": 1.0, "mm": 1e3, "millimeter": 1e3, "millimetre": 1e3, "cm": 1e2}
SAME = 1e-6
LEAST = 1e-9  # of units a metre, or metres a unit; the most is its inverse


def depth_scale_of(values: Mapping[str, Any], where: str, error: type[InputError]) -> float | None:
    """Units a metre from fields by plain name; None where none of them says it.

    Raises
    ------
    error  starting with `where`, if it is no positive number, or two fields say different ones.
    """
    found: dict[str, float] = {}
    for name in (*SCALES, *UNITS):
        value = values.get(name)
        if value is None:
            continue
        if isinstance(value, str) and value.strip().lower().removesuffix("s") in NAMED:
            found[name] = NAMED[value.strip().lower().removesuffix("s")]
            continue
        if isinstance(value, bool) or not isinstance(value, int | float) or not LEAST < value < 1 / LEAST:
            raise error(f"{where}: {name}: expected a positive number, got {str(value)[:40]}")
        if name in UNITS and value > 1:
            raise error(f"{where}: {name}: expected metres a unit, as 0.001 for millimetres, got {value:g}")
        found[name] = float(value) if value >= 1 and name in SCALES else 1.0 / value
    scales = list(found.values())
    if any(abs(scale - scales[0]) > SAME * scales[0] for scale in scales):
        said = " and ".join(f"{name} {values[name]}" for name in found)
        raise error(f"{where}: {said} do not agree on the depth unit; keep the true one")
    return scales[0] if scales else None
