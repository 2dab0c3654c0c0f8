"""Measured records: what they are, how they are read, checked and resampled.

Import from the modules: `record`, `dataset`, `readers`, `resample`, `quality`; `fourier` and `derivatives` filter
signals.
"""
