"""What the doctor finds, and what it says when something is missing."""

import tomllib
from importlib.metadata import PackageNotFoundError, metadata, version

from aerodima.workbench.cli import doctor_commands as doctor
from aerodima.workbench.core.extras import install_command
from tests.code_measure import ROOT


def finding(subject):
    return next(found for found in doctor.examine() if found.subject == subject)


def test_here_everything_required_is_there():
    assert all(found.ok for found in doctor.examine() if found.required)


def test_missing_browser_is_named_but_not_fatal(monkeypatch):
    monkeypatch.setenv("PATH", "")
    browser = finding("browser")
    assert not browser.ok
    assert not browser.required
    assert "chromium" in browser.found


def test_extras_are_those_of_the_installed_distribution_and_each_has_its_use():
    extras = metadata("aerodima-workbench").get_all("Provides-Extra")
    found = [f.subject for f in doctor.examine() if f.subject.startswith("extra ")]
    assert sorted(found) == sorted(f"extra {extra}" for extra in extras)
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(doctor.USES_OF_EXTRAS) == set(declared["optional-dependencies"])


def test_missing_package_of_an_extra_is_named_with_its_use(monkeypatch):
    def version_without_mcap(name):
        if name == "mcap":
            raise PackageNotFoundError
        return version(name)

    monkeypatch.setattr(doctor, "version", version_without_mcap)
    logs = finding("extra logs")
    assert logs.found.endswith("; no mcap")
    assert "MCAP" in logs.found
    assert logs.advice == install_command("logs")
    assert finding("extra hardware").ok


def test_old_drake_is_required_and_fails_the_command(call, monkeypatch):
    monkeypatch.setattr(doctor, "version", lambda name: "1.40.0")
    assert not finding("Drake").ok
    result = call("doctor")
    assert result.exit_code == 1
    assert "1.40.0" in result.output


def test_drake_1_100_is_newer_than_1_51(monkeypatch):
    monkeypatch.setattr(doctor, "version", lambda name: "1.100.0")
    assert finding("Drake").ok


def test_full_disk_is_told(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(doctor, "MIN_DISK", 1e18)
    assert not finding("disk").ok
