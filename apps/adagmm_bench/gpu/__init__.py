"""What the command `gpu` measures. Its modules import CUDA where they use it, so that all can be imported without."""
