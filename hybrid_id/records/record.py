"""One measured (or simulated) experiment: time, what was commanded, what came out, and what its signals are."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from hybrid_id.errors import CONTROL, InputError, has_control, shown
from hybrid_id.reading import PLAIN_NAME
from hybrid_id.records.units import to_si

UNIFORM_TOLERANCE = 0.01  # steps this close to the median step, relative, count as equal
SAMPLE_TIME_TOLERANCE = 1e-3  # mean step of a record against the dataset's sample time, relative
SMALLEST = 1e-15  # of a signal's largest value in SI, unless it is zero throughout: less is no measurement
LARGEST = 1e10  # of a signal in SI; what is larger is a fault of the log, and its square may overflow


def stamp(time: float) -> str:
    """A time [s] as a message shows it: to the millisecond where stamps count from 1970, too."""
    return f"{time:.13g}"


@dataclass(frozen=True)
class Channel:
    """One signal of a dataset.

    Attributes:
        name: `u1`, `q_m1`, ...: an identifier; docs/formats.md has the table of names.
        unit: SI unit, such as `V` or `rad/s`.
        noise_std: Standard deviation of the sensor's noise, in `unit`; None where it is not known.
        logged: Unit of the files, in which values are shown; empty for `unit`.
        joint: Name that a robot's description gives to its joint; empty where none does.
    """

    name: str
    unit: str
    noise_std: float | None = None
    logged: str = ""
    joint: str = ""

    def __post_init__(self) -> None:
        if not self.name.isidentifier() or self.name == "t":
            raise InputError(f"channel name '{self.name}' is not usable; give a name such as u1 or q_m1")
        try:
            si = to_si(self.unit, self.name)[0]
            logged = to_si(self.logged or self.unit, self.name)[0]
        except InputError as error:
            raise InputError(f"channel '{self.name}': {error}") from None
        if si != self.unit:
            raise InputError(
                f"channel '{self.name}': unit '{self.unit}' is not SI; convert its values to {si}"
            )
        if logged != self.unit:
            raise InputError(f"channel '{self.name}': logged unit '{self.logged}' is not one of {self.unit}")
        if self.noise_std is not None and not 0 < self.noise_std < np.inf:
            raise InputError(
                f"channel '{self.name}': noise_std is {self.noise_std}; give one above 0, or none"
            )

    @property
    def title(self) -> str:
        """How the signal is called where people read of it: `q_a3 (elbow)`, its name alone where no joint is named."""
        return f"{self.name} ({self.joint})" if self.joint else self.name

    @property
    def shown(self) -> tuple[str, float]:
        """Unit in which values are shown, and the factor that brings values in `unit` to it."""
        if not self.logged:
            return self.unit, 1.0
        return self.logged, 1.0 / to_si(self.logged, self.name)[1]


@dataclass(frozen=True, eq=False)
class Record:
    """One experiment, checked on construction; its arrays cannot be written to.

    Attributes:
        name: Unique in its dataset; letters, digits and `._-+ `.
        time: Stamps [s], shape (T,), strictly increasing, T >= 2.
        inputs: Channel name -> values in SI units, (T,); sample k is held until sample k + 1.
        outputs: Channel name -> values in SI units, (T,), measured at the stamps.
        role: `train`; `validation` for a record that chooses between models, or `test` for one that nothing may see.
        note: What was done, for people.
        source: File that it came from, for messages.
        meta: Facts of the experiment, name -> number or text (payload, controller gain).

    Raises:
        InputError: when a value is not finite, lengths differ, or time does not increase.
    """

    name: str
    time: np.ndarray
    inputs: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]
    role: Literal["train", "validation", "test"] = "train"
    note: str = ""
    source: str = ""
    meta: Mapping[str, float | str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not PLAIN_NAME.fullmatch(self.name):
            raise InputError(
                f"record name {self.name!r} cannot be a file name; use at most 100 letters, digits, '_' and '-'"
            )
        for what, words in {
            "note": self.note,
            **{f"meta '{k}'": f"{k} {v}" for k, v in self.meta.items()},
        }.items():
            if has_control(words, lines=True):
                raise InputError(f"{self.title}: {shown(what)} {CONTROL}; correct it")
        if self.role not in ("train", "validation", "test"):
            raise InputError(
                f"{self.title}: role {self.role!r} is unknown; it is 'train', 'validation' or 'test'"
            )
        if twice := set(self.inputs) & set(self.outputs):
            raise InputError(f"{self.title}: '{min(twice)}' is an input and an output; give one another name")
        freeze = {name: _read_only(values) for name, values in {**self.inputs, **self.outputs}.items()}
        time = _read_only(self.time)
        if fault := find_fault(time, freeze, self.title, lambda k: f"sample {k}"):
            raise InputError(fault)
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "inputs", MappingProxyType({name: freeze[name] for name in self.inputs}))
        object.__setattr__(self, "outputs", MappingProxyType({name: freeze[name] for name in self.outputs}))
        object.__setattr__(self, "meta", MappingProxyType(dict(self.meta)))

    def __reduce__(self) -> tuple[Any, ...]:
        # Read-only mappings cannot be sent to worker processes; rebuild from plain ones.
        inputs, outputs = dict(self.inputs), dict(self.outputs)
        return Record, (
            self.name, self.time, inputs, outputs, self.role, self.note, self.source, dict(self.meta),
        )  # fmt: skip

    def __repr__(self) -> str:
        channels = f"{', '.join(self.inputs)} -> {', '.join(self.outputs)}"
        return (
            f"Record({self.name!r}, {self.role}, {self.n_samples} samples, {self.duration:.3g} s, {channels})"
        )

    @property
    def title(self) -> str:
        """Name for messages: the record, and its file where there is one."""
        return f"record '{self.name}'" + (f" ({self.source})" if self.source else "")

    @property
    def n_samples(self) -> int:
        """Number of samples T."""
        return self.time.size

    @property
    def duration(self) -> float:
        """Time from the first to the last stamp [s]."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def sample_time(self) -> float:
        """Median step between stamps [s]."""
        return float(np.median(np.diff(self.time)))

    @cached_property
    def is_uniform(self) -> bool:
        """Whether every step lies within 1 % of the median step."""
        return bool(
            np.all(np.abs(np.diff(self.time) - self.sample_time) <= UNIFORM_TOLERANCE * self.sample_time)
        )

    def signal(self, channel: str) -> np.ndarray:
        """Return an input or output by its name, (T,)."""
        if channel in self.inputs:
            return self.inputs[channel]
        if channel in self.outputs:
            return self.outputs[channel]
        known = ", ".join([*self.inputs, *self.outputs])
        raise InputError(f"{self.title} has no channel '{channel}'; it has {known}")

    def between(self, start: float, stop: float) -> "Record":
        """Return the part whose stamps lie in [start, stop] (s), the stamps unchanged."""
        if not start < stop:
            raise InputError(
                f"{self.title}: between [{stamp(start)}, {stamp(stop)}] is reversed; give the earlier time first"
            )
        first, last = np.searchsorted(self.time, (start, stop), side="left")
        last += last < self.n_samples and self.time[last] == stop
        if last - first < 2:
            raise InputError(
                f"{self.title}: fewer than 2 samples lie between {stamp(start)} s and {stamp(stop)} s; "
                f"its stamps run from {stamp(self.time[0])} s to {stamp(self.time[-1])} s"
            )
        cut = slice(first, last)
        return replace(
            self,
            time=self.time[cut],
            inputs={name: values[cut] for name, values in self.inputs.items()},
            outputs={name: values[cut] for name, values in self.outputs.items()},
        )


def find_fault(
    time: np.ndarray, signals: Mapping[str, np.ndarray], source: str, place: Callable[[int], str]
) -> str | None:
    """Say in a sentence what is wrong with the arrays of a record, or return None.

    Args:
        time: Stamps [s], shape (T,).
        signals: Name -> values, to be (T,) and finite.
        source: The record or file, to begin the sentence with.
        place: Words for sample k, such as `row 17`.
    """
    if time.ndim != 1:
        return f"{source}: time has shape {time.shape}; give one number a sample"
    if time.size < 2:
        return f"{source}: it holds {time.size} sample{'s' * (time.size != 1)}; a record needs at least 2"
    for name, values in {"time": time, **signals}.items():
        if values.shape != time.shape:
            return f"{source}: '{name}' has shape {values.shape} where time has {time.shape}; give one value a stamp"
        if not np.isfinite(values).all():
            k = int(np.argmin(np.isfinite(values)))
            return (
                f"{source}, {place(k)}: '{name}' is {values[k]:g}, not a finite number; correct or remove it"
            )
        if name != "time" and np.abs(values).max() > LARGEST:
            k = int(np.argmax(np.abs(values) > LARGEST))
            return f"{source}, {place(k)}: '{name}' is {values[k]:g}, which no sensor reads; correct it or its unit"
        if name != "time" and 0 < (most := float(np.abs(values).max())) < SMALLEST:
            return f"{source}: '{name}' never exceeds {most:g}, which no sensor reads; check its column and its scale"
    backward = np.diff(time) <= 0
    if backward.any():
        k = int(np.argmax(backward)) + 1
        return (
            f"{source}, {place(k)}: time goes from {time[k - 1]:.9g} s to {time[k]:.9g} s, but it must increase; "
            "sort the samples or remove the repeated ones"
        )
    return None


def _read_only(values: Any) -> np.ndarray:
    """Return values as a float64 array that cannot be written to, without a copy where it already is one."""
    if isinstance(values, np.ndarray) and values.dtype == np.float64 and not values.flags.writeable:
        return values
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"a signal is not an array of numbers ({error}); give floats") from None
    array.setflags(write=False)
    return array


def keeps_step(record: Record, sample_time: float) -> bool:
    """Whether a record is uniform and keeps this step (s) on average within 0.1 %."""
    mean = record.duration / (record.n_samples - 1)
    return record.is_uniform and abs(mean - sample_time) <= SAMPLE_TIME_TOLERANCE * sample_time
