"""Every physical number has one home, with a unit and a source; an assumed one says why and within
what range.
"""

import re
from importlib import import_module

import pytest

from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.quantity import unit_of
from aerodima.workbench.core.resources import models_dir
from aerodima.workbench.core.yaml_files import read_yaml
from aerodima.workbench.scenario import scenario_file
from aerodima.workbench.scenario.scenario import (
    Scenario,
    scenario_from_dict,
)
from aerodima.workbench.scenario.scenario_file import ParameterEntry
from tests.refusals import assert_refused

SECTIONS = Scenario.sections()
GOOD = {
    "value": 6.0,
    "unit": "kg",
    "source": "assumed",
    "prior": [4.5, 8.0],
    "reason": "not published",
}


def entry(**changes):
    return ParameterEntry.model_validate(
        {key: value for key, value in (GOOD | changes).items() if value is not None}
    )


@pytest.mark.parametrize("section", SECTIONS)
def test_every_number_has_unit_and_source(section):
    raw = read_yaml(models_dir() / "parameters" / f"{section}.yaml")
    entries = Scenario.parameters(section)
    assert set(raw) - {"schema"} == set(SECTIONS[section].model_fields) == set(entries)
    for key, one in entries.items():
        assert one.unit == unit_of(SECTIONS[section], key) == raw[key]["unit"], key
        assert raw[key]["source"], key
        if one.source == "assumed":
            assert one.prior is not None, key
            assert one.reason, key
            assert one.prior[0] < one.prior[1], key


@pytest.mark.parametrize("section", SECTIONS)
def test_scenario_without_overrides_has_the_values_of_the_files(section):
    values = {key: one.value for key, one in Scenario.parameters(section).items()}
    assert getattr(scenario_from_dict({}), section).model_dump() == values


@pytest.fixture
def gps_file(tmp_path, monkeypatch):
    """A copy of the GPS parameters that a test may spoil."""
    path = tmp_path / "gps.yaml"
    path.write_text((models_dir() / "parameters" / "gps.yaml").read_text())
    monkeypatch.setattr(scenario_file, "model_path", lambda relative: path)
    return path


def _spoilt(text):
    """The first number of a parameter file becomes one that no unit allows."""
    return re.sub(r"value: [-0-9.e]+", "value: -1.0e9", text, count=1)


@pytest.mark.parametrize(
    ("module", "read", "file"),
    [
        ("aerodima.hardware.devices.motor_settings", "load_motor_safety", "motor_safety"),
        ("aerodima.hardware.car.safety_settings", "load_drive_safety", "drive_safety"),
        ("aerodima.hardware.car.safety_settings", "load_teensy_timing", "teensy_firmware"),
    ],
)
def test_value_out_of_range_in_a_file_of_the_real_car_is_refused(
    tmp_path, monkeypatch, module, read, file
):
    path = tmp_path / f"{file}.yaml"
    path.write_text(
        _spoilt((models_dir() / "parameters" / "hardware" / f"{file}.yaml").read_text())
    )
    monkeypatch.setattr(f"{module}.model_path", lambda relative: path)
    load = getattr(import_module(module), read)
    assert_refused(load, ScenarioError, f"{file}.yaml", "-1000000000")


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        *(
            ({"source": source}, "source")
            for source in ("", "guessed", "published", "published:", "assumed: mine", "Table 6.1")
        ),
        ({"reason": None}, "reason"),
        ({"source": "chosen", "prior": None, "reason": None}, "reason"),
        ({"prior": None}, "prior"),
        ({"value": 9.0}, "9.0"),
        ({"value": 4.4}, "4.4"),
        ({"prior": [8.0, 4.5]}, "prior"),
        ({"value": "six"}, "six"),
    ],
    ids=str,
)
def test_entry_without_source_reason_or_prior_is_refused(changes, named):
    assert_refused(lambda: entry(**changes), ValueError, named)


@pytest.mark.parametrize(
    ("good", "bad", "named"),
    [
        ("unit: Hz", "unit: kHz", ("rate", "kHz", "'Hz'")),
        ("rate:", "7:", (": 7:",)),
        ("rate:", "rait:", ("rait", "'rate'")),
        ("parameters/1", "parameters/2", ("schema", "aerodima/parameters/1")),
        ("source: assumed,", "", ("delay", "source")),
        ("unit: m/s,", "", ("noise", "unit")),
        ("value: 0.1,", "value: 0.9,", ("delay", "0.9")),
        ("value: 10.0", "value: .nan", ("rate",)),
        ("\nnoise:", "\n# noise:", ("noise",)),
    ],
)
def test_spoilt_parameter_file_is_refused_by_name(gps_file, good, bad, named):
    text = gps_file.read_text()
    assert good in text
    gps_file.write_text(text.replace(good, bad, 1))
    assert_refused(lambda: Scenario.parameters("gps"), ScenarioError, "gps.yaml", *named)
