"""Being told to stop: SIGTERM and SIGHUP end a command as Ctrl-C does, with what is finished kept and an exit code of
their own."""

import _thread
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Compiled code calls these, and takes an exception in them for something else or for nothing.
LOST_IN = ("__del__", "__array__")
# An interrupt that came at a bad moment is sent again after this time.
AGAIN_S = 0.02


class Terminated(KeyboardInterrupt):
    """SIGTERM has come."""

    number = signal.SIGTERM


class HungUp(Terminated):
    """SIGHUP has come: the terminal has gone."""

    number = getattr(signal, "SIGHUP", signal.SIGTERM)


STOPS: dict[int, type[Terminated]] = {signal.SIGTERM: Terminated}
if hasattr(signal, "SIGHUP"):
    STOPS[signal.SIGHUP] = HungUp


def exit_code(stop: KeyboardInterrupt) -> int:
    """130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP, as shells have it."""
    return 128 + (stop.number if isinstance(stop, Terminated) else signal.SIGINT)


def word_for(stop: KeyboardInterrupt) -> str:
    """What has happened, in a word for the user."""
    return "hung up" if isinstance(stop, HungUp) else "terminated" if isinstance(stop, Terminated) else "interrupted"


def _heard() -> tuple[int, ...]:
    """The signals that end a command. Under nohup SIGHUP is ignored, and stays so."""
    return (signal.SIGINT, *(number for number in STOPS if signal.getsignal(number) != signal.SIG_IGN))


@contextmanager
def heard_afterwards() -> Iterator[None]:
    """Within, Ctrl-C, SIGTERM and SIGHUP are put off to the end and heard before anything else is done."""
    if threading.current_thread() is not threading.main_thread():  # only there can handlers be set
        yield
        return
    heard: list[int] = []
    before = {number: signal.signal(number, lambda number, _: heard.append(number)) for number in _heard()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if heard:
        signal.raise_signal(heard[0])


@contextmanager
def signals_as_interrupts() -> Iterator[None]:
    """Within, Ctrl-C raises KeyboardInterrupt, SIGTERM Terminated and SIGHUP HungUp, as soon as they can, see
    `must_not_stop`.

    The last two do it once: what is then done to keep results is not disturbed by another one.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        if must_not_stop(frame):
            again = threading.Timer(AGAIN_S, _send_to_main_thread, (number,))
            again.daemon = True
            again.start()
        elif number in STOPS:
            for other in STOPS:
                signal.signal(other, signal.SIG_IGN)
            raise STOPS[number]
        else:
            raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in _heard()}
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
    exception is lost, and the process crashes without what was asked for. In a `__del__` it is lost too,
    and in an `__array__`, which Matplotlib's drawing asks for, it becomes another error. A grammar of pyparsing's (for
    Matplotlib's labels) that is half made prints a traceback when it is thrown away.
    """
    while frame is not None:
        module, function = str(frame.f_globals.get("__name__")), frame.f_code.co_name
        if module == "importlib._bootstrap" or module.startswith("pyparsing.") or function in LOST_IN:
            return True
        if module == "llvmlite.binding.executionengine" and function.startswith("_raw_"):
            return True
        frame = frame.f_back
    return False
