# pyright: reportCallIssue=false
import gzip
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.quality import check_dataset
from hybrid_id.records.readers import load_any, record_name
from hybrid_id.records.units import to_si

COLUMNS = {"t": [0.0, 0.5, 1.0], "u1": [1.5, -2.0, 3e-5]}


@pytest.mark.parametrize(
    "text",
    [
        "t,u1\n0,1.5\n.5,-2\n1,3e-5\n",
        "t, u1, more\n0, 1.5, x\n0.5, -2, y\n1, 3e-5, z\n",
        '"t"\t"u1"\r\n0\t1.5\r\n0.5\t-2\r\n1\t3e-5\r\n',
        "t;u1\n0;1,5\n0,5;-2\n1;0,00003\n",
        "t\tu1\n0\t1,5\n0,5\t-2\n1\t0,00003\n",
        "t   u1\n  0   1.5\n  0.5  -2\n  1 3e-5",
        "# t u1\n0 1.5\n0.5 -2\n1 3e-5\n",
        "% recorded in May\n\nt,u1,\n0,1.5,\n\n0.5,-2,\n1,3e-5,\n",
        "\ufefft,u1\n0,1.5\n0.5,-2\n1,3e-5\n",
    ],
)
def test_dialects_of_text_tables(text: str, tmp_path) -> None:
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(text.encode()))
    table = load_any(path, ["t", "u1"])
    for name, values in COLUMNS.items():
        np.testing.assert_array_equal(table.columns[name], values)


def test_row_of_a_sample_counts_every_line_of_the_file(tmp_path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("# remark\n\nt,u1\n0,1\n\n1,2\n")
    table = load_any(path, ["t"])
    assert [table.place(k) for k in range(2)] == ["row 4", "row 6"]


def test_file_without_header_has_numbered_columns(tmp_path) -> None:
    (tmp_path / "a.txt").write_text("0 1.5\n0.5 -2\n1 3e-5\n")
    np.testing.assert_array_equal(load_any(tmp_path / "a.txt", ["2"]).columns["2"], COLUMNS["u1"])


def test_parquet_with_time_of_day(tmp_path) -> None:
    frame = pd.DataFrame(COLUMNS | {"on": [True, False, True], "text": "x"})
    frame["clock"] = pd.Timestamp("2024-02-29 23:59:59") + pd.to_timedelta(frame["t"], unit="s")
    frame.to_parquet(tmp_path / "a.parquet")
    table = load_any(tmp_path / "a.parquet", ["u1", "clock", "on"])
    np.testing.assert_array_equal(table.columns["u1"], COLUMNS["u1"])
    np.testing.assert_allclose(table.columns["clock"], COLUMNS["t"])
    np.testing.assert_array_equal(table.columns["on"], [1, 0, 1])


def test_dates_have_no_unit_of_their_own(tmp_path) -> None:
    frame = pd.DataFrame({"u1": np.arange(9.0), "q_m1": np.arange(9.0) ** 2})
    frame["clock"] = pd.Timestamp("2026-11-20") + pd.to_timedelta(0.01 * np.arange(9), unit="s")
    frame.to_parquet(tmp_path / "a.parquet")
    text = "name: a\ninputs: [{name: u1, unit: V}]\noutputs: [{name: q_m1, unit: rad}]\nrecords: [{file: a.parquet}]\n"
    (tmp_path / "dataset.yaml").write_text(text + "columns: {t: {column: clock}}\n")
    np.testing.assert_allclose(Dataset.load(tmp_path)["a"].time, 0.01 * np.arange(9), atol=1e-9)
    (tmp_path / "dataset.yaml").write_text(text + "columns: {t: {column: clock, unit: ms}}\n")
    with pytest.raises(InputError, match="column 'clock' holds dates, which are read as seconds; leave out"):
        Dataset.load(tmp_path)


def test_emps_layout_needs_no_column_map(tmp_path) -> None:
    t = np.arange(50.0)[:, None] * 1e-3
    scipy.io.savemat(
        tmp_path / "DATA_EMPS.mat", {"t": t, "qm": t**2, "qg": t**2 + 1e-4, "vir": np.sin(t), "gtau": 35.15}
    )
    (tmp_path / "dataset.yaml").write_text(
        "name: emps\ninputs: [{name: tau1, unit: N}, {name: goal1, unit: m}]\noutputs: [{name: q_m1, unit: m}]\n"
        "records: [{file: DATA_EMPS.mat}]\n"
    )
    record = Dataset.load(tmp_path)["DATA_EMPS"]
    np.testing.assert_allclose(record.inputs["tau1"], 35.15 * np.sin(t[:, 0]))
    np.testing.assert_allclose(record.outputs["q_m1"], t[:, 0] ** 2)
    assert record.meta["gtau"] == 35.15


def test_matlab_variables_and_columns_of_matrices(tmp_path) -> None:
    data = np.column_stack([COLUMNS["t"], COLUMNS["u1"]])
    scipy.io.savemat(tmp_path / "a.mat", {"data": data, "row": COLUMNS["u1"], "s": {"field": 1.0}})
    table = load_any(tmp_path / "a.mat", ["data(:,2)", "row"])
    np.testing.assert_array_equal(table.columns["data(:,2)"], COLUMNS["u1"])
    np.testing.assert_array_equal(table.columns["row"], COLUMNS["u1"])
    with pytest.raises(InputError, match="has no column 's'"):
        load_any(tmp_path / "a.mat", ["s"])


SERVO = Path(__file__).parents[2] / "experiments" / "02_xl330" / "servo.yaml"


def bam_log(load: list[int]) -> dict:
    entries = [
        {"timestamp": 0.005 * k, "position": 0.1 * k, "speed": 20.0 + k, "goal_position": 0.2, "load": value,
         "input_volts": 7.4, "torque_enable": k < 2, "temp": 28}
        for k, value in enumerate(load)
    ]  # fmt: skip
    return {"mass": 0.49, "length": 0.1, "kp": 400, "vin": 7.4, "trajectory": "sin_sin", "entries": entries}


def test_bam_log(tmp_path) -> None:
    """Signs and scale as in the publisher's notes: unsigned 16-bit counts, 885 at full duty."""
    for name in ("one.json", "two.json.gz"):
        raw = json.dumps(bam_log([0, 885, 65536 - 885, 65535])).encode()
        (tmp_path / name).write_bytes(gzip.compress(raw) if name.endswith("gz") else raw)
    roles = "  - {file: one.json}\n  - {file: two.json.gz, format: bam, role: test}\n"
    (tmp_path / "dataset.yaml").write_text(
        SERVO.read_text().replace('  - {file: "*.json*", format: bam}\n', roles)
    )
    data = Dataset.load(tmp_path)
    assert all(record.meta["temperature1"] == 28.0 for record in data)
    assert [record.role for record in data] == ["train", "test"]
    record = data["one"]
    np.testing.assert_allclose(record.inputs["duty1"], [0, 1, -1, -1 / 885])
    np.testing.assert_array_equal(record.inputs["enable1"], [1, 1, 0, 0])
    np.testing.assert_array_equal(record.inputs["gain1"], 400)
    np.testing.assert_allclose(record.outputs["q_m1"], [0, 0.1, 0.2, 0.3])
    assert record.meta["mass"] == 0.49
    assert record.note == "sin_sin"
    assert Dataset.load(data.save(tmp_path / "native"))["one"].meta == record.meta


def test_real_bam_logs(shared) -> None:
    data = Dataset.load(SERVO, folder=shared / "data" / "bam_xl330" / "raw")
    assert len(data) == 12
    assert data.sample_time is None
    for record in data:
        assert 0.05 < np.abs(record.inputs["duty1"]).max() <= 1.0
        assert 5.5 < record.inputs["supply1"].min() < record.inputs["supply1"].max() < 9.5
    # The firmware's law of the publisher's notes ties three channels together, signs included.
    record = data["2026-01-15_10h29m14"]
    error = record.inputs["goal1"] - record.outputs["q_m1"]
    law = np.clip(record.inputs["gain1"] * error * 4096 / (2 * np.pi) / 256 / 885, -1, 1)
    assert np.corrcoef(law, record.inputs["duty1"])[0, 1] > 0.999


def test_every_gap_case_loads_and_starts_at_rest(shared) -> None:
    folders = sorted((shared / "gapcases" / "dev").glob("c*"))
    assert folders
    for folder in folders[::4]:
        data = Dataset.load(folder)
        assert (len(data.train), len(data.test), data.sample_time) == (6, 2, 0.002)
        found = check_dataset(data)
        assert not [one for one in found if one.severity == "error" or one.code == "start_motion"]


def test_names_of_records() -> None:
    from pathlib import Path

    assert record_name(Path("x/rec_00.csv.gz")) == "rec_00"
    assert record_name(Path("run#1.v2.JSON")) == "run_1.v2"
    assert record_name(Path(".hidden.mat")) == "_hidden"


@pytest.mark.parametrize(
    ("unit", "channel", "si", "factor"),
    [
        ("deg", "q_m1", "rad", np.pi / 180),
        ("rpm", "v_m2", "rad/s", np.pi / 30),
        ("ms", "t", "s", 1e-3),
        ("mV", "u1", "V", 1e-3),
        ("mA", "i1", "A", 1e-3),
        ("mN m", "tau1", "N m", 1e-3),
        ("%", "duty1", "1", 0.01),
        ("mm", "q_m1", "m", 1e-3),
        ("N", "my_force", "N", 1.0),
    ],
)
def test_units(unit: str, channel: str, si: str, factor: float) -> None:
    assert to_si(unit, channel) == (si, pytest.approx(factor))
