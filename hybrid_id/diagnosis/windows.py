"""Windows of records that begin where the machine was measured to be; they live on the floor of identification."""

from hybrid_id.identification.horizons import window_errors, windows

__all__ = ["window_errors", "windows"]
