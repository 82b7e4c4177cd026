"""`--print-completion SHELL`: what makes a shell complete a command's options, printed."""

import argparse
from collections.abc import Callable
from typing import Any

SHELLS = ("bash", "zsh", "tcsh")


def add_completion(top: argparse.ArgumentParser, whole: Callable[[], argparse.ArgumentParser]) -> None:
    """Add the option to a command's grammar; `whole` makes it with the options of all its commands."""

    class PrintCompletion(argparse.Action):
        def __call__(self, parser: argparse.ArgumentParser, namespace: object, values: Any, *_: object) -> None:
            import shtab  # type: ignore[import-untyped,import-not-found,unused-ignore]

            print(shtab.complete(whole(), values))
            parser.exit()

    top.add_argument(
        "--print-completion", choices=SHELLS, action=PrintCompletion, help="print what completes options in a shell"
    )
