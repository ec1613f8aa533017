"""Commands that install an extra, in a checkout and beside an installed wheel."""

import json
import os
from pathlib import Path

import pytest

from aerodima.workbench.core import extras
from tests.code_measure import ROOT


def test_a_checkout_is_installed_by_its_folder(monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    assert extras.install_command("logs") == "pip install -e '.[logs]' -c constraints.txt"
    monkeypatch.chdir(tmp_path)
    command = extras.install_command("console,hardware").split()
    assert Path(command[3].strip("'").removesuffix("[console,hardware]")).resolve() == ROOT
    assert Path(command[-1]).resolve() == ROOT / "constraints.txt"


@pytest.mark.parametrize(
    ("record", "source"),
    [
        (None, "'aerodima-workbench[logs]'"),
        ({"url": "file:///a.whl"}, "'aerodima-workbench[logs] @ file:///a.whl'"),
    ],
    ids=["index", "wheel"],
)
def test_a_wheel_is_named_by_where_it_came_from(monkeypatch, tmp_path, record, source):
    folder = tmp_path / "aerodima_workbench-9.0.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Name: aerodima-workbench\nVersion: 9.0.0\n")
    if record is not None:
        (folder / "direct_url.json").write_text(json.dumps(record))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(extras, "ROOT", tmp_path)
    constraints = os.path.relpath(tmp_path / "constraints.txt")
    assert extras.install_command("logs") == f"pip install {source} -c {constraints}"
