"""`aerodima log import`, `log export` and `log condition`: what they refuse; what they do is in the
README's test.
"""

import numpy as np
import pandas as pd
import pytest

from aerodima.workbench.logs.schema import read_run_log, write_run_log
from tests.commands import done
from tests.workbench.made_up_runs import made_up_run

MAPPING = """
schema: aerodima/log-mapping/1
kind: static
time: {from: t}
columns: {angle_rad: {from: theta}}
"""


@pytest.fixture
def folder(tmp_path):
    time = np.arange(300) / 100
    pd.DataFrame({"t": time, "theta": np.sin(time)}).to_csv(tmp_path / "log.csv", index=False)
    (tmp_path / "m.yaml").write_text(MAPPING)
    write_run_log(made_up_run(), tmp_path / "run.parquet")
    return tmp_path


def test_import_refuses_an_existing_log_before_it_reads_anything(refused, folder, untouched):
    message = refused(
        "log", "import", folder / "none.csv", "--mapping", folder / "m.yaml", "--out", untouched
    )
    assert "--force" in message
    assert untouched.read_text() == "precious"


def test_import_names_the_file_that_is_missing(refused, folder):
    out = folder / "out.parquet"
    mapping = ("--mapping", folder / "m.yaml", "--out", out)
    assert "none.csv" in refused("log", "import", folder / "none.csv", *mapping)
    assert "none.yaml" in refused(
        "log", "import", folder / "log.csv", "--mapping", folder / "none.yaml", "--out", out
    )
    assert not out.exists()


def test_condition_keeps_the_raw_log_and_refuses_to_overwrite(refused, folder, untouched):
    raw = folder / "raw.parquet"
    out = folder / "out.parquet"
    done("log", "import", folder / "log.csv", "--mapping", folder / "m.yaml", "--out", raw)
    condition = ("log", "condition", raw, "--columns", "angle_rad", "--low-pass", "5", "--out")
    assert "raw.parquet" in refused(*condition, raw, "--force")
    assert "--force" in refused(*condition, untouched)
    assert "--low-pass" in refused("log", "condition", raw, "--out", out)
    assert "-1 s" in refused("log", "condition", raw, "--fill", "-1", "--out", out)
    assert "0 Hz" in refused(*condition[:-2], "0", "--out", out)
    assert not out.exists()
    assert "5 Hz" in done(*condition, out)
    ours = read_run_log(raw).signal("angle_rad")
    assert np.array_equal(ours, np.sin(np.arange(300) / 100))
    assert 0.0 < np.max(np.abs(read_run_log(out).signal("angle_rad") - ours)) < 0.05


def test_export_goes_beside_the_log_and_names_a_wrong_format(refused, folder):
    assert "--to xlsx" in refused("log", "export", folder / "run.parquet", "--to", "xlsx")
    told = done("log", "export", folder / "run.parquet", "--to", "csv")
    assert told.split() == [str(folder / "run.csv"), str(folder / "run.csv.json")]
    assert "--force" in refused("log", "export", folder / "run.parquet", "--to", "csv")


def test_export_keeps_the_log_and_what_is_there_until_the_run_is_found(refused, folder, untouched):
    run = folder / "run.parquet"
    before = run.read_bytes()
    for form in ("csv", "mcap"):
        assert ".csv, .mcap" in refused("log", "export", run, "--out", run, "--force", "--to", form)
    assert "--to csv" in refused("log", "export", run, "--out", folder / "run.mcap", "--to", "csv")
    assert run.read_bytes() == before
    missing = ("log", "export", folder / "none.parquet", "--to", "mcap", "--out")
    kept = untouched.rename(untouched.with_suffix(".mcap"))
    assert "none.parquet" in refused(*missing, kept, "--force")
    assert kept.read_text() == "precious"
    assert "none.parquet" in refused(*missing, folder / "new.mcap")
    assert not (folder / "new.mcap").exists()
