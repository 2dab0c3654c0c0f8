"""A case of an arm: its records, its description, and its ground truth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.machines.arms.effects import FRICTION, KINDS, OUTSIDE, Effect, draw_effect, draw_small
from hybrid_id.machines.arms.motion import (
    SAMPLE,
    TRAIN,
    Motion,
    Unstable,
    carried,
    counted,
    draw_goals,
    moved,
)
from hybrid_id.machines.arms.refit import Fit, OneByOne
from hybrid_id.machines.arms.robot import Arm, described, draw_arm, mjcf
from hybrid_id.machines.effects.base import UNKNOWN
from hybrid_id.machines.grading import level_of
from hybrid_id.machines.judge import SOUND
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.records.units import number_of

SOURCE = 6
"""Of the random numbers that arms are drawn from, beside the seed."""
FAMILIES = {"single": 0.775, "unknown": 0.125, "parameters": 0.10}
"""Families of arms: one dominant effect, one outside the catalogue, or nothing but wrong values."""
WRONG = 0.195
"""Values of the description are off by up to this share."""
SPREAD = (0.008, 0.042)
"""Standard deviation of the factor on a joint's friction between records."""
DOMINANT, TWICE = 0.4, 2.0
"""Share of the gap that the dominant effect closes at least, on train and on test records, and how many times that of
the largest small one."""
PLAIN = 1.6
"""Error of the re-fitted joint over that with all effects, at least, where the dominant effect acts; where nothing is
missing, of the described arm over the re-fitted one."""
SEEN = 0.01
"""Rise of a joint's error from which a small effect that lacks is one that is at work."""
ROUNDS = 11
"""Steps of a fit, at most."""
CLOSE, OPEN = 1.06, 0.12
"""A rival counts up to this error relative to the true effect's, and up to this share of what that closes left open."""
IMITATED = 0.5
"""Share of what acts outside the catalogue that an effect of the catalogue may explain."""
STARTS = 2
"""Draws of a rival's values from which its fits start."""
SAME = {"delay": ("electrical_lag", "motor")}
"""What the catalogue has a second law for, with its place: a delay is a lag to the first order."""


@dataclass(frozen=True, eq=False)
class ArmCase:
    """A case.

    Attributes:
        dataset: its records.
        description: MJCF of the nominal arm.
        truth: its ground truth.
    """

    dataset: Dataset
    description: str
    truth: dict[str, Any]


@dataclass(frozen=True, eq=False)
class _Drawn:
    """An arm with its effects.

    Attributes:
        bare, arm: without and with them.
        lead: the dominant effect, None where nothing is missing.
        small: of each joint.
    """

    bare: Arm
    arm: Arm
    lead: Effect | None
    small: tuple[tuple[Effect, ...], ...]

    @property
    def outside(self) -> list[Effect]:
        """The dominant effect where its drives do not have it."""
        return [self.lead] if self.lead is not None and self.lead.formula else []

    @property
    def formulas(self) -> list[str]:
        """Formula or name of the dominant effect, as the ground truth keeps it."""
        return [] if self.lead is None else [self.lead.formula or self.lead.name]


def family_of(seed: int, family: str | None, effect: str | None) -> str:
    """Family of a case, drawn where it is not given."""
    if family is None and effect:
        family = "unknown" if effect in OUTSIDE else "single"
    return family or str(np.random.default_rng([seed, 5]).choice(list(FAMILIES), p=list(FAMILIES.values())))


def draw_arm_case(seed: int, draw: int, name: str, family: str, effect: str | None) -> ArmCase | None:
    """One attempt at a case; None where its dominant effect does not come out as one.

    Args:
        seed: source of all that is random.
        draw: number of the attempt.
        name: of the case.
        family: one of :data:`FAMILIES`.
        effect: name of the dominant effect, of the formula for one outside the catalogue; None to draw it.

    Raises:
        InputError: MuJoCo is not installed.
    """
    rng = np.random.default_rng([seed, SOURCE, draw])
    drawn = _draw(rng, family, effect)
    if drawn is None:
        return None
    arm, joints = drawn.arm, len(drawn.arm.links)
    spread = rng.uniform(*SPREAD, joints)
    drift = 1.0 + spread * np.clip(rng.standard_normal((TRAIN + 1, joints)), -2.0, 2.0)
    try:
        motions = [
            moved(arm, draw_goals(rng, joints), drawn.outside, own, rng.uniform(-np.pi, np.pi))
            for own in drift
        ]
    except Unstable:
        return None
    angles = [np.round(counted(arm, one.angle, rng), 7) for one in motions]
    nominal = described(drawn.bare, rng, WRONG)
    fits = _fitted(rng, drawn, nominal, motions, angles)
    if fits is None:
        return None
    truth = _truth(drawn, fits, family, (seed, draw))
    truth["messy"]["drift_of_friction"] = [_short(one) for one in drift.std(axis=0)]
    return ArmCase(_dataset(name, arm, motions, angles), mjcf(nominal), truth)


class SameArm:
    """The arm of a case once more, for experiments beyond its own.

    Args:
        seed: of the case, as its answers tell.
        draw: which of the arms that were tried, as its answers tell.
        family: as it was given to :func:`draw_arm_case`.
        effect: likewise.

    Attributes:
        engine, formulas, sizes: as the ground truth has them.
    """

    engine = "mujoco"

    def __init__(self, seed: int, draw: int, family: str, effect: str | None) -> None:
        rng = np.random.default_rng([seed, SOURCE, draw])
        drawn = _draw(rng, family, effect)
        if drawn is None:
            raise InputError("its answers belong to another version of the generator")
        self.drawn, self.spread = drawn, rng.uniform(*SPREAD, len(drawn.arm.links))
        self.formulas = drawn.formulas
        self.sizes = [] if drawn.lead is None else [_size(drawn.lead)]

    def record(self, experiment: Mapping[str, Any], name: str, *, seed: int) -> Record:
        """Move the arm by a proposed experiment, the other joints held.

        Noise and drift of the friction are new, of the case's size.

        Args:
            experiment: number of the ``joint`` that moves, its ``command`` (T,) [rad], a goal for its controller, the
                ``sample_time``, the angles at which others are ``held``, and the ``start``, by channel.
            name: of the record.
            seed: of noise and drift.

        Raises:
            InputError: another sample time than the case's.
            Unstable: the arm runs away.
        """
        arm, joints = self.drawn.arm, len(self.drawn.arm.links)
        if abs(experiment["sample_time"] - SAMPLE) > 1e-9:
            raise InputError(f"a further record of an arm needs the sample time {SAMPLE} s of its case")
        rng, own, command = (
            np.random.default_rng([seed, 7]),
            experiment["joint"] - 1,
            np.array(experiment["command"]),
        )
        goals = np.zeros((len(command), joints))
        for channel, angle in (*experiment["held"].items(), *experiment["start"].items()):
            goals[:, int(number_of(channel)) - 1] = angle
        goals[:, own] = command
        drift = 1.0 + self.spread * np.clip(rng.standard_normal(joints), -2.0, 2.0)
        motion = moved(arm, goals, self.drawn.outside, drift, rng.uniform(-np.pi, np.pi))
        return _record(name, arm, motion, np.round(counted(arm, motion.angle, rng), 7), "train")


def _draw(rng: np.random.Generator, family: str, effect: str | None) -> _Drawn | None:
    bare, moment = draw_arm(rng)
    joints = len(bare.links)
    if family in SOUND:
        return _Drawn(bare, bare, None, ((),) * joints)
    names = list(OUTSIDE) if family == UNKNOWN else [n for n, kind in KINDS.items() if kind.fits(bare.servo)]
    if effect is not None and effect not in names:
        return None
    wanted = effect or str(rng.choice(names))
    at = int(rng.integers(joints))
    of = (UNKNOWN, wanted) if family == UNKNOWN else (wanted, "")
    lead = draw_effect(rng, of[0], at, bare.drives[at], moment[at], of[1])
    if wanted == "friction_over_other_joint":
        others = [k for k in range(joints) if k != at]
        lead = replace(lead, values={**lead.values, "other": float(rng.choice(others))})
    small = tuple(
        tuple(one for one in own if (one.name, one.joint) != (lead.name, at))
        for own in draw_small(rng, bare.drives, bare.servo)
    )
    drives = []
    for k, own in enumerate(bare.drives):
        for one in (*small[k], *((lead,) if k == at else ())):
            own = one.on(own)
        drives.append(own)
    return _Drawn(bare, replace(bare, drives=tuple(drives)), lead, small)


@dataclass(frozen=True, eq=False)
class _Fits:
    """Fits of an arm's joints one by one.

    Attributes:
        nominal, base, floor: by joint: as described, re-fitted, and with all effects.
        lead: re-fitted with the dominant effect, by the joints that feel it.
        without: by joint, with all effects but one of its small ones.
        rivals: at the dominant effect's joint, by name.
    """

    nominal: list[Fit]
    base: list[Fit]
    floor: list[Fit]
    lead: dict[int, Fit]
    without: list[list[Fit]]
    rivals: dict[str, Fit]

    def gap(self, of: str) -> float:
        """Of the re-fitted arm, on the train or the test records."""
        return sum(
            max(getattr(a, of) - getattr(b, of), 0.0) for a, b in zip(self.base, self.floor, strict=True)
        )

    def closes(self, of: str) -> float:
        """Share of the gap that the dominant effect closes."""
        closed = sum(getattr(self.base[k], of) - getattr(one, of) for k, one in self.lead.items())
        return closed / max(self.gap(of), 1e-300)


def _fitted(
    rng: np.random.Generator,
    drawn: _Drawn,
    described_arm: Arm,
    motions: Sequence[Motion],
    angles: Sequence[np.ndarray],
) -> _Fits | None:
    """All fits; None where the dominant effect does not dominate, or is imitated though outside the catalogue."""
    arm, lead, joints = drawn.arm, drawn.lead, len(drawn.arm.links)
    at = 0 if lead is None else lead.joint
    masses = [one.mass for one in arm.drives]
    small = [
        0.0 if lead is not None and lead.name == "link_mass" and k == at else m for k, m in enumerate(masses)
    ]
    nominal = carried(arm, [0.0] * joints, motions)
    one_by_one = OneByOne(
        arm,
        motions,
        angles,
        nominal,
        carried(arm, small, motions).less(nominal),
        carried(arm, [float(k == at) for k in range(joints)], motions).less(nominal),
    )
    felt = [] if lead is None else arm.carriers(at) if lead.name == "link_mass" else [at]

    def full(k: int, but: Effect | None = None) -> Fit:
        drive = drawn.bare.drives[k]
        for one in drawn.small[k]:
            drive = drive if one is but or one.name == "link_mass" else one.on(drive)
        if lead is not None and k in felt:
            drive = lead.on(drive)
        masses_too = bool(drawn.small[k]) and not (but is not None and but.name == "link_mass")
        return Fit(k, drive, small=masses_too, outside=lead is not None and bool(lead.formula))

    plain = [Fit(k, own) for k, own in enumerate(drawn.bare.drives)]
    leading = [
        Fit(
            k,
            lead.on(drawn.bare.drives[k]),
            () if lead.formula else tuple(lead.values),
            outside=bool(lead.formula),
        )
        for k in felt
        if lead is not None
    ]
    found = one_by_one.fit([*plain, *(full(k) for k in range(joints)), *leading], ROUNDS)
    base, floor, leads = (
        found[:joints],
        found[joints : 2 * joints],
        dict(zip(felt, found[2 * joints :], strict=True)),
    )
    first = one_by_one.fit([Fit(k, own) for k, own in enumerate(described_arm.drives)], 0)
    fits = _Fits(first, base, floor, leads, [[] for _ in range(joints)], {})
    if lead is None:
        return fits if _error(first) >= PLAIN * _error(base) else None
    plainly = np.sqrt(base[at].test / floor[at].test) >= PLAIN
    if not plainly or not min(fits.closes("train"), fits.closes("test")) >= DOMINANT:
        return None
    lacking = one_by_one.fit([full(k, one) for k in range(joints) for one in drawn.small[k]], ROUNDS)
    rest = iter(lacking)
    without = [[next(rest) for _ in own] for own in drawn.small]
    largest = max((one.train - floor[one.joint].train for one in lacking), default=0.0) / fits.gap("train")
    if fits.closes("train") < TWICE * largest:
        return None
    rivals = _rivals(rng, drawn, one_by_one, base[at], lead)
    if lead.formula and any(_open(base[at], leads[at], one) < 1.0 - IMITATED for one in rivals.values()):
        return None
    return replace(fits, without=without, rivals=rivals)


def _rivals(
    rng: np.random.Generator, drawn: _Drawn, one_by_one: OneByOne, base: Fit, lead: Effect
) -> dict[str, Fit]:
    """The best fit of every other effect at the joint of the dominant one, which it takes the place of."""
    starts, names = [], []
    heavy = 0.07 * base.drive.gain  # a dominant effect's size at a joint of this stiffness
    for name, kind in KINDS.items():
        if name != lead.name and kind.fits(drawn.arm.servo):
            for _ in range(STARTS):
                values = kind.draw(rng, base.drive, heavy)
                starts.append(Fit(lead.joint, replace(base.drive, **values), tuple(values)))
                names.append(name)
    found: dict[str, Fit] = {}
    for name, one in zip(names, one_by_one.fit(starts, ROUNDS + 3), strict=True):
        if name not in found or one.train < found[name].train:
            found[name] = one
    return found


def _open(base: Fit, lead: Fit, rival: Fit, of: str = "test") -> float:
    """Share of what the true effect closes that a rival leaves open, on the test or the train records."""
    return float(
        1.0 - (getattr(base, of) - getattr(rival, of)) / max(getattr(base, of) - getattr(lead, of), 1e-300)
    )


def _error(joints: Sequence[Fit]) -> float:
    """Normalised RMSE on the test record, mean of the joints."""
    return float(np.mean([np.sqrt(one.test) for one in joints]))


def _counts(base: Fit, lead: Fit, rival: Fit) -> bool:
    """Whether a rival explains the records as well as the true effect."""
    return all(
        getattr(rival, of) <= CLOSE**2 * getattr(lead, of) and _open(base, lead, rival, of) < OPEN
        for of in ("train", "test")
    )


def _small_answers(drawn: _Drawn, fits: _Fits, gap: float) -> Iterator[dict[str, Any]]:
    """Entries of the small effects without which a re-fit errs enough to be seen; ``gap`` of the train records."""
    for k, own in enumerate(drawn.small):
        for one, lacking in zip(own, fits.without[k], strict=True):
            lift = float(np.sqrt(lacking.train / fits.floor[k].train)) - 1.0
            if lift >= SEEN:
                share = round((lacking.train - fits.floor[k].train) / gap, 4)
                about = {"role": "small", "share_train": share, "closes_train": share, "lift": round(lift, 3)}
                yield _answer(drawn.arm, one, []) | about


def _truth(drawn: _Drawn, fits: _Fits, family: str, source: tuple[int, int]) -> dict[str, Any]:
    """The ground truth, in the form of that of messy machines."""
    arm, lead = drawn.arm, drawn.lead
    effects: list[dict[str, Any]] = []
    ratio = 1.0
    if lead is not None:
        at, gap = lead.joint, fits.gap("train")
        counting = [n for n, one in fits.rivals.items() if _counts(fits.base[at], fits.lead[at], one)]
        effects.append(_answer(arm, lead, counting) | {"role": "dominant"})
        for of, name in (
            ("test", "share"),
            ("test", "closes"),
            ("train", "share_train"),
            ("train", "closes_train"),
        ):
            effects[0][name] = round(fits.closes(of), 4)
        ratio = float(np.sqrt(fits.base[at].test / fits.floor[at].test))
        effects += _small_answers(drawn, fits, gap)
    return {
        "family": family,
        "effects": effects,
        "level": level_of(ratio) if lead is not None else "none",
        "oracle": {
            "nominal": _short(_error(fits.nominal)),
            "refit": _short(_error(fits.base)),
            "with_effect": _short(_error([fits.lead.get(k, one) for k, one in enumerate(fits.base)])),
            "noise_floor": _short(_error(fits.floor)),
        },
        "made_by": {
            "engine": "mujoco",
            "system": "robot",
            "seed": source[0],
            "draw": source[1],
            "formulas": drawn.formulas,
        },
        "messy": {"dominant_outside": family == UNKNOWN},
        "arm": {
            "joints": len(arm.links),
            "drives": "servo" if arm.servo else "torque",
            "noise": _short(arm.noise),
        },
        "notes": {
            "rest_with_rival": {
                name: round(_open(fits.base[lead.joint], fits.lead[lead.joint], one), 3)
                for name, one in sorted(fits.rivals.items(), key=lambda pair: pair[1].test)[:6]
            }
            if lead is not None
            else {}
        },
    }


def _answer(arm: Arm, effect: Effect, rivals: Sequence[str]) -> dict[str, Any]:
    """One effect of the ground truth, with all that counts as right."""
    places, own = _places(arm, effect), arm.names[effect.joint]
    pairs = [(effect.name, where) for where in places]
    pairs += [(name, where) for name in rivals for where in _at(own, KINDS[name].place)]
    if effect.name in SAME:
        name, place = SAME[effect.name]
        pairs.append((name, f"{own}/{place}"))
    known = [(name, where) for name, where in pairs if name != UNKNOWN]
    return {
        "name": effect.name,
        "where": places[-1] if effect.name == "link_mass" else places[0],
        "accept": list(dict.fromkeys(name for name, _ in known)),
        "accept_where": list(dict.fromkeys(where for _, where in pairs)),
        "right": list(dict.fromkeys(f"{name}@{where}" for name, where in known)),
        "size": _size(effect),
    }


def _size(effect: Effect) -> dict[str, float]:
    return {key: _short(value) for key, value in effect.values.items()}


def _places(arm: Arm, effect: Effect) -> list[str]:
    """Places of an effect that physics cannot tell apart: all joints that carry a link feel its mass."""
    own = arm.names[effect.joint]
    if effect.name == "link_mass":
        return [f"{arm.names[k]}/load" for k in arm.carriers(effect.joint)]
    if effect.name == UNKNOWN:
        return _at(own, "load" if effect.formula in ("torque_over_time", "latch") else FRICTION)
    return _at(own, KINDS[effect.name].place)


def _at(joint: str, place: str) -> list[str]:
    """A place of a joint; of friction at a rigid gear, both sides."""
    return [f"{joint}/{side}" for side in ((place, "link_friction") if place == FRICTION else (place,))]


def _dataset(name: str, arm: Arm, motions: Sequence[Motion], angles: Sequence[np.ndarray]) -> Dataset:
    """The records as they were logged."""
    numbers = range(1, len(arm.links) + 1)
    records = [
        _record(f"rec_{r:02d}", arm, motion, angle, "train" if r < TRAIN else "test")
        for r, (motion, angle) in enumerate(zip(motions, angles, strict=True))
    ]
    return Dataset(
        name,
        tuple(Channel(f"{_command(arm)}{k}", "rad" if arm.servo else "N m") for k in numbers),
        tuple(Channel(f"q_a{k}", "rad", _short(arm.noise)) for k in numbers),
        tuple(records),
        SAMPLE,
    )


def _record(name: str, arm: Arm, motion: Motion, angle: np.ndarray, role: Literal["train", "test"]) -> Record:
    """One record as it was logged: what was commanded, and the angles that the encoders read."""
    numbers = range(1, len(arm.links) + 1)
    return Record(
        name=name,
        time=np.round(SAMPLE * np.arange(len(angle)), 6),
        inputs={f"{_command(arm)}{k}": np.round(motion.command[:, k - 1], 7) for k in numbers},
        outputs={f"q_a{k}": angle[:, k - 1] for k in numbers},
        role=role,
    )


def _command(arm: Arm) -> str:
    return "goal" if arm.servo else "tau"


def _short(value: Any) -> float:
    return float(f"{float(value):.4g}")
