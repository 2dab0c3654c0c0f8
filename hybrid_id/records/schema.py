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
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator

from hybrid_id.records.resample import MAX_GAP
from hybrid_id.records.units import spellings
from hybrid_id.records.yaml_file import FileName, one_of

Format = Literal["csv", "parquet", "mat", "bam", "bag", "npz", "lerobot"]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, coerce_numbers_to_str=True)


class ChannelEntry(_Part):
    """One input or output.

    Attributes:
        name: its stem and the number of its joint: u1 (voltage), q_m1 (motor's angle), q_a1 (link's angle), ...
        unit: of the values in the files; they become SI on loading.
        noise_std: standard deviation of the sensor's noise, in that unit; estimated where it is left out.
        skew: how much later than the others it is recorded [s].
    """

    name: str
    unit: str = Field(json_schema_extra=one_of(spellings))
    noise_std: float | None = Field(default=None, gt=0)
    skew: float = 0.0


class ColumnEntry(_Part):
    """Where a channel's values are: value = scale * (column, unwrapped, less zero), in `unit`.

    Attributes:
        column: its name in the files.
        scale: what its numbers are multiplied by; -1 turns a sign.
        zero: the file's number where the channel is 0.
        unit: of the result, where it is another than the channel's.
        unwrap: period of a counter or an angle that jumps, in the file's numbers.
    """

    column: str
    scale: float = 1.0
    zero: float = 0.0
    unit: str | None = Field(default=None, json_schema_extra=one_of(spellings))
    unwrap: float | None = Field(default=None, gt=0)

    @field_validator("scale")
    @classmethod
    def _leaves_something(cls, value: float) -> float:
        if value == 0:
            raise ValueError("of 0 leaves nothing of the column; use -1 to turn its sign")
        return value


class ResampleEntry(_Part):
    """A uniform grid for stamps that are none.

    Attributes:
        sample_time: its step [s]; the median one where it is left out.
        inputs: mean of the held command over the new step, or its value there.
        max_gap: longest gap that is bridged, in median steps.
    """

    sample_time: float | None = Field(default=None, gt=0)
    inputs: Literal["average", "hold"] = "average"
    max_gap: float = Field(default=MAX_GAP, gt=1)


def _short_columns(value: Any) -> Any:
    """Write `u1: plant_input` out as `u1: {column: plant_input}`."""
    if not isinstance(value, dict):
        return value
    return {key: item if isinstance(item, dict) else {"column": item} for key, item in value.items()}


Columns = Annotated[
    dict[str, ColumnEntry],
    BeforeValidator(_short_columns, json_schema_input_type=dict[str, str | ColumnEntry]),
]
"""What ``columns`` may be in a file."""


class RecordEntry(_Part):
    """One record, or by a pattern in `file` several.

    Attributes:
        file: inside the dataset's folder; * stands for any characters.
        name: that of the file where it is left out.
        role: train is fitted, validation chooses between models, test measures at the end.
        note: what was done, for people.
        format: where the file's ending does not say it.
        columns: where the files of this record name things otherwise than the others.
        episode: of a LeRobot dataset whose file holds several.
        between: only the samples stamped between these two [s].
        meta: facts that hold throughout the record, payload or temperature say.
    """

    file: FileName = Field(min_length=1)
    name: str | None = None
    role: Literal["train", "validation", "test"] = "train"
    note: str = ""
    format: Format | None = None
    columns: Columns = {}
    episode: int | None = Field(default=None, ge=0)
    between: tuple[float, float] | None = None
    meta: dict[str, float | str] = {}

    @field_validator("file")
    @classmethod
    def _inside(cls, value: str) -> str:
        if any("**" in part and part != "**" for part in value.split("/")):
            raise ValueError("has '**' beside other characters; '*' stands for any of them within a name")
        posix, windows = PurePosixPath(value), PureWindowsPath(value)
        if posix.is_absolute() or windows.anchor or ".." in (*posix.parts, *windows.parts):
            raise ValueError("must name a file inside the dataset's folder")
        return value


class DatasetFile(_Part):
    """Records of one machine: what was commanded, what was measured, and the files that hold it.

    Attributes:
        name: short name.
        sample_time: step that all records share [s]; the stamps count where it is left out.
        inputs: what was commanded.
        outputs: what was measured; every one that is listed is fitted.
        records: the files.
        format: of all files, where their ending does not say it.
        columns: channel (or t) to the column that holds it, where the files name things otherwise.
        resample: true, or options: brings jittered stamps to a uniform grid.
        follow_links: whether symbolic links in the dataset's folder may lead out of it.
    """

    name: str = Field(min_length=1)
    sample_time: float | None = Field(default=None, gt=0)
    inputs: list[ChannelEntry] = []
    outputs: list[ChannelEntry] = Field(min_length=1)
    records: list[RecordEntry] = Field(min_length=1)
    format: Format | None = None
    columns: Columns = {}
    resample: ResampleEntry | None = None
    follow_links: bool = False

    @field_validator("resample", mode="before", json_schema_input_type=bool | ResampleEntry | None)
    @classmethod
    def _short_resample(cls, value: Any) -> Any:
        return {True: {}, False: None}[value] if isinstance(value, bool) else value
