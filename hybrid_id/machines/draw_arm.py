"""Draws an arm with something at work: its records in MuJoCo, its description, and what each joint's effects are worth.

Each joint is re-fitted by itself, the others as they truly moved. The gap is the sum of what the joints err more than
they would with all their effects.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hybrid_id.machines.arm import Arm, draw_arm
from hybrid_id.machines.case import Case, Graded, Part, level_of, short
from hybrid_id.machines.draw import DOMINANT, IMITATED, TWICE
from hybrid_id.machines.effects import Effect
from hybrid_id.machines.effects.arm import ArmEffect, ArmOutside, LinkMass
from hybrid_id.machines.effects.base import UNKNOWN
from hybrid_id.machines.experiments import Campaign
from hybrid_id.machines.joint import SAMPLE, JointTrials, Masses, Moved
from hybrid_id.machines.physics.bench import Encoders, Program, run
from hybrid_id.machines.rivals import find_rivals
from hybrid_id.machines.score import SOUND
from hybrid_id.machines.trials import Measured, Simulator

WRONG = 0.195
"""Values of the description are off by up to this share."""
SPREAD = (0.008, 0.042)
"""Standard deviation of the factor on a joint's friction between records."""
GROWN = (0.8, 4.5)
"""Least and greatest of the factor on the small effects of an arm."""
LENGTH = 5.0
"""Length of a record [s]."""
TRAIN = 4
"""Train records; one more is for the test."""
SETTLING = 60
"""Samples for which an arm holds its first pose before a record begins."""
PLAIN = 1.6
"""Error of the re-fitted joint over that with all effects, at least, where the dominant effect acts; where nothing is
missing, of the described arm over the re-fitted one."""
SEEN = 0.01
"""Rise of a joint's error from which a small effect that lacks is one that is at work."""
ROUNDS = 16
"""Evaluations of a re-fit."""
RUNAWAY = 4 * np.pi
"""Angle [rad] beyond which a motion is lost."""


def draw_arm_case(rng: np.random.Generator, name: str, family: str, effect: str | None) -> Graded | None:
    """One attempt at a case of an arm; None where its dominant effect does not come out as one."""
    arm = draw_arm(rng)
    joints, lead = arm.joints, None
    named = [kind for kind in ArmEffect.__subclasses__() if kind is not ArmOutside and kind.fits(arm)]
    if family not in SOUND:
        kinds = ArmOutside.__subclasses__() if family == UNKNOWN else named
        kinds = [kind for kind in kinds if effect in (None, kind.name, kind.formula)]
        if not kinds:
            return None
        lead = kinds[rng.integers(len(kinds))].draw(rng, arm, int(rng.integers(joints)))
    small: list[list[Effect]] = [[] for _ in range(joints)]
    if lead:
        grown, about = float(np.exp(rng.uniform(*np.log(GROWN)))), (lead.name, lead.joint)
        for k in range(joints):
            milder = [kind.draw_small(rng, arm, k, grown) for kind in named if kind.small]
            small[k] = [effect for effect in milder if (effect.name, effect.joint) != about]
    effects = [*(one for own in small for one in own), *([lead] if lead else [])]
    spread = rng.uniform(*SPREAD, (joints, 1))
    drift = 1.0 + spread * np.clip(rng.standard_normal((joints, TRAIN + 1)), -2.0, 2.0)
    case = Case(name, arm, _campaign(rng, arm))
    moved = _moved(replace(arm, phase=rng.uniform(-np.pi, np.pi, TRAIN + 1)), effects, drift, case.campaign)
    if moved is None:
        return None
    described = arm.described(rng, WRONG)
    case = replace(
        case,
        campaign=replace(case.campaign, lengths=np.full(TRAIN + 1, len(moved.volts))),
        model={"robot": {"file": "arm.xml"}},
        files={"arm.xml": described.description()},
    )
    at = lead.joint if lead else 0
    shares = [sum(one.values["mass"] for one in own if isinstance(one, LinkMass)) for own in small]
    nominal_load = moved.carried(arm, [0.0] * joints)
    of_one = moved.carried(arm, [float(k == at) for k in range(joints)])
    loads = nominal_load, moved.carried(arm, shares) - nominal_load, of_one - nominal_load
    felt = [] if lead is None else arm.carriers(at) if isinstance(lead, LinkMass) else [at]
    trials, nominal, base, floor, leads = [], [], [], [], {}
    for k in range(joints):
        own = [lead] if lead and k in felt else []
        beside = [one for one in small[k] if not isinstance(one, LinkMass)]
        joint = JointTrials(arm, k, [*own, *beside, *([Masses(k, {})] if small[k] else [])], moved, loads)
        whole, nothing = (1.0,) * len(joint.effects), (0.0,) * len(joint.effects)
        values = {name: float(described.values[name]) for name in joint.true}
        nominal += joint.errors([Simulator(0, nothing, values)], joint.measured)
        starts = [Simulator(0, nothing, joint.true), Simulator(0, whole, joint.true)]
        if lead and own:
            shapes = {(0, key): float(lead.values[key]) for key in lead.shapes}
            free = () if lead.name == UNKNOWN else (0,)
            starts.append(
                Simulator(0, (1.0, *nothing[1:]), joint.true, shapes, free, tuple(shapes) if free else ())
            )
        first, full, *having = joint.fit(starts, joint.measured, rounds=ROUNDS)
        base, floor, trials = [*base, first], [*floor, full], [*trials, joint]
        leads |= dict.fromkeys([k] if having else [], *having)

    def gap(of: str) -> float:
        return sum(max(t.gap(b, of) - t.gap(f, of), 0.0) for t, b, f in zip(trials, base, floor, strict=True))

    def closes(of: str) -> float:
        closed = sum(trials[k].gap(base[k], of) - trials[k].gap(one, of) for k, one in leads.items())
        return round(float(closed / max(gap(of), 1e-300)), 4)

    def error(fits: Sequence[Simulator]) -> float:
        return float(np.mean([one.test for one in fits]))

    with_lead = [leads.get(k, one) for k, one in enumerate(base)]
    oracle = error(nominal), error(base), error(with_lead), error(floor)
    drives = "servo" if arm.servo else "torque"
    more = {
        "messy": {
            "dominant_outside": lead is not None and lead.name == UNKNOWN,
            "drift_of_friction": [short(one) for one in drift.std(axis=1)],
        },
        "arm": {"joints": joints, "drives": drives, "noise": short(arm.noise)},
    }
    volts_and_angles = Measured(moved.volts, moved.measured)
    if lead is None:
        graded = Graded(case, volts_and_angles, *oracle, "none", more=more)
        return graded if oracle[0] >= PLAIN * oracle[1] else None
    ratio = base[at].test / floor[at].test
    if not ratio >= PLAIN or not min(closes("train"), closes("test")) >= DOMINANT:
        return None
    parts = []
    for k, joint in enumerate(trials):
        for i, one in enumerate(joint.effects):
            if one is lead:
                continue
            sizes = tuple(float(j != i) for j in range(len(joint.effects)))
            fit = joint.fit([Simulator(0, sizes, floor[k].values)], joint.measured, rounds=ROUNDS)[0]
            share = float((joint.gap(fit, "train") - joint.gap(floor[k], "train")) / gap("train"))
            if closes("train") < TWICE * share:
                return None
            lift = float(np.sqrt(joint.gap(fit, "train") / joint.gap(floor[k], "train"))) - 1.0
            if lift >= SEEN:
                if isinstance(one, Masses):
                    one = next((e for e in small[k] if isinstance(e, LinkMass)), LinkMass(k, {"mass": 0.0}))
                told = {
                    "share_train": round(share, 4),
                    "closes_train": round(share, 4),
                    "lift": round(lift, 3),
                }
                parts.append(Part(one, (), {"role": "small", **told}))
    rivals = find_rivals(rng, trials[at], trials[at].measured, base[at], leads[at], 0, on_train=True)
    if lead.name == UNKNOWN and any(1.0 - rival.rest > IMITATED for rival in rivals):
        return None
    closed = {"share": closes("test"), "closes": closes("test")}
    closed |= {"share_train": closes("train"), "closes_train": closes("train")}
    parts.insert(0, Part(lead, rivals, {"role": "dominant", **closed}))
    return Graded(case, volts_and_angles, *oracle, level_of(ratio), parts, more=more)


def _campaign(rng: np.random.Generator, arm: Arm) -> Campaign:
    """Records of moves between poses, with two tones upon them, after a rest at the first pose."""
    time, joints, runs = SAMPLE * np.arange(round(LENGTH / SAMPLE)), arm.joints, TRAIN + 1
    goals = np.zeros((len(time), joints, runs))
    for k, r in np.ndindex(joints, runs):
        starts = np.sort(rng.uniform(0.06 * LENGTH, 0.88 * LENGTH, 4))
        poses = rng.uniform(-0.72, 0.72, 5)
        own = np.full(len(time), poses[0])
        for start, (before, after) in zip(starts, pairwise(poses), strict=True):
            part = np.clip((time - start) / rng.uniform(0.28, 0.64), 0.0, 1.0)
            own += (after - before) * part * part * (3.0 - 2.0 * part)
        for frequency in rng.uniform(0.5, 3.2, 2):
            tone = 0.06 * np.sin(2 * np.pi * frequency * time + rng.uniform(-np.pi, np.pi))
            own += tone * np.clip(time / 0.4, 0.0, 1.0)
        goals[:, k, r] = own
    goals = np.concatenate([np.repeat(goals[:1], SETTLING, axis=0), goals])
    gains = np.array([[arm.value(k, "k_p")] for k in range(joints)])
    still, unlimited = np.zeros((joints, runs)), np.full((joints, runs), np.inf)
    if arm.servo:
        program = Program(goals, np.zeros_like(goals), still, still, still, unlimited, np.zeros_like(goals))
    else:
        held, brake = gains + still, np.array(arm.brake)[:, None] + still
        program = Program(np.zeros_like(goals), goals, held, brake, still, unlimited, np.zeros_like(goals))
    jitter = arm.jitter * rng.standard_normal(goals.shape)
    encoders = Encoders(np.full(joints, arm.count), jitter, at_links=True)
    roles = ("train",) * TRAIN + ("test",)
    return Campaign(program, encoders, np.full(runs, len(goals)), ("",) * runs, roles, SAMPLE)


def _moved(arm: Arm, effects: Sequence[Effect], drift: np.ndarray, campaign: Campaign) -> Moved | None:
    """The records of an arm with effects, without the rest before them; None where it runs away."""
    machine = arm.drifted(drift).assemble(effects)
    start = campaign.program.feed[0] if arm.servo else campaign.program.reference[0]
    with np.errstate(all="ignore"):
        volts, measured = run(
            machine, campaign.program, campaign.encoders, sample_time=SAMPLE, rest=0.0, start=start, slope=1
        )
    laws = [law for drive in machine.drives for law in drive.rotor_laws if isinstance(law, ArmOutside)]
    trace = np.array([np.zeros_like(volts[:, 0]), np.ones_like(volts[:, 0])])
    for law in laws:
        trace = trace if law.trace is None else law.trace
    if not np.abs(measured).max() < RUNAWAY:
        return None
    kept = slice(SETTLING, None)
    _, angles, _, speeds = map(np.array, zip(*machine.trail[kept], strict=True))
    return Moved(np.round(volts[kept], 7), np.round(measured[kept], 7), angles, speeds, trace[:, kept])
