from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from malformed import SOUND, change_yaml, write_sound_dataset

from hybrid_id.errors import REVERSING, InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.quality import check_dataset
from hybrid_id.records.record import LARGEST, SMALLEST, Record

finite = st.floats(allow_nan=False, allow_infinity=False)
measured = st.just(0.0) | st.floats(SMALLEST, LARGEST) | st.floats(-LARGEST, -SMALLEST)
words = st.text(st.characters(exclude_categories=("Cc", "Cs"), exclude_characters=REVERSING))


@st.composite
def records(draw: st.DrawFn, name: str, channels: tuple[str, ...]) -> Record:
    n = draw(st.integers(2, 12))
    steps = draw(npst.arrays(np.float64, n, elements=st.floats(1e-6, 10.0)))
    signals = [draw(npst.arrays(np.float64, n, elements=measured)) for _ in channels]
    signals[-1][0] = 1.0 if signals[-1][1] != 1.0 else 2.0  # a constant output is refused on loading
    return Record(
        name=name,
        time=draw(st.floats(-100, 100)) + np.cumsum(steps),
        inputs=dict(zip(channels[:-1], signals, strict=False)),
        outputs={channels[-1]: signals[-1]},
        role=draw(st.sampled_from(["train", "test"])),
        note=draw(words),
        meta=draw(st.dictionaries(words, finite | words, max_size=3)),
    )


@st.composite
def datasets(draw: st.DrawFn) -> Dataset:
    channels = draw(st.sampled_from([("u1", "q_m1"), ("q_a1",), ("duty1", "supply1", "v_m1")]))
    units = {"u1": "V", "q_m1": "rad", "q_a1": "rad", "duty1": "1", "supply1": "V", "v_m1": "rad/s"}
    noise = draw(st.none() | st.floats(1e-12, 1e6))
    names = draw(
        st.lists(
            st.from_regex(r"[a-zA-Z0-9_][\w .+-]{0,9}", fullmatch=True),
            min_size=1,
            max_size=3,
            unique_by=str.lower,
        )
    )
    return Dataset(
        name=draw(words.filter(bool)),
        inputs=tuple(Channel(name, units[name]) for name in channels[:-1]),
        outputs=(Channel(channels[-1], units[channels[-1]], noise),),
        records=tuple(draw(records(name, channels)) for name in names),
    )


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(dataset=datasets())
def test_saving_and_loading_is_the_identity(dataset: Dataset, tmp_path_factory) -> None:
    loaded = Dataset.load(dataset.save(tmp_path_factory.mktemp("saved") / "data"))
    assert (loaded.name, loaded.inputs, loaded.outputs, loaded.sample_time) == (
        dataset.name, dataset.inputs, dataset.outputs, dataset.sample_time,
    )  # fmt: skip
    assert len(loaded) == len(dataset)
    for new, old in zip(loaded, dataset, strict=True):
        assert (new.name, new.role, new.note, dict(new.meta)) == (
            old.name,
            old.role,
            old.note,
            dict(old.meta),
        )
        np.testing.assert_array_equal(new.time, old.time)
        for name in (*old.inputs, *old.outputs):
            np.testing.assert_array_equal(new.signal(name), old.signal(name))


def test_loading_a_sound_folder(tmp_path) -> None:
    data = Dataset.load(write_sound_dataset(tmp_path))
    assert [record.name for record in data.train] == ["rec_0"]
    assert [record.name for record in data.test] == ["rec_1"]
    assert data.sample_time == 0.002
    assert data.outputs == (Channel("q_m1", "rad", 0.001),)
    assert data["rec_1"].source == str(tmp_path / "rec_1.csv")
    assert [record.name for record in data.select(["rec_1"])] == ["rec_1"]
    with pytest.raises(InputError, match="has no record 'x'; it has rec_0, rec_1"):
        data.select(["x"])


def test_sample_time_is_found_or_left_to_the_stamps(tmp_path) -> None:
    write_sound_dataset(tmp_path)
    change_yaml(tmp_path, lambda values: values.pop("sample_time"))
    assert Dataset.load(tmp_path).sample_time == pytest.approx(0.002)
    change_yaml(tmp_path, lambda values: values.update(sample_time=None))
    assert Dataset.load(tmp_path).sample_time is None


def test_columns_are_mapped_scaled_unwrapped_and_brought_to_si(tmp_path) -> None:
    angle = np.array([170.0, 175.0, -178.0, -170.0])
    lines = [f"{k}; {100 * k};{value}" for k, value in enumerate(angle)]
    (tmp_path / "run.csv").write_text("time; command; theta\n" + "\n".join(lines))
    settings = {
        "name": "mapped",
        "inputs": [{"name": "u1", "unit": "mV"}],
        "outputs": [{"name": "q_m1", "unit": "deg", "noise_std": 0.1}],
        "columns": {"t": {"column": "time", "unit": "ms"}, "u1": "command"},
        "records": [
            {"file": "*.csv", "columns": {"q_m1": {"column": "theta", "scale": -1, "unwrap": 360, "zero": 5}}}
        ],
    }
    change_yaml(tmp_path, lambda values: values.update(settings))
    data = Dataset.load(tmp_path)
    np.testing.assert_allclose(data["run"].time, [0, 0.001, 0.002, 0.003])
    np.testing.assert_allclose(data["run"].inputs["u1"], [0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(np.rad2deg(data["run"].outputs["q_m1"]), [-165, -170, -177, -185])
    assert data.outputs[0].unit == "rad"
    assert data.outputs[0].noise_std == pytest.approx(np.deg2rad(0.1))


def test_records_may_lie_elsewhere_and_be_cut(tmp_path) -> None:
    (tmp_path / "records").mkdir()
    write_sound_dataset(tmp_path / "records")
    change_yaml(tmp_path, lambda values: values.update(SOUND))
    change_yaml(tmp_path, lambda values: values["records"][0].update(between=[0.1, 0.3], name="cut"))
    data = Dataset.load(tmp_path / "dataset.yaml", folder=tmp_path / "records")
    assert data["cut"].time[0] == 0.1
    assert data["cut"].n_samples == 101


@pytest.mark.parametrize(
    ("between", "logged"),
    [
        ([0.1, 60], "0.1 to 60 s, of which 0.1 to 0.598 s are logged"),
        ([-5, 0.3], "-5 to 0.3 s, of which 0 to 0.3 s are logged"),
        ([0, 0.6], ""),  # within a few steps
    ],
)
def test_a_part_beyond_the_log_is_told(tmp_path, between: list[float], logged: str) -> None:
    write_sound_dataset(tmp_path)
    change_yaml(tmp_path, lambda values: values["records"][0].update(between=between))
    data = Dataset.load(tmp_path)
    told = [one.message for one in check_dataset(data) if one.code == "between"]
    assert len(told) == bool(logged) and all(f"'between' asks for {logged}" in words for words in told)
    assert not [one for one in check_dataset(data.select(["rec_1"])) if one.code == "between"]


def test_resampling_on_request_is_reported(tmp_path) -> None:
    write_sound_dataset(tmp_path)
    change_yaml(tmp_path, lambda values: values.update(resample={"sample_time": 0.005}, sample_time=None))
    data = Dataset.load(tmp_path)
    assert data.sample_time == 0.005
    assert [report.record for report in data.resampling] == ["rec_0", "rec_1"]
    assert "300 samples" in data.resampling[0].message
    assert data.select(["rec_1"]).resampling == data.resampling[1:]


def test_saving_never_touches_what_is_there(tmp_path) -> None:
    data = Dataset.load(write_sound_dataset(tmp_path))
    with pytest.raises(InputError, match="exists already"):
        data.save(tmp_path)
    target = data.save(tmp_path / "new" / "data")
    assert sorted(path.name for path in target.iterdir()) == ["dataset.yaml", "rec_0.csv.gz", "rec_1.csv.gz"]
    assert [path.name for path in target.parent.iterdir()] == ["data"]


def test_a_failing_save_leaves_nothing_behind(tmp_path, monkeypatch) -> None:
    data = Dataset.load(write_sound_dataset(tmp_path))
    monkeypatch.setattr("hybrid_id.records.dataset_file.write_yaml", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        data.save(tmp_path / "out" / "data")
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("t", "s"), "not usable"),
        (("u1", "mV"), "not SI"),
        (("u1", "A"), "does not fit"),
        (("u1", "V", 0.0), "noise_std"),
        (("q_m1", "rad", None, "V"), "does not fit 'q_m1'"),
        (("q_m1", "rad", None, "mm"), "logged unit 'mm' is not one of rad"),
    ],
)
def test_bad_channels_are_refused(arguments: tuple, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Channel(*arguments)


def test_records_must_have_the_channels_of_the_dataset(tmp_path) -> None:
    data = Dataset.load(write_sound_dataset(tmp_path))
    with pytest.raises(InputError, match=r"has outputs \['q_m1'\] where .* has \['q_a1'\]"):
        Dataset("other", data.inputs, (Channel("q_a1", "rad"),), data.records)


@pytest.mark.parametrize(
    ("unit", "columns", "shown"),
    [
        ("deg", {}, ("deg", 180.0 / np.pi)),
        ("rad", {}, ("rad", 1.0)),
        ("rad", {"q_m1": {"column": "q_m1", "unit": "deg"}}, ("deg", 180.0 / np.pi)),
        ("deg", {"q_m1": {"column": "q_m1", "scale": -1}}, ("deg", 180.0 / np.pi)),
    ],
)
def test_a_channel_knows_the_unit_that_was_logged(
    tmp_path: Path, unit: str, columns: dict, shown: tuple[str, float]
) -> None:
    (tmp_path / "a.csv").write_text("t,q_m1\n0,0\n0.1,90\n0.2,180\n")
    values = {"name": "a", "outputs": [{"name": "q_m1", "unit": unit}], "columns": columns}
    (tmp_path / "dataset.yaml").write_text(yaml.safe_dump(values | {"records": [{"file": "a.csv"}]}))
    (channel,) = Dataset.load(tmp_path).outputs
    assert channel.unit == "rad"
    assert channel.shown == (shown[0], pytest.approx(shown[1]))
    saved = Dataset.load(Dataset.load(tmp_path).save(tmp_path / "saved"))  # whose files hold SI
    assert saved.outputs[0].shown == ("rad", 1.0)
