"""`aerodima play` in a real browser: keys drive the simulated car for 20 s, begin again, and end
it.
"""

import subprocess
import sys

import numpy as np
import pytest

from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.view.captions import run_caption
from aerodima.workbench.view.hand_drive import HEADING_NOW, SPEED, SPEED_NOW, STEERING, TIME_NOW

pytestmark = [pytest.mark.realtime, pytest.mark.nightly]

QUICK = ("--set", "simulation.step=0.004", "--set", "simulation.log_rate=250")
VALUE = "viewer.gui_controllers[name]?.getValue()"
"""What the slider of that name says, in Meshcat's page."""
PATIENCE = 120_000.0
"""ms: a computer with other work simulates a second in several."""
DRAW_NO_MORE = "() => { viewer.renderer.render = () => {}; }"
"""Once the car is there: a browser that draws in software would leave the simulation no computer to
run on."""


class Driver:
    """A page of the car, and what is pressed on it.

    Args:
        page: of the browser.
        folder: where the logs go.
    """

    def __init__(self, page, folder):
        self.page = page
        self.log = folder / "by_hand.parquet"
        command = [sys.executable, "-P", "-m", "aerodima", "play", *QUICK, "--out", str(self.log)]
        self.process = subprocess.Popen(
            command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def open(self):
        """Goes to the address that the program says; the car is driven from then on."""
        page = self.page
        address = next(line for line in self.process.stderr if line.startswith("watch: "))
        page.goto(address.removeprefix("watch: ").strip(), timeout=PATIENCE)
        self.until(TIME_NOW, "> 0")
        page.wait_for_function("() => viewer.renderer.info.render.triangles > 0", timeout=PATIENCE)
        page.evaluate(DRAW_NO_MORE)

    def press(self, key, times=1):
        for _ in range(times):
            self.page.keyboard.press(key)

    def until(self, slider, condition):
        """Waits until the slider says so, however slowly simulated time passes."""
        self.page.wait_for_function(f"name => {VALUE} {condition}", arg=slider, timeout=PATIENCE)

    def says(self, slider):
        return float(self.page.evaluate(f"name => {VALUE}", slider))


@pytest.fixture
def driver(page, tmp_path):
    driver = Driver(page, tmp_path)
    try:
        driver.open()
        yield driver
    finally:
        driver.process.kill()
        driver.process.wait()


def test_keys_drive_for_twenty_seconds_begin_again_and_end(driver):
    driver.press("ArrowUp", 8)
    driver.until(SPEED, "=== 2")
    driver.until(SPEED_NOW, "> 1.7")
    driver.press("ArrowLeft", 3)
    driver.until(STEERING, "=== 9")
    driver.until(HEADING_NOW, "> 45")
    driver.press("ArrowRight", 6)
    driver.until(STEERING, "=== -9")
    driver.until(HEADING_NOW, "< -45")
    driver.press("Space")
    driver.until(STEERING, "=== 0")
    driver.press("ArrowDown", 8)
    driver.until(SPEED_NOW, "< 0.5")
    driver.until(TIME_NOW, "> 20")
    driver.press("KeyR")
    driver.until(TIME_NOW, "< 10")
    assert driver.says(HEADING_NOW) == pytest.approx(0.0, abs=2.0)
    driver.press("ArrowUp", 8)
    driver.until(SPEED_NOW, "> 1")
    driver.press("Escape")
    said, _ = driver.process.communicate(timeout=PATIENCE / 1000.0)
    assert driver.process.returncode == 0
    assert said.count("log: ") == 2

    first, second = (read_run_log(driver.log.with_stem(stem)) for stem in ("by_hand", "by_hand_2"))
    assert first.time[-1] > 20.0
    assert np.degrees(np.ptp(first.signal("steering_command_rad"))) == pytest.approx(18.0)
    assert np.max(first.signal("yaw_truth_rad")) > np.radians(45.0)
    assert np.min(first.signal("yaw_truth_rad")) < np.radians(-45.0)
    assert abs(second.signal("yaw_truth_rad")[0]) < 1e-3
    assert not second.signal("steering_command_rad").any()
    assert "driven by hand (simulation)" in run_caption(first).text
