import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.exporters import export_log, topics_of
from aerodima.workbench.logs.foreign_files import read_mcap
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import awkward_run, made_up_run, signals_equal


def mcap_table(path):
    """The signals of an exported run."""
    columns = read_mcap(path).columns
    return pd.DataFrame(
        {name.split(".", 1)[1]: values for name, values in columns.items() if "@" not in name}
    )


def mcap_metadata(path):
    with open(path, "rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    return str(record.metadata["json"])


@pytest.mark.parametrize("form", ["csv", "mcap"])
def test_an_export_comes_back_bit_for_bit_with_its_metadata(tmp_path, form):
    run = awkward_run()
    written = export_log(run, tmp_path / f"run.{form}", form)
    if form == "csv":
        table = pd.read_csv(written[0])
        metadata = written[1].read_text()
    else:
        table = mcap_table(written[0])
        metadata = mcap_metadata(written[0])
    assert signals_equal(run, dataclasses.replace(run, table=table[list(run.table.columns)]))
    assert json.loads(metadata) == run.metadata()


@pytest.mark.parametrize(
    ("form", "name"), [("csv", "run.csv"), ("csv", "run.csv.json"), ("mcap", "run.mcap")]
)
def test_an_existing_file_is_not_overwritten(tmp_path, form, name):
    present = tmp_path / name
    present.write_text("precious")
    path = tmp_path / f"run.{form}"
    assert_refused(lambda: export_log(awkward_run(), path, form), LogError, name, "--force")
    assert [*tmp_path.iterdir()] == [present]
    assert present.read_text() == "precious"
    export_log(awkward_run(), path, form, force=True)
    assert present.read_bytes() != b"precious"


def test_mcap_has_a_topic_per_device_with_schema_and_times_in_nanoseconds(tmp_path):
    run = awkward_run()
    export_log(run, tmp_path / "run.mcap", "mcap")
    with open(tmp_path / "run.mcap", "rb") as stream:
        messages = [
            (schema, channel, message)
            for schema, channel, message in make_reader(stream).iter_messages(topics=["/imu"])
        ]
    assert len(messages) == len(run.table)
    schema, channel, message = messages[10]
    assert channel.message_encoding == "json"
    # Whole microseconds: rounding, since 0.014 s / 1e-9 is a little less than 14e6.
    assert [one.log_time for _, _, one in messages] == [
        2_000_000 * number for number in range(len(messages))
    ]
    assert set(json.loads(schema.data)["properties"]) == set(json.loads(message.data))
    assert json.loads(message.data)["imu_gyro_x_rad_per_s"] == np.nextafter(1.0, 2.0)


def test_every_column_has_one_topic():
    columns = list(made_up_run().table.columns)
    topics = topics_of(columns)
    assert sorted(name for names in topics.values() for name in names) == sorted(
        name for name in columns if name != "time_s"
    )
    assert topics["/plant"] == ["plant_position_x", "plant_position_y"]
    assert all("_truth" in name for name in topics["/truth"])
    for device in ("tail", "sail", "imu", "speed", "status"):
        assert all(name.startswith(device) for name in topics[f"/{device}"])
    assert topics_of(["time_s", "angle_rad", "force_x_n"]) == {"/rig": ["angle_rad", "force_x_n"]}


def test_mcap_refuses_times_before_zero(tmp_path):
    run = made_up_run(truth=False)
    run.table["time_s"] -= 1.0
    assert_refused(lambda: export_log(run, tmp_path / "run.mcap", "mcap"), LogError, "time_s")
    assert list(tmp_path.iterdir()) == []
