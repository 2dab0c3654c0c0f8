"""One case: a machine with something at work in it, its experiments, and the nominal model; how difficult it is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hybrid_id.machines.arm import Arm
from hybrid_id.machines.effects import Effect
from hybrid_id.machines.effects.base import UNKNOWN
from hybrid_id.machines.experiments import Campaign, noise_std
from hybrid_id.machines.rivals import Rival
from hybrid_id.machines.robots import Robot
from hybrid_id.machines.trials import Measured, Simulator
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record


@dataclass(frozen=True, eq=False)
class Case:
    """What a case is made of.

    Attributes:
        name: of its folder.
        robot: the machine without effects.
        campaign: planned records.
        model: the nominal model, as the content of a model file.
        files: further files beside it, by name.
    """

    name: str
    robot: Robot | Arm
    campaign: Campaign
    model: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)

    def dataset(self, measured: Measured) -> Dataset:
        """The records as they are written."""
        campaign, time = self.campaign, self.campaign.sample_time
        inputs, outputs, records = self.robot.inputs, self.robot.outputs, []
        for b, length in enumerate(campaign.lengths):
            volts, angles = measured.volts[:length, :, b], np.round(measured.angles[:length, :, b], 7)
            records.append(
                Record(
                    name=f"rec_{b:02d}",
                    time=np.round(time * np.arange(length), 6),
                    inputs={one.name: np.round(volts[:, i], 7) for i, one in enumerate(inputs)},
                    outputs={name: angles[:, i] for i, name in enumerate(outputs)},
                    role="train" if campaign.roles[b] == "train" else "test",
                    note=campaign.notes[b],
                )
            )
        noise = noise_std(campaign.encoders)
        channels = (Channel(n, "rad", float(f"{std:.3g}")) for n, std in zip(outputs, noise, strict=True))
        return Dataset(self.name, tuple(inputs), tuple(channels), tuple(records), time)

    def nominal(self) -> Simulator:
        """Today's simulator of a single drive, without any effect."""
        given = {name: float(entry["nominal"]) for name, entry in self.model["parameters"].items()}
        return Simulator(0, (), {**dict.fromkeys(self.robot.values, 0.0), **given})


@dataclass(frozen=True)
class Part:
    """One effect of a case.

    Attributes:
        effect: in its final size.
        rivals: other effects in its place, the best first; none of a small one.
        shares: what the answers say of it beyond that: its ``role`` (dominant or small), the share of the gap that it
            ``closes`` alone and in its place of the order (``share``), both on the test and on the train records, and
            the ``lift`` of the re-fit's error over the floor by a small one alone.
    """

    effect: Effect
    rivals: Sequence[Rival] = ()
    shares: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Graded:
    """A case of known difficulty.

    Attributes:
        case: the case.
        measured: its records.
        nominal, refit, with_effect, floor: normalised RMSE on the test records of the nominal model as it stands,
            re-fitted, and with what it lacks, and of the machine itself.
        level: strong, medium, weak or none.
        parts: its effects, in the order in which they are added.
        notes: what else the answers tell in passing.
        more: further keys of the answers.
    """

    case: Case
    measured: Measured
    nominal: float
    refit: float
    with_effect: float
    floor: float
    level: str
    parts: Sequence[Part] = ()
    notes: Mapping[str, Any] = field(default_factory=dict)
    more: Mapping[str, Any] = field(default_factory=dict)


def level_of(ratio: float) -> str:
    """Level of a ratio of re-fit to noise floor, as the format of cases defines it."""
    return "strong" if ratio >= 3 else "medium" if ratio >= 1.5 else "weak" if ratio >= 1.15 else "none"


def short(value: Any) -> float:
    """A number as answers hold it."""
    return float(f"{float(value):.4g}")


def ground_truth(graded: Graded, family: str, seed: int, draw: int) -> dict[str, Any]:
    """The ground truth of a case.

    Args:
        graded: the case with its effects.
        family: single, pair, none, parameters or unknown.
        seed: that it was made from.
        draw: which of the machines that were drawn.
    """
    case = graded.case
    rest = [
        {f"{one.effect.name}@{one.effect.joint + 1}": round(one.rest, 3) for one in part.rivals[:6]}
        for part in graded.parts
        if part.rivals
    ]
    oracle = {
        "nominal": graded.nominal,
        "refit": graded.refit,
        "with_effect": graded.with_effect,
        "noise_floor": graded.floor,
    }
    return {
        "family": family,
        "effects": [_answer(part, case.robot) for part in graded.parts],
        "level": graded.level,
        "oracle": {name: short(value) for name, value in oracle.items()},
        "made_by": {
            "system": case.robot.system,
            "seed": seed,
            "draw": draw,
            "formulas": [part.effect.formula for part in graded.parts],
        },
        **graded.more,
        "notes": {**graded.notes, **({"rest_of_gap_with_rival": rest} if rest else {})},
    }


def _answer(part: Part, robot: Robot | Arm) -> dict[str, Any]:
    """One effect of the ground truth, with all that counts as right."""
    effect, places = part.effect, robot.places(part.effect)
    right = [effect, *(rival.effect for rival in part.rivals if rival.counts)]
    pairs = [(one.name, place) for one in right for place in robot.places(one)]
    if effect.alias is not None:
        name, place = effect.alias
        pairs.append((name, f"{places[0].partition('/')[0]}/{place}"))
    known = [(name, place) for name, place in pairs if name != UNKNOWN]
    return {
        "name": effect.name,
        "where": places[-1] if effect.name == "link_mass" else places[0],
        "accept": list(dict.fromkeys(name for name, _ in known)),
        "accept_where": list(dict.fromkeys(place for _, place in pairs)),
        "right": list(dict.fromkeys(f"{name}@{place}" for name, place in known)),
        "size": effect.size(),
        **part.shares,
    }
