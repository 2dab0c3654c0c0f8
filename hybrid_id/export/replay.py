"""Records replayed through an exported model in MuJoCo, beside the package's own replay."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from joblib import cpu_count

from hybrid_id.components.input.position_loop import PositionLoop
from hybrid_id.components.motor.dc_motor import DCMotor
from hybrid_id.errors import InputError
from hybrid_id.export.drives import Mjcf
from hybrid_id.export.own_file import mujoco_model
from hybrid_id.identification.horizons import WHOLE, Horizon
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.records.units import number_of, stem
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.fit import known_mean, nrmse, rmse
from hybrid_id.study.replay import batch_of, run_freely
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint

STRANGE = 0.5
"""Normalised RMSE of the package's own replay above which records may be of another robot."""
READ = ("q_m", "v_m", "q_a", "v_a")
"""Outputs that MuJoCo has."""
MOST_THREADS = 4
"""Records that are replayed side by side at most."""
BROKEN = ("mjWARN_BADQPOS", "mjWARN_BADQVEL", "mjWARN_BADQACC")
"""MuJoCo's warnings that a position, speed or acceleration is no number or without bound: it then begins anew."""


@dataclass(frozen=True)
class Agreement:
    """One output of one record in MuJoCo and here, as normalised RMSE.

    Attributes:
        record: name of the record.
        role: its role.
        output: name of the output.
        apart: MuJoCo against the package's own replay.
        here: the package's replay against what was measured.
        there: MuJoCo against what was measured.
        rmse: MuJoCo against what was measured, not normalised: in the output's SI unit.
    """

    record: str
    role: str
    output: str
    apart: float
    here: float
    there: float
    rmse: float

    @property
    def known_apart(self) -> float:
        """``apart``; NaN where what was measured stands still, so that both simulations may move by rounding alone."""
        return math.nan if math.isnan(self.here) else self.apart


@dataclass(frozen=True)
class Summary:
    """What the replay of several records comes to, as normalised RMSE; an output that stands still has none.

    Attributes:
        worst: largest difference between MuJoCo and the package's own replay.
        role: of the records that judge, those left out: test where there are any, else validation, else all ("").
        n_records: how many these are.
        there, here: MuJoCo, and the package's own replay, against what was measured: means over those records.
        by_output: MuJoCo against what was measured, for each output its mean over those records.
        rmse: the same, not normalised: in the output's SI unit.
        strange: mean of the package's own replay over all records where it is so large that they may be of another
            robot; None otherwise.
    """

    worst: float
    role: str
    n_records: int
    there: float
    here: float
    by_output: dict[str, float]
    rmse: dict[str, float]
    strange: float | None


def judging_role(roles: Iterable[str]) -> str:
    """Role of the records that judge, which no fit has seen: test, else validation, else all (the empty word)."""
    known = set(roles)
    return next((role for role in ("test", "validation") if role in known), "")


def left_out(dataset: Dataset) -> Dataset:
    """The records that judge: all where no role leaves any out."""
    role = judging_role(record.role for record in dataset)
    return replace(dataset, records=tuple(one for one in dataset if role in ("", one.role)))


def summarise(rows: Sequence[Agreement]) -> Summary:
    """The agreement of all records and outputs in a few figures."""
    role = judging_role(row.role for row in rows)
    judges = [row for row in rows if role in ("", row.role)]
    there, here = (known_mean(getattr(row, name) for row in judges) for name in ("there", "here"))
    by_output, by_unit = (
        {
            name: known_mean(getattr(row, of) for row in judges if row.output == name)
            for name in dict.fromkeys(row.output for row in judges)
        }
        for of in ("there", "rmse")
    )
    missed = known_mean(row.here for row in rows)
    known = [apart for row in rows if not math.isnan(apart := row.known_apart)]
    worst = max(known, default=math.nan)
    n_records = len({row.record for row in judges})
    strange = missed if missed > STRANGE else None
    return Summary(worst, role, n_records, there, here, by_output, by_unit, strange)


@dataclass(frozen=True, eq=False)
class FreeRun:
    """A free run of the package over a record or a piece of one, which MuJoCo repeats from the same start.

    Attributes:
        record: the piece, ``(T,)`` samples.
        start: the package's first state, ``(n_x,)``.
        outputs: what the package simulates, ``(T,)`` each.
        weight: 1 / standard deviation of each measurement, ``(T,)`` by output.
    """

    record: Record
    start: list[float]
    outputs: Mapping[str, np.ndarray]
    weight: Mapping[str, np.ndarray]


def free_runs_of(system: System, dataset: Dataset, horizon: Horizon = WHOLE) -> list[FreeRun]:
    """The package's own free runs of every record, pieces of a record one after the other.

    Args:
        system: the model.
        dataset: the records.
        horizon: where the free runs begin anew from a measured state.

    Raises:
        InputError: a channel that the model needs is missing.
    """
    batch = batch_of(dataset, system, dataset.records)
    own = run_freely(system, compiled_for(system, Engine()), batch, horizon)
    first, found = dict.fromkeys(batch.names, 0), []
    for row, name in enumerate(own.pieces.names):
        whole, samples = dataset[name], int((own.pieces.weight[row] > 0).any(1).sum())
        here = slice(first[name], first[name] + samples)
        first[name] = here.stop
        inputs, outputs = ({k: v[here] for k, v in one.items()} for one in (whole.inputs, whole.outputs))
        piece = replace(whole, time=whole.time[here], inputs=inputs, outputs=outputs)
        simulated, weight = (
            dict(zip(batch.outputs, values[row, :samples].numpy().T, strict=True))
            for values in (own.simulated.y, own.pieces.weight)
        )
        found.append(FreeRun(piece, own.simulated.x[row, 0].tolist(), simulated, weight))
    return found


def agreement(
    system: System, exported: Mjcf, dataset: Dataset, horizon: Horizon = WHOLE, *, there: System | None = None
) -> list[Agreement]:
    """Replay every record in MuJoCo and here.

    Args:
        system: the model.
        exported: what has become of it.
        dataset: the records.
        horizon: where the free runs begin anew from a measured state, there and here.
        there: the model with the values that were exported, where these are others.

    Raises:
        InputError: MuJoCo is not installed, or a record has what MuJoCo cannot follow.
    """
    runs = free_runs_of(system, dataset, horizon)
    both = list(zip(runs, mujoco_replays(there or system, exported, runs), strict=True))
    found = []
    for record in dataset.records:
        mine = [(run, replayed) for run, replayed in both if run.record.name == record.name]
        for name in (name for name in mine[0][0].outputs if name in mine[0][1]):
            pieces = [(run.record.signal(name), run.outputs[name], replayed[name]) for run, replayed in mine]
            measured, ours, theirs = (np.concatenate(one) for one in zip(*pieces, strict=True))
            pairs = (ours, theirs), (measured, ours), (measured, theirs)
            scores = [float(nrmse(*pair)) for pair in pairs]
            # what moves within a count alone has no error relative to its motion
            if math.isnan(scores[1]) and np.ptp(measured) > 0.0:
                scores = [math.nan] * 3
            found.append(
                Agreement(record.name, record.role, name, *scores, rmse=float(rmse(measured, theirs)))
            )
    return found


def mujoco_replays(system: System, exported: Mjcf, runs: Sequence[FreeRun]) -> list[Mapping[str, np.ndarray]]:
    """Outputs of the exported model from the starts and under the commands of free runs, ``(T,)`` each.

    MuJoCo gives true angles; they are read through the model's own encoders, whose zero may be elsewhere.
    MuJoCo's motors have no switch. One that is off is given the voltage that it induces itself, beyond its limits if
    need be, so that no current flows: an open circuit.

    Raises:
        InputError: MuJoCo is not installed, or the exported model is unstable there.
    """
    try:
        import mujoco  # noqa: F401
    except ImportError:
        raise InputError("MuJoCo is not installed; pip install 'hybrid-id[blind]' brings it") from None
    model = mujoco_model(exported)

    def replayed(run: FreeRun) -> Mapping[str, np.ndarray]:
        return _mujoco_replay(copy.copy(model), system, exported, run.record, run.start)

    pool = ThreadPoolExecutor(
        min(len(runs), cpu_count(), MOST_THREADS)
    )  # MuJoCo's steps leave Python to others
    try:
        return list(pool.map(replayed, runs))
    finally:
        pool.shutdown(cancel_futures=True)


def _mujoco_replay(
    model: Any, system: System, exported: Mjcf, record: Record, start: Sequence[float]
) -> Mapping[str, np.ndarray]:
    """One record through MuJoCo's model, which is changed where motors are switched."""
    import mujoco

    data = mujoco.MjData(model)  # type: ignore[attr-defined]
    for joint in system.joints:
        name = exported.joints[joint.number - 1]
        turning = joint.motors or [(joint, 1.0 / joint.gear_ratio)]
        state = {name: [sum(share * start[m.positions[0] + k] for m, share in turning) for k in (0, 1)]}
        if not joint.rigid:
            rotor, link = state[name], start[joint.positions[1] : joint.positions[1] + 2]
            gear = _gear(model, joint)
            state |= {gear: [b - a for a, b in zip(rotor, link, strict=True)]} if gear else {name: link}
        for hinge, (angle, speed) in state.items():
            data.joint(hinge).qpos[:], data.joint(hinge).qvel[:] = angle, speed
    joints = {model.joint(k).name for k in range(model.njnt)}
    for hinge, angle in exported.held.items():
        if hinge in joints:  # else a base, which stands as it is drawn
            data.joint(hinge).qpos[:] = angle
    motors = [model.actuator(name).id for name in exported.motors]
    commands = [
        _Command(system, joint, exported, record, model, bool(model.actuator_biastype[motor]))
        for joint, motor in zip(system.joints, motors, strict=True)
    ]
    for command, motor in zip(commands, motors, strict=True):
        if command.delays:
            model.actuator_delay[motor] = 0.0
        elif (held := int(model.actuator_history[motor, 0])) > 0:
            # what a delay holds at the start: the first command, as the package takes it
            times = model.opt.timestep * np.arange(-held, 0)
            fill = mujoco.mj_initCtrlHistory  # type: ignore[attr-defined]
            fill(model, data, motor, times, np.full(held, command(0, data)))
    switched = any((command.on != 1.0).any() for command in commands)
    limited = model.actuator_ctrllimited[motors].copy()
    pulls = [(matrix, matrix[motors].copy()) for matrix in (model.actuator_gainprm, model.actuator_biasprm)]
    read = {n: _reading(model, system, exported, n) for n in record.outputs if stem(n) in READ}
    states = np.empty((record.n_samples, model.nq + model.nv))
    ticks = np.rint((record.time - record.time[0]) / model.opt.timestep).astype(int)
    for k in range(record.n_samples):
        states[k] = np.concatenate([data.qpos, data.qvel])
        if k + 1 == record.n_samples:
            break
        if switched:
            model.actuator_ctrllimited[motors] = limited * [command.on[k] == 1.0 for command in commands]
            for matrix, own in pulls:  # a servo that is off lets go
                matrix[motors] = [c.pull(k) * row for c, row in zip(commands, own, strict=True)]
        left = int(ticks[k + 1] - ticks[k])
        at_once = 1 if any(command.follows(k) for command in commands) else left
        for _ in range(0, left, max(at_once, 1)):
            data.ctrl[motors] = [command(k, data) for command in commands]
            mujoco.mj_step(model, data, at_once)  # type: ignore[attr-defined]
    kinds = mujoco.mjtWarning  # type: ignore[attr-defined]
    if any(data.warning[int(getattr(kinds, name))].number for name in BROKEN):
        raise InputError(
            f"the exported model is unstable in MuJoCo on record '{record.name}': a spring is too stiff for steps of "
            f"{1e3 * model.opt.timestep:g} ms; shorten 'timestep' in the file"
        )
    return {name: _read(system, name, states @ one) for name, one in read.items()}


def _read(system: System, name: str, true: np.ndarray) -> np.ndarray:
    """What an encoder reads of true angles, in time."""
    views = system.views([value.detach().reshape(1) for value in system.theta()])
    joint = system.joints[int(number_of(name)) - 1]
    return joint.sensing.read(stem(name), torch.tensor(true), 0.0, (), views).numpy()


def _reading(model: Any, system: System, exported: Mjcf, name: str) -> np.ndarray:
    """An output as a sum over MuJoCo's positions and speeds, ``(n_q + n_v,)``: its sensors lag a step."""
    channel, number = stem(name), int(number_of(name)) - 1
    joint = system.joints[number]
    found = np.zeros(model.nq + model.nv)

    def add(hinge: str, share: float) -> None:
        known = model.joint(hinge)
        found[int(known.dofadr[0]) + model.nq if channel[0] == "v" else int(known.qposadr[0])] += share

    if channel[2] == "m":
        for link, turns in joint.links:
            add(exported.joints[link.number - 1], turns)
        return found
    add(exported.joints[number], 1.0)
    if gear := _gear(model, joint):
        add(gear, 1.0)
    return found


def _gear(model: Any, joint: Joint) -> str:
    """Name of the hinge that is a gear's deflection in MuJoCo; empty where the gear is rigid there."""
    name = f"gear{joint.number}"
    return name if not joint.rigid and name in {model.joint(k).name for k in range(model.njnt)} else ""


class _Command:
    """What a joint's input stage gives at a sample: duty times supply, say; a position loop needs the angle, too.

    Attributes:
        on: whether the motor is switched on at each sample, ``(T,)``.
        servo: whether MuJoCo closes the position loop itself and takes its goal.
        delays: whether the command is held back here: a switch acts at once, and MuJoCo would delay it as well.
    """

    def __init__(
        self, system: System, joint: Joint, exported: Mjcf, record: Record, model: Any, servo: bool
    ) -> None:
        key, self._source = joint.drive.input
        self._exported, self._joint = exported, joint
        self._view = system.components[key].view()  # type: ignore[operator]
        self.on = record.inputs.get(f"enable{joint.number}", np.ones(record.n_samples))
        key, motor = joint.drive.motor
        self._induced = motor.specs["P_m2"].value if isinstance(motor, DCMotor) else 0.0
        self._channels = {
            c: torch.tensor(record.signal(f"{c}{joint.number}"), dtype=torch.float64)
            for c in self._source.channels
        }
        self._encoders = [(part, part.view()) for _, part in joint.drive.encoders]
        self.servo = servo = servo and self._source.at_joint
        self._closed = not servo and (isinstance(self._source, PositionLoop) or self._source.at_joint)
        self._tick, self._gear = model.opt.timestep, _gear(model, joint)
        self._time, delay = record.time - record.time[0], joint.drive.delay
        self._late = 0.0 if delay is None else delay[1].specs["T_d"].value
        zero = torch.zeros(1, dtype=torch.float64)
        if servo:
            self._held: torch.Tensor | None = self._channels["goal"]
        else:
            self._held = (
                None if self._closed else self._at(self._channels, zero, zero).expand(record.n_samples)
            )
        self.delays = bool(self._late) and not self._closed and not servo and bool((self.on != 1.0).any())

    @torch.no_grad()
    def _at(
        self, channels: Mapping[str, torch.Tensor], angle: torch.Tensor, speed: torch.Tensor
    ) -> torch.Tensor:
        return self._source.command(self._view, channels, angle, speed)

    def follows(self, sample: int) -> bool:
        """Whether the command follows the motion within a sample."""
        return self._closed or self.delays or self.on[sample] != 1.0

    def pull(self, sample: int) -> float:
        """Share of a servo's torque at a sample."""
        return float(self.on[sample]) if self.servo else 1.0

    def __call__(self, sample: int, data: Any) -> float:
        """The command at a sample."""
        row = sample
        if self.delays or (self._late and self._held is None):  # a delay holds back the goal, not the angle
            # the sample whose command has arrived; half a step forgives the rounding to MuJoCo's
            now = data.time - self._late + 0.5 * self._tick
            row = max(int(np.searchsorted(self._time, now, side="right")) - 1, 0)
        if self._held is not None:
            given = float(self._held[row])
        else:  # the loop closes over the rotor's angle or the link's, as its encoder reads it
            angle, speed = self._shaft(data, "qpos"), self._shaft(data, "qvel")
            if self._source.at_joint:
                gear = data.joint(self._gear) if self._gear else None
                twist, turning = (0.0, 0.0) if gear is None else (gear.qpos[0], gear.qvel[0])
                angle, speed = (
                    angle / self._joint.gear_ratio + twist,
                    speed / self._joint.gear_ratio + turning,
                )
            motion = [torch.tensor([end], dtype=torch.float64) for end in (angle, speed)]
            for encoder, view in self._encoders:
                motion[0] = encoder.read(view, motion[0])
            command = self._at({c: v[row : row + 1] for c, v in self._channels.items()}, *motion)
            given = float(command[0]) / (self._joint.gear_ratio if self._source.at_joint else 1.0)
        on = 1.0 if self.servo else float(self.on[sample])
        return given if on == 1.0 else on * given + (1.0 - on) * self._induced * self._shaft(data, "qvel")

    def _shaft(self, data: Any, field: str) -> float:
        """Angle or speed of the joint's motor."""
        links = ((self._exported.joints[link.number - 1], turns) for link, turns in self._joint.links)
        return sum(turns * getattr(data.joint(name), field)[0] for name, turns in links)
