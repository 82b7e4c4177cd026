"""`python -m adagmm_fusion` is the command `adagmm-fusion`."""

import sys

from adagmm_fusion.cli import main

sys.exit(main())
