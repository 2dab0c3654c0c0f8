"""A board of 240 blind cases in parts of 12: run.py run START STEP KEEP, then run.py score KEEP PARTS [OPTION ...].

A part that is done goes into an archive of its own under KEEP, and is not run again where its archive is there.
"""

import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

PARTS, EACH = 20, 12
METHODS = ("diagnose", "bic", "stribeck")
ROOT = Path("runs/board")
BROKEN = 3
"""Exit code of a run with a case that broke off: it counts as wrong, and the board goes on."""


def command(*words: object, fine: tuple[int, ...] = (0,)) -> None:
    """Run one command of hybrid-id; stop where it fails."""
    done = subprocess.run([sys.executable, "-m", "hybrid_id", *map(str, words)]).returncode
    if done not in fine:
        sys.exit(done)


def run(start: int, step: int, keep: Path) -> None:
    """Make and run every step-th part from the start on, as far as it is not kept yet."""
    keep.mkdir(parents=True, exist_ok=True)
    for k in range(start, PARTS, step):
        part, archive = ROOT / f"p{k:02d}", keep / f"p{k:02d}.tar.xz"
        if archive.exists():
            continue
        if not (part / "cases" / "manifest.json").exists():
            options = ("--cases", EACH, "--first", k * EACH + 1, "--seed", "commit")
            command("blind", "make", "--out", part / "cases", "--answers", ROOT / f"p{k:02d}.tar", *options)
        methods = [word for method in METHODS for word in ("--method", method)]
        command("blind", "run", part / "cases", "--out", part / "run", *methods, fine=(0, BROKEN))
        half = archive.with_suffix(".part")
        with tarfile.open(half, "w:xz") as file:
            for path in (part / "run", part / "cases" / "manifest.json", ROOT / f"p{k:02d}.tar"):
                file.add(path, path.relative_to(ROOT))
        half.replace(archive)


def score(keep: Path, parts: int, options: list[str]) -> None:
    """Score the first parts together, from their archives alone: another board may lie where parts are made."""
    with tempfile.TemporaryDirectory() as place:
        home = Path(place)
        for k in range(parts):
            with tarfile.open(keep / f"p{k:02d}.tar.xz") as file:
                file.extractall(home, filter="data")
        answers = [word for k in range(parts) for word in ("--answers", home / f"p{k:02d}.tar")]
        command("blind", "score", *(home / f"p{k:02d}" / "run" for k in range(parts)), *answers, *options)


if sys.argv[1] == "run":
    run(int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
else:
    score(Path(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
