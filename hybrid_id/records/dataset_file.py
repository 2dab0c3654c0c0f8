"""Reading and writing of a dataset folder: `dataset.yaml` (see `schema.py`) and one file a record."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.reading import refuse_outside
from hybrid_id.records.files import plain
from hybrid_id.records.readers import Table, TimeRange, format_of, is_bag_folder, load_any, record_name
from hybrid_id.records.record import Channel, Record, find_fault, keeps_step, stamp
from hybrid_id.records.resample import MAX_GAP, ResampleReport, bring_to, resample_record, shift_channels
from hybrid_id.records.schema import ColumnEntry, DatasetFile, RecordEntry, ResampleEntry
from hybrid_id.records.units import number_of, to_si
from hybrid_id.records.yaml_file import read_yaml, validate, write_yaml

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset

FILE_NAME = "dataset.yaml"
FOLLOW = "copy the file there, or set 'follow_links: true' in dataset.yaml if the link is yours"
SAVED = ("name", "unit", "noise_std")
"""What a file holds of a channel whose values are in SI."""
AROUND = 0.1
"""Share of the part of a file that is kept by which it is read beyond, where channels are brought to one another."""


def load_dataset(path: Path, folder: Path | None) -> dict[str, Any]:
    """Arguments of a `Dataset`; `Dataset.load` documents those of this function."""
    file = path / FILE_NAME if path.is_dir() else path
    if path.is_dir() and not file.exists():
        found = sorted(item.name for item in path.iterdir() if item.is_file())
        shown = (
            f"only {', '.join(found[:3])}{', ...' if len(found) > 3 else ''}" if found else "no files at all"
        )
        raise InputError(
            f"{path} holds no {FILE_NAME} ({shown}); 'hybrid-id init {path}' writes one for its logs, or write it as "
            "docs/records.md shows"
        )
    if path.is_file() and format_of(path) not in (None, "bam"):
        raise InputError(f"{path} is a log and no dataset; 'hybrid-id init {path}' makes a dataset of it")
    spec = validate(DatasetFile, read_yaml(file), file)
    if not spec.follow_links:
        refuse_outside(file, file.parent, str(file), FOLLOW)
    return _build(spec, file, folder or file.parent, path)


def write_dataset(dataset: "Dataset", folder: Path) -> None:
    """Write a dataset into an existing empty folder."""
    import pandas as pd

    entries = []
    for record in dataset:
        file = f"{record.name}.csv.gz"
        frame = pd.DataFrame({"t": record.time, **record.inputs, **record.outputs})
        frame.to_csv(
            folder / file, index=False, compression={"method": "gzip", "compresslevel": 6, "mtime": 0}
        )
        optional = {"note": record.note, "meta": plain(dict(record.meta))}
        entries.append(
            {"file": file, "role": record.role} | {key: item for key, item in optional.items() if item}
        )
    values = {"name": dataset.name, "sample_time": dataset.sample_time}
    for group in ("inputs", "outputs"):
        values[group] = [
            {key: item for key in SAVED if (item := getattr(channel, key)) is not None}
            for channel in getattr(dataset, group)
        ]
    write_yaml(folder / FILE_NAME, plain(values) | {"records": entries})


def _build(spec: DatasetFile, file: Path, folder: Path, path: Path) -> dict[str, Any]:
    """Read all records of a checked dataset file."""
    units = {"t": "s"} | {entry.name: entry.unit for entry in (*spec.inputs, *spec.outputs)}
    # a column map names channels, in units that fit them
    maps = {"columns": spec.columns}
    maps |= {f"records[{index}].columns": entry.columns for index, entry in enumerate(spec.records)}
    for key, columns in maps.items():
        for channel, column in columns.items():
            if channel not in units:
                raise InputError(
                    f"{file}: key '{key}.{channel}' is no channel; channels are {', '.join(units)}"
                )
            try:
                _ = column.unit and to_si(column.unit, channel)
            except InputError as error:
                raise InputError(f"{file}: key '{key}.{channel}': {error}") from None
    # no channel is read from the column of the stamps, and no input from that of an output
    inputs, outputs = ({entry.name for entry in group} for group in (spec.inputs, spec.outputs))
    for index, entry in enumerate(spec.records):
        columns = {name: name for name in ("t", *inputs, *outputs)}
        columns |= {name: column.column for name, column in (spec.columns | entry.columns).items()}
        for one in columns:
            for other in columns:
                stamps, crossed = one != "t" and other == "t", one in inputs and other in outputs
                if (stamps or crossed) and columns[one] == columns[other]:
                    key = f"records[{index}].columns" if {one, other} & entry.columns.keys() else "columns"
                    raise InputError(
                        f"{file}: key '{key}': '{one}' and '{other}' are both read from column '{columns[one]}'; "
                        "correct one of them"
                    )
    inputs, outputs = _channels(spec, "inputs", file), _channels(spec, "outputs", file)
    read = [
        (entry.between, _read_record(entry, spec, units, data_file, file))
        for index, entry in enumerate(spec.records)
        for data_file in _files(entry, folder, f"{file}: key 'records[{index}].file'", spec.follow_links)
    ]
    records = tuple(record for _, record in read)
    slack = max(abs(channel.skew) for channel in (*spec.inputs, *spec.outputs))
    beyond = {}  # records that begin later or end earlier than asked for, by more than steps and skews explain
    for between, record in read:
        if between is None:
            continue
        (start, stop), first, last = between, float(record.time[0]), float(record.time[-1])
        if max(first - start, stop - last) > slack + MAX_GAP * record.sample_time:
            beyond[record.name] = (
                f"'between' asks for {stamp(start)} to {stamp(stop)} s, of which {stamp(first)} to {stamp(last)} s are "
                "logged; correct it, unless all of that is meant"
            )
    # a joint of which nothing changes may be held, while others move; one of two sensors of a joint may not
    moving = {c.name for c in outputs if any(np.ptp(record.outputs[c.name]) for record in records)}
    joints = {number_of(name) for name in moving}
    for channel in outputs:
        if channel.name not in moving and (not moving or number_of(channel.name) in joints):
            words = "stands still in every record; check its column and its sensor"
            raise InputError(f"{file}: output '{channel.name}' {words}")
    sample_time, reports = spec.sample_time, ()
    if spec.resample:
        if spec.resample.sample_time and sample_time and spec.resample.sample_time != sample_time:
            raise InputError(
                f"{file}: key 'resample.sample_time' is {spec.resample.sample_time:g} s where 'sample_time' is "
                f"{sample_time:g} s; give one of them"
            )
        sample_time, records, reports = resampled(records, spec.resample, sample_time)
    elif "sample_time" not in spec.model_fields_set:
        sample_time = common_sample_time(records)
    return {
        "name": spec.name, "inputs": inputs, "outputs": outputs, "records": records, "sample_time": sample_time,
        "path": path, "resampling": reports, "cut_beyond": beyond,
    }  # fmt: skip


def common_sample_time(records: tuple[Record, ...]) -> float | None:
    """Return the step (s) that all records keep, to 9 digits, or None where they have none in common."""
    step = float(f"{np.median([record.sample_time for record in records]):.9g}")
    return step if all(keeps_step(record, step) for record in records) else None


def _channels(spec: DatasetFile, group: str, file: Path) -> tuple[Channel, ...]:
    """Convert the channels of one group to SI."""
    channels = []
    for index, entry in enumerate(getattr(spec, group)):
        try:
            unit, factor = to_si(entry.unit, entry.name)
            column = spec.columns.get(entry.name)
            logged = (column.unit if column else None) or entry.unit
            noise = entry.noise_std and entry.noise_std * factor
            channels.append(Channel(entry.name, unit, noise, "" if logged == unit else logged))
        except InputError as error:
            raise InputError(f"{file}: key '{group}[{index}]': {error}") from None
    return tuple(channels)


def _files(entry: RecordEntry, folder: Path, where: str, follow_links: bool) -> Iterator[Path]:
    """Yield the files that one entry stands for; none of them lies elsewhere, unless links may be followed."""
    found = [folder / entry.file]
    if not found[0].exists() and any(sign in entry.file for sign in "*?["):
        found = sorted(
            path
            for path in folder.glob(entry.file)
            if not path.name.startswith(".") and (path.is_file() or is_bag_folder(path))
        )
        if not found:
            raise InputError(
                f"{where}: no file fits the pattern '{entry.file}'; correct it or bring the files"
            )
        if entry.name and len(found) > 1:
            raise InputError(
                f"{where}: {len(found)} files fit '{entry.file}', but 'name' names one; remove 'name'"
            )
    for path in found:
        for one in () if follow_links else (path, *(path.iterdir() if path.is_dir() else ())):
            refuse_outside(one, folder, f"{where}: {one}", FOLLOW)
        yield path


def _read_record(
    entry: RecordEntry, spec: DatasetFile, units: Mapping[str, str], path: Path, file: Path
) -> Record:
    """Read one file and bring its signals to SI."""
    columns = {channel: ColumnEntry(column=channel) for channel in units} | spec.columns | entry.columns
    table = _read(path, columns, entry, spec, units["t"])
    signals = {
        channel: _to_channel(table, column, column.unit or units[channel], channel)
        for channel, column in columns.items()
    }
    time = signals.pop("t")
    times = {
        name: table.times[columns[name].column] for name in signals if columns[name].column in table.times
    }
    fault = find_fault(
        time, {name: signals[name] for name in signals if name not in times}, str(path), table.place
    )
    if times and not fault:
        kept, signals = bring_to(
            time,
            signals,
            times,
            {channel.name for channel in spec.inputs},
            source=str(path),
            max_gap=(spec.resample or ResampleEntry()).max_gap,
            between=entry.between,
        )
        first, time = kept.start, time[kept]
        fault = find_fault(time, signals, str(path), lambda k: table.place(first + k))
    if fault:
        raise InputError(fault)
    still = [channel.name for channel in spec.outputs if not np.ptp(signals[channel.name])]
    if len(still) == len(spec.outputs):
        raise InputError(
            f"{path}: output '{still[0]}' is {signals[still[0]][0]:g} in every sample, so nothing can be learnt from "
            "it; check its column and its sensor, or leave the record out"
        )
    meta = {**table.meta, **entry.meta}
    try:
        record = Record(
            name=entry.name
            or record_name(path) + ("" if entry.episode is None else f"_episode_{entry.episode}"),
            time=time,
            inputs={channel.name: signals[channel.name] for channel in spec.inputs},
            outputs={channel.name: signals[channel.name] for channel in spec.outputs},
            role=entry.role,
            note=entry.note or str(meta.get("trajectory", "")),
            source=str(path),
            meta=meta,
        )
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    record = shift_channels(record, {channel.name: channel.skew for channel in (*spec.inputs, *spec.outputs)})
    return record.between(*entry.between) if entry.between else record


def _read(
    path: Path, columns: Mapping[str, ColumnEntry], entry: RecordEntry, spec: DatasetFile, unit: str
) -> Table:
    """Read a file, or what of it a record's `between` asks for: the file may be larger than the memory."""
    wanted, time = list(dict.fromkeys(column.column for column in columns.values())), columns["t"]
    file_format, factor = entry.format or spec.format, time.scale * to_si(time.unit or unit, "t")[1]
    turns = any(column.unwrap for column in columns.values())  # are counted from the file's start
    if entry.between and factor > 0 and not turns:
        low, high = (stamp / factor + time.zero for stamp in entry.between)
        slack = 1e-9 * max(abs(low), abs(high))  # the exact cut comes later, in seconds
        if skew := max(abs(channel.skew) for channel in (*spec.inputs, *spec.outputs)):
            # channels that are recorded late or early have values there
            slack += skew / factor + AROUND * (high - low)
        table = load_any(
            path,
            wanted,
            file_format=file_format,
            time_range=TimeRange(time.column, low - slack, high + slack),
            episode=entry.episode,
        )
        if len(table.columns[time.column]) > 1:
            return table
    return load_any(
        path, wanted, file_format=file_format, episode=entry.episode
    )  # whole, to say what it has instead


def _to_channel(table: Table, column: ColumnEntry, unit: str, channel: str) -> np.ndarray:
    """Bring one column to its channel's SI unit, (T,)."""
    values = table.columns[column.column]
    if column.unwrap:
        values = np.unwrap(values, period=column.unwrap)
    if column.zero:
        values = values - column.zero
    factor = column.scale * to_si(unit, channel)[1]
    if column.column in table.stamps and factor != 1:
        raise InputError(
            f"{table.path}: column '{column.column}' holds dates, which are read as seconds; leave out its 'unit' and "
            "'scale'"
        )
    return values if factor == 1 else factor * values


def resampled(
    records: tuple[Record, ...], options: ResampleEntry, sample_time: float | None
) -> tuple[float, tuple[Record, ...], tuple[ResampleReport, ...]]:
    """Records on one grid, its step [s], and what was done to each: the step asked for, the dataset's, or the usual."""
    middle = float(np.median([record.sample_time for record in records]))
    step = options.sample_time or sample_time or common_sample_time(records) or float(f"{middle:.3g}")
    pairs = [
        resample_record(record, step, inputs=options.inputs, max_gap=options.max_gap) for record in records
    ]
    return step, tuple(pair[0] for pair in pairs), tuple(pair[1] for pair in pairs)
