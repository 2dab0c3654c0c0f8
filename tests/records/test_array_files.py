"""NumPy archives and MATLAB 7.3 files."""

import io
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from malformed import read_afresh
from record_formats import ANGLE, TIME, VOLTS, write_yaml

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.readers import load_any


def refused(path: Path, wanted: list[str], *words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_any(path, wanted)
    message = str(caught.value)
    for word in (path.name, *words):
        assert word in message, message
    assert "\n" not in message
    assert len(message.replace(str(path.parent), "")) < 320, message


def same_record(folder: Path) -> None:
    (record,) = Dataset.load(folder).records
    np.testing.assert_array_equal(record.time, TIME)
    np.testing.assert_array_equal(record.inputs["u1"], VOLTS)
    np.testing.assert_array_equal(record.outputs["q_m1"], ANGLE)
    assert record.meta["payload"] == 0.5
    assert record.name == "run"


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_npz_gives_the_record(tmp_path: Path, save: Callable[..., None]) -> None:
    state = np.column_stack([ANGLE, -ANGLE])
    save(tmp_path / "run.npz", t=TIME, u=VOLTS[:, None], state=state, payload=0.5, who=np.array("R. M."))
    same_record(write_yaml(tmp_path, "run.npz", {"u1": "u", "q_m1": "state/0"}))
    refused(tmp_path / "run.npz", ["t", "state"], "no column 'state'", "state/0, state/1")
    refused(tmp_path / "run.npz", ["who"], "array 'who' holds str", "save numbers")


def test_npz_that_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    np.savez(path, t=TIME, u=np.array([{"volts": 1}], dtype=object))
    refused(path, ["u"], "array 'u' holds pickled objects")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    refused(path, ["t"], "not a readable .npz file")
    np.savez_compressed(path, t=np.zeros(40_000_000))
    assert "unpacks to more than" in read_afresh(path, "t")
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    for claimed, word in (
        (buffer.getvalue(), "unpacks to more than"),
        (buffer.getvalue()[:20], "not a readable"),
    ):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("t.npy", claimed)
        refused(path, ["t"], word)


def write_mat73(path: Path, variables: dict[str, np.ndarray | float], **options: object) -> None:
    """Write arrays as MATLAB does: a header before the HDF5 file, columns as rows, and each variable's class."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in variables.items():
            array = np.atleast_2d(values)
            item = file.create_dataset(name, data=array if array.shape[0] == 1 else array.T, **options)
            item.attrs["MATLAB_class"] = np.bytes_("double")
        file.create_group("arm").attrs["MATLAB_class"] = np.bytes_("struct")
        cells = file.create_dataset("cells", (1, 2), dtype=h5py.ref_dtype)
        cells.attrs["MATLAB_class"] = np.bytes_("cell")
        text = file.create_dataset("text", data=np.array([[72, 105]], dtype=np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
        file["away"] = h5py.ExternalLink("other.h5", "/x")
        file["soft"] = h5py.SoftLink("/t")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(512))


@pytest.mark.parametrize("options", [{}, {"chunks": True, "compression": "gzip", "shuffle": True}])
def test_mat73_gives_the_record(tmp_path: Path, options: dict) -> None:
    state = np.column_stack([ANGLE, -ANGLE])
    path = tmp_path / "run.mat"
    write_mat73(
        path, {"t": TIME, "u": VOLTS, "state": state} | ({} if options else {"payload": 0.5}), **options
    )
    folder = write_yaml(
        tmp_path, "run.mat", {"u1": "u", "q_m1": "state(:,1)"}, meta={"payload": 0.5} if options else {}
    )
    same_record(folder)
    np.testing.assert_array_equal(load_any(path, ["state(:,2)"]).columns["state(:,2)"], -ANGLE)


def test_mat73_that_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.mat"
    write_mat73(path, {"t": TIME, "u": VOLTS})
    refused(path, ["arm"], "variable 'arm' is a struct")
    refused(path, ["cells"], "variable 'cells' is a cell of object references")
    refused(path, ["text"], "variable 'text' is of class char")
    refused(path, ["away"], "variable 'away' is a link to another place")
    refused(path, ["soft"], "variable 'soft' is a link")
    refused(path, ["theta"], "no column 'theta'", "t, u")
    whole = path.read_bytes()
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "h5py", None)
        refused(path, ["t"], "pip install 'hybrid_id[logs]'")
    path.write_bytes(whole[: len(whole) // 3])
    refused(path, ["t"], "not a readable MATLAB 7.3 file")
    write_mat73(path, {"t": np.zeros(40_000_000)}, chunks=(1, 1_000_000), compression="gzip")
    assert "unpacks to more than" in read_afresh(path, "t")


def test_mat73_with_a_piece_that_unpacks_to_more_than_it_says(tmp_path: Path) -> None:
    import zlib

    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.mat", "w") as file:
        item = file.create_dataset("t", (1, 1000), chunks=(1, 1000), compression="gzip", dtype="f8")
        item.id.write_direct_chunk((0, 0), zlib.compress(bytes(150_000_000), 9))
    assert "not a readable MATLAB 7.3 file" in read_afresh(tmp_path / "run.mat", "t")
