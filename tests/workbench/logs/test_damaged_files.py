"""Damaged files of every kind: what is read is what was written, or one error names the file."""

import random

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.importers import read_foreign_log
from aerodima.workbench.logs.mapping import CsvFormat, load_mapping
from aerodima.workbench.logs.schema import read_run_log, write_run_log
from tests.refusals import assert_refused
from tests.workbench.logs.test_importers import MAPPING, TIMES, foreign, write_mat_7_3, write_mcap
from tests.workbench.made_up_runs import made_up_run

TABLE = foreign()[:60]
MESSAGES = [("/imu", TIMES[row], values) for row, values in enumerate(TABLE.to_dict("records"))]
WRITERS = {
    "log.csv": lambda path: TABLE.to_csv(path, index=False),
    "log.mat": lambda path: savemat(path, dict(TABLE), do_compression=True),
    "log_7_3.mat": lambda path: write_mat_7_3(path, dict(TABLE)),
    "log.mcap": lambda path: write_mcap(path, MESSAGES),
    "log.parquet": lambda path: pq.write_table(pa.table(TABLE), path, write_page_checksum=True),
    "run.parquet": lambda path: write_run_log(made_up_run(truth=False), path),
    "m.yaml": lambda path: path.write_text(MAPPING),
}
TRIED_ONE_IN = {"log.mat": 10, "log_7_3.mat": 10}
"""Files of which one in so many is tried: a process of its own reads each."""
CHECKED = ("log.mat", "log.mcap", "log.parquet", "run.parquet")
"""Files with a checksum of every value."""


def read(path):
    if path.suffix == ".yaml":
        return load_mapping(path).columns
    if path.stem == "run":
        return read_run_log(path).table
    log = read_foreign_log(path, CsvFormat())
    return {name: log.numbers(name) for name in log.columns}


def damaged(content, chance):
    """Content that is cut, or has a bit turned, noise in it, bytes too few or repeated."""
    start = chance.randrange(len(content))
    end = start + chance.randrange(40)
    turned = bytes([content[start] ^ 1 << chance.randrange(8)])
    return chance.choice(
        [
            content[:start],
            content[:start] + turned + content[start + 1 :],
            content[:start] + chance.randbytes(end - start) + content[end:],
            content[:start] + content[end:],
            content[:end] + content[start:],
        ]
    )


def test_a_file_that_makes_the_hdf5_library_crash_is_refused(tmp_path):
    path = tmp_path / "log_7_3.mat"
    WRITERS[path.name](path)
    content = bytearray(path.read_bytes())
    content[6065:6067] = b"\x93\x8c"  # the place of an attribute's type, which libhdf5 2.0 follows
    path.write_bytes(content)
    assert_refused(lambda: read(path), LogError, path.name)


def test_a_file_that_makes_scipy_crash_is_refused(tmp_path):
    path = tmp_path / "log.mat"
    WRITERS[path.name](path)
    content = path.read_bytes()
    path.write_bytes(content[:370] + content[341:])  # bytes that come twice, which loadmat follows
    assert_refused(lambda: read(path), LogError, path.name)


def test_a_module_of_the_users_folder_does_not_disturb_the_reader_of_hdf5(tmp_path, monkeypatch):
    path = tmp_path / "log_7_3.mat"
    WRITERS[path.name](path)
    (tmp_path / "numpy.py").write_text("raise SystemExit(1)")
    monkeypatch.chdir(tmp_path)
    assert np.array_equal(read(path)["data.Fy"], TABLE["Fy"])


@pytest.mark.parametrize(
    "count", [40, pytest.param(10_000, marks=[pytest.mark.slow, pytest.mark.nightly])]
)
@pytest.mark.parametrize("name", WRITERS)
def test_a_damaged_file_is_refused_or_read_as_it_was_written(tmp_path, name, count):
    path = tmp_path / name
    WRITERS[name](path)
    written = read(path)
    content = path.read_bytes()
    chance = random.Random(name)
    for _ in range(count // TRIED_ONE_IN.get(name, 1)):
        path.write_bytes(damaged(content, chance))
        found = {}
        message = name
        try:
            found = read(path)
        except LogError as error:
            message = str(error)
        assert name in message
        for column in {*found} & {*written} if name in CHECKED else ():
            assert np.array_equal(found[column], written[column], equal_nan=True)


def test_a_size_that_the_file_cannot_hold_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "log.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("angle", shape=(10**12,), dtype="f8")
    assert_refused(lambda: read_foreign_log(path, CsvFormat()), LogError, "log.mat", "/angle")
