"""The schema of `dataset.yaml`.

Only `name`, `outputs` and `records` are needed; unknown keys are errors.

```yaml
name: my_robot
sample_time: 0.002            # s; leave it out to take the stamps as they are
inputs:
  - {name: u1, unit: V}
outputs:
  - {name: q_m1, unit: deg, noise_std: 0.05}     # unit in the files; values become SI on loading
  - {name: i1, unit: A, skew: 0.0009}            # s; recorded so much late against the others, shifted on loading
columns:                      # only where the files name things otherwise
  t: {column: time, unit: ms}
  u1: plant_input
  q_m1: {column: theta, scale: -1, unwrap: 360, zero: 12.5}
resample: true                # or {sample_time: 0.005, inputs: hold, max_gap: 5}
records:
  - {file: run1.csv, role: train, note: multisine}
  - {file: run2.csv, role: test, between: [0.2, 5.0]}
  - {file: logs/*.json.gz, format: bam}          # a pattern stands for every file that fits it
```
"""

from pathlib import PurePosixPath, PureWindowsPath
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from hybrid_id.records.resample import MAX_GAP

Format = Literal["csv", "parquet", "mat", "bam", "bag", "npz", "lerobot"]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, coerce_numbers_to_str=True)


class ChannelEntry(_Part):
    """One input or output; `unit` is that of the files, and so is `noise_std`; `skew` is in seconds."""

    name: str
    unit: str
    noise_std: float | None = Field(default=None, gt=0)
    skew: float = 0.0


class ColumnEntry(_Part):
    """Where a channel's values are: value = scale * (column, unwrapped, less zero), in `unit`."""

    column: str
    scale: float = 1.0
    zero: float = 0.0  # the file's number where the channel is 0
    unit: str | None = None
    unwrap: float | None = Field(
        default=None, gt=0
    )  # period of a counter or angle that jumps, in the file's numbers

    @field_validator("scale")
    @classmethod
    def _leaves_something(cls, value: float) -> float:
        if value == 0:
            raise ValueError("of 0 leaves nothing of the column; use -1 to turn its sign")
        return value


class ResampleEntry(_Part):
    """Options of `resample_record`."""

    sample_time: float | None = Field(default=None, gt=0)
    inputs: Literal["average", "hold"] = "average"
    max_gap: float = Field(default=MAX_GAP, gt=1)


class RecordEntry(_Part):
    """One record, or by a pattern in `file` several."""

    file: str = Field(min_length=1)
    name: str | None = None
    role: Literal["train", "validation", "test"] = "train"
    note: str = ""
    format: Format | None = None
    columns: dict[str, ColumnEntry] = {}
    episode: int | None = Field(default=None, ge=0)  # of a LeRobot dataset whose file holds several
    between: tuple[float, float] | None = None  # s; only the samples stamped between these two
    meta: dict[str, float | str] = {}

    _columns = field_validator("columns", mode="before")(lambda value: _short_columns(value))

    @field_validator("file")
    @classmethod
    def _inside(cls, value: str) -> str:
        if not value.isprintable():
            raise ValueError("must be a file's name without control characters")
        if any("**" in part and part != "**" for part in value.split("/")):
            raise ValueError("has '**' beside other characters; '*' stands for any of them within a name")
        posix, windows = PurePosixPath(value), PureWindowsPath(value)
        if posix.is_absolute() or windows.anchor or ".." in (*posix.parts, *windows.parts):
            raise ValueError("must name a file inside the dataset's folder")
        return value


class DatasetFile(_Part):
    """All of `dataset.yaml`."""

    name: str = Field(min_length=1)
    sample_time: float | None = Field(default=None, gt=0)
    inputs: list[ChannelEntry] = []
    outputs: list[ChannelEntry] = Field(min_length=1)
    records: list[RecordEntry] = Field(min_length=1)
    format: Format | None = None
    columns: dict[str, ColumnEntry] = {}
    resample: ResampleEntry | None = None

    _columns = field_validator("columns", mode="before")(lambda value: _short_columns(value))

    @field_validator("resample", mode="before")
    @classmethod
    def _short_resample(cls, value: Any) -> Any:
        return {True: {}, False: None}[value] if isinstance(value, bool) else value


def _short_columns(value: Any) -> Any:
    """Write `u1: plant_input` out as `u1: {column: plant_input}`."""
    if not isinstance(value, dict):
        return value
    return {key: item if isinstance(item, dict) else {"column": item} for key, item in value.items()}
