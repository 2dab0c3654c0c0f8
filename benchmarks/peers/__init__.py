"""Peers of the speed comparison: one file each, `prepare(problem, **options)` returns `solve(problem) -> Estimate`."""
