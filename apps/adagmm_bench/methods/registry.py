"""The registry of methods: a name for each function of two clouds that returns a pose.

    @method("my-method", library="my_library")
    def my_method(source: Cloud, target: Cloud) -> np.ndarray:
        '''What it is; its settings.'''
        return my_library.align(source.points, target.points)      # (D+1, D+1), source to target

Clouds come scaled to about unit RMS radius (problem.prepare), so distances are in radii and hold for all data. A
method that gives up raises; the trial is then recorded as failed with the error's text and counts with the error of
its start.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from adagmm_bench.problem import Cloud
from adagmm_fusion.source_digest import source_digest
from adagmm_o3d.entry_points import entry_points, load
from adagmm_o3d.errors import InputError

GROUP = "adagmm_bench.methods"

Function = Callable[[Cloud, Cloud], np.ndarray]


@dataclass(frozen=True)
class Method:
    """One entry: `library` is the module it needs, `anywhere` says that its result does not depend on the start."""

    name: str
    function: Function
    library: str
    dimensions: tuple[int, ...]
    anywhere: bool
    ours: bool
    default: bool  # False: runs only where it is named, because it takes minutes

    def __call__(self, source: Cloud, target: Cloud) -> np.ndarray:
        return self.function(source, target)

    def settings(self) -> str:
        """What it is and how it is set, from its docstring, in one line."""
        return " ".join((self.function.__doc__ or "").split())

    def missing(self) -> str | None:
        """Why it cannot run here; None if it can."""
        return _import_failure(self.library)

    def version(self) -> str:
        """The library and its version, with a digest of the source that a result comes from: ours, and what is done
        here before and after; so old results of changed code are not reused.
        """
        return _version(self.library)


# Where the problem, the call and the judgement of a trial are written.
TRIAL_SOURCES = (
    "adagmm_bench.methods",
    "adagmm_bench.archives",
    "adagmm_bench.covariance_trial",
    "adagmm_bench.extra_pairs",
    "adagmm_bench.models",
    "adagmm_bench.pairs",
    "adagmm_bench.problem",
    "adagmm_bench.scenes",
    "adagmm_bench.simulation",
    "adagmm_bench.speed",
    "adagmm_bench.trial",
    "adagmm_fusion.clouds",
    "adagmm_fusion.frames",
    "adagmm_o3d.evaluation",
)

METHODS: dict[str, Method] = {}
# Other packages' modules of methods that cannot be used, with the reason.
UNUSABLE: dict[str, str] = {}


def register_others() -> None:
    """Import the modules that other packages' entry points name, which enters their methods."""
    for name, entry in entry_points(GROUP).items():
        try:
            load(entry)
        except InputError as error:
            UNUSABLE[name] = str(error)


def method(
    name: str,
    *,
    library: str,
    dimensions: tuple[int, ...] = (2, 3),
    anywhere: bool = False,
    ours: bool = False,
    default: bool = True,
) -> Callable[[Function], Function]:
    """Enter a function of (source, target) into the registry under `name`."""

    def enter(function: Function) -> Function:
        if name in METHODS:
            raise InputError(f"method {name!r} is registered twice")
        METHODS[name] = Method(name, function, library, dimensions, anywhere, ours, default)
        return function

    return enter


def choose_methods(names: Sequence[str] | None, dimension: int) -> tuple[list[Method], list[str]]:
    """The methods to run in one dimension, and a line for each that cannot, saying why.

    Raises
    ------
    InputError  if a name is not registered, or a named method cannot run here.
    """
    if names is not None and (unknown := [name for name in names if name not in METHODS]):
        raise InputError(f"methods: unknown {', '.join(unknown)}; known are {', '.join(METHODS)}")
    chosen, skipped = [], list(UNUSABLE.values()) if names is None else []
    for entry in METHODS.values():
        if (names is None and not entry.default) or (names is not None and entry.name not in names):
            continue
        reason = None if dimension in entry.dimensions else f"is not made for {dimension}D"
        reason = reason or entry.missing()
        if reason is None:
            chosen.append(entry)
        elif names is None:
            skipped.append(f"{entry.name}: {reason}")
        else:
            raise InputError(f"methods: {entry.name} {reason}")
    return chosen, skipped


@cache
def _import_failure(library: str) -> str | None:
    try:
        importlib.import_module(library)
    except ImportError as error:
        return f"needs the Python package {library} ({error})"
    return None


@cache
def _version(library: str) -> str:
    if library == "adagmm_o3d":
        digest = source_digest(library, *TRIAL_SOURCES, distributions=("numba", "numpy", "open3d"))
        return f"adagmm-o3d {importlib.metadata.version('adagmm-o3d')} ({digest})"
    digest = source_digest(*TRIAL_SOURCES, distributions=("numpy", "open3d"))
    distributions = importlib.metadata.packages_distributions().get(library, [library])
    try:
        return f"{library} {importlib.metadata.version(distributions[0])} ({digest})"
    except importlib.metadata.PackageNotFoundError:
        return f"{library} ({digest})"
