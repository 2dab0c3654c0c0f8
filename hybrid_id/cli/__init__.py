"""The command line `hybrid-id`: it reads arguments and files, calls the package, and writes what came out."""

from hybrid_id.cli.entry import main

__all__ = ["main"]
