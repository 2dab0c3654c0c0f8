"""`make soak`: a training killed (SIGKILL) at random moments and resumed ends as if nobody had touched it.

The processes are killed between their start and well beyond the first checkpoints; a run that is done before its kill
counts as a pass that met none. Prints one line a trial and a summary; exit code 1 where a result differs.
"""

import argparse
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import yaml

sys.path.insert(0, str(Path(__file__).parent))
from drives import make_record, multisine, rigid_drive

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.systems.model_file import save_model


def make_drive(folder: Path) -> None:
    """Two short records of a rigid drive and a model whose values are off."""
    truth = rigid_drive()
    records = tuple(
        make_record(
            truth, multisine(k, samples=300, amplitude=7.0), seed=k, noise={"q_m1": 0.01}, name=f"run_{k}"
        )
        for k in range(2)
    )
    Dataset("soak", (Channel("u1", "V"),), (Channel("q_m1", "rad", 0.01),), records, 0.002).save(folder)
    start = truth.with_values({"J": 2.4e-5, "F_c": 0.008})
    held = {n: replace(start.parameter(n).spec, estimate=False) for n in ("P_m1", "P_m2")}
    save_model(start.with_specs(held), folder / "model.yaml")


def command(data: Path, out: Path, *more: str) -> list[str]:
    """The training's command line; a study without pages, for these take longer than the training."""
    return [sys.executable, "-m", "hybrid_id", "train", str(data / "study.yaml"), "--out", str(out), *more]


def values(out: Path) -> dict[str, float]:
    """Identified values of a finished run."""
    return json.loads((out / "result.json").read_text())["selected"]["values"]


def trial(data: Path, out: Path, longest: float, draw: random.Random) -> int:
    """Run with kills until the result is there; returns how many kills it took."""
    kills = 0
    while not (out / "result.json").exists():
        more = ["--resume"] if (out / "checkpoint.pt").exists() else ["--force"] if out.exists() else []
        run = subprocess.Popen(command(data, out, *more), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        try:
            _, said = run.communicate(timeout=draw.uniform(0.2, longest) if kills < 3 else None)
        except subprocess.TimeoutExpired:
            run.send_signal(signal.SIGKILL)
            run.communicate()
            kills += 1
            continue
        if run.returncode:
            raise SystemExit(f"exit code {run.returncode} after {kills} kills: {said.decode()[-400:]}")
    return kills


def main() -> None:
    """Parse, run, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    wish = parser.parse_args()
    draw, failures, kills = random.Random(wish.seed), 0, 0
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        make_drive(data)
        output = {"report": False, "figures": False, "tensorboard": False}
        study = {"dataset": ".", "model": "model.yaml", "output": output}
        (data / "study.yaml").write_text(yaml.safe_dump(study))
        start = time.monotonic()
        subprocess.run(command(data, Path(folder) / "whole"), check=True, capture_output=True)
        longest, whole = time.monotonic() - start, values(Path(folder) / "whole")
        for k in range(wish.trials):
            out = Path(folder) / f"trial_{k}"
            met = trial(data, out, longest, draw)
            same = values(out) == whole
            left = [path.name for path in Path(folder).iterdir() if path.name.startswith(".")]
            kills, failures = kills + met, failures + (not same)
            print(
                f"trial {k}: {met} kills, {'the same' if same else 'ANOTHER'} result, left over: {left}",
                flush=True,
            )
    print(f"{wish.trials} trials, {kills} kills, {failures} results differ; one run takes {longest:.1f} s")
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
