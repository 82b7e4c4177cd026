"""The progress bar of commands that take long."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from adagmm_fusion.processes.terminal import printable


def progress() -> Progress:
    """A progress display on stderr, if that is a terminal."""
    console = Console(stderr=True)
    console.quiet = not console.is_terminal  # before rich 15 a display that is not shown ends in an empty line
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr, if that is a terminal; call what is yielded with how many are done, and of how many."""
    with progress() as display:
        task = display.add_task(printable(description), total=None)
        yield lambda done, total: display.update(task, completed=done, total=total)


@contextmanager
def staged_progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """As progress_bar, of work in stages; call what is yielded with the stage, how many are done, and of how many."""
    with progress() as display:
        task = display.add_task("", total=None)
        yield lambda stage, done, total: display.update(task, description=printable(stage), completed=done, total=total)
