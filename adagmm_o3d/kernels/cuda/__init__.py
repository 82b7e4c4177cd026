"""The CUDA twins of the CPU kernels. Nothing here is imported before a GPU is asked for; see `availability`."""
