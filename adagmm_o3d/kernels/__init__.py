"""The pair loop: formulas once, loops per device, one pass over all pairs behind `PairLoop`."""

import warnings

# Open3D brings an older TBB than Numba wants; Numba then takes OpenMP, which is as good here, and need not say so.
warnings.filterwarnings("ignore", message=r".*The TBB threading layer requires TBB version")
