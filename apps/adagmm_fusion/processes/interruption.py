"""Being told to stop: SIGTERM ends a command as Ctrl-C does, with what is finished kept and an exit code of its own."""

import _thread
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# An interrupt that came at a bad moment is sent again after this time.
AGAIN_S = 0.02


class Terminated(KeyboardInterrupt):
    """SIGTERM has come."""


def exit_code(stop: KeyboardInterrupt) -> int:
    """130 after Ctrl-C, 143 after SIGTERM, as shells have it."""
    return 128 + (signal.SIGTERM if isinstance(stop, Terminated) else signal.SIGINT)


@contextmanager
def heard_afterwards() -> Iterator[None]:
    """Within, Ctrl-C and SIGTERM are put off to the end and heard before anything else is done."""
    if threading.current_thread() is not threading.main_thread():  # only there can handlers be set
        yield
        return
    heard: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda number, _: heard.append(number)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if heard:
        signal.raise_signal(heard[0])


@contextmanager
def signals_as_interrupts() -> Iterator[None]:
    """Within, Ctrl-C raises KeyboardInterrupt and SIGTERM Terminated, as soon as they can, see `must_not_stop`.

    SIGTERM does it once: what is then done to keep results is not disturbed by another one.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        if must_not_stop(frame):
            again = threading.Timer(AGAIN_S, _send_to_main_thread, (number,))
            again.daemon = True
            again.start()
        elif number == signal.SIGTERM:
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            raise Terminated
        else:
            raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _send_to_main_thread(number: int) -> None:
    """Send a signal to the main thread itself, which may be asleep; Windows can only have it noticed when it is not."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident, number)
    else:
        _thread.interrupt_main(signal.Signals(number))


def must_not_stop(frame: FrameType | None) -> bool:
    """Whether an exception raised in `frame` would do more than end what runs there.

    An import that is interrupted fails in some way of its own. LLVM asks Python for kernels compiled before: there an
    exception is lost, and the process crashes without what was asked for. In a `__del__` it is lost too. A grammar of
    pyparsing's (for Matplotlib's labels) that is half made prints a traceback when it is thrown away.
    """
    while frame is not None:
        module, function = str(frame.f_globals.get("__name__")), frame.f_code.co_name
        if module == "importlib._bootstrap" or module.startswith("pyparsing.") or function == "__del__":
            return True
        if module == "llvmlite.binding.executionengine" and function.startswith("_raw_"):
            return True
        frame = frame.f_back
    return False
