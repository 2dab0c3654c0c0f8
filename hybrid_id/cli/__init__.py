"""The command line `hybrid-id`: it reads arguments and files, calls the package, and writes what came out."""

from hybrid_id.cli.app import app, main

__all__ = ["app", "main"]
