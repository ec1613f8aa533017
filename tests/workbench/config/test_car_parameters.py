"""Every physical number has one home, with a unit and a source; an assumed one says why and within
what range.
"""

import re
from importlib import import_module

import pytest

from aerodima.workbench.config import scenario
from aerodima.workbench.config.checked_files import read_yaml, unit_of
from aerodima.workbench.config.scenario import (
    SECTIONS,
    ParameterEntry,
    load_parameter_entries,
    scenario_from_dict,
)
from aerodima.workbench.errors import ScenarioError
from aerodima.workbench.resources import models_dir

GOOD = {
    "value": 6.0,
    "unit": "kg",
    "source": "assumed",
    "prior": [4.5, 8.0],
    "reason": "not published",
}


def entry(**changes) -> ParameterEntry:
    return ParameterEntry.model_validate(
        {key: value for key, value in (GOOD | changes).items() if value is not None}
    )


def test_every_section_has_its_file():
    assert set(SECTIONS) <= {path.stem for path in (models_dir() / "parameters").glob("*.yaml")}


@pytest.mark.parametrize("section", SECTIONS)
def test_every_number_has_unit_and_source(section):
    raw = read_yaml(models_dir() / "parameters" / f"{section}.yaml")
    entries = load_parameter_entries(section)
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
    values = {key: one.value for key, one in load_parameter_entries(section).items()}
    assert getattr(scenario_from_dict({}), section).model_dump() == values


@pytest.mark.parametrize("section", SECTIONS)
def test_every_field_says_what_it_is(section):
    for key, field in SECTIONS[section].model_fields.items():
        assert field.description, key


@pytest.mark.parametrize(
    "source",
    [
        "published: Table 6.1",
        "datasheet: AK series manual",
        "calibrated: out/run.parquet",
        "assumed",
    ],
)
def test_sources_of_the_design_are_allowed(source):
    assert entry(source=source).source == source


@pytest.mark.parametrize(
    "source", ["", "guessed", "published", "published:", "assumed: mine", "Table 6.1"]
)
def test_other_sources_are_refused(source):
    with pytest.raises(ValueError, match="source"):
        entry(source=source)


def test_assumed_value_needs_prior_and_reason_and_lies_within():
    with pytest.raises(ValueError, match="needs a reason"):
        entry(reason=None)
    with pytest.raises(ValueError, match="needs a prior range"):
        entry(prior=None)
    with pytest.raises(ValueError, match=r"value 9\.0 lies outside its prior \[4\.5, 8\.0\]"):
        entry(value=9.0)
    with pytest.raises(ValueError, match="lies outside its prior"):
        entry(value=6.0, prior=[8.0, 4.5])
    with pytest.raises(ValueError, match="lies outside its prior"):
        entry(value="six")


def test_chosen_value_needs_a_reason():
    assert entry(source="chosen", prior=None).prior is None
    with pytest.raises(ValueError, match="needs a reason"):
        entry(source="chosen", prior=None, reason=None)


@pytest.fixture
def gps_file(tmp_path, monkeypatch):
    """A copy of the GPS parameters that a test may spoil."""
    path = tmp_path / "gps.yaml"
    path.write_text((models_dir() / "parameters" / "gps.yaml").read_text())
    monkeypatch.setattr(scenario, "model_path", lambda relative: path)
    return path


@pytest.mark.parametrize(
    ("good", "bad", "message"),
    [
        ("unit: Hz", "unit: kHz", r"rate: unit 'kHz'; allowed is 'Hz'"),
        ("rate:", "7:", r"7: unknown key; allowed: delay, noise, rate"),
        ("rate:", "rait:", r"rait: unknown key; did you mean 'rate'"),
        ("parameters/1", "parameters/2", r"schema: allowed is 'aerodima/parameters/1'"),
        ("source: assumed,", "", r"delay: source: missing"),
        ("unit: m/s,", "", r"noise: unit: missing"),
        ("value: 0.1,", "value: 0.9,", r"delay.*outside its prior"),
        ("value: 10.0", "value: .nan", r"rate"),
    ],
)
def test_spoilt_parameter_file_is_refused_by_name(gps_file, good, bad, message):
    text = gps_file.read_text()
    assert good in text
    gps_file.write_text(text.replace(good, bad, 1))
    with pytest.raises(ScenarioError, match=r"gps\.yaml: .*" + message):
        load_parameter_entries("gps")


def test_parameter_that_is_missing_is_named(gps_file):
    lines = [line for line in gps_file.read_text().splitlines() if not line.startswith("noise")]
    gps_file.write_text("\n".join(lines))
    with pytest.raises(ScenarioError, match=r"gps\.yaml: missing: noise"):
        load_parameter_entries("gps")


def _spoilt(text: str) -> str:
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
def test_value_out_of_range_in_a_file_of_the_real_car_is_one_line(
    tmp_path, monkeypatch, module, read, file
):
    path = tmp_path / f"{file}.yaml"
    path.write_text(
        _spoilt((models_dir() / "parameters" / "hardware" / f"{file}.yaml").read_text())
    )
    monkeypatch.setattr(f"{module}.model_path", lambda relative: path)
    with pytest.raises(ScenarioError, match=rf"{file}\.yaml: .*-1000000000.*allowed") as caught:
        getattr(import_module(module), read)()
    assert "\n" not in str(caught.value)
