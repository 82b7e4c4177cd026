"""All that is compiled: formulas once, loops over pairs for each device, and what EM makes of their sums.

`formulas` and `layout` are shared by `cpu` and `cuda`, whose files of one name are twins; `update` is what both loops
of EM do between two passes. `pairs` and `em` call these, and nothing here knows of them.
"""

import warnings

# Open3D brings an older TBB than Numba wants; Numba then takes OpenMP, which is as good here, and need not say so.
warnings.filterwarnings("ignore", message=r".*The TBB threading layer requires TBB version")
