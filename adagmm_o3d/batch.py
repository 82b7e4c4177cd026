"""`register_batch`: many pairs at once, a thread each."""

from __future__ import annotations

import inspect
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from adagmm_o3d.arguments import whole_number
from adagmm_o3d.array_registration import register_points
from adagmm_o3d.errors import InputTypeError
from adagmm_o3d.lazy_open3d import is_installed
from adagmm_o3d.options import DeviceName
from adagmm_o3d.pairs.device import check_device
from adagmm_o3d.registration import kind_of, registration_adaptive_gmm

if TYPE_CHECKING:
    from adagmm_o3d.open3d_results import RegistrationResult, TensorRegistrationResult
    from adagmm_o3d.result import PointRegistrationResult

    Registered = PointRegistrationResult | RegistrationResult | TensorRegistrationResult

# How often a thread that only waits looks whether it was interrupted [s].
LOOK_S = 0.2
# Where the pair of a tuple has its `max_correspondence_distance`.
DISTANCE = 2


def register_batch(
    pairs: Iterable[Sequence[Any] | Mapping[str, Any]],
    *,
    threads: int | None = None,
    device: DeviceName = "cpu",
    **arguments: Any,
) -> list[Registered | Exception]:
    """Register many pairs on all cores; each to the last bit as by itself.

    Parameters
    ----------
    pairs : each a tuple of what its door takes, (source, target) or more, or a dictionary of that by name. Arrays go to
        `register_points`, Open3D's clouds to `registration_adaptive_gmm`, which needs a `max_correspondence_distance`;
        a cloud that is in many pairs is best prepared, see `prepare`.
    threads : pairs at a time; None for one on each core that Numba may use. What cores there are more, they share.
    device : as in `register_points`. Other than "cpu", pairs are registered one after another.
    arguments : what all pairs have in common, e.g. `max_correspondence_distance` or `criteria`; what a pair says itself
        goes before.

    Returns
    -------
    For each pair its result, in their order, or the exception that it raised: one that fails does not take the others
    with it. Ctrl-C begins no more pairs, and is raised at once.

    Raises
    ------
    InputTypeError, InputError, DeviceError : what is no pair, clouds without a `max_correspondence_distance`, or an
        argument out of its range.
    """
    check_device(device)
    if not isinstance(pairs, Iterable):
        raise InputTypeError(f"pairs: expected (source, target) pairs, got {type(pairs).__name__}")
    jobs = [_job(f"pairs[{k}]", pair, arguments | {"device": device}) for k, pair in enumerate(pairs)]
    if threads is not None:
        threads = whole_number("threads", threads, minimum=1)
    return _run(jobs, threads) if device == "cpu" else [_attempt(job) for job in jobs]


def _job(name: str, pair: Any, arguments: dict[str, Any]) -> Callable[[], Registered]:
    if isinstance(pair, Mapping):
        given, named = (), arguments | dict(pair)
        missing = [role for role in ("source", "target") if role not in pair]
        if missing:
            raise InputTypeError(f"{name}: expected a source and a target, got no {missing[0]}")
        source = pair["source"]
    elif isinstance(pair, (tuple, list)) and len(pair) >= 2:
        given, named = tuple(pair), arguments
        source = pair[0]
    else:
        got = f"{len(pair)} of them" if isinstance(pair, (tuple, list)) else type(pair).__name__
        raise InputTypeError(f"{name}: expected a tuple (source, target) or a dictionary of arguments, got {got}")
    if named["device"] != arguments["device"]:
        raise InputTypeError(f"{name}: expected no device of its own; give register_batch() one for all")
    clouds = is_installed() and kind_of(source) in ("legacy", "tensor")
    if clouds and len(given) <= DISTANCE and "max_correspondence_distance" not in named:
        raise InputTypeError(
            f"{name}: expected max_correspondence_distance for Open3D's clouds, got none; give it to the pair, third "
            "in a tuple, or to register_batch()"
        )
    door: Callable[..., Registered] = registration_adaptive_gmm if clouds else register_points
    known = inspect.signature(door).parameters
    if unknown := [argument for argument in arguments if argument not in known]:
        raise InputTypeError(f"{unknown[0]}: {door.__name__}() has no such argument; it takes {', '.join(known)}")
    return partial(door, *given, **named)


def _attempt(job: Callable[[], Registered]) -> Registered | Exception:
    try:
        return job()
    except Exception as error:
        return error


def _run(jobs: list[Callable[[], Registered]], threads: int | None) -> list[Registered | Exception]:
    """Every job on one of so many threads, which the kernels let run at the same time."""
    import numba

    cores = numba.get_num_threads()
    workers = min(len(jobs), cores if threads is None else threads)
    results: list[Any] = [None] * len(jobs)
    waiting = deque(range(len(jobs)))

    def work() -> None:
        numba.set_num_threads(max(1, cores // workers))
        while True:
            try:
                k = waiting.popleft()
            except IndexError:
                return
            results[k] = _attempt(jobs[k])

    helpers = [threading.Thread(target=work, name=f"adagmm_o3d-batch-{k}", daemon=True) for k in range(workers)]
    try:
        for helper in helpers:
            helper.start()
        for helper in helpers:
            while helper.is_alive():
                helper.join(LOOK_S)
    finally:
        waiting.clear()
    return results
