"""Checks of a model, a study and its records: identifiability, plausibility, residual tests, profile likelihoods."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np
import torch

from hybrid_id.errors import InputError, listed
from hybrid_id.identification.fit import UNBOUNDED, fit, make_bounds
from hybrid_id.identification.horizons import WHOLE, Horizon
from hybrid_id.identification.least_squares import Options, free_parameters
from hybrid_id.identification.objective import evaluate
from hybrid_id.identification.result import FitResult, sensitivities
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.measures import estimate_noise, less_half_a_count, sensor_noise
from hybrid_id.records.quality import Finding
from hybrid_id.records.record import Record
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.identifiability import Identifiability, identifiability
from hybrid_id.statistics.profile import Profile, profile_likelihood
from hybrid_id.statistics.residuals import ResidualTest, residual_test
from hybrid_id.study.base_parameters import BaseParameterCheck, check_base_parameters
from hybrid_id.study.replay import batch_of, replay, run_freely
from hybrid_id.study.result import Study
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint

OFF, WRONG = 0.02, 0.2
"""Relative difference between the records' ratio and the model's that is said, and from which no fit means anything."""
ONE_GEAR = 0.8
"""Correlation below which two angles hardly belong to one gear, unless it is very soft."""
MOVES = 20.0
"""Standard deviation of an angle over its noise from which it moves."""
REFERENCES = ("P_m1", "k_t", "P_m1m1", "P_m1m2")
"""Parameters by which identifiable combinations are divided, where the model has them."""
FROM_PRIOR = 6.0
"""Standard deviations of a prior from which its parameter is called odd."""
ALIKE, UNIT, ABSURD = 0.9, 5.0, 40.0
"""Correlation of a signal with its simulation, and factors between the two from which its unit is doubted and surely
wrong: 9.5 is a speed's in rpm, 57 an angle's in degrees, 1000 that of a time in ms."""
RANGES = 3.0
"""Span of a joint's angle over its range in the robot's file, from which the angle's unit is wrong."""
OVER = 0.02
"""Share of how far a command goes by which it may go beyond its range: rounding, and the steps of registers."""
LITTLE = 0.5
"""Correlation of an angle with its goal up to which it may be another joint's."""
BESIDE, STEADY, NEAR, QUARTER = 0.3, 3.0, 0.1, 1.4
"""Least distance [rad] of an angle from its goal, and over how much it varies, from which its zero is doubted; how near
it lies to whole quarter turns that are meant; and from where on no load explains it."""
INSTANTS, TURNED = 50, 0.5
"""Instants of a record between which motions are compared, and the negative correlation that casts doubt on a sign."""
STILL = 1.2
"""Standard deviation of a signal over that of its noise up to which it stands still."""
FAR_OUT = 20.0
"""Error of a record over the median of all from which it contradicts the others."""
FIRST_STEP = 0.1
"""First step as a share of the estimate, where no standard error is known."""
CONTRADICT = ("unit", "sign", "zero", "columns")
"""Codes of findings after which no table may follow: it would be confident of what means nothing."""


def identifiability_of(result: FitResult, *, inflation: float = 1.0) -> Identifiability:
    """What the records of a fit tell about its parameters, at its estimates and its noise."""
    noise = max(result.noise_scale, 1e-300)
    specs = [result.system.parameter(name).spec for name in result.names]
    ends = [max((abs(b) for b in (s.lower, s.upper) if np.isfinite(b)), default=0.0) for s in specs]
    return identifiability(
        result.values,
        result.names,
        jacobian=[j / noise for j in result.jacobian],
        prior_precision=result.prior_precision,
        scale=np.array([end if 0.0 < end < UNBOUNDED else 1.0 for end in ends]),
        inflation=inflation,
        references=REFERENCES,
    )


def check_identifiability(dataset: Dataset, system: System) -> Identifiability:
    """What the train records can tell about the model's parameters, before any fit, at its start values.

    The sensitivities are those of a free run linearised along the measured motion.

    Raises:
        InputError: nothing to estimate, or missing channels.
    """
    free = free_parameters(system)
    batch = batch_of(dataset, system, dataset.train or dataset.records)
    theta = system.theta().detach()[:, None].expand(-1, batch.rows)
    engine = with_substeps(system, compiled_for(system, Engine()), batch, theta)
    options = Options()
    at = evaluate(system, engine, batch, batch.x, theta, free, loss=options.loss, chunk=options.chunk)
    every = torch.arange(batch.rows)
    bounds = make_bounds(system, free)
    return identifiability(
        np.array([system.table[i].spec.value for i in free]),
        [system.table[i].name for i in free],
        jacobian=sensitivities(at, every, every, batch, options)[0],
        prior_precision=bounds.prior_precision.numpy(),
        scale=(10.0 * bounds.scale).numpy(),
        references=REFERENCES,
    )


def check_scales(dataset: Dataset, system: System) -> list[Finding]:
    """What contradicts the model without a simulation: gear ratios, ranges of angles and commands, goals' units.

    With an error among them, what the model would do means nothing.
    """
    ratios = {joint.number: ratio for joint, ratio in zip(system.joints, system.own_ratios, strict=True)}
    found = [*check_encoders(dataset, ratios), *_spans(dataset, system), *_commands(dataset, system)]
    return [*found, *_goals(dataset, system)]


def check_encoders(dataset: Dataset, gear_ratio: Mapping[int, float | None]) -> Iterator[Finding]:
    """Findings of joints whose motor's angle is not the gear ratio times the link's, over all records.

    Play, compliance and errors of the gear change the angles for a while and not their ratio.

    Args:
        dataset: records; a joint counts that has ``q_m`` and ``q_a``.
        gear_ratio: by the joint's number; None where a motor turns with other joints, too.
    """
    names = {channel.name for channel in dataset.outputs}
    for n, ratio in gear_ratio.items():
        motor, link = f"q_m{n}", f"q_a{n}"
        if ratio is None or not {motor, link} <= names:
            continue
        pairs = _centred([(r.outputs[motor], r.outputs[link]) for r in dataset])
        moved = [np.concatenate(side).std() for side in zip(*pairs, strict=True)]
        noise = [max(estimate_noise(r.outputs[name]) for r in dataset) for name in (motor, link)]
        if any(size <= MOVES * max(still, 1e-300) for size, still in zip(moved, noise, strict=True)):
            continue  # noise has no ratio
        together = _alike(pairs)
        seen = float(moved[0] / moved[1]) * (1.0 if together > 0 else -1.0)
        if abs(together) < ONE_GEAR:
            words = (
                f"joint {n}: {motor} and {link} hardly move together (correlation {together:.2f}); {link} is to be the "
                "angle between this link and the one before it"
            )
        elif abs(seen / ratio - 1.0) > OFF:
            words = (
                f"joint {n}: {motor} moves {seen:.4g} times {link} in the records, but the model's gear ratio is "
                f"{ratio:.4g}; correct gear_ratio, or unit or sign of one of them"
                + (f"; {link} is to be the angle against the link before" if n > 1 else "")
            )
        else:
            continue
        grave = abs(together) >= ONE_GEAR and abs(seen / ratio - 1.0) > WRONG
        yield Finding("error" if grave else "warning", "gear_ratio", words, channel=link)


def _goals(dataset: Dataset, system: System) -> Iterator[Finding]:
    """Doubts of goals and their angles: of units, signs, columns, and the zeros of encoders."""
    measured = {channel.name for channel in dataset.outputs}

    def pairs(name: str, scale: float, goal: str) -> list[tuple[np.ndarray, np.ndarray]]:
        """An angle over its scale, and a goal, of each record that has the goal."""
        return [(r.outputs[name] / scale, r.inputs[goal]) for r in dataset if goal in r.inputs]

    for joint, ratio in zip(system.joints, system.own_ratios, strict=True):
        goal, sides = f"goal{joint.number}", _sides(joint, ratio)
        name = next((name for name in sides if name in measured), None)
        if name is None or goal not in system.input_names:
            continue
        # of the joint, for one of the side that the loop reads
        scale = sides[name] * (1.0 if joint.drive.input[1].at_joint else 1.0 / joint.gear_ratio)
        own = pairs(name, scale, goal)
        moves = _centred(own)
        alike = _alike(moves)
        if times := _times(moves):
            words = (
                f"{name} moves {times:.3g} times as far as {goal}, which it follows; correct the unit of either in "
                "the dataset file (degrees?), or gear_ratio in the model file"
            )
            yield _of_unit(times, words, goal)
        elif alike <= -ALIKE:
            words = (
                f"{name} moves against {goal}, which it should follow; give one of them 'scale: -1' under 'columns' in "
                "the dataset file"
            )
            yield Finding("warning", "sign", words, channel=name)
        elif alike < LITTLE:
            goals = [f"goal{other.number}" for other in system.joints]
            follows = {other: _alike(_centred(pairs(name, scale, other))) for other in goals}
            most = max(follows, key=follows.__getitem__)
            if follows[most] >= ALIKE:
                words = (
                    f"{name} follows {most} and not {goal}; check which columns of the dataset file they are"
                )
                yield Finding("warning", "columns", words, channel=name)
        elif alike >= ALIKE:
            apart = np.concatenate([angle - aim for angle, aim in own])
            beside = float(np.median(apart))
            if abs(beside) <= max(BESIDE, STEADY * float(np.median(abs(apart - beside)))):
                continue  # a loop that gives way may do it
            turned, joint_turned = (_turn(zero) for zero in (beside * scale, beside))
            words = (
                f"{name} stays {turned:.5g} rad ({np.degrees(turned):.4g} deg) beside {goal}, which it follows; where "
                "its encoder counts from elsewhere, give it that 'zero' under 'columns' in the dataset file, in unit "
                "and sign of the file's own column"
            )
            code = "zero" if abs(joint_turned) >= QUARTER else "beside"
            yield Finding("warning", code, words, channel=name)


def _centred(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(a - a.mean(), b - b.mean()) for a, b in pairs]


def _turn(zero: float) -> float:
    """The quarter turns that an angle [rad] is near to, or else itself."""
    near = round(zero / (0.5 * np.pi)) * 0.5 * np.pi
    return near if abs(near - zero) < NEAR else zero


def _sides(joint: Joint, ratio: float | None) -> dict[str, float]:
    """Channels of a joint's angle, each with its turns for one of the joint; the motor's where that alone turns it."""
    return {f"q_a{joint.number}": 1.0} | ({f"q_m{joint.number}": ratio} if ratio else {})


def _of_unit(times: float, words: str, channel: str) -> Finding:
    """A doubt of a channel's unit; an error where no other reason explains so large a factor."""
    return Finding("error" if max(times, 1.0 / times) > ABSURD else "warning", "unit", words, channel=channel)


def _spans(dataset: Dataset, system: System) -> Iterator[Finding]:
    """Errors of the joints of a robot whose angles go several times through their range."""
    if system.tree is None:
        return
    measured = {channel.name for channel in dataset.outputs}
    for seat, joint, ratio in zip(system.arm.seats, system.joints, system.own_ratios, strict=True):
        described = system.tree.joints[seat]
        low, high = described.limits
        sides = _sides(joint, ratio)
        for name in sorted(sides.keys() & measured):
            values = [record.outputs[name] for record in dataset]
            span = (max(v.max() for v in values) - min(v.min() for v in values)) / sides[name]
            if span > RANGES * (high - low) > 0.0:
                unit = "m" if described.kind == "slide" else "rad"
                words = (
                    f"{name} takes {described.name} through {span:.4g} {unit}, {span / (high - low):.3g} times its "
                    f"range in {Path(system.tree.source).name} ({low:.3g} to {high:.3g} {unit}); correct its 'unit' in "
                    "the dataset file (degrees?), or gear_ratio in the model file"
                )
                yield Finding("error", "range", words, channel=name)


def _commands(dataset: Dataset, system: System) -> Iterator[Finding]:
    """Torques and goals beyond what their actuators take, by the robot's file or by a servo's limits in the model."""
    for seat, joint in zip(system.arm.seats, system.joints, strict=True):
        source, known = joint.drive.input[1], None if system.tree is None else system.tree.joints[seat]
        name = f"{source.channels[0]}{joint.number}"
        values = [record.inputs[name] for record in dataset if name in record.inputs]
        if not values:
            continue
        of = joint.name if known is None else known.name
        if {"goal_min", "goal_max"} <= source.specs.keys():
            low, high = (source.specs[end].value for end in ("goal_min", "goal_max"))
            cure = f"to which the servo of {of} clips it (goal_min, goal_max; ctrlrange in a robot's file)"
        elif source.channels == ("tau",) and known is not None and system.tree is not None:
            factor = known.gear * known.gain / joint.gear_ratio
            low, high = sorted(factor * end for end in known.commands)
            cure = f"that ctrlrange of the actuator of {of} allows in {Path(system.tree.source).name}"
        else:
            continue
        least, most = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
        if max(low - least, most - high) > OVER * (most - least):
            unit = next(channel.unit for channel in dataset.inputs if channel.name == name)
            words = (
                f"{name} goes from {least:.4g} to {most:.4g} {unit}, beyond the {low:.4g} to {high:.4g} {unit} {cure}; "
                "correct its 'unit' or 'scale' in the dataset file, or that range, unless it is so"
            )
            yield Finding("warning", "command_range", words, channel=name)


def check_start_values(dataset: Dataset, system: System) -> list[Finding]:
    """Simulate the train records with the model's start values, and say what these do not explain.

    Of a joint that stands still in all of them it is said that nothing of it can be identified. Findings of the codes
    ``unit`` and ``sign`` say that records and model contradict each other, so that nothing may be concluded from both.

    Raises:
        InputError: no joint of the model moves.
    """
    names = [record.name for record in dataset.train or dataset.records]
    known, noise = dataset.select(names), sensor_noise(dataset.select(names))
    still, joints = [], len(system.joints)
    for seat, joint in zip(system.arm.seats, system.joints, strict=True):
        own = {f"{stem}{joint.number}" for stem in ("q_m", "q_a", "v_m", "v_a")} & noise.keys()
        signals = [(record.signal(name), noise[name]) for record in known for name in own]
        moved = [np.ptp(values) > 0.0 and np.std(values) > STILL * level for values, level in signals]
        if own and not any(moved):
            still.append(joint.name if system.tree is None else system.tree.names[seat])
    at_rest = (
        f"{listed(still)} {'stands' if len(still) == 1 else 'stand'} still in all records to learn from, so that "
        "nothing of a drive at rest can be identified; record motions of it"
    )
    if still and len(still) == joints:
        raise InputError(f"{at_rest}.")
    runs = replay(known, system)
    outputs = list(runs[0].nrmse) if runs else []
    words = _verdict("the model's start values", names, [list(run.nrmse.values()) for run in runs], outputs)
    found = [Finding("warning", "start_values", words)] if words else []
    if still:
        words = f"{at_rest}, or hold it in the model: its parameters stay at their start values"
        found.insert(0, Finding("warning", "start_values", words))
    for output in runs[0].outputs:
        pairs = [(run.record.signal(output), run.outputs[output]) for run in runs if run.status == "ok"]
        if times := _times(_centred(pairs)):
            words = (
                f"{output} moves {times:.3g} times as far in the records as with the model's start values, and alike "
                "otherwise; check its unit and that of the time, or correct the start values"
            )
            found.append(_of_unit(times, words, output))
        # it may drift, and still turn as it does from one of some instants to the next, or as with the sign reversed
        shares = [(pair, max(1, len(pair[0]) // INSTANTS)) for pair in pairs]
        steps = [(np.diff(a[::every]), np.diff(b[::every])) for (a, b), every in shares]
        if _alike(steps) < -TURNED:
            words = (
                f"{output} turns the other way than with the model's start values; if the sign of the sensor or of the "
                "command is reversed, give its channel 'scale: -1' under 'columns' in dataset.yaml"
            )
            found.append(Finding("warning", "sign", words, channel=output))
    return found


def _times(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Factor between two signals that are alike but for one that no start value explains; 0 where there is none."""
    own, other = (float(sum(np.vdot(pair[k], pair[k]) for pair in pairs)) for k in (0, 1))
    times = (own / other) ** 0.5 if _alike(pairs) >= ALIKE else 0.0
    return times if times and max(times, 1.0 / times) > UNIT else 0.0


def _alike(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Correlation of signals whose means, if any, are taken out; 0 where one stands still or is not finite."""
    both, own, other = (float(sum(np.vdot(p[i], p[j]) for p in pairs)) for i, j in ((0, 1), (0, 0), (1, 1)))
    known = np.isfinite((both, own, other)).all() and own > 0.0 and other > 0.0
    return both / (own * other) ** 0.5 if known else 0.0


def check_fit(study: Study) -> str:
    """The same of the selected set on train and test records; empty where it explains something."""
    cross, index = study.cross_validation, study.selection.index
    outputs = study.selected.residual[0].shape[-1]
    train = 1.0 - cross.fits[index, :, :outputs] / 100.0
    test = [[value] for value in study.test_nrmse.values()]
    who = "the identified parameters"
    return _verdict(who, cross.record_names, train) or _verdict(who, tuple(study.test_nrmse), test)


def check_priors(study: Study) -> list[str]:
    """Say which identified values lie further from their priors than data sheets are wrong: units are, or the model."""
    lines, selected = [], study.selected
    for name, value in zip(selected.names, selected.values, strict=True):
        spec = selected.system.parameter(name).spec
        if spec.prior_std is None or spec.prior_mean is None:
            continue
        away = abs(value - spec.prior_mean) / spec.prior_std
        if away > FROM_PRIOR:
            lines.append(
                f"{name} = {value:.4g} is {away:.0f} standard deviations from its prior {spec.prior_mean:.4g}; check "
                "the units of commands and outputs, and that nothing is missing ('hybrid-id diagnose')"
            )
    return lines


def _verdict(
    who: str,
    names: Sequence[str],
    nrmse: Sequence[Sequence[float]] | np.ndarray,
    outputs: Sequence[str] = (),
) -> str:
    """Say that the normalised RMSE (n_records, n_outputs) of the worst output, median of the records, is above 1.

    Or that of single records which stand far out of the others. Of several ``outputs``, if they are given, which.
    """
    errors = np.array(nrmse, float)
    if not errors.size:
        return ""
    moving = np.flatnonzero(~np.isnan(errors).all(0))  # an output that stands still in all records has none
    typical = np.nanmedian(errors[:, moving], axis=0)
    worst = float(np.max(typical, initial=0.0))
    if worst > 1.0:
        size = f"normalised RMSE {worst:.3g}" if np.isfinite(worst) else "the simulation diverges"
        if len(outputs) > 1 and np.isfinite(worst):
            size += f" of {outputs[moving[int(np.argmax(typical))]]}"
        return f"{who} explain less than the mean of the records ({size}); check signs, units and gear ratio"
    largest = np.max(np.where(np.isnan(errors), 0.0, errors), axis=1, initial=0.0)
    usual = float(np.median(largest[~np.isnan(errors).all(1)])) if moving.size else 0.0
    out = [k for k, error in enumerate(largest) if error > max(1.0, FAR_OUT * usual)]
    if not out:
        return ""
    return (
        f"{who} explain the records but for {listed([names[k] for k in out])} (normalised RMSE {largest[out[0]]:.3g}, "
        f"median {usual:.2g}); check signs, units and columns there"
    )


def residual_tests(
    dataset: Dataset,
    system: System,
    engine: Engine,
    *,
    records: Sequence[Record] = (),
    x0: np.ndarray | None = None,
    horizon: Horizon = WHOLE,
) -> tuple[ResidualTest, ...]:
    """Test what a model's free runs leave; an output that stands still in all of the records is left out.

    Args:
        dataset: the records, with the noise that it declares; it is estimated from the records where it is not.
        system: the model.
        engine: how it was fitted.
        records: which to simulate (default: the test records, or the train records where none is a test).
        x0: first state of each, ``(R, n_x)`` (default: as measured); of whole records only.
        horizon: how long the free runs are (default: whole records).
    """
    records = records or dataset.test or dataset.train
    batch = batch_of(dataset, system, records)
    if x0 is not None and horizon.kind == "whole":
        batch.x[:, 0] = torch.as_tensor(x0)
    runs = run_freely(system, engine, batch, horizon)
    simulated = runs.by_record(runs.simulated.y)
    known, tests = sensor_noise(dataset), []
    for column, output in enumerate(batch.outputs):
        residual, inputs = [], []
        for run, record in zip(simulated, records, strict=True):
            measured = record.outputs[output][: len(run)]
            if np.ptp(measured) == 0.0:
                continue
            left = measured - run[:, column]
            residual.append(less_half_a_count(left, measured) if np.isfinite(left).all() else left)
            inputs.append({name: values[: len(run)] for name, values in record.inputs.items()})
        if residual:
            tests.append(residual_test(output, residual, inputs, [known[output]] * len(residual)))
    return tuple(tests)


def study_residuals(dataset: Dataset, study: Study) -> dict[str, tuple[ResidualTest, ...]]:
    """What the selected set leaves of the records that it was fitted to (``train``), and of the test records."""
    chosen = study.selected
    fitted = [dataset[name] for name in dict.fromkeys(chosen.records)]
    parts = {"train": (fitted, chosen.x0)} | ({"test": (dataset.test, None)} if dataset.test else {})
    return {
        role: residual_tests(
            dataset, chosen.system, chosen.engine, records=records, x0=x0, horizon=study.horizon
        )
        for role, (records, x0) in parts.items()
    }


def profiles(
    dataset: Dataset,
    study: Study,
    names: Sequence[str],
    *,
    options: Options | None = None,
    progress: Callable[[str], object] | None = None,
) -> dict[str, Profile]:
    """Profile likelihood of some parameters of the selected set, by name: every point is a fit of all the others.

    The cost rises to where the study's standard error would end if the model were linear, so that noise,
    autocorrelation, priors and the noise of inputs count as they do there. Ctrl-C ends it with the profiles that are
    complete.

    Args:
        dataset: of the study.
        study: whose selected set is profiled.
        names: of parameters that it estimates.
        options: settings of the fits; those of the study's own.
        progress: called with words before each fit.

    Raises:
        InputError: a name that the study does not estimate, or no other parameter is estimated.
    """
    check_names(names, study.names)
    chosen, index = study.selected, study.selection.index
    records = [record for record in dataset.train if record.name in chosen.records]
    batch = batch_of(dataset, chosen.system, records)
    batch = study.horizon.cut(chosen.system, chosen.engine, batch)
    plain, robust = study.covariances[index], study.robust[index]

    def profile(name: str) -> Profile:
        k = chosen.names.index(name)
        errors = plain.std_error[k], robust.std_error[k]
        known = bool(np.isfinite(errors).all()) and min(errors) > 0.0
        error = float(study.errors_of_fit(index)[k])
        variance = error**2 / plain.inverse_hessian[k, k] if known else plain.noise_variance
        spec, number = chosen.system.parameter(name).spec, count(1)

        def fitted(start: System) -> FitResult:
            if progress is not None:
                progress(f"profile of {name}, fit {next(number)}")
            return fit(start, batch, pooled=True, engine=chosen.engine, options=options, warm=False)[0]

        def cost_at(value: float, start: np.ndarray) -> tuple[float, np.ndarray]:
            moved = chosen.system.with_values(dict(zip(chosen.names, start, strict=True)))
            one = fitted(moved.with_specs({name: replace(spec, value=value, estimate=False)}))
            found = dict(zip(one.names, one.values, strict=True)) | {name: value}
            cost = 2.0 * one.cost
            if (
                spec.prior_std is not None and spec.prior_mean is not None
            ):  # the parameter is held, its prior is not
                cost += ((value - spec.prior_mean) / spec.prior_std) ** 2
            return cost, np.array([found[n] for n in chosen.names])

        best = fitted(chosen.system)
        return profile_likelihood(
            cost_at,
            best.values,
            k,
            minimum=2.0 * best.cost,
            step=error if known else FIRST_STEP * abs(best.values[k]) or FIRST_STEP,
            noise_variance=variance,
            level=study.level,
            bounds=(spec.lower, spec.upper),
        )

    found: dict[str, Profile] = {}
    try:
        for name in names:
            found[name] = profile(name)
    except KeyboardInterrupt:
        return found
    return found


def check_names(names: Sequence[str], estimated: Sequence[str]) -> None:
    """Refuse names that a study does not estimate, and a profile without other parameters to fit."""
    for name in names:
        if name not in estimated:
            raise InputError(
                f"key 'statistics.profile': '{name}' is not estimated; give some of {', '.join(estimated)}"
            )
    if names and len(estimated) < 2:
        raise InputError(
            f"key 'statistics.profile': nothing but {estimated[0]} is estimated, so that its interval is its profile; "
            "leave it out"
        )


@dataclass(frozen=True)
class ModelCheck:
    """Result of :func:`check_model`.

    Attributes:
        findings: what is wrong, or may be.
        identified: what the records identify of the model; None where they contradict it.
        based: base parameters of a robot; None where records and model contradict each other, for other systems and
            for some joints of a robot by themselves.
    """

    findings: tuple[Finding, ...]
    identified: Identifiability | None = None
    based: BaseParameterCheck | None = None


def check_model(
    dataset: Dataset, system: System, progress: Callable[[str], object] = lambda _: None
) -> ModelCheck:
    """Check a model against records: first what costs nothing, then a simulation, then what is identifiable.

    Args:
        dataset: the records.
        system: the model with its start values.
        progress: called with words before each slow step.

    Raises:
        InputError: nothing to estimate, missing channels, or no joint moves.
    """
    found = check_scales(dataset, system)
    if any(finding.severity == "error" for finding in found):
        return ModelCheck(tuple(found))  # what the model would do means nothing, and takes its time
    progress("free runs with the start values")
    found += check_start_values(dataset, system)
    if any(finding.code in CONTRADICT for finding in found):
        return ModelCheck(tuple(found))
    progress("what is identifiable")
    identified = check_identifiability(dataset, system)
    if (
        system.tree is None or system.seats is not None
    ):  # of a joint by itself, the robot's are none of its own
        return ModelCheck(tuple(found), identified)
    progress("base parameters")
    return ModelCheck(tuple(found), identified, check_base_parameters(dataset, system))
