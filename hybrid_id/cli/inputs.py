"""Loading what a study config names: records as they shall be used, and the model."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from hybrid_id.cli.console import remark
from hybrid_id.config import Ablation, Hybrid, Identification, StudyConfig, Training
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.records.quality import Finding
    from hybrid_id.records.record import Record
    from hybrid_id.systems.chain import System

UNEVEN = 1.5
MAX_WARNINGS = 5  # said before a fit; `check` says them all


def load_records(path: Path, config: StudyConfig | None = None) -> "Dataset":
    """Load a dataset and do to it what the config says."""
    from dataclasses import replace

    from hybrid_id.records.dataset import Dataset
    from hybrid_id.records.dataset_file import resampled

    dataset = Dataset.load(path)
    if config is None:
        return dataset
    wish = config.preprocessing
    dataset = replace(dataset, signal_share=wish.signal_share)
    if wish.records is not None:
        with config.at("preprocessing.records"):
            dataset = dataset.select(wish.records)
    records = dataset.records
    if wish.between is not None:
        with config.at("preprocessing.between"):
            records = tuple(record.between(*wish.between) for record in records)
    if wish.resample is None:
        return replace(dataset, records=records)
    step, records, reports = resampled(records, wish.resample, dataset.sample_time)
    return replace(dataset, records=records, sample_time=step, resampling=reports)


def refuse_errors(findings: "list[Finding]") -> None:
    """Raise the first finding that makes a fit meaningless, as one sentence."""
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors:
        more = f" (and {len(errors) - 1} more; see 'hybrid-id check')" if len(errors) > 1 else ""
        raise InputError(errors[0].message + more)


def records_to_replay(path: Path) -> "Dataset":
    """Load records for a simulation, which is no fit and takes gaps; a step that cannot be meant ends the command."""
    from hybrid_id.records.quality import absurd_steps

    dataset = load_records(path)
    refuse_errors(absurd_steps(dataset))
    return dataset


def checked_records(config: StudyConfig) -> "Dataset":
    """Load records for a fit; errors end the command, the worst warnings are said."""
    from hybrid_id.records.quality import check_dataset

    if not config.model.exists():  # before minutes of reading
        raise InputError(
            f"{config.model} does not exist; write it (docs/formats.md shows one), or name another one with --model"
        )
    if not config.dataset.exists():
        with config.at("dataset"):
            raise InputError(f"{config.dataset} does not exist; correct the path")
    dataset = load_records(config.dataset, config)
    findings = check_dataset(dataset)
    refuse_errors(findings)
    warnings = [finding for finding in findings if finding.severity == "warning"]
    for finding in warnings[:MAX_WARNINGS]:
        remark(f"warning: {finding.message}")
    if len(warnings) - MAX_WARNINGS > 0:
        remark(f"({len(warnings) - MAX_WARNINGS} more: 'hybrid-id check {config.dataset}')")
    if (wish := config.preprocessing.fourier) is None:
        return dataset
    from hybrid_id.records.fourier import fourier

    with config.at("preprocessing.fourier"):
        return fourier(dataset, wish.band, speeds=wish.speeds)


def read_model(path: Path) -> "System":
    """A model file's system; masses and rotors that its robot's description lacks and gears that it has are said."""
    from hybrid_id.records.yaml_file import read_yaml
    from hybrid_id.systems.builders import started
    from hybrid_id.systems.model_file import load_model

    system = load_model(path)
    if (tree := system.tree) is None:
        return system
    file = Path(tree.source).name
    if light := tree.massless:
        remark(
            f"{file} gives no mass for {', '.join(light)}: taken as massless, but for "
            "payloads that the model lists; give each an <inertial> there"
        )
    joints = list(zip(tree.joints, system.joints, strict=True))
    bare = [  # whose rotor stands at what is put in for the description that has none
        known.name
        for (known, joint), start in zip(joints, started(tree), strict=True)
        if not known.armature
        and (spec := joint.inertia[1].specs.get("J_m")) is not None
        and spec.value == start.armature / joint.gear_ratio**2
    ]
    if bare:
        remark(
            f"{file} gives no armature for {', '.join(bare)}: these rotors are taken at a "
            "tenth of the largest inertia that a joint carries, and missing damping as one that stops a joint in 0.3 s"
        )
    by_torque = [(known, joint) for known, joint in joints if joint.drive.input[1].channels == ("tau",)]
    if braked := [known.name for known, _ in by_torque if known.by_speed]:
        remark(
            f"{file} brakes {', '.join(braked)} by the speed (<velocity>, or a back-EMF), "
            "which is left out: commands are taken as torques; where they are none, log torque or voltage"
        )
    # such a gear may be the drive's, or a mere scale of commands, which nobody can tell from the file
    gears = {k.name: k.gear for k, joint in by_torque if k.gear != 1.0 and joint.gear_ratio == 1.0}
    if gears and "gear_ratio" not in read_yaml(path):
        each = [f"{gear:g} at {name}" for name, gear in gears.items()]
        ratios = [abs(gears.get(name, 1.0)) or 1.0 for name in tree.names]
        theirs, ours = (", ".join(f"{one:g}" for one in some) for some in (ratios, [1.0] * len(ratios)))
        remark(
            f"{file} multiplies commands by a gear ({', '.join(each)}). Torque and "
            f"motor are taken at the joint all the same; where it is the drive's gear, and they are before it, add "
            f"'gear_ratio: [{theirs}]' to {path.name}, else 'gear_ratio: [{ours}]'"
        )
    return system


MOST_JOINTS = 2
"""Joints of an arm up to which a search or a training of all at once ends within minutes."""


def load_system(config: StudyConfig, dataset: "Dataset") -> "System":
    """The model of a study, started at what an earlier stage has found where the study names one.

    Records that contradict its gear ratio or the ranges of its joints end the command.
    """
    from hybrid_id.study import check_scales

    system, stage = read_model(config.model), config.previous
    system.check_outputs([channel.name for channel in dataset.outputs])
    odd = check_scales(dataset, system)
    refuse_errors(odd)
    for finding in odd:
        remark(f"warning: {finding.message}")
    idle = [i.name for i in system.table if i.spec.prior_std is not None and not i.spec.estimate]
    if idle:
        remark(f"the prior of {', '.join(idle)} has no effect, for 'estimate' is false")
    if stage is None:
        return system
    from hybrid_id.systems.builders import carry_over
    from hybrid_id.systems.model_file import load_model

    previous = load_model(stage.model)
    try:
        return carry_over(system, previous, stage.hold)
    except InputError as error:
        raise InputError(f"previous ({stage.model}): {error}") from None


def remark_validation(count: int, command: str) -> None:
    """Say that a command has no use for validation records, where there are any."""
    if count:
        those = "1 validation record is" if count == 1 else f"{count} validation records are"
        remark(f"{those} not fitted by {command}; 'hybrid-id diagnose' chooses models by them")


def remark_start_values(dataset: "Dataset", system: "System") -> None:
    """Say what the start values do not explain: a sign, a unit."""
    from hybrid_id.study import check_start_values

    for finding in check_start_values(dataset, system):
        remark(f"warning: {finding.message}")


def one_joint(
    dataset: "Dataset", system: "System", name: str, seed: int
) -> "tuple[Dataset, System, list[Dataset]]":
    """One joint of a robot by itself, the records that bring the motion of the others, and noisier ones."""
    from hybrid_id.systems.by_joint import NOISIER, alone, joint_number, noisier, with_others_measured

    joint = joint_number(system, name)
    given = [dataset, *(noisier(dataset, joint, seed + k) for k in range(NOISIER))]
    first, *others = (with_others_measured(one, system, joint) for one in given)
    return first, alone(system, joint), others


def remark_uneven(records: "Iterable[Record]") -> None:
    """Say where windows, which count samples, last longer in some records than in others."""
    steps = [record.sample_time for record in records]
    if steps and max(steps) > UNEVEN * min(steps):
        remark(
            f"warning: sample times differ between records ({min(steps):.3g} to {max(steps):.3g} s), and windows count "
            "samples of the usual one; 'resample' in dataset.yaml brings all to one"
        )


def check_window(window: str | float, records: "Sequence[Record]") -> None:
    """Refuse windows that hold too few samples, or of which no record has four."""
    from hybrid_id.study import Horizon

    if (horizon := Horizon.of(window)) is not None and records:
        step = median(record.sample_time for record in records)
        horizon.check(max(record.n_samples for record in records), step)


def remark_idle(said: Identification, words: str, settings: "Sequence[str] | None" = None) -> None:
    """Say which settings of the section 'identification' a command does without, of these or but seed and window."""
    plain, asked = Identification(), settings or set(type(said).model_fields) - {"seed", "window"}
    if idle := [k for k in type(said).model_fields if k in asked and getattr(said, k) != getattr(plain, k)]:
        remark(f"{words}; of 'identification' it does without {', '.join(idle)}")


def check_windows(config: StudyConfig, key: str, records: "Sequence[Record]") -> None:
    """Say which windows are longer than the records allow; refuse them where it is all of those that were asked for.

    Args:
        config: the study.
        key: of the windows: `training.windows`, `hybrid.windows`, or `ablation.horizon`.
        records: out of which they are cut.
    """
    from hybrid_id.study.training import too_long

    if not records:
        return
    wish = {
        "training.windows": (config.training.windows, Training().windows),
        "hybrid.windows": ((config.hybrid or Hybrid()).windows, Hybrid().windows),
        "ablation.horizon": ([((config.ablation or Ablation()).horizon, 1)],) * 2,
    }
    windows, default = wish[key]
    remark_uneven(records)
    lengths, why = too_long(records, [seconds for seconds, _ in windows])
    long = [f"{seconds:g} s" for seconds in lengths]
    if not long:
        return
    if len(long) == len(windows) and windows != default:
        with config.at(key):
            raise InputError(
                f"windows of {', '.join(long)} are too long, for {why}; give shorter ones, or [] to begin with whole "
                "records"
            )
    lost = "no short free runs of" if key == "ablation.horizon" else "left out: the stage with windows of"
    remark(f"{lost} {', '.join(long)} ('{key}'), for {why}")
