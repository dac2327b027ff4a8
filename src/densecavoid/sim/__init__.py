"""The world: batched, structure-of-arrays, Numba; no learning in it."""
