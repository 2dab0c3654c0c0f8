"""Logs as they come: which files a path stands for, and all of their columns on one clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.reading import size_of
from hybrid_id.records.files import natural_order
from hybrid_id.records.readers import (
    Table,
    column_names,
    format_of,
    in_lerobot,
    is_bag_folder,
    lerobot_episodes,
    load_any,
)

READ = "CSV, Parquet, MAT, npz, ROS bags, LeRobot datasets and BAM logs"
MOST_COLUMNS = 300
"""Columns of one log that are looked at."""


@dataclass(frozen=True)
class LogFile:
    """A file, or an episode of one, that a record can be made of; ``named`` where the user named it himself."""

    path: Path
    file_format: str
    episode: int | None = None
    named: bool = True

    @property
    def title(self) -> str:
        """Name for messages."""
        return self.path.name + ("" if self.episode is None else f", episode {self.episode}")


@dataclass(frozen=True)
class Log:
    """A log that has been read.

    Attributes:
        file: where it comes from.
        columns: name -> values, all of one length.
        clock: name of the topic of a bag whose stamps are the clock; empty elsewhere.
        left: columns that could not be taken -> why.
        times: columns of other topics of a bag -> their own stamps [s].
    """

    file: LogFile
    columns: Mapping[str, np.ndarray]
    clock: str = ""
    left: Mapping[str, str] = field(default_factory=dict)
    times: Mapping[str, np.ndarray] = field(default_factory=dict)


def find_logs(paths: Sequence[Path]) -> list[LogFile]:
    """The logs that files and folders stand for, in natural order of their names.

    Raises:
        InputError: a path does not exist, or nothing under it is a log.
    """
    found: dict[tuple[Path, int | None], LogFile] = {}
    for path in paths:
        if not path.exists():
            raise InputError(f"{path} does not exist; correct the path or bring the file")
        if not path.is_dir():
            size_of(path)  # refuses pipes and devices
        try:
            files = _below(path)
        except PermissionError as error:
            raise InputError(f"{path} cannot be read ({error.strerror}); give a readable folder") from None
        if not files:
            raise InputError(f"{path} holds no logs that are read ({READ}); give files or folders of those")
        for file in files:
            found.setdefault((file.path.resolve(), file.episode), file)
    if not found:
        raise InputError(f"there are no logs; give files or folders of {READ}")
    return list(found.values())


def _below(path: Path) -> list[LogFile]:
    named = path.is_file() or is_bag_folder(path)
    if named:
        files = [path]
    elif in_lerobot(path) == path.resolve():
        files = list(path.glob("data/**/*.parquet"))
    else:
        files = [one for one in path.iterdir() if not one.name.startswith(".")]
    logs = []
    for file in sorted(files, key=lambda file: natural_order(str(file))):
        kind = format_of(file) if file.is_file() or is_bag_folder(file) else None
        if kind is None:
            if named:
                raise InputError(f"{file} is of no format that 'init' reads ({READ}); give one of those")
            continue
        if kind == "parquet" and in_lerobot(file) is not None:
            episodes = lerobot_episodes(file)
            single = len(episodes) == 1
            logs += [LogFile(file, "lerobot", None if single else episode, named) for episode in episodes]
        else:
            logs.append(LogFile(file, kind, None, named))
    return logs


def read_log(file: LogFile) -> Log:
    """Read all columns of a log that hold numbers, on one clock.

    Raises:
        InputError: the file is damaged or holds no numbers.
    """
    names = list(dict.fromkeys(column_names(file.path, file.file_format)))
    clock = ""
    if file.file_format == "bag":
        topics = [name for name in names if any(other.startswith(f"{name}/") for other in names)]
        if not topics:
            raise InputError(
                f"{file.path} has no topic of joint states, of a controller's state or of numbers"
            )
        clock = max(
            topics,
            key=lambda topic: sum("/position" in name for name in names if name.startswith(f"{topic}/")),
        )
        names = [name for name in names if name not in topics]
        names.sort(key=lambda name: not name.startswith(f"{clock}/"))
    left = {name: "beyond the first columns, which are looked at" for name in names[MOST_COLUMNS:]}
    names = names[:MOST_COLUMNS]
    table, faults = _read(file, names, clock)
    left |= faults
    time = table.columns.get(clock)
    if clock:
        length = table.columns[clock].size
    else:
        sizes = [values.size for values in table.columns.values()]
        length = max(set(sizes), key=lambda size: (sizes.count(size), size)) if sizes else 0
    columns = {}
    for name in names:
        if name in left:
            continue
        values = table.columns[name]
        if name in table.times and table.times[name].size < 2:
            left[name] = "has a single value"
            continue
        if name in table.times and time is not None:
            # nearest where it steps by half of its range: an angle that begins anew has no value between, nor a switch
            stamps = table.times[name]
            after = np.clip(np.searchsorted(stamps, time), 1, stamps.size - 1)
            jumps = np.abs(values[after] - values[after - 1]) > 0.5 * np.ptp(values)
            sooner = time - stamps[after - 1] < stamps[after] - time
            nearest = np.where(sooner, values[after - 1], values[after])
            values = np.where(jumps, nearest, np.interp(time, stamps, values))
        if values.size != length:
            left[name] = f"has {values.size} values where most columns have {length}"
        elif not np.isfinite(values).all():
            left[name] = "has values that are missing or no finite numbers"
        else:
            columns[name] = values
    if clock and time is not None:
        columns = {clock: time, **columns}
    if len(columns) < 2 or length < 20:
        raise InputError(f"{file.path} holds no table of at least 20 rows and 2 columns of numbers")
    return Log(
        file, columns, clock, left, {name: table.times[name] for name in columns if name in table.times}
    )


def _read(file: LogFile, names: Sequence[str], clock: str) -> tuple[Table, dict[str, str]]:
    """All columns at once; where one cannot be read, one by one."""
    first = [clock] if clock else []

    def load(wanted: Sequence[str]) -> Table:
        return load_any(file.path, [*first, *wanted], file_format=file.file_format, episode=file.episode)

    try:
        return load(names), {}
    except InputError:
        pass
    faults, good = {}, []
    for name in names:
        try:
            load([name])
            good.append(name)
        except InputError as error:
            faults[name] = str(error).removeprefix(f"{file.path}, ").removeprefix(f"{file.path}: ")
    if not good:
        raise InputError(
            f"{file.path} has no column of numbers: {next(iter(faults.values()), 'it is empty')}"
        )
    return load(good), faults
