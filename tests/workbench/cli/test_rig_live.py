"""`aerodima rig ... --live`: the viewer is there while the swing goes on, and on this computer
only.
"""

import re
import subprocess
import sys
from pathlib import Path
from urllib.request import urlopen

import pytest


@pytest.mark.slow
def test_a_live_swing_can_be_watched_on_the_local_address(tmp_path: Path) -> None:
    log = tmp_path / "swing.parquet"
    command = [
        sys.executable,
        "-m",
        "aerodima.workbench.cli.program",
        "rig",
        "robot",
        "--live",
        "--duration",
        "3",
    ]
    process = subprocess.Popen(
        [*command, "--out", str(log)], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stderr is not None
        told = next(line for line in process.stderr if line.startswith("watch: "))
        address = re.fullmatch(r"watch: (http://127\.0\.0\.1:\d+)\n", told)
        assert address is not None, told
        with urlopen(address[1], timeout=30) as answer:
            page = answer.read().decode()
        assert answer.status == 200
        assert "meshcat" in page.lower()
        output, _ = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 0
    assert "robot_swing" in output
    assert log.is_file()
