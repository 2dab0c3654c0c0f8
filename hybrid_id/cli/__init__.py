"""The command line `hybrid-id`: it reads arguments and files, calls the package, and writes what came out."""

import io
import os
import signal
import sys
import warnings
from typing import NoReturn


def main() -> NoReturn:
    """Run the command line of this process and leave with its exit code.

    From the first import to the last line, Ctrl-C ends it with one sentence or not at all.
    """
    # the matrices are small: a second thread costs time, and rounds them otherwise than a process of --jobs does
    for library in ("OMP", "MKL", "OPENBLAS"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    # a worker that has grown is replaced by a fresh one: nothing is lost, and nothing to be done about it
    warnings.filterwarnings("ignore", message="A worker stopped while some jobs", category=UserWarning)
    for stream in (sys.stdout, sys.stderr):  # a terminal in ASCII has no ±
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        from hybrid_id.cli.app import app
    except KeyboardInterrupt:
        print("Error: stopped; no results were written.", file=sys.stderr)
        sys.exit(130)
    try:
        app()
    finally:  # what the command had to say is said: a Ctrl-C while Python tidies up would deny it
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise AssertionError("a command line ends with its exit code")
