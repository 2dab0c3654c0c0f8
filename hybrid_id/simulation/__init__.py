"""Simulation: one sample, all samples at once, the free run; torchdiffeq behind `solvers`."""
