"""`python -m adagmm_bench` is the command `adagmm-bench`."""

import sys

from adagmm_bench.cli import main

if __name__ == "__main__":
    sys.exit(main())
