"""The world: batched, structure-of-arrays, Numba; no learning in it."""

from densecavoid.sim._jit import kernels_are_compiled

__all__ = ["kernels_are_compiled"]
