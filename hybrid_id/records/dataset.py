"""A set of records with the same channels, and the folder that it is kept in."""

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hybrid_id.errors import CONTROL, InputError, close_match, has_control, listed, shown
from hybrid_id.records.files import hidden_beside
from hybrid_id.records.record import Channel, Record, keeps_step
from hybrid_id.records.resample import ResampleReport, shift_channels

SIGNAL_SHARE = 0.004
"""Standard deviation added to each measurement's noise, as a share of the record's: what a good model still misses."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """Records of one machine with the same channels, checked on construction.

    Attributes:
        name: Short name.
        inputs: What was commanded, in the order of the files.
        outputs: What was measured.
        records: At least one; names are unique.
        sample_time: Step that all records share [s]; None where they differ or are not uniform, so that
            each record's own stamps count.
        path: Folder or file that it was loaded from.
        resampling: One report a record where they were resampled on loading.
        cut_beyond: Record -> words on its `between` in the file, where that reaches beyond what is logged.
        signal_share: What fits add to the noise of each measurement, as a share of its signal's standard deviation.

    Example:
        >>> data = Dataset.load("my_robot")  # doctest: +SKIP
        >>> [record.name for record in data.train]  # doctest: +SKIP
        ['rec_00', 'rec_01']
    """

    name: str
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    records: tuple[Record, ...]
    sample_time: float | None = None
    path: Path | None = None
    resampling: tuple[ResampleReport, ...] = ()
    cut_beyond: Mapping[str, str] = field(default_factory=dict)
    signal_share: float = SIGNAL_SHARE

    def __post_init__(self) -> None:
        for name in ("inputs", "outputs", "records", "resampling"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        where = f"dataset '{self.name}'" + (f" ({self.path})" if self.path else "")
        if has_control(self.name):
            raise InputError(f"the dataset's name '{shown(self.name)}' {CONTROL}; correct it")
        if not self.outputs or not self.records:
            missing = "outputs" if not self.outputs else "records"
            raise InputError(f"{where} has no {missing}; list at least one under '{missing}'")
        channels = [channel.name for channel in (*self.inputs, *self.outputs)]
        for kind, names in (("channel", channels), ("record", [record.name for record in self.records])):
            twice = next((name for name in names if names.count(name) > 1), None)
            if twice:
                sources = [record.source for record in self.records if record.name == twice and record.source]
                same = f", or leave {sources[0]} out of one entry" if len(sources) > len(set(sources)) else ""
                raise InputError(
                    f"{where}: {kind} name '{twice}' is used twice; give each {kind} its own name{same}"
                )
        if self.sample_time is not None and not 0 < self.sample_time < np.inf:
            raise InputError(f"{where}: sample_time is {self.sample_time}; give seconds above 0")
        for record in self.records:
            for kind, declared in (("inputs", self.inputs), ("outputs", self.outputs)):
                has, needs = set(getattr(record, kind)), {channel.name for channel in declared}
                if has != needs:
                    raise InputError(
                        f"{record.title} has {kind} {sorted(has)} where {where} has {sorted(needs)}"
                    )
            if self.sample_time is not None and not keeps_step(record, self.sample_time):
                steps, advice = np.diff(record.time), ""
                least, most = f"{steps.min():.6g}", f"{steps.max():.6g}"
                apart = least if least == most else f"{least} to {most}"
                for unit, factor in {"ms": 1e3, "us": 1e6}.items():
                    if abs(record.sample_time / (factor * self.sample_time) - 1) < 0.1:
                        entry = f"'t: {{column: t, unit: {unit}}}'"
                        advice = f"if they are in {unit}, set {entry} under 'columns'; otherwise "
                raise InputError(
                    f"{record.title}: its stamps are {apart} s apart, but sample_time is {self.sample_time:g} s; "
                    f"{advice}correct or remove sample_time, or set 'resample: true'"
                )

    def __len__(self) -> int:
        return len(self.records)

    def __iter__(self) -> Iterator[Record]:
        return iter(self.records)

    def __repr__(self) -> str:
        steps = f"{self.sample_time:g} s" if self.sample_time else "as stamped"
        channels = [", ".join(channel.name for channel in group) for group in (self.inputs, self.outputs)]
        return (
            f"Dataset({self.name!r}, {len(self.train)} train + {len(self.test)} test records, step {steps}, "
            f"{channels[0]} -> {channels[1]})"
        )

    @property
    def train(self) -> tuple[Record, ...]:
        """Records for fitting."""
        return tuple(record for record in self.records if record.role == "train")

    @property
    def validation(self) -> tuple[Record, ...]:
        """Records that choose between models and are fitted last, with the train records."""
        return tuple(record for record in self.records if record.role == "validation")

    @property
    def test(self) -> tuple[Record, ...]:
        """Records that no fit may see."""
        return tuple(record for record in self.records if record.role == "test")

    def __getitem__(self, name: str) -> Record:
        """Return the record of a name."""
        return self.select([name]).records[0]

    def select(self, names: Iterable[str]) -> "Dataset":
        """Return the dataset with only the named records, in the order of the names."""
        by_name = {record.name: record for record in self.records}
        names = list(names)
        for name in names:
            if name not in by_name:
                near = close_match(name, by_name)
                raise InputError(
                    f"dataset '{self.name}' has no record '{name}'{near}; it has {listed(by_name)}"
                )
        kept = tuple(report for report in self.resampling if report.record in names)
        return replace(self, records=tuple(by_name[name] for name in names), resampling=kept)

    @property
    def digest(self) -> str:
        """Hash of the channels and of all records, their names and roles included."""
        found = hashlib.sha256(repr((self.inputs, self.outputs)).encode())
        for record in self.records:
            found.update(f"{record.name} {record.role}".encode() + record.time.tobytes())
            for name, values in (*record.inputs.items(), *record.outputs.items()):
                found.update(name.encode() + values.tobytes())
        return found.hexdigest()

    def without_skew(self, late: Mapping[str, float]) -> "Dataset":
        """Return the dataset with channels shifted that were recorded late, so that all belong to one time.

        Args:
            late: Channel -> how late it is recorded [s], negative where early; `records.skew.find_skews` estimates it.

        Raises:
            InputError: a channel is not there, or a skew is longer than a record.
        """
        known = [channel.name for channel in (*self.inputs, *self.outputs)]
        for name in late:
            if name not in known:
                raise InputError(
                    f"dataset '{self.name}' has no channel '{name}'{close_match(name, known)}; it has {listed(known)}"
                )
        return replace(self, records=tuple(shift_channels(record, late) for record in self.records))

    @staticmethod
    def load(path: str | Path, *, folder: str | Path | None = None) -> "Dataset":
        """Read a dataset folder, or a dataset file of any name.

        Args:
            path: Folder that holds `dataset.yaml`, or the YAML file itself.
            folder: Where the records lie; None means beside the YAML file.

        Raises:
            InputError: one sentence that names file, row and column or key of the first fault.
        """
        from hybrid_id.records.dataset_file import load_dataset  # brings in pydantic and yaml, only here

        return Dataset(**load_dataset(Path(path), None if folder is None else Path(folder)))

    def save(self, path: str | Path) -> Path:
        """Write the dataset as a folder of `dataset.yaml` and one `.csv.gz` a record; returns the folder.

        Values are written with all their digits, so that loading gives the same numbers. The folder appears
        under its name only when it is complete.

        Raises:
            InputError: when there is a non-empty folder or a file of that name already.
        """
        from hybrid_id.records.dataset_file import write_dataset

        path = Path(path)
        if path.exists() and not (path.is_dir() and not any(path.iterdir())):
            raise InputError(f"{path} exists already and is not empty; give another folder or remove it")
        path.parent.mkdir(parents=True, exist_ok=True)
        with hidden_beside(path) as temporary:
            complete = temporary / "complete"
            complete.mkdir()
            write_dataset(self, complete)
            complete.replace(path)
        return path
