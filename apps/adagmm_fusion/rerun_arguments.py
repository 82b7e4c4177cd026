"""The arguments that Rerun users know, without importing Rerun, which takes most of a second."""

import argparse


def add_rerun_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what `rerun.script_add_args` adds; `--serve` binds to loopback here, `--port` chooses where."""
    parser.add_argument("--headless", action="store_true", help="Don't show GUI")
    parser.add_argument("--connect", action="store_true", help="Connect to an external viewer")
    parser.add_argument(
        "--serve",
        action="store_true",
        help="Host a GRPC & web server and open a web viewer connecting to it.",
    )
    parser.add_argument("--url", type=str, default=None, help="Connect to this Rerun URL")
    parser.add_argument("--save", type=str, default=None, help="Save data to a .rrd file at this path")
    parser.add_argument(
        "--stdout", action="store_true", help="Log data to standard output, to be piped into a Rerun Viewer"
    )
    parser.add_argument("--port", type=int, default=None, help="With --serve: the gRPC port (default: a free one)")


def logs_to_file(args: argparse.Namespace) -> bool:
    """Whether these arguments, and `--no-rerun`, leave it to a file to take what is logged."""
    return not (args.no_rerun or args.connect or args.serve or args.url or args.stdout)
