"""Sub-commands of `adagmm-fusion`, one file each: `add(commands)` gives it its arguments, and imports little."""
