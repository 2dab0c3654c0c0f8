"""SO-101: the table under the arm, judged by all joints at once, by one of two halves: floor.py --data FOLDER HALF."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import so101
import torch
from halves import nominal

from hybrid_id.components.load.floor_contact import FloorContact
from hybrid_id.diagnosis.fits import FULL, WINDOW, Fits, Task
from hybrid_id.diagnosis.model import FittedModel, Name
from hybrid_id.diagnosis.select import accepted, chance
from hybrid_id.identification.horizons import Horizon
from hybrid_id.parameters import Bounded
from hybrid_id.systems.by_joint import with_standing_held
from hybrid_id.systems.chain import System

FLOOR: Name = ("floor_contact", "joint2/load")
ROUNDS = 3
"""Fits to the end, each from where the one before has ended: a robot goes on for long."""


def fitted(fits: Fits, effects: tuple[Name, ...], start: System) -> FittedModel:
    """The robot fitted until one more fit to the end gains less than a hundredth; judged by motions left out."""
    ends: list[FittedModel] = []
    for _ in range(ROUNDS):
        again = fits.run([Task(effects, ends[-1].system if ends else start)], FULL)[0]
        if again is None:
            raise RuntimeError(f"the robot cannot be fitted: {fits.tally.as_dict()}")
        ends.append(again)
        if len(ends) > 1 and again.trained > 0.99 * ends[-2].trained:
            break
    return min(ends, key=lambda one: one.trained)


def main() -> None:
    """Fit all moving joints over windows, without and with a floor, and compare them on motions left out."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--data", type=Path, required=True)
    ask.add_argument("half", type=int, choices=(0, 1))
    wish = ask.parse_args()
    torch.set_num_threads(1)
    motions = so101.load(wish.data, "train")["train"]
    motions = replace(motions, records=motions.records[wish.half :: 2])
    motions, robot = with_standing_held(motions, nominal(wish.data, table=False))
    fits = Fits(motions).over(Horizon("windows", WINDOW))
    plain = fitted(fits, (), robot)
    point = next(p.point for p in nominal(wish.data).components.values() if isinstance(p, FloorContact))
    floor = FloorContact(point, z_f=Bounded(-0.03, -0.2, 0.2, "m"), k_f=Bounded(300.0, 0.0, 1e5, "N/m"))
    richer = fitted(fits, (FLOOR,), plain.system.with_component(FLOOR[1], floor))
    fits.weights = plain.validation.even_weights()
    plain, richer = (
        replace(one, validation=one.validation.weighted(fits.weights)) for one in (plain, richer)
    )
    found = {i.symbol: i.spec.value for i in richer.system.table if i.symbol in ("z_f", "k_f")}
    print(
        f"half {wish.half}: mean square left out {plain.error:.2f} without, {richer.error:.2f} with a floor (fall "
        f"{richer.validation.fall(plain.validation):.2f}, by chance {chance(richer, plain):.4f}, accepted: "
        f"{accepted(richer, plain)}); z_f {found['z_f']:.4f} m, k_f {found['k_f']:.0f} N/m"
    )


if __name__ == "__main__":
    main()
